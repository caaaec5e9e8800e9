"""Logarithmic decrement: dense exact records, its reading by closed form, noise about zero, what it declines."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Estimate, Problem, Record, Status
from bench.scenario.truth import closed_form
from bench.systems import SDOF
from methods.modal.log_decrement import LogDecrement, Swings, extremes, resting_level

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table


def free(times: np.ndarray, p: dict[str, float] = PLANT, noise: float = 0.0, seed: int = 1) -> Problem:
    values = closed_form(p, 0.8, 0.5, times) + noise * np.random.default_rng(seed).standard_normal(times.size)
    return Problem(SDOF(), (Record((Channel(times, values),)),))


def fit(problem: Problem, **settings: float) -> Estimate:
    return LogDecrement(**settings).identify(problem, np.random.default_rng(0))


def groups(problem: Problem, **settings: float) -> np.ndarray:
    estimate = fit(problem, **settings)
    assert estimate.groups is not None, estimate.message
    return estimate.groups.mean


def test_crossings_of_a_cosine_lie_at_odd_quarters_of_its_period() -> None:
    times = np.linspace(0.0, 10.0, 400)
    crossings = Swings.of(times, np.cos(2.0 * times)[None], 0.2).crossings[0]
    np.testing.assert_allclose(crossings, (np.arange(6) + 0.5) * np.pi / 2, atol=1e-4)


@pytest.mark.parametrize("h", [0.3, 1.2])
def test_the_top_of_the_parabola_by_closed_form(h: float) -> None:
    """About a sample on the top of a cosine the parabola's top is 1. Between two equal samples at ±h/2, with a third at
    3h/2, the parabola ``a t² + c`` through them tops at ``c = cos(h/2) + (cos(h/2) - cos(3h/2))/8``.
    """
    on = np.arange(-3, 4) * h
    place, heights = extremes(on, np.cos(on)[None], np.array([[3]]))
    np.testing.assert_allclose([place[0, 0], heights[0, 0]], [0.0, 1.0], atol=1e-12)
    between = (np.arange(-3, 3) + 0.5) * h
    place, heights = extremes(between, -np.cos(between)[None], np.array([[2]]))
    expected = np.cos(h / 2) + (np.cos(h / 2) - np.cos(1.5 * h)) / 8
    np.testing.assert_allclose([place[0, 0], heights[0, 0]], [0.0, -expected], atol=1e-12)


def test_noise_about_zero_makes_no_crossings() -> None:
    """The sign turns many times about each zero; the crossings counted are those of the motion."""
    times = np.linspace(0.0, 10.0, 2000)
    problem = free(times, {"m": 1.0, "c": 0.02, "k": 9.0}, noise=0.03)
    y = problem.records[0].channels[0].values
    turns = np.count_nonzero(np.diff(np.sign(y)))
    crossings = Swings.of(times, y[None], 0.2).crossings[0]
    half_period = np.pi / np.sqrt(9.0 - 0.01**2)
    assert turns > 2 * crossings.size
    np.testing.assert_allclose(np.diff(crossings), half_period, rtol=0.02)


def test_the_reading_stops_at_a_missing_swing() -> None:
    """A second burst after a pause is not joined to the first."""
    times = np.linspace(0.0, 20.0, 2000)
    y = np.sin(4.0 * times) * np.where((times < 6.0) | (times > 12.0), 1.0, 0.01)
    crossings = Swings.of(times, y[None], 0.2).crossings[0]
    crossings = crossings[np.isfinite(crossings)]
    np.testing.assert_allclose(crossings, np.arange(1, crossings.size + 1) * np.pi / 4, atol=1e-3)
    assert crossings[-1] < 6.1


@pytest.mark.parametrize(
    "problem",
    [
        free(np.linspace(0.0, 1.0, 40)),
        free(np.linspace(0.0, 10.0, 40), {"m": 1.0, "c": 9.0, "k": 9.0}),
        free(np.linspace(0.0, 10.0, 4)),
    ],
    ids=["half a cycle", "overdamped", "four samples"],
)
def test_too_little_to_read_is_a_sentence(problem: Problem) -> None:
    estimate = fit(problem)
    assert estimate.status is Status.DIVERGED
    assert "crossings" in estimate.message


@pytest.mark.parametrize("level", [0.0, 0.1, -3.0])
def test_an_offset_is_taken_out(level: float) -> None:
    """About its level a dense exact decay alternates in a geometric sequence, which Aitken's formula sums exactly."""
    times = np.linspace(0.0, 10.0, 1500)
    y = closed_form(PLANT, 0.8, 0.5, times) + level
    assert resting_level(times, y[None], 0.2)[0] == pytest.approx(level, abs=1e-4)
    problem = Problem(SDOF(), (Record((Channel(times, y, offset=True),)),))
    np.testing.assert_allclose(groups(problem), [9.0 / 1.3, 0.6 / 1.3], rtol=2e-3)
