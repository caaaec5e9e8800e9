"""Logarithmic decrement: dense exact records, its reading by closed form, noise about zero, what it declines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench import Channel, Estimate, Force, InitialState, InputError, Problem, Record, Status
from bench.scenario.truth import closed_form
from bench.systems import SDOF, Chain, Duffing
from methods.modal.log_decrement import LogDecrement, Swings, extremes, resting_level

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table


def free(times: np.ndarray, p: dict[str, float] = PLANT, noise: float = 0.0, seed: int = 1) -> Problem:
    values = closed_form(p, 0.8, 0.5, times) + noise * np.random.default_rng(seed).standard_normal(times.size)
    return Problem(SDOF(), (Record((Channel(times, values),)),))


def fit(problem: Problem, **settings: float) -> Estimate:
    return LogDecrement(**settings).identify(problem, np.random.default_rng(0))  # type: ignore[arg-type]


def groups(problem: Problem, **settings: float) -> np.ndarray:
    estimate = fit(problem, **settings)
    assert estimate.groups is not None, estimate.message
    return estimate.groups.mean


@pytest.mark.parametrize("p", [PLANT, {"m": 2.0, "c": 0.05, "k": 5.0}, {"m": 1.0, "c": 1.2, "k": 30.0}])
@pytest.mark.parametrize("uneven", [False, True])
def test_a_dense_exact_record_gives_the_groups(p: dict[str, float], uneven: bool) -> None:
    """Parabola and straight line over steps h err by parts of (ωh)², which is below 2e-3 here (ω below 5.5 rad/s)."""
    times = np.linspace(0.0, 10.0, 1500)
    if uneven:
        times[1:-1] += np.random.default_rng(2).uniform(-0.3, 0.3, 1498) * times[1]
    np.testing.assert_allclose(groups(free(times, p)), [p["k"] / p["m"], p["c"] / p["m"]], rtol=2e-3)


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
    at, heights = extremes(on, np.cos(on)[None], np.array([[3]]))
    np.testing.assert_allclose([at[0, 0], heights[0, 0]], [0.0, 1.0], atol=1e-12)
    between = (np.arange(-3, 3) + 0.5) * h
    at, heights = extremes(between, -np.cos(between)[None], np.array([[2]]))
    expected = np.cos(h / 2) + (np.cos(h / 2) - np.cos(1.5 * h)) / 8
    np.testing.assert_allclose([at[0, 0], heights[0, 0]], [0.0, -expected], atol=1e-12)


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


def test_the_start_is_not_used() -> None:
    problem = free(np.linspace(0.0, 10.0, 25), noise=0.05)
    told = InitialState(np.array([7.0]), np.array([-3.0]))
    record = replace(problem.records[0], initial_state=told)
    here, there = fit(problem).groups, fit(replace(problem, records=(record,))).groups
    assert here is not None
    assert there is not None
    np.testing.assert_array_equal(here.mean, there.mean)
    np.testing.assert_array_equal(here.covariance, there.covariance)


def test_a_growing_vibration_is_said_to_grow() -> None:
    """``e^(+σt) cos(ωt)`` read backwards: c/m is negative, and its size as for a decay."""
    times = np.linspace(0.0, 10.0, 1500)
    y = np.exp(0.1 * times) * np.cos(3.0 * times)
    estimate = fit(Problem(SDOF(), (Record((Channel(times, y),)),)))
    assert estimate.groups is not None
    np.testing.assert_allclose(estimate.groups.mean, [9.01, -0.2], rtol=2e-3)
    assert "negative" in estimate.message


@pytest.mark.parametrize("level", [0.0, 0.1, -3.0])
def test_an_offset_is_taken_out(level: float) -> None:
    """About its level a dense exact decay alternates in a geometric sequence, which Aitken's formula sums exactly."""
    times = np.linspace(0.0, 10.0, 1500)
    y = closed_form(PLANT, 0.8, 0.5, times) + level
    assert resting_level(times, y[None], 0.2)[0] == pytest.approx(level, abs=1e-4)
    problem = Problem(SDOF(), (Record((Channel(times, y, offset=True),)),))
    np.testing.assert_allclose(groups(problem), [9.0 / 1.3, 0.6 / 1.3], rtol=2e-3)


def test_a_clipped_top_is_read_as_it_is() -> None:
    at, heights = extremes(np.arange(5.0), np.array([[-1.0, 2.0, 2.0, 2.0, -1.0]]), np.array([[2]]))
    np.testing.assert_array_equal([at[0, 0], heights[0, 0]], [2.0, 2.0])


def test_no_bootstrap_no_uncertainty() -> None:
    estimate = fit(free(np.linspace(0.0, 10.0, 25), noise=0.05), bootstrap=0)
    assert estimate.groups is not None
    assert estimate.groups.covariance is None


def test_what_it_declines() -> None:
    times = np.linspace(0.0, 5.0, 25)
    channel, method = Channel(times, np.cos(times)), LogDecrement()
    push = Force(times, np.sin(times))
    two = (channel, Channel(times, np.cos(times), dof=1))
    declined = {
        "force": Problem(SDOF(), (Record((channel,), (push,)),)),
        "DOF": Problem(Chain(2), (Record((channel,)),)),
        "channel": Problem(Chain(2), (Record(two),)),
        "linear": Problem(Duffing(), (Record((channel,)),)),
        "one record": Problem(SDOF(), (Record((channel,)), Record((channel,)))),
    }
    for word, problem in declined.items():
        assert word in (method.objection(problem) or ""), word


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="smallest"):
        LogDecrement(smallest=1.5)
    with pytest.raises(InputError, match="bootstrap"):
        LogDecrement(bootstrap=-1)
