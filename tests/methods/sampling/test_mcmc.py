"""Sampling: agrees with quadrature, tells when it has not converged, and is repeatable."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp

from bench import Channel, Draws, Normal, Problem, Record
from bench.contract.estimate import Estimate, Status
from bench.dynamics.simulate import simulate
from bench.entrants.registry import make_method
from bench.scenario.scenario import PriorSpec, Scenario
from bench.systems import SDOF

pytest.importorskip("emcee")
from methods.sampling.diagnostics import autocorrelation_times, rank_r_hat
from methods.sampling.mcmc import MCMC
from methods.sampling.posterior import NOISE_SD

NOMINAL = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})
TRUE = {"m": 1.3, "c": 0.6, "k": 9.0}


def scenario(snr: float, **changes: object) -> Scenario:
    given = {"system": "sdof", "parameters": TRUE, "initial": ((0.8,), (0.5,)), "prior": NOMINAL, **changes}
    return Scenario(snr_db=snr, **given)


def sample(problem: Problem, seed: int = 0, **settings: object) -> Estimate:
    return MCMC(**settings).identify(problem, np.random.default_rng(seed))


def quadrature(problem: Problem, logs: list[np.ndarray], log_sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean and standard deviation of (m, c, k) by a sum over a grid of log-parameters and log-noise."""
    record = problem.records[0]
    data, times = record.channels[0].values, record.channels[0].times
    grids = [g.ravel() for g in np.meshgrid(*logs, indexing="ij")]
    p = {name: np.exp(g) for name, g in zip(problem.system.names, grids, strict=True)}
    assert record.initial_state is not None
    rss = np.sum((simulate(problem.system, p, record.initial_state, times).displacement[0] - data) ** 2, axis=-1)
    sigma = np.exp(log_sigma)
    centre = np.log(0.1 * np.sqrt(np.mean(data**2)))
    log_density = -0.5 * rss[:, None] / sigma**2 - data.size * log_sigma - 0.5 * ((log_sigma - centre) / NOISE_SD) ** 2
    if problem.prior is not None:
        log_density -= 0.5 * np.sum(problem.prior.residuals(np.stack(grids, axis=-1)) ** 2, axis=-1)[:, None]
    weights = np.exp(log_density - log_density.max()).sum(axis=1)
    weights /= weights.sum()
    values = np.stack([p[name] for name in problem.system.names])
    mean = values @ weights
    return mean, np.sqrt(((values - mean[:, None]) ** 2) @ weights)


@pytest.mark.parametrize(
    ("name", "snr"),
    [("mcmc", 20.0), ("mcmc", 8.0), *(pytest.param("nuts", snr, marks=pytest.mark.slow) for snr in (20.0, 10.0))],
)
def test_mean_and_spread_agree_with_quadrature(name: str, snr: float) -> None:
    """Of 1500 effective draws a mean is known to 0.026 sd and an sd to 0.018 sd where the posterior is normal: the
    tolerances are at least five of those.
    """
    problem, _ = scenario(snr).replicates(1, 1)[0]
    longer = {"mcmc": {"effective": 2000.0}, "nuts": {"effective": 1500.0, "blocks": 12, "kept": 20000}}
    if name == "nuts":
        pytest.importorskip("blackjax")
    estimate = make_method(name, longer[name]).identify(problem, np.random.default_rng(0))
    assert isinstance(estimate.parameters, Draws), estimate.message
    draws = estimate.parameters.samples
    logs = np.log(draws)
    # a grid along the mass, and for c and k about the ridge that follows it
    width = 6 * logs.std(axis=0)
    grid = [np.linspace(m - w, m + w, n) for m, w, n in zip(logs.mean(axis=0), width, (25, 61, 61), strict=True)]
    noise = np.log(0.1 * np.sqrt(np.mean(problem.records[0].channels[0].values ** 2))) + np.linspace(-4, 3, 120)
    mean, sd = quadrature(problem, grid, noise)
    assert np.all(np.abs(draws.mean(axis=0) - mean) < 0.15 * sd)
    assert draws.std(axis=0) == pytest.approx(sd, rel=0.1)


