"""The problems that methods are checked on: a system that is in no table, ordinary data of it, and difficult ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.contract.prior import Prior
from bench.contract.problem import Channel, Force, InitialState, Problem, Record
from bench.scenario.truth import closed_form, matrix_exponential_response
from bench.systems.linear import SDOF

PLANT = {"m": 1.4, "c": 0.7, "k": 11.0}
START = (0.9, 0.4)
"""Displacement (m) and velocity (m/s) of the plant at time 0."""
NOISE_M = 0.03


def problem(
    times: np.ndarray | None = None, noise: float = NOISE_M, seed: int = 5, start: bool = True, dead: bool = False
) -> Problem:
    """Return free vibration of the plant with Gaussian noise (m); ``dead``: of a sensor that shows nothing."""
    times = np.linspace(0.0, 8.0, 25) if times is None else times
    rng = np.random.default_rng(seed)
    values = closed_form(PLANT, *START, times) + noise * rng.standard_normal(times.size)
    channel = Channel(times, np.zeros(times.size) if dead else values)
    state = InitialState(np.array(START[:1]), np.array(START[1:])) if start else None
    prior = Prior({"m": 1.41, "c": 0.4, "k": 14.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
    return Problem(SDOF(), (Record((channel,), (), state),), prior)


def without_prior() -> Problem:
    """Return the ordinary data without a prior."""
    given = problem()
    return Problem(given.system, given.records, None)


def forced() -> Problem:
    """Return the plant under a known sine force (3 N, 2 rad/s), with little noise and no prior."""
    times, fine = np.linspace(0.0, 8.0, 40), np.linspace(0.0, 8.0, 161)
    force = Force(fine, 3.0 * np.sin(2.0 * fine))
    start = InitialState(np.array([0.5]), np.array([0.0]))
    clean = matrix_exponential_response(SDOF(), PLANT, start, times, (force,))[0]
    channel = Channel(times, clean + 1e-3 * np.random.default_rng(1).standard_normal(40))
    return Problem(SDOF(), (Record((channel,), (force,), start),))


HARD: dict[str, Callable[[], Problem]] = {
    "dead channel": lambda: problem(dead=True),
    "dead channel, unknown initial state": lambda: problem(dead=True, start=False),
    "five samples": lambda: problem(np.linspace(0.0, 8.0, 5)),
    "irregular times": lambda: problem(np.sort(np.random.default_rng(3).uniform(0.0, 8.0, 25)), start=False),
    "huge noise": lambda: problem(noise=3.0, start=False),
    "one cycle only": lambda: problem(np.linspace(0.0, 2.0, 25), start=False),
}
