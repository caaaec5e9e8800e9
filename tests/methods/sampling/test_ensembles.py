"""Ensembles in lockstep: they leave a known density as it is, whatever the moves, and do not mind their company."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("emcee")
from bench import OutputError, Problem
from bench.config.experiment import expand
from methods.sampling.ensembles import Ensemble, Lockstep
from methods.sampling.mixture import Mixture
from methods.sampling.modes import modes_of
from methods.sampling.posterior import Posterior
from methods.starts.candidates import screened

COVARIANCE = np.array([[1.0, 0.8], [0.8, 2.0]])
MEANS = np.array([[0.0, 0.0], [5.0, -3.0]])


def normal(phi: np.ndarray, which: np.ndarray) -> np.ndarray:
    """A correlated normal distribution about one mean or the other, up to a constant."""
    away = phi - MEANS[which]
    return -0.5 * np.sum(away @ np.linalg.inv(COVARIANCE) * away, axis=1)


def lockstep(independent: float, walkers: int = 30) -> Lockstep:
    """Two ensembles at each mean, by proposals that are off the mean and too narrow."""
    roots = 0.8 * np.linalg.cholesky(COVARIANCE)[None]
    ensembles = [
        Ensemble(i, Mixture(np.zeros(1), MEANS[i][None] + 0.5, roots, 6.0), np.random.RandomState(seed))
        for seed, i in enumerate((0, 0, 1, 1))
    ]
    return Lockstep(normal, ensembles, walkers, independent)


@pytest.mark.parametrize("independent", [1.0, 0.8, 0.0])
def test_moments_are_those_of_the_density(independent: float) -> None:
    """Of some 5000 effective draws a mean is known to 0.02 sd and a variance to 3 %: four such errors are allowed."""
    chains = lockstep(independent)
    chains.run(100)
    paths = chains.run(1500)
    assert paths.shape == (4, 1500, 30, 2)
    for i, mean in enumerate(MEANS):
        draws = paths[2 * i : 2 * i + 2].reshape(-1, 2)
        np.testing.assert_allclose(draws.mean(axis=0), mean, atol=0.1)
        np.testing.assert_allclose(np.cov(draws.T), COVARIANCE, atol=0.2)


@pytest.mark.slow
def test_the_snooker_move_leaves_a_narrow_density_as_it_is() -> None:
    """Alone, on standard deviations of 0.05 and 0.07, where a length is far from its root. A variance of some 6000
    effective draws is known to 2 %.
    """
    chains = lockstep(0.0, walkers=40)
    chains.target = lambda phi, which: normal(MEANS[which] + (phi - MEANS[which]) / 0.05, which)
    chains.coords = MEANS[[0, 0, 1, 1]][:, None] + 0.05 * (chains.coords - MEANS[[0, 0, 1, 1]][:, None])
    chains.log_prob = chains._log_density(chains.coords)
    paths = []
    for _ in range(3000):
        chains._evolve(chains.snooker)
        paths.append(chains.coords)
    for i, mean in enumerate(MEANS):
        draws = (np.stack(paths[200:])[:, 2 * i : 2 * i + 2].reshape(-1, 2) - mean) / 0.05
        np.testing.assert_allclose(np.cov(draws.T), COVARIANCE, atol=0.2)


def test_walkers_have_the_log_densities_of_where_they_are() -> None:
    chains = lockstep(0.5)
    chains.run(37)
    which, flat = np.repeat([0, 0, 1, 1], 30), chains.coords.reshape(-1, 2)
    np.testing.assert_allclose(chains.log_prob.ravel(), normal(flat, which), rtol=1e-12)
    for computed, x, log_q in zip(chains.ensembles, chains.coords, chains.log_q, strict=True):
        np.testing.assert_allclose(log_q, computed.proposal.log_density(x), rtol=1e-12)


def test_an_ensemble_goes_on_as_it_would_in_company() -> None:
    together, fewer = lockstep(0.8), lockstep(0.8)
    together.run(10)
    fewer.run(10)
    fewer.keep([1, 3])
    assert np.array_equal(together.run(20)[[1, 3]], fewer.run(20))


def problems(arguments: list[str], n: int) -> list[Problem]:
    job = expand(["method=prior", *arguments], multirun=False)[0]
    return [p.expressed_in(p.natural_units()) for p, _ in job.scenario.replicates(job.config.seed, n)]


@pytest.mark.parametrize("arguments", [["snr=10"], ["snr=20", "initial_state=unknown"], ["system=sdof_forced"]])
def test_the_posterior_of_several_problems_is_that_of_each(arguments: list[str]) -> None:
    models = [OutputError(problem) for problem in problems(arguments, 3)]
    modes = [computed[0][1] for computed in modes_of(models)]
    rng, which = np.random.default_rng(0), np.repeat(np.arange(3), 4)
    phi = np.stack([np.concatenate([modes[i], [-2.0]]) for i in which])
    phi += 0.1 * rng.standard_normal(phi.shape)
    together = Posterior(models, modes)
    values = together(phi, which)
    for i, (model, mode) in enumerate(zip(models, modes, strict=True)):
        np.testing.assert_allclose(values[which == i], Posterior([model], [mode])(phi[which == i]), rtol=1e-10)
    assert together.calls.tolist() == [4, 4, 4]


def test_a_vector_without_a_response_spoils_no_other() -> None:
    """Equal entries of a mass matrix are singular."""
    model = OutputError(problems(["system=matrices", "snr=40"], 1)[0])
    posterior = Posterior([model], [modes_of([model])[0][0][1]])
    phi = np.tile(np.concatenate([posterior.mode, np.full(len(model.channels), -3.0)]), (5, 1))
    phi[2, [i for i, name in enumerate(model.free) if name.startswith("m")]] = 0.0
    values = posterior(phi)
    assert values[2] == -np.inf
    np.testing.assert_allclose(values[[0, 1, 3, 4]], posterior(phi[:1])[0], rtol=1e-12)
    assert np.isfinite(values[0])


@pytest.mark.parametrize("arguments", [["snr=10"], ["snr=20", "initial_state=unknown"], ["system=chain2", "snr=20"]])
def test_modes_are_those_of_the_search_by_differences(arguments: list[str]) -> None:
    """Other derivatives and steps; what is left of a search is within a hundredth of a standard error."""
    models = [OutputError(problem) for problem in problems(arguments, 3)]
    for model, modes in zip(models, modes_of(models), strict=True):
        value, theta = screened(model, rounds=3, iterations=30)[0]
        assert modes[0][0] == pytest.approx(value, abs=0.01)
        predicted, slopes = model.jacobian(theta)
        covariance = model.covariance(slopes, model.noise(model.data - predicted, 0.0), 3.0)
        assert np.all(np.abs(modes[0][1] - theta) < 0.03 * np.sqrt(np.diag(covariance)))