def test_without_a_prior_the_groups_agree_with_quadrature() -> None:
    problem, _ = scenario(15.0, prior=None).replicates(2, 1)[0]
    estimate = sample(problem, effective=2000.0)
    assert isinstance(estimate.groups, Normal)
    assert estimate.parameters is None
    k_m, c_m = estimate.groups.mean
    k_sd, c_sd = np.sqrt(np.diag(estimate.groups.covariance))
    grid = [
        np.zeros(1),
        np.log(np.linspace(max(c_m - 5 * c_sd, 0.01 * c_m), c_m + 6 * c_sd, 121)),
        np.log(np.linspace(k_m - 6 * k_sd, k_m + 6 * k_sd, 121)),
    ]
    noise = np.log(0.1 * np.sqrt(np.mean(problem.records[0].channels[0].values ** 2))) + np.linspace(-3, 3, 120)
    # uneven steps in the logarithm: the sum over a grid needs even ones
    grid = [g if g.size == 1 else np.linspace(g[0], g[-1], g.size) for g in grid]
    mean, sd = quadrature(problem, grid, noise)
    assert k_m == pytest.approx(mean[2], abs=0.1 * sd[2])
    assert c_m == pytest.approx(mean[1], abs=0.1 * sd[1])
    assert [c_sd, k_sd] == pytest.approx(sd[1:], rel=0.1)


@pytest.mark.slow
def test_an_answer_is_the_same_alone_and_in_company() -> None:
    """Problems of three layouts, one of which cannot be sampled with others, and one that needs more blocks."""
    free, unknown = scenario(5.0).replicates(0, 3), scenario(5.0, initial_state="unknown").replicates(0, 3)
    duffing = scenario(25.0, system="duffing", parameters=DUFFING, samples=15, duration=3.0).replicates(0, 1)
    given = [problem for problem, _ in [*free, *duffing, *unknown]]
    method = MCMC(block=30)
    company = method.identify_many(given, [np.random.default_rng(i) for i in range(len(given))])
    assert len({computed.cost.iterations for computed in company}) > 1
    for i, (problem, computed) in enumerate(zip(given, company, strict=True)):
        alone = method.identify(problem, np.random.default_rng(i))
        assert isinstance(alone.parameters, Draws)
        assert isinstance(computed.parameters, Draws)
        np.testing.assert_allclose(computed.parameters.samples, alone.parameters.samples, rtol=1e-9)
        assert computed.cost == alone.cost


def test_a_chain_that_is_too_short_is_a_failure_with_a_sentence() -> None:
    problem, _ = scenario(20.0).replicates(0, 1)[0]
    estimate = sample(problem, burn=0, block=8, blocks=1)
    assert estimate.status is Status.DIVERGED
    assert "not converged (R-hat" in estimate.message
    assert "of 8 steps, too long for a reliable estimate): raise blocks" in estimate.message


def test_the_autocorrelation_time_is_emcee_s() -> None:
    from emcee.autocorr import integrated_time

    rng = np.random.default_rng(3)
    for steps, weight in ((60, 0.5), (97, 0.9), (8, 0.99)):
        noise = rng.standard_normal((2, steps, 12, 3))
        path = np.stack([noise[:, : i + 1].sum(axis=1) * weight + noise[:, i] for i in range(steps)], axis=1)
        expected = [integrated_time(part, tol=0, quiet=True) for part in path]
        np.testing.assert_allclose(autocorrelation_times(path), expected, rtol=1e-9)


@pytest.mark.slow
def test_walkers_that_move_by_each_other_alone_do_not_mix_among_many_unknowns() -> None:
    """Four masses, 24 unknowns: without independent moves the autocorrelation time outgrows the chain."""
    n = range(1, 5)
    parameters = {f"m{i}": 1.0 for i in n} | {f"c{i}": 0.2 for i in n} | {f"k{i}": 10.0 for i in n}
    start = ((1.0, 0.0, 0.0, 0.0), (0.0,) * 4)
    setting = {"parameters": parameters, "initial": start, "samples": 40, "initial_state": "unknown"}
    made = scenario(20.0, system="chain", options={"n": 4}, **setting)
    estimate = sample(made.replicates(0, 1)[0][0], independent=0.0, blocks=4)
    assert estimate.status is Status.DIVERGED
    assert "autocorrelation time" in estimate.message
    assert "24 unknowns" in estimate.message


