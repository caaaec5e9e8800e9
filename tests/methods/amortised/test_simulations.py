"""Simulated records beside the closed form, mixtures beside scipy and quadrature, the likelihood beside integration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from bench import Channel, InitialState, Problem, Record
from bench.scenario.truth import closed_form
from bench.systems import SDOF
from methods.amortised.correction import log_likelihood
from methods.amortised.simulations import DECIBELS, SampleLayout, network_inputs, simulated, unit_responses
from methods.sampling.mixture import Mixture

TIMES = np.linspace(0.0, 1.0, 12)


@pytest.mark.parametrize("ratio", [0.003, 0.3, 0.999, 1.0, 1.3, 2.0])
def test_unit_responses_are_the_closed_form(ratio: float) -> None:
    omega = 11.0
    p = {"m": 2.0, "c": 4.0 * ratio * omega, "k": 2.0 * omega**2}
    even, odd = unit_responses(np.array([omega]), np.array([ratio]), TIMES)
    np.testing.assert_allclose(even[0], closed_form(p, 1.0, 0.0, TIMES), atol=1e-5)
    np.testing.assert_allclose(odd[0], closed_form(p, 0.0, 1.0, TIMES), atol=1e-6)


def test_simulated_records_have_the_stated_noise() -> None:
    """The clean motion comes from the closed form; the noise is drawn evenly in decibels."""
    layout = SampleLayout(40, 0.0, True)
    logs, values, starts = simulated(layout, 400, np.random.default_rng(3))
    computed = []
    for (frequency, ratio), y, (x0, v0) in zip(np.exp(logs), values, starts, strict=True):
        clean = closed_form({"m": 1.0, "c": 2 * ratio * frequency, "k": frequency**2}, x0, v0, layout.times)
        computed.append(10 * np.log10(np.mean(clean**2) / np.mean((y - clean) ** 2)))
    assert np.mean(computed) == pytest.approx(np.mean(DECIBELS), abs=3.0)
    assert np.std(computed) == pytest.approx((DECIBELS[1] - DECIBELS[0]) / np.sqrt(12), rel=0.1)


@pytest.mark.parametrize("known", [True, False])
def test_the_anchor_is_the_frequency_and_size_does_not_matter(known: bool) -> None:
    layout = SampleLayout(40, 0.0, known)
    omega = np.array([2 * np.pi * 5.2])
    even, odd = unit_responses(omega, np.array([0.02]), layout.times)
    start = np.array([[1.0, 9.0]]) if known else None
    y = even + 9.0 * odd
    computed = network_inputs(layout, y, start)
    assert abs(computed.anchor[0] - np.log(omega[0])) <= computed.step[0]
    other = network_inputs(layout, 1e-3 * y, None if start is None else 1e-3 * start)
    np.testing.assert_allclose(other.features, computed.features, atol=1e-5)


def mixture() -> Mixture:
    a, b = np.array([[0.5, 0.2], [0.2, 0.4]]), np.array([[0.1, -0.05], [-0.05, 0.3]])
    return Mixture(np.log([0.3, 0.7]), np.array([[0.0, 1.0], [-1.0, 0.5]]), np.linalg.cholesky(np.stack([a, b])))


@pytest.mark.parametrize("dof", [np.inf, 6.0])
def test_the_density_of_a_mixture_is_scipys(dof: float) -> None:
    computed, x = replace(mixture(), dof=dof), np.random.default_rng(0).standard_normal((5, 2))
    parts = zip(
        np.exp(computed.log_weights), computed.centres, computed.roots @ computed.roots.swapaxes(1, 2), strict=True
    )
    expected = sum(w * multivariate_t(m, s, df=dof).pdf(x) for w, m, s in parts)
    np.testing.assert_allclose(np.exp(computed.log_density(x)), expected)


def test_a_mixture_times_a_normal_is_the_normalised_product() -> None:
    computed, mean, covariance = mixture(), np.array([0.5, 0.0]), np.array([[0.3, 0.1], [0.1, 0.6]])
    axis = np.linspace(-5.0, 5.0, 201)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    product = np.exp(computed.log_density(grid)) * multivariate_normal(mean, covariance).pdf(grid)
    product /= product.sum() * (axis[1] - axis[0]) ** 2
    np.testing.assert_allclose(np.exp(computed.times(mean, covariance).log_density(grid)), product, atol=1e-6)


def test_draws_have_the_moments_of_the_mixture() -> None:
    draws = mixture().draw(100_000, np.random.default_rng(1))
    np.testing.assert_allclose(draws.mean(axis=0), [0.7 * -1.0, 0.3 * 1.0 + 0.7 * 0.5], atol=0.02)
    assert np.mean(draws[:, 0] ** 2) == pytest.approx(0.3 * 0.5 + 0.7 * (0.1 + 1.0), rel=0.02)


def record(start: InitialState | None) -> Problem:
    y = closed_form({"m": 1.0, "c": 1.0, "k": 60.0}, 1.0, 2.0, TIMES)
    y = y + 0.1 * np.random.default_rng(2).standard_normal(TIMES.size)
    return Problem(SDOF(), (Record((Channel(TIMES, y),), (), start),))


POINTS = np.log([[60.0, 1.0], [50.0, 2.0], [75.0, 0.4]])


def rss(problem: Problem, logs: np.ndarray, x0: float, v0: float) -> float:
    k, c = np.exp(logs)
    y = problem.records[0].channels[0].values
    return float(np.sum((y - closed_form({"m": 1.0, "c": c, "k": k}, x0, v0, TIMES)) ** 2))


def test_the_likelihood_with_a_told_start_is_the_sum_of_squares_to_the_power() -> None:
    """Gaussian noise with density 1/sigma: the integral over sigma is RSS^(-N/2)."""
    problem = record(InitialState(np.array([1.0]), np.array([2.0])))
    expected = np.array([-6.0 * np.log(rss(problem, logs, 1.0, 2.0)) for logs in POINTS])
    computed = log_likelihood(problem, POINTS)
    np.testing.assert_allclose(computed - computed[0], expected - expected[0], atol=1e-6)


def test_an_unknown_start_is_integrated_out() -> None:
    """By a sum over a grid of displacement and of velocity over frequency, both flat."""
    problem, expected = record(None), []
    y = problem.records[0].channels[0].values
    x, u = (axis.ravel() for axis in np.meshgrid(np.linspace(-3, 5, 241), np.linspace(-4, 4, 241)))
    for k, c in np.exp(POINTS):
        unit = [closed_form({"m": 1.0, "c": c, "k": k}, *start, TIMES) for start in ((1.0, 0.0), (0.0, np.sqrt(k)))]
        squares = np.sum((y - np.outer(x, unit[0]) - np.outer(u, unit[1])) ** 2, axis=1)
        expected.append(np.log(np.sum(squares**-6.0)))
    computed = log_likelihood(problem, POINTS)
    np.testing.assert_allclose(computed - computed[0], np.array(expected) - expected[0], atol=5e-3)
