"""Doubt of a regression's answer: the most likely values by another optimiser, records that fool differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from bench import Channel, Estimate, Identifier, InitialState, Problem, Record, Status
from bench.scenario.truth import closed_form
from bench.systems import SDOF
from methods.regression.equation import Regression
from methods.regression.hausman import most_likely
from methods.regression.ls import LS
from methods.regression.rls import RLS
from methods.regression.smoothing import spline_fits

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table


def decay(samples: int, snr: float, plant: dict[str, float] = PLANT, duration: float = 10.0, seed: int = 4) -> Problem:
    times = np.linspace(0.0, duration, samples)
    y = closed_form(plant, 1.0, 0.0, times)
    noise = np.sqrt(np.mean(y**2) * 10.0 ** (-snr / 10.0))
    y = y + noise * np.random.default_rng(seed).standard_normal(samples)
    start = InitialState(np.array([1.0]), np.array([0.0]))
    return Problem(SDOF(), (Record((Channel(times, y),), (), start),))


def fit(method: Identifier, problem: Problem) -> Estimate:
    return method.identify(problem, np.random.default_rng(0))


@pytest.mark.parametrize("ratio", [0.09, 0.8, 1.3])
def test_the_most_likely_values_are_those_of_least_squares_on_the_closed_form(ratio: float) -> None:
    plant = {"m": 2.0, "c": 2.0 * ratio * np.sqrt(60.0), "k": 30.0}
    problem = decay(40, 20.0, plant, 4.0)
    channel = problem.records[0].channels[0]

    def misfit(groups: np.ndarray) -> np.ndarray:
        p = {"m": 1.0, "k": groups[0], "c": groups[1]}
        return np.asarray(closed_form(p, 1.0, 0.0, channel.times) - channel.values)

    expected = least_squares(misfit, [15.0, plant["c"] / 2.0], xtol=1e-12, ftol=1e-12).x
    regression = Regression.of([problem])
    np.testing.assert_allclose(most_likely(regression, spline_fits(regression))[0], expected, rtol=1e-3)


@pytest.mark.parametrize("method", [LS(), RLS()])
def test_a_bias_beyond_the_interval_is_said(method: Identifier) -> None:
    """Four samples a radian and 20 dB: noise adds ``2 sigma²/h²`` to the second difference, some 30 % of k/m."""
    estimate = fit(method, decay(100, 20.0))
    assert estimate.status is Status.OK
    assert "biased estimate" in estimate.message
    assert "k_over_m" in estimate.message


def test_smoothing_is_not_doubted_there() -> None:
    assert fit(LS(derivative="spline"), decay(100, 20.0)).message == ""


def test_an_interval_that_holds_the_bias_is_not_doubted() -> None:
    """At 40 dB and 100 samples the bias of differences, ``w² h²/12`` and ``2 sigma²/h²``, is half a per cent."""
    assert fit(LS(), decay(100, 40.0)).message == ""


@pytest.mark.parametrize("method", [LS(bootstrap=20), RLS(bootstrap=20)])
def test_differences_of_noise_alone_are_no_estimate(method: Identifier) -> None:
    """At 1000 samples noise adds ``2 sigma²/h²``, thirty times k/m: no answer, and what to do instead."""
    estimate = fit(method, decay(1000, 20.0))
    assert estimate.status is Status.DIVERGED
    assert "decimate or smooth the samples" in estimate.message


def test_smoothing_away_a_fast_decay_is_said() -> None:
    """Above critical damping the fast pole lives in a few noisy samples, and a smoothing spline has none of it."""
    overdamped = {"m": 2.0, "c": 2.4 * np.sqrt(60.0), "k": 30.0}
    answers = [fit(LS(derivative="spline"), decay(60, 20.0, overdamped, 5.0, seed)) for seed in range(6)]
    wrong = [e for e in answers if e.groups is not None and e.groups.mean[0] < 0.7 * 15.0]
    assert len(wrong) >= 3
    assert sum("biased estimate" in e.message for e in wrong) >= len(wrong) - 1