def test_r_hat_tells_ensembles_apart() -> None:
    rng = np.random.default_rng(0)
    mixed = rng.standard_normal((2, 100, 20, 3))
    assert rank_r_hat(mixed) < 1.01
    apart = mixed.copy()
    apart[1, ..., 1] += 1.0
    assert rank_r_hat(apart) > 1.1
    wider = mixed.copy()
    wider[1, ..., 2] *= 3.0
    assert rank_r_hat(wider) > 1.05
    drifting = mixed.copy()
    drifting[..., 0] += np.linspace(0, 2, 100)[None, :, None]
    assert rank_r_hat(drifting) > 1.1
    stuck = mixed.copy()
    stuck[..., 0] = 1.0
    assert rank_r_hat(stuck) == np.inf


@pytest.mark.parametrize("initial_state", ["known", "unknown"])
def test_the_mode_recovers_clean_data(initial_state: str) -> None:
    problem, _ = scenario(120.0, initial_state=initial_state).replicates(0, 1)[0]
    estimate = sample(problem)
    mode = dict(zip(problem.system.names, estimate.traces["posterior_mode"], strict=True))
    assert mode["k"] / mode["m"] == pytest.approx(9.0 / 1.3, rel=1e-5)
    assert mode["c"] / mode["m"] == pytest.approx(0.6 / 1.3, rel=1e-5)
    assert mode["m"] == pytest.approx(problem.prior.nominal["m"], rel=0.05)
    marginal = estimate.marginal(problem.system.quantity("k_over_m"))
    assert marginal is not None, estimate.message
    assert marginal.value == pytest.approx(9.0 / 1.3, rel=1e-5)


def test_a_wrong_half_period_in_the_prior_does_not_hold_it() -> None:
    problem, _ = scenario(20.0, initial_state="unknown", parameters={"m": 0.5, "c": 0.1, "k": 6.0}).replicates(3, 1)[0]
    marginal = sample(problem).marginal(problem.system.quantity("k_over_m"))
    assert marginal.value == pytest.approx(12.0, rel=0.05)


CHAIN = {"m1": 1.2, "m2": 0.9, "c1": 0.25, "c2": 0.2, "k1": 7.0, "k2": 11.0}
DUFFING = {"m": 1.2, "c": 0.5, "k": 6.0, "k3": 4.0}


@pytest.mark.parametrize(
    ("system", "parameters", "initial", "snr", "setting"),
    [
        ("chain", CHAIN, ((0.5, -0.4), (0.0, 1.0)), 30.0, {"samples": 40}),
        pytest.param(
            *("duffing", DUFFING, ((0.9,), (0.0,)), 25.0, {"samples": 25, "duration": 4.0}), marks=pytest.mark.slow
        ),
    ],
)
def test_the_groups_lie_in_the_intervals(
    system: str, parameters: dict[str, float], initial: object, snr: float, setting: dict[str, object]
) -> None:
    """Of 99.9 %, for two masses and for a hardening spring."""
    made = scenario(snr, system=system, parameters=parameters, initial=initial, **setting)
    problem, _ = made.replicates(0, 1)[0]
    estimate = sample(problem)
    for group in problem.system.groups:
        marginal = estimate.marginal(group)
        assert marginal is not None, estimate.message
        low, high = marginal.interval(0.999)
        assert low < group.value(parameters) < high


@pytest.mark.parametrize("initial_state", ["known", "unknown"])
@pytest.mark.parametrize("prior", [NOMINAL, None])
def test_five_samples_give_an_answer_or_a_sentence(initial_state: str, prior: PriorSpec | None) -> None:
    for problem, _ in scenario(10.0, initial_state=initial_state, samples=5, prior=prior).replicates(0, 2):
        estimate = sample(problem, blocks=4).checked()
        assert estimate.status is Status.OK or (estimate.status is Status.DIVERGED and len(estimate.message) > 20)


