"""Model classes of a measured record, as sums of terms, and their comparison."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from bench.records.dominant_frequency import dominant_frequency
from bench.systems.sums import GROUPS, TERMS, Sum

TIED = 10.0
"""Difference of scores below which a class is tied with the selected one: evidence beyond it is very strong (R. E.
Kass, A. E. Raftery, J. Am. Stat. Assoc. 90:773, 1995, section 3.2)."""
FRACTION = 0.01
"""Ratio of the smoothing velocity v_s to the root mean square speed.

In a cycle of speed amplitude V, ``mu tanh(v/v_s)`` dissipates less energy than Coulomb friction by the fraction
``(π²/24) (v_s/V)²`` (the integral of ``u (1 - tanh u)`` at each turning point is π²/24). For a ratio of 0.01 this is
1 in 50 000 at the mean amplitude, and below 1 % until the amplitude has fallen to a twentieth of it. A smaller ratio
makes the differential equation stiffer, with a rate of ``mu / (m v_s)``. Smoothed friction cannot stick: a mass held
away from its equilibrium creeps at up to v_s.
"""
PART_OF_PERIOD = 0.25
"""Length of the local polynomials over the dominant period, for which a cubic has the slope of a sine to 0.1 %."""
ROUNDING = 1e-9
"""Speeds below this fraction of the record's amplitude over its duration are due to rounding."""


@dataclass(frozen=True, eq=False)
class ModelClass:
    """Model class fitted to records.

    Attributes:
        name: Display name.
        system: Sum of its terms, without damping terms whose estimate was negative.
        parameters: Values in SI units, over the mass if no force determines it; means over the records.
        start: Displacement and velocity at time 0 of the first record.
        criterion: Difference of the information criterion to that of the best class.
        criterion_error: Standard error of this difference.
        score: Evidence against the class including the penalty for additional terms; the lowest score is selected.
        left: Root mean square of the residuals over the standard deviation of the samples.
        zero: One-sided 95 % limit, over the mass, of each damping coefficient that the class lacks.
        told_apart: Whether the records distinguish it from the selected class.
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
    """Classes fitted to records, sorted by score; the first is selected."""

    classes: Sequence[ModelClass]

    @property
    def chosen(self) -> ModelClass:
        """The class with the best score."""
        return self.classes[0]

    @property
    def tied(self) -> list[ModelClass]:
        """The other classes, which the records do not distinguish from the selected one."""
        return [model for model in self.classes[1:] if not model.told_apart]

    def variance(self, quantity: str) -> float:
        """Return the variance of a quantity's logarithm between tied classes, about the value of the selected class.

        Weights are posterior probabilities of the classes (J. A. Hoeting and others, Stat. Sci. 14:382, 1999). It is 0
        for a quantity that the selected class does not have.
        """
        having = [m for m in (self.chosen, *self.tied) if quantity in {q.name for q in m.system.quantities}]
        if not having or having[0] is not self.chosen:
            return 0.0
        values = [float(m.system.quantity(quantity).value({"m": 1.0, **m.parameters})) for m in having]
        weights = np.exp([(self.chosen.score - m.score) / 2.0 for m in having])
        logs = np.log(np.maximum(values, 1e-300) / max(values[0], 1e-300))
        return float(np.sum(weights * logs**2 * (np.array(values) > 0)) / np.sum(weights))


def without(system: Sum, zero: Collection[str]) -> Sum:
    """Return the sum without the terms of the parameters in ``zero``, unchanged if no term would be left."""
    kept = tuple(term for term in system.terms if TERMS[term].parameters[0].name not in zero)
    return Sum(kept or system.terms, system.smoothing_velocity, system.fixed, system.bias_sign)


def unit_over_mass(name: str) -> str:
    """Return the unit of a parameter of a sum divided by the mass."""
    return next((group.unit for group in GROUPS if group.name == f"{name}_over_m"), "")


def smoothing_velocity(times: np.ndarray, values: np.ndarray, measures: str = "displacement") -> float:
    """Return the smoothing velocity (m/s) of friction for a record: ``FRACTION`` of its root mean square speed.

    The speed is computed from displacements by local cubics (A. Savitzky, M. Golay, Anal. Chem. 36:1627, 1964), and
    from accelerations as that of a sine of the dominant frequency.

    Args:
        times: Times (s), shape (n,).
        values: Samples, shape (n,).
        measures: Kind of the samples: displacement, velocity or acceleration.
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
    # The speed must not be zero, nor that of rounding errors: the amplitude over the duration replaces it.
    still = (float(np.max(np.abs(x))) or 1.0) / unit
    return FRACTION * (speed if speed > ROUNDING * still else still)
