"""Model classes of a measured record, as sums of terms: what is known of each, and what they have in common."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from bench.records.dominant_frequency import dominant_frequency
from bench.systems.sums import GROUPS, TERMS, Sum

TIED = 10.0
"""Difference of scores below which a class is as good as the chosen one: evidence beyond it is very strong (R. E. Kass,
A. E. Raftery, J. Am. Stat. Assoc. 90:773, 1995, section 3.2)."""
FRACTION = 0.01
"""Smoothing velocity over the root mean square speed.

Per cycle of amplitude V of the speed ``mu tanh(v/v_s)`` takes less work than Coulomb's friction by the part
``(π²/24) (v_s/V)²`` (from the integral of ``u (1 - tanh u)``, π²/24, about each of the turns). With a hundredth that is
1 in 50 000 at the mean amplitude, and below 1 % until the amplitude has fallen to a twentieth of it. A smaller
one would make the motion stiffer, at a rate of ``mu / (m v_s)``. What the smoothing cannot do is stick: a body that
friction holds off its rest creeps there, at up to v_s.
"""
PART_OF_PERIOD = 0.25
"""Length of the local polynomials over the strongest period: a cubic has the slope of a sine there to 0.1 %."""
ROUNDING = 1e-9
"""A speed of less than this part of the record's size in its time is none."""


@dataclass(frozen=True, eq=False)
class ModelClass:
    """One class fitted to records.

    Attributes:
        name: Its name for people.
        system: The sum of its terms, without those that came out negative.
        parameters: Values in SI units, over the mass where no force determines it; means over the records.
        start: Displacement and velocity at time 0 of the first record.
        criterion: Information criterion less that of the best class.
        criterion_error: Standard error of this difference.
        score: Evidence against the class, with the odds against further terms; the lowest is chosen.
        left: Root mean square of the residuals over the amplitude, which is half the range of the samples.
        zero: The one-sided 95 % limit, over the mass, of each coefficient of damping that the class lacks.
        told_apart: Whether the records tell it from the chosen class.
    """

    name: str
    system: Sum
    parameters: Mapping[str, float]
    start: tuple[float, float]
    criterion: float
    criterion_error: float
    score: float
    left: float
    zero: Mapping[str, float]
    told_apart: bool = False


@dataclass(frozen=True, eq=False)
class ClassComparison:
    """Classes that were fitted to records, the chosen one first."""

    classes: Sequence[ModelClass]

    @property
    def chosen(self) -> ModelClass:
        """Return the class with the best score."""
        return self.classes[0]

    @property
    def tied(self) -> list[ModelClass]:
        """Return the other classes that are as good."""
        return [model for model in self.classes[1:] if not model.told_apart]

    def variance(self, quantity: str) -> float:
        """Return the mean square of a quantity's logarithm about the chosen class, over the classes that are as good.

        Weights are posterior probabilities of the classes that have the quantity (J. A. Hoeting and others, Stat. Sci.
        14:382, 1999); 0 where the chosen class has it not.
        """
        having = [m for m in (self.chosen, *self.tied) if quantity in {q.name for q in m.system.quantities}]
        if not having or having[0] is not self.chosen:
            return 0.0
        values = [float(m.system.quantity(quantity).value({"m": 1.0, **m.parameters})) for m in having]
        weights = np.exp([(self.chosen.score - m.score) / 2.0 for m in having])
        logs = np.log(np.maximum(values, 1e-300) / max(values[0], 1e-300))
        return float(np.sum(weights * logs**2 * (np.array(values) > 0)) / np.sum(weights))


def without(system: Sum, zero: Collection[str]) -> Sum:
    """Return the sum without the terms of some parameters; one of them stays where nothing else is left."""
    kept = tuple(term for term in system.terms if TERMS[term].parameters[0].name not in zero)
    return Sum(kept or system.terms, system.smoothing_velocity, system.fixed, system.bias_sign)


def unit_over_mass(name: str) -> str:
    """Return the unit of a parameter of a sum over the mass."""
    return next((group.unit for group in GROUPS if group.name == f"{name}_over_m"), "")


def smoothing_velocity(times: np.ndarray, values: np.ndarray, measures: str = "displacement") -> float:
    """Choose a smoothing velocity (m/s) for the friction in a record: ``FRACTION`` of its root mean square speed.

    The speed of displacements is the slope of local cubics (A. Savitzky, M. Golay, Anal. Chem. 36:1627, 1964) over a
    part of the strongest period, on the record at even times; noise of a tenth of the motion changes it by little. That
    of accelerations is the one of a sine of the strongest frequency.
    """
    even = np.linspace(times[0], times[-1], times.size)
    step = float(even[1] - even[0])
    frequency = dominant_frequency(times, values)
    x = np.interp(even, times, values)
    if measures == "displacement":
        most = x.size - 1 + x.size % 2
        window = min(max(2 * int(0.5 * PART_OF_PERIOD / (frequency * step)) + 1, 5), most)
        speed = float(np.sqrt(np.mean(savgol_filter(x, window, min(3, window - 1), deriv=1, delta=step) ** 2)))
        unit = step * x.size
    else:
        unit = 1.0 if measures == "velocity" else 2 * np.pi * frequency
        speed = float(np.std(x)) / unit
    # what rounding alone would give is no speed: the record's size in its time stands in for it, so never zero
    still = (float(np.max(np.abs(x))) or 1.0) / unit
    return FRACTION * (speed if speed > ROUNDING * still else still)