@pytest.mark.parametrize("initial_state", ["known", "unknown"])
@pytest.mark.parametrize("likelihood", ["normal", "student"])
def test_data_of_twenty_digits_have_an_answer(initial_state: str, likelihood: str) -> None:
    """At 200 dB double precision is the limit: k/m to nine digits, in an interval that holds the truth."""
    problem, _ = scenario(200.0, initial_state=initial_state).replicates(3, 1)[0]
    estimate = sample(problem, likelihood=likelihood)
    assert estimate.status is Status.OK, estimate.message
    marginal = estimate.marginal(problem.system.quantity("k_over_m"))
    low, high = marginal.interval(0.95)
    assert low <= 9.0 / 1.3 <= high
    assert high - low < 1e-7
    assert marginal.value == pytest.approx(9.0 / 1.3, rel=1e-9)


def test_student_draws_agree_with_quadrature() -> None:
    """Mean and spread of k with the other unknowns summed over a grid, by scipy's own t density."""
    problem, _ = scenario(15.0).replicates(6, 1)[0]
    record, prior = problem.records[0], problem.prior
    assert record.initial_state is not None
    values = record.channels[0].values.copy()
    values[8] += 1.5
    record = Record((Channel(record.channels[0].times, values),), initial_state=record.initial_state)
    problem = Problem(problem.system, (record,), prior)
    estimate = sample(problem, likelihood="student", effective=1500.0)
    # the response is that of k/m and c/m; the prior decides the mass
    shapes = [
        np.log(TRUE["c"] / TRUE["m"]) + np.linspace(-2.5, 1.2, 61),
        np.log(9.0 / 1.3) + np.linspace(-0.2, 0.2, 81),
    ]
    c, k = (g.ravel() for g in np.meshgrid(*shapes, indexing="ij"))
    p = {"m": np.ones(c.size), "c": np.exp(c), "k": np.exp(k)}
    r = simulate(problem.system, p, record.initial_state, record.channels[0].times).displacement[0] - values
    scales, centre = np.linspace(-4.5, 0.0, 40), np.log(0.1 * np.sqrt(np.mean(values**2)))
    terms = [stats.t.logpdf(r, 4, scale=np.exp(part)).sum(axis=-1) for part in scales]
    fit = logsumexp(np.array(terms) - 0.5 * ((scales - centre) / NOISE_SD)[:, None] ** 2, axis=0)
    m = np.log(TRUE["m"]) + np.linspace(-0.12, 0.12, 61)[:, None]
    logs = np.stack(np.broadcast_arrays(m, c + m, k + m), axis=-1)
    density = fit - 0.5 * np.sum(prior.residuals(logs) ** 2, axis=-1)
    weights, stiffness = np.exp(density - density.max()), np.exp(logs[..., 2])
    mean = float(np.sum(weights * stiffness) / np.sum(weights))
    sd = float(np.sqrt(np.sum(weights * (stiffness - mean) ** 2) / np.sum(weights)))
    assert isinstance(estimate.parameters, Draws)
    draws = estimate.parameters.samples[:, 2]
    assert np.mean(draws) == pytest.approx(mean, abs=0.1 * sd)
    assert np.std(draws) == pytest.approx(sd, rel=0.1)


def test_noise_below_the_rounding_of_a_simulation_is_said_and_its_error_is_that_rounding() -> None:
    times, system = np.linspace(0, 8, 40), SDOF()
    clean = simulate(system, TRUE, (np.array([1.0]), np.array([0.0])), times).displacement[0]
    for noise, expected_message in ((1e-4, False), (1e-10, True)):
        values = clean + noise * np.random.default_rng(1).standard_normal(40)
        estimate = sample(Problem(system, (Record((Channel(times, values),)),)))
        assert ("noise is below" in estimate.message) is expected_message
    marginal = estimate.marginal(system.quantity("k_over_m"))
    assert marginal.value == pytest.approx(TRUE["k"] / TRUE["m"], rel=5e-10)
