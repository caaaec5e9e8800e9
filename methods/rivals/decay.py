"""The problem as every package is given it: one free decay in natural units, on a time from -1 to 1.

With ``s = 2 t / duration - 1`` and omega the frequency of our start scan's wave, the equation of motion over omega² is

    ``(rate / omega)² u'' + (c/m / omega) (rate / omega) u' + (k/m / omega²) u = 0``,  ``rate = 2 / duration``,

so that its mean square is of order one, like that of the data, and stands in the loss with weight 1; so does a told
start, as ``u(-1) = x0`` and ``rate u'(-1) / omega = v0 / omega``. The scan is the one that :mod:`methods.pinn` starts
from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import Problem
from methods.pinn.starts import starts
from methods.starts.rounding import rounded
from methods.starts.waves import scan

COLLOCATION = 200
"""Points at which the equation of motion is asked for, evenly spaced over the record, its ends included."""
HIDDEN = (64, 64)
"""Units of the hidden layers."""
ADAM_RATE = 1e-3


@dataclass(frozen=True, eq=False)
class Decay:
    """The record and its start: ``times`` (n,) from -1 to 1, ``values`` (n,), ``told`` is (x0, v0 / omega) or None.

    ``logs`` are log(k/m) and log(c/m) to start from; ``speed`` is rate over omega.
    """

    times: np.ndarray
    values: np.ndarray
    told: tuple[float, float] | None
    omega: float
    logs: tuple[float, float]
    duration: float

    @property
    def speed(self) -> float:
        return 2.0 / (self.duration * self.omega)

    @property
    def stiffness_unit(self) -> float:
        """What log(k/m) is less by in units of omega."""
        return float(2.0 * np.log(self.omega))

    @property
    def damping_unit(self) -> float:
        """What log(c/m) is less by in units of omega."""
        return float(np.log(self.omega))


def decay_of(problem: Problem) -> Decay:
    """The free decay, to ten digits, with the best wave of the start scan. The problem is in natural units."""
    own = rounded(problem)
    guess = starts(own, *scan(own, forced=True, beyond=True)).guesses[0]
    record = own.records[0]
    channel, start = record.channels[0], record.initial_state
    told = None
    if start is not None:
        told = float(start.displacement[0]), float(start.velocity[0]) / guess.omega
    logs = float(np.log(guess.omega**2 + guess.decay**2)), float(np.log(2.0 * guess.decay))
    times = 2.0 * channel.times / record.duration - 1.0
    return Decay(times, channel.values, told, guess.omega, logs, record.duration)


def objection(problem: Problem) -> str | None:
    """Why the problem is not the free decay of one mass with k/m and c/m to find, in a sentence; None where it is."""
    if sorted(parameter.kind for parameter in problem.system.parameters) != ["damping", "mass", "stiffness"]:
        return "it needs one mass, one damping and one stiffness"
    return None
