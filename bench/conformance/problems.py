"""Problems for the checks of methods: ordinary and difficult data of a system that is in no table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.contract.prior import Prior
from bench.contract.problem import Channel, Force, InitialState, Problem, Record
from bench.scenario.truth import closed_form, matrix_exponential_response
from bench.systems.linear import SDOF

PLANT = {"m": 1.4, "c": 0.7, "k": 11.0}
START = (0.9, 0.4)
"""Displacement (m) and velocity (m/s) of the plant at time 0."""
PRIOR = Prior({"m": 1.41, "c": 0.4, "k": 14.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
TIMES = np.linspace(0.0, 8.0, 25)


def free_problem(
    times: np.ndarray = TIMES,
    noise: float = 0.03,
    seed: int = 5,
    known: bool = True,
    dead: bool = False,
    prior: Prior | None = PRIOR,
) -> Problem:
    """Return free vibration of the plant with Gaussian noise (m).

    Args:
        times: Sample times (s).
        noise: Standard deviation of the noise (m).
        seed: Seed of the noise.
        known: Whether the initial state is known.
        dead: Whether the sensor reads zero throughout.
        prior: The prior, if any.
    """
    rng = np.random.default_rng(seed)
    values = closed_form(PLANT, *START, times) + noise * rng.standard_normal(times.size)
    state = InitialState(np.array(START[:1]), np.array(START[1:])) if known else None
    channel = Channel(times.copy(), np.zeros(times.size) if dead else values)
    return Problem(SDOF(), (Record((channel,), (), state),), prior)


def forced_problem() -> Problem:
    """Return the plant under a known sine force (3 N, 2 rad/s), with little noise and no prior."""
    times, fine = np.linspace(0.0, 8.0, 40), np.linspace(0.0, 8.0, 161)
    force = Force(fine, 3.0 * np.sin(2.0 * fine))
    start = InitialState(np.array([0.5]), np.array([0.0]))
    clean = matrix_exponential_response(SDOF(), PLANT, start, times, (force,))[0]
    channel = Channel(times, clean + 1e-3 * np.random.default_rng(1).standard_normal(40))
    return Problem(SDOF(), (Record((channel,), (force,), start),))


DIFFICULT: Mapping[str, Mapping[str, Any]] = {
    "dead channel": {"dead": True},
    "dead channel, unknown initial state": {"dead": True, "known": False},
    "five samples": {"times": np.linspace(0.0, 8.0, 5)},
    "irregular times": {"times": np.sort(np.random.default_rng(3).uniform(0.0, 8.0, 25)), "known": False},
    "huge noise": {"noise": 3.0, "known": False},
    "one cycle only": {"times": np.linspace(0.0, 2.0, 25), "known": False},
}
"""Arguments of :func:`free_problem`, by the name of the check."""
