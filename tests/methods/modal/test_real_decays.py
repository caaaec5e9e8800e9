"""Overdamped masses whose fast decay the noise hides: two real poles are an answer."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Problem, Record, Status
from bench.entrants.registry import make_method
from bench.systems.linear import SDOF
from methods.modal.real_decays import real_decays

SLOW, FAST = 1.5, 5.2
TIMES = np.linspace(0, 10, 25)


def decay(times: np.ndarray) -> np.ndarray:
    """A unit displacement released at rest."""
    return np.asarray((FAST * np.exp(-SLOW * times) - SLOW * np.exp(-FAST * times)) / (FAST - SLOW))


@pytest.mark.parametrize("offset", [False, True])
def test_two_decays_are_found_almost_without_noise(offset: bool) -> None:
    samples = decay(TIMES)[None] + 0.3 * offset
    # as near as the grid of rates is fine
    assert real_decays(TIMES, samples, offset)[0] == pytest.approx([SLOW * FAST, SLOW + FAST], rel=0.12)


def test_a_vibration_and_a_decay_that_turns_its_sign_are_none() -> None:
    vibration, turning = np.exp(-0.2 * TIMES) * np.cos(3 * TIMES), np.exp(-SLOW * TIMES) - (-0.5) ** np.arange(25)
    assert np.all(np.isnan(real_decays(TIMES, np.stack([vibration, turning]), False)))


@pytest.mark.parametrize("name", ["matrix_pencil", "iqml"])
def test_noise_that_turns_the_sign_of_the_fast_pole_is_no_failure(name: str) -> None:
    rng, samples = np.random.default_rng(3), decay(TIMES)
    noise = np.sqrt(np.mean(samples**2) / 1000)
    problems = [
        Problem(SDOF(), (Record((Channel(TIMES, samples + noise * rng.standard_normal(25)),)),)) for _ in range(40)
    ]
    estimates = make_method(name, {}).identify_many(problems, [np.random.default_rng(i) for i in range(40)])
    assert {e.status for e in estimates} == {Status.OK}
    quantity, inside, errors = SDOF().quantity("k_over_m"), 0, []
    for estimate in estimates:
        marginal = estimate.marginal(quantity)
        low, high = marginal.interval(0.95)
        inside += low <= SLOW * FAST <= high
        errors.append(np.log(marginal.value / (SLOW * FAST)))
    # the bound on its logarithm, the initial state unknown, is 0.36
    assert inside >= 32
    assert np.sqrt(np.mean(np.square(errors))) < 1.3 * 0.36
