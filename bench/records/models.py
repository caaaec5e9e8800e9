"""The models that a measured record may be compared with, as sums of terms, and what of them the data set.

Nothing is fitted here.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import savgol_filter

from bench.records.strongest import strongest_frequency
from bench.systems.sums import Sum

VIBRATION = {
    "viscous": ("viscous", "spring"),
    "viscous + Coulomb": ("viscous", "spring", "coulomb"),
    "viscous + quadratic": ("viscous", "spring", "quadratic"),
    "viscous + Coulomb + quadratic": ("viscous", "spring", "coulomb", "quadratic"),
    "Duffing": ("viscous", "spring", "cubic"),
    "softening": ("viscous", "spring", "softening"),
    "pendulum": ("viscous", "pendulum"),
    "pendulum + Coulomb": ("viscous", "pendulum", "coulomb"),
    "pendulum + quadratic": ("viscous", "pendulum", "quadratic"),
    "pendulum + Coulomb + quadratic": ("viscous", "pendulum", "coulomb", "quadratic"),
}
"""Terms of what vibrates, from few to many; a pendulum damps viscously too."""
DRIVEN = {
    "no spring: viscous": ("viscous",),
    "no spring: viscous + Coulomb": ("viscous", "coulomb"),
    "no spring: viscous + Coulomb + bias": ("viscous", "coulomb", "bias"),
    "no spring: viscous + Coulomb - bias": ("viscous", "coulomb", "bias"),
}
"""Terms of what a force drives to and fro, and nothing pulls back: an axis of a machine."""

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


def candidates(forced: bool, angle: bool, smoothing_velocity: float = 0.01) -> dict[str, Sum]:
    """The models to compare, by names for people: those that vibrate and, where a force is known, driven axes.

    An ``angle`` is its own ``x/l`` (rad), so a pendulum's ``l`` is 1; of a path in metres it is a parameter.
    """
    found = {}
    for name, terms in {**VIBRATION, **(DRIVEN if forced else {})}.items():
        fixed = (("l", 1.0),) if angle and "pendulum" in terms else ()
        found[name] = Sum(terms, smoothing_velocity, fixed, -1 if name.endswith("- bias") else 1)
    return found


def smoothing_velocity(times: np.ndarray, values: np.ndarray) -> float:
    """A smoothing velocity (m/s) for the friction in a record of displacements: ``FRACTION`` of its speed.

    The speed is the root mean square slope of local cubics (A. Savitzky, M. Golay, Anal. Chem. 36:1627, 1964) over a
    part of the strongest period, on the record at even times; noise of a tenth of the motion changes it by little.
    """
    even = np.linspace(times[0], times[-1], times.size)
    step = float(even[1] - even[0])
    period = 1.0 / (strongest_frequency(times, values) * step)
    x = np.interp(even, times, values)
    most = x.size - 1 + x.size % 2
    window = min(max(2 * int(0.5 * PART_OF_PERIOD * period) + 1, 5), most)
    speeds = savgol_filter(x, window, min(3, window - 1), deriv=1, delta=step)
    speed = float(np.sqrt(np.mean(speeds**2)))
    # what rounding alone would give is no speed: the record's size in its time stands in for it, so never zero
    still = (float(np.max(np.abs(x))) or 1.0) / (step * x.size)
    return FRACTION * (speed if speed > ROUNDING * still else still)
