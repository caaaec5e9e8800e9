"""Where a physics-informed fit starts: the waves of the scan, by what data and prior say of them together.

Noise as large as the motion, or a sampling that does not tell a frequency from its alias, leaves several waves that
are nearly as good. All of these are then fitted, and the posterior of the fits decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench import Problem
from methods.starts.reach import expected_rate, resolved_cycles
from methods.starts.waves import Guess

DETOURS = (1.0, 1.6, 0.625)
"""Where a system of several modes is started again: the dominant wave may be a high or a low one."""
LOUD = 0.4
"""Share of the data that plain damped waves leave beyond which noise is taken to be as large as the motion."""
RIVALS = 6.0
"""A wave whose minus log posterior is within this of the best is fitted too: odds of 400 to 1."""


@dataclass(frozen=True)
class Starts:
    """Guesses, best first; how many of them are fitted in any case; the others only after a bad fit."""

    guesses: list[Guess]
    rivals: int = 1


def starts(problem: Problem, waves: Sequence[Guess], left: float) -> Starts:
    """The waves of the scan, which leave ``left`` of the data; or the dominant one and detours for several modes."""
    n_dof, loud = problem.system.n_dof, left > LOUD
    if n_dof > 1:
        return Starts([replace(waves[0], omega=waves[0].omega * by, left=left, firm=loud) for by in DETOURS])
    values = np.zeros(1)
    if problem.system.linear:
        values = np.array([_minus_log_posterior(problem, wave) for wave in waves])
        order = np.argsort(values, kind="stable")
        waves, values = [waves[i] for i in order], values[order]
    detours = [replace(waves[0], omega=waves[0].omega * by) for by in DETOURS[1:]]
    guesses = [replace(g, firm=loud or alias(problem, g)) for g in [*waves, *detours]]
    return Starts(guesses, int(np.sum(values <= values[0] + RIVALS)))


def alias(problem: Problem, guess: Guess) -> bool:
    """Whether a wave is above half the sampling rate."""
    return guess.omega > 2 * np.pi * max(resolved_cycles(record) for record in problem.records) * (1 + 1e-9)


def _minus_log_posterior(problem: Problem, wave: Guess) -> float:
    """At the best noise, of the wave's frequency alone: its decay is read from the grid too coarsely."""
    value = 0.5 * problem.n * np.log(max(wave.left, 1e-12))
    expected = expected_rate(problem)
    if expected is not None:
        centre, sd = expected
        value += 0.5 * ((0.5 * np.log(wave.omega**2 + wave.decay**2) - centre) / sd) ** 2
    return float(value)
