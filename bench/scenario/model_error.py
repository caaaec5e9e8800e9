"""Data of another system than the one that is fitted: friction, a cubic spring, a second mode.

Methods assume one mass with a viscous damper and a linear spring, and these kinds of disturbance give them the
motion of something else. The truth of m, c and k is what the two have in common: the viscous part of the damping, the
stiffness at small amplitude, the first mode. Sizes are relative to the spring's force at the amplitude of the
undamped motion, ``A = √(x0² + m v0² / k)``. One mass in free vibration only, for a force has no such amplitude.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bench.contract.problem import Force, InitialState
from bench.scenario.disturbance import Disturbance
from bench.scenario.truth import closed_form, integrated_response
from bench.systems import System, make_system

SMOOTHING = 0.005
"""Speed below which friction is smoothed, over the largest speed of the undamped motion."""
FREQUENCY_RATIO = 2.7
"""Natural frequency of the second mode over that of the first; no whole number, so it is not a harmonic."""


def amplitude(p: Mapping[str, float], start: InitialState) -> float:
    """Return the amplitude (m) of the motion without damping."""
    x0, v0 = float(start.displacement[0]), float(start.velocity[0])
    return math.hypot(x0, v0 * math.sqrt(p["m"] / p["k"]))


class AddedFriction(Disturbance):
    """Dry friction of ``size`` times the largest force of the spring, beside the viscous damping.

    Alone it takes ``4 size`` of the first amplitude in each period (Inman, Engineering Vibration, section 1.10).
    """

    kind, allowed, meaning = "added_friction", (0.0, 0.25), "friction over the spring's force at the amplitude"
    free = one_mass = True

    def response(
        self, system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
    ) -> np.ndarray:
        size = amplitude(p, start)
        speed = SMOOTHING * size * math.sqrt(p["k"] / p["m"])
        rubbing = make_system("coulomb", {"smoothing_velocity": speed})
        return integrated_response(rubbing, {**p, "mu": self.size * p["k"] * size}, start, times, method="LSODA")


class CubicSpring(Disturbance):
    """A hardening spring, ``k x (1 + size (x/A)²)``: the truth of k is the stiffness at small amplitude."""

    kind, allowed, meaning = "cubic_spring", (0.0, 10.0), "cubic over linear force of the spring at the amplitude"
    free = one_mass = True

    def response(
        self, system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
    ) -> np.ndarray:
        cubic = self.size * p["k"] / amplitude(p, start) ** 2
        return integrated_response(make_system("duffing", {}), {**p, "k3": cubic}, start, times)


class SecondMode(Disturbance):
    """A second mode in the sensor's signal, released at ``size`` times the amplitude of the first.

    The motion of a point of a linear structure is the sum of its modes; this one has the same damping ratio and
    :data:`FREQUENCY_RATIO` times the frequency. The truth of k/m and c/m is the first mode's.
    """

    kind, allowed, meaning = "second_mode", (0.0, 1.0), "amplitude of the second mode over that of the first"
    free = one_mass = True

    def start(self, system: System, p: Mapping[str, float], start: InitialState) -> InitialState:
        return InitialState(start.displacement + self.size * amplitude(p, start), start.velocity)

    def response(
        self, system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
    ) -> np.ndarray:
        first = closed_form(p, float(start.displacement[0]), float(start.velocity[0]), times)
        faster = {"m": p["m"], "c": p["c"] * FREQUENCY_RATIO, "k": p["k"] * FREQUENCY_RATIO**2}
        return (first + closed_form(faster, self.size * amplitude(p, start), 0.0, times))[None]
