"""Neural posterior: a small network is calibrated on fresh records; corrected, it is the posterior of quadrature."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest

from bench import Channel, Draws, Estimate, InitialState, NoEstimate, Prior, Problem, Record, Status
from bench.scenario.truth import closed_form
from bench.systems import SDOF

torch = pytest.importorskip("torch")

from methods.amortised import density, npe  # noqa: E402
from methods.amortised.npe import NPE  # noqa: E402
from methods.amortised.simulations import SampleLayout, network_inputs, simulated  # noqa: E402
from methods.sampling.mixture import Mixture  # noqa: E402

LAYOUT = SampleLayout(20, 0.0, True)
PRIOR = Prior({"m": 1.41, "c": 0.4, "k": 14.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
P = {"m": 1.4, "c": 0.7, "k": 11.0}  # a plant that is in no table
TIMES = np.linspace(0.0, 8.0, 20)
SMALL = {"steps": 150, "batch": 64, "width": 48, "depth": 2, "components": 4}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A place for networks that are trained on few records."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(density, "POOL", 2500)
        yield tmp_path_factory.mktemp("npe")


def record(noise: float = 0.1, prior: Prior | None = PRIOR) -> Problem:
    y = closed_form(P, 0.9, 0.4, TIMES) + noise * np.random.default_rng(5).standard_normal(TIMES.size)
    start = InitialState(np.array([0.9]), np.array([0.4]))
    return Problem(SDOF(), (Record((Channel(TIMES, y),), (), start),), prior)


def answer(folder: Path, problem: Problem, corrected: bool = False) -> Estimate:
    method = NPE(**SMALL, corrected=corrected, folder=str(folder))
    return method.identify(problem, np.random.default_rng(1))


def test_the_truth_lies_evenly_in_the_mixtures_of_fresh_records(folder: Path) -> None:
    """The rank of the truth among draws is uniform where a posterior is calibrated (Talts et al., arXiv:1804.06788)."""
    answer(folder, record())
    settings = {**SMALL, "seed": 0}
    network = npe._loaded(LAYOUT, tuple((name, settings[name]) for name in (*SMALL, "seed")), str(folder))
    rng = np.random.default_rng(8)
    logs, values, starts = simulated(LAYOUT, 120, rng)
    levels = []
    for (frequency, ratio), y, start in zip(logs, values, starts, strict=True):
        drawn = density.mixture_of(network, network_inputs(LAYOUT, y[None], start[None])).draw(200, rng)
        levels.append([np.mean(drawn[:, 0] < frequency), np.mean(drawn[:, 1] < frequency + ratio)])
    for part in np.array(levels).T:
        assert kstest(part, "uniform").statistic < 0.2


def test_corrected_draws_are_the_posterior_by_quadrature(folder: Path) -> None:
    """On a grid of k/m and c/m, with the likelihood RSS^(-N/2) of the closed form and the prior of both."""
    problem = record()
    estimate = answer(folder, problem, corrected=True)
    assert isinstance(estimate.parameters, Draws), estimate.message
    a, b = np.meshgrid(np.linspace(-0.15, 0.15, 51), np.linspace(-1.6, 1.2, 51), indexing="ij")
    a, b = a + np.log(11.0 / 1.4), b + np.log(0.5)
    y = problem.records[0].channels[0].values
    rss = [
        np.sum((y - closed_form({"m": 1.0, "c": np.exp(v), "k": np.exp(u)}, 0.9, 0.4, TIMES)) ** 2)
        for u, v in zip(a.ravel(), b.ravel(), strict=True)
    ]
    away = np.stack([a.ravel() - np.log(14.0 / 1.41), b.ravel() - np.log(0.4 / 1.41)])
    covariance = np.array([[0.25 + 0.0004, 0.0004], [0.0004, 1.0004]])
    logs = -10.0 * np.log(rss) - 0.5 * np.sum(away * np.linalg.solve(covariance, away), axis=0)
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    samples = np.log(estimate.parameters.samples)
    for computed, axis in ((samples[:, 2] - samples[:, 0], a.ravel()), (samples[:, 1] - samples[:, 0], b.ravel())):
        mean = weights @ axis
        sd = np.sqrt(weights @ (axis - mean) ** 2)
        assert np.mean(computed) == pytest.approx(mean, abs=0.2 * sd)
        assert np.std(computed) == pytest.approx(sd, rel=0.2)


def test_the_mass_is_drawn_as_the_prior_says_given_both_groups() -> None:
    """The conditional of a joint normal by its blocks: log m given log k/m and log c/m."""
    prior = Prior({"m": 1.4, "c": 0.5, "k": 12.0}, {"m": 0.3, "c": 0.5, "k": 0.2})
    logs = np.log([[9.0, 0.4]])
    joint = np.diag([0.09, 0.25, 0.04])
    maps = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 1.0], [-1.0, 1.0, 0.0]])  # log m, log k/m, log c/m
    mean, cov = maps @ np.log([1.4, 0.5, 12.0]), maps @ joint @ maps.T
    gain = cov[0, 1:] @ np.linalg.inv(cov[1:, 1:])
    drawn = np.log(npe._masses(record(), prior, np.repeat(logs, 20_000, axis=0), np.random.default_rng(0)))
    assert drawn.mean() == pytest.approx(mean[0] + gain @ (logs[0] - mean[1:]), abs=0.01)
    assert drawn.var() == pytest.approx(cov[0, 0] - gain @ cov[1:, 0], rel=0.05)


def test_the_prior_of_the_groups_is_that_of_draws() -> None:
    rng = np.random.default_rng(2)
    m, c, k = (PRIOR.nominal[n] * np.exp(PRIOR.log_sd[n] * rng.standard_normal(100_000)) for n in ("m", "c", "k"))
    mean, covariance = npe._group_prior(record(), PRIOR)
    drawn = np.stack([np.log(k / m), np.log(c / m)])
    np.testing.assert_allclose(mean, drawn.mean(axis=1), atol=0.02)
    np.testing.assert_allclose(covariance, np.cov(drawn), atol=0.02)


def test_draws_outside_the_box_are_not_trusted() -> None:
    slow = Mixture(np.zeros(1), np.array([[2 * np.log(0.01), 0.0]]), 0.03 * np.eye(2)[None])
    with pytest.raises(NoEstimate, match="outside the range of training"):
        npe._inside(LAYOUT, slow, 500, np.random.default_rng(0))


def test_a_response_far_from_the_record_is_not_trusted() -> None:
    """Draws of the right damping at twice the frequency, which no start brings near the record."""
    wrong = np.log(np.tile([4 * 11.0 / 1.4, 0.5], (200, 1)))
    with pytest.raises(NoEstimate, match="residuals"):
        npe._estimate(record(), wrong, np.random.default_rng(0))


def test_uneven_and_too_few_samples_are_declined_with_a_sentence() -> None:
    for times, sentence in ((np.sort(np.random.default_rng(1).uniform(0, 8, 20)), "even"), (TIMES[:6], "samples")):
        problem = Problem(SDOF(), (Record((Channel(times, np.cos(times)),)),), PRIOR)
        estimate = NPE().identify(problem, np.random.default_rng(0))
        assert estimate.status is Status.UNSUPPORTED
        assert sentence in estimate.message
