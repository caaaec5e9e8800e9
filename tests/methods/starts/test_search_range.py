"""How far a scan looks, and what it makes of fast motions and long records, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, InitialState, Prior, Problem, Record
from bench.systems import SDOF
from methods.pinn.collocation import Collocation
from methods.starts.search_range import most_cycles
from methods.starts.waves import scan

TRUE = {"m": 1.3, "c": 0.4, "k": 1.3 * 6.0**2}
START = InitialState(np.array([1.0]), np.array([2.0]))


def motion(times: np.ndarray) -> np.ndarray:
    """Free vibration in closed form: ``e^(-d t) (x0 cos w t + (v0 + d x0) / w sin w t)``."""
    decay = TRUE["c"] / (2 * TRUE["m"])
    rate = np.sqrt(TRUE["k"] / TRUE["m"] - decay**2)
    return np.asarray(np.exp(-decay * times) * (np.cos(rate * times) + (2.0 + decay) / rate * np.sin(rate * times)))


def problem(times: np.ndarray, known: bool, sd: float = 0.5) -> Problem:
    values = motion(times) + 0.02 * np.random.default_rng(1).standard_normal(times.size)
    prior = Prior({"m": 1.3, "c": 0.5, "k": 40.0}, {"m": 0.02, "c": 1.0, "k": sd})
    return Problem(SDOF(), (Record((Channel(times, values),), (), START if known else None),), prior)


def test_the_reach_is_half_the_sampling_rate_or_three_standard_deviations_of_the_prior() -> None:
    step = 0.6
    given = problem(step * np.arange(30), known=False)
    expected = np.sqrt(40.0 / 1.3) * np.exp(0.5 * np.hypot(0.5, 0.02) * 3.0) / (2 * np.pi)
    assert most_cycles(given) == pytest.approx(np.ceil(expected))
    assert most_cycles(given, limit=0.7) == 0.7
    assert most_cycles(problem(0.01 * np.arange(30), known=False)) == pytest.approx(50.0)


def test_a_motion_beyond_half_the_sampling_rate_is_found_where_start_and_prior_tell_it() -> None:
    """1.6 samples a period; a slower motion of 0.6 of the frequency goes through nearly the same samples."""
    given = problem(2 * np.pi / 6.0 / 1.6 * np.arange(35), known=True)
    marginal = Collocation().identify(given, np.random.default_rng(0)).marginal(given.system.quantity("k_over_m"))
    assert marginal.value == pytest.approx(36.0, rel=0.01)


def test_a_long_record_is_scanned_by_samples_that_have_no_alias() -> None:
    """10,000 samples, 3.1 a period: every tenth of them would show another frequency."""
    times = 2 * np.pi / 6.0 / 3.1 * np.arange(10_000)
    values = np.cos(6.0 * times)
    guesses, left = scan(Problem(SDOF(), (Record((Channel(times, values),)),)))
    assert guesses[0].omega == pytest.approx(6.0, rel=1e-4)
    assert left < 0.3
