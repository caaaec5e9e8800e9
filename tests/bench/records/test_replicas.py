"""Simulated replicas of a record: their properties, coverage, and correction of intervals."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from bench.contract.estimate import Status
from bench.contract.prior import Prior
from bench.contract.problem import Channel, Force, Problem, Record
from bench.entrants.registry import make_method
from bench.errors import InputError
from bench.isolation.processes import Died
from bench.likelihood.autoregression import Autoregression
from bench.records.finding import Finding
from bench.records.identification import assess
from bench.records.intervals import StatedInterval
from bench.records.problem import Measured
from bench.records.replicas import (
    ReplicaCoverage,
    coverage_of,
    coverage_on_replicas,
    determined_quantities,
    draw_replicas,
    fit_replicas,
    miss,
    rounding_step,
    true_values,
    widening_of,
)
from bench.records.request import request_of
from bench.records.workers import Workers
from bench.scenario.truth import closed_form
from bench.systems.linear import SDOF

P = {"m": 1.0, "c": 0.25, "k": 40.0}
T = np.arange(80) / 10.0


def record(seed: int = 0, step: float = 0.0, rho: float = 0.0, times: np.ndarray = T, noise: float = 0.02) -> Problem:
    colour = Autoregression(np.array([rho]), noise**2 * (1 - rho**2))
    x = closed_form(P, 0.8, -0.4, times) + colour.drawn(times.size, np.random.default_rng(seed)) + 0.3
    x = step * np.round(x / step) if step else x
    return Problem(SDOF(), (Record((Channel(times, x, offset=True),)),))


def finding_of(problem: Problem) -> Finding:
    estimate = make_method("output_error", {}).identify(problem, np.random.default_rng(0))
    assert estimate.status is Status.OK
    return assess("output_error", Measured((), problem, ()), estimate)


def replicas(problem: Problem, n: int = 20, seed: int = 0) -> list[Problem]:
    finding = finding_of(problem)
    assert finding.fit is not None
    return list(draw_replicas(finding.fit, problem, range(n), seed))


def values(replica: Problem) -> np.ndarray:
    return replica.records[0].channels[0].values


def test_a_replica_depends_on_seed_and_number_only() -> None:
    problem = record()
    first, again, other = replicas(problem, 3), replicas(problem, 5), replicas(problem, 3, seed=1)
    for a, b, c in zip(first, again[:3], other, strict=True):
        np.testing.assert_array_equal(values(a), values(b))
        assert not np.any(values(a) == values(c))
    assert not np.any(values(first[0]) == values(first[1]))


def test_replicas_have_the_mean_of_the_fit_and_the_noise_of_the_record() -> None:
    """Mean and standard deviation are within about four standard errors."""
    problem = record()
    finding = finding_of(problem)
    assert finding.fit is not None
    made = np.array([values(replica) for replica in draw_replicas(finding.fit, problem, range(400), 0)])
    size = problem.natural_units().length
    fit = problem.records[0].channels[0].values - size * finding.fit.residuals
    sigma = size * float(finding.fit.sigma[0])
    assert np.max(np.abs(made.mean(axis=0) - fit)) < 4.5 * sigma / 20.0
    assert made.std(axis=0).mean() == pytest.approx(sigma, rel=0.05)
    truth = true_values(finding.fit, problem)
    ratio = finding.intervals["k_over_m"].value
    assert truth["k"] / truth["m"] == pytest.approx(ratio, rel=1e-9)


def test_a_replica_keeps_times_force_and_offset() -> None:
    times = np.arange(120) / 10.0
    force = Force(times, np.sin(3.0 * times))
    x = np.sin(3.0 * times) / 30.0 + 1e-3 * np.random.default_rng(0).standard_normal(120)
    problem = Problem(SDOF(), (Record((Channel(times, x, offset=True),), (force,)),))
    (simulated,) = replicas(problem, 1)[0].records
    assert simulated.forces == (force,)
    np.testing.assert_array_equal(simulated.channels[0].times, times)
    assert simulated.channels[0].offset
    assert {q.name for q in determined_quantities(problem)} > {"m", "c", "k"}
    assert {q.name for q in determined_quantities(record())} == {
        "k_over_m", "c_over_m", "natural_frequency", "damping_ratio",
    }  # fmt: skip


def test_nominal_values_of_a_prior_are_drawn_about_the_true_values() -> None:
    prior = Prior(P, dict.fromkeys(P, 0.1))
    problem = replace(record(), prior=prior)
    finding = finding_of(problem)
    assert finding.fit is not None
    truth = true_values(finding.fit, problem)
    made = list(draw_replicas(finding.fit, problem, range(300), 0))
    z = np.array([[math.log(t.prior.nominal[n] / truth[n]) / 0.1 for n in P] for t in made if t.prior])
    assert np.all(np.abs(z.mean(axis=0)) < 4.0 / math.sqrt(300))
    assert z.std() == pytest.approx(1.0, rel=0.1)


def test_a_replica_is_rounded_as_its_record() -> None:
    problem = record(step=0.01)
    measured = values(problem)
    assert rounding_step(measured) == pytest.approx(0.01, rel=1e-6)
    for replica in replicas(problem, 3):
        multiples = (values(replica) - measured[0]) / 0.01
        np.testing.assert_allclose(multiples, np.round(multiples), atol=1e-6)


def test_rounding_adds_no_noise() -> None:
    """With a step of the size of the noise, residuals of replicas still have the noise of the record."""
    problem = record(step=0.03)
    finding = finding_of(problem)
    assert finding.fit is not None
    size = problem.natural_units().length
    fit = problem.records[0].channels[0].values - size * finding.fit.residuals
    left = np.array([values(replica) - fit for replica in draw_replicas(finding.fit, problem, range(200), 0)])
    assert np.sqrt(np.mean(left**2)) == pytest.approx(size * float(finding.fit.sigma[0]), rel=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_values_that_are_not_rounded_have_no_step(seed: int) -> None:
    assert rounding_step(np.random.default_rng(seed).standard_normal(200)) == 0.0
    assert rounding_step(np.zeros(5)) == 0.0


def test_the_noise_of_a_replica_has_the_colour_of_the_residuals() -> None:
    problem = record(rho=0.8, times=np.arange(400) / 10.0)
    finding = finding_of(problem)
    assert finding.fit is not None
    noise = finding.fit.noises[0]
    assert noise is not None
    size = problem.natural_units().length
    fit = problem.records[0].channels[0].values - size * finding.fit.residuals
    drawn_noise = [values(replica) - fit for replica in draw_replicas(finding.fit, problem, range(100), 0)]
    lag_one = np.mean([r[1:] @ r[:-1] / (r @ r) for r in drawn_noise])
    covariance = noise.autocovariance(2)
    assert lag_one == pytest.approx(covariance[1] / covariance[0], abs=0.03)


def test_a_miss_is_one_at_the_ends_of_an_interval() -> None:
    assert miss(2.0, 1.0, 8.0, 8.0) == pytest.approx(1.0)
    assert miss(2.0, 1.0, 8.0, 1.0) == pytest.approx(1.0)
    assert miss(2.0, 1.0, 8.0, 4.0) == pytest.approx(0.5)
    assert miss(1.0, -1.0, 5.0, 3.0) == pytest.approx(0.5)
    assert miss(2.0, 2.0, 2.0, 3.0) == math.inf
    assert miss(2.0, 1.0, math.inf, 3.0) == 0.0
    assert math.isnan(miss(2.0, math.nan, math.nan, 3.0))


def test_widening_is_an_order_statistic() -> None:
    """The 0.95 quantile of 1, 2, …, 39 by the (n + 1) rule is 38."""
    assert widening_of(np.arange(1.0, 40.0)) == pytest.approx(38.0)
    assert math.isnan(widening_of(np.ones(19)))


def exact(sd: float, stated_sd: float, n: int) -> ReplicaCoverage:
    """Return the coverage of a method whose errors of ln k/m have ``sd``, and intervals have ``stated_sd``."""
    rng, finding = np.random.default_rng(3), finding_of(record())
    answers = []
    for _ in range(n):
        log = math.log(P["k"]) + sd * rng.standard_normal()
        value, low, high = (math.exp(log + sign * 1.959964 * stated_sd) for sign in (0.0, -1.0, 1.0))
        answers.append({"k_over_m": stated(value, low, high)})
    coverage = coverage_of(SDOF().quantity("k_over_m"), P["k"], answers, finding)
    assert coverage is not None
    return coverage


def stated(value: float, low: float, high: float) -> StatedInterval:
    return StatedInterval(value, low, high, low, high, low, high, "1/s²")


def test_an_exact_normal_method_needs_no_widening() -> None:
    """The 0.95 quantile of 2000 misses is within 3 standard errors, 3 % each, of 1; half the interval needs 2."""
    line = exact(0.1, 0.1, 2000)
    assert line.widening == pytest.approx(1.0, abs=0.08)
    assert line.covered == pytest.approx(0.95, abs=0.015)
    assert line.median_error_pct == pytest.approx(100 * 0.1 * 0.6745, rel=0.1)
    assert exact(0.1, 0.05, 2000).widening == pytest.approx(2.0, abs=0.16)


def test_only_significant_differences_are_corrected() -> None:
    interval = finding_of(record()).intervals["k_over_m"]
    assert exact(0.1, 0.1, 200).corrected is None
    for stated_sd, factor in ((0.05, 2.0), (0.2, 0.5)):
        corrected = exact(0.1, stated_sd, 1000).corrected
        assert corrected is not None
        ratio = math.log(corrected[1] / interval.value) / math.log(interval.record_high / interval.value)
        assert ratio == pytest.approx(factor, rel=0.12)


@pytest.mark.slow
def test_the_requested_number_of_replicas_is_fitted() -> None:
    """Each is the same in whichever process it is fitted."""
    finding, (job,) = finding_of(record()), request_of({"data": ["x"], "method": ["output_error"]}).jobs
    progress = list[tuple[int, float]]()
    with Workers() as workers:
        lines = coverage_on_replicas(finding, job, 31, workers, lambda done, left: progress.append((done, left)))
        again = coverage_on_replicas(finding, job, 31, workers, lambda done, left: None)
    assert {line.quantity for line in lines} == {"k_over_m", "c_over_m", "natural_frequency", "damping_ratio"}
    assert {line.n for line in lines} == {31}
    errors = {line.quantity: line.median_error_pct for line in lines}
    assert 0.0 < errors["natural_frequency"] < errors["damping_ratio"] < 20.0
    assert [done for done, _ in progress] == sorted(done for done, _ in progress)
    assert progress[-1] == (31, 0.0)
    assert again == lines


def test_a_worker_that_exceeds_its_limit_is_replaced() -> None:
    with Workers() as workers:
        late = workers.submit(0.3, time.sleep, 60.0)
        roots = [workers.submit(60.0, math.sqrt, float(i)) for i in range(3)]
        with pytest.raises(Died, match=r"limit of 0\.3 s"):
            late.result()
        assert [root.result() for root in roots] == [0.0, 1.0, math.sqrt(2.0)]


def test_an_input_error_of_a_task_is_raised_by_its_future() -> None:
    with Workers() as workers, pytest.raises(InputError, match="method"):
        workers.submit(60.0, refuse).result()


def refuse() -> None:
    raise InputError("method", "truth", "choose another")


def corrected_intervals(seed: int) -> dict[str, tuple[bool, bool]]:
    """Decide whether the white and the corrected intervals of a record with AR(1) noise at 20 dB cover the truth."""
    times, rate = np.arange(160) / 20.0, 2 * np.pi
    truth = {"m": 1.0, "c": 0.04 * rate, "k": rate**2}
    rng = np.random.default_rng([5, seed])
    motion = closed_form(truth, 1.0, 0.0, times)
    noise = Autoregression(np.array([0.8]), 0.36 * 0.01 * float(np.mean(motion**2))).drawn(times.size, rng)
    problem = Problem(SDOF(), (Record((Channel(times, motion + noise, offset=True),)),))
    finding = replace(finding_of(problem), reasons=())
    assert finding.fit is not None
    job = request_of({"data": ["x"], "method": ["output_error"], "seed": [seed]}).job
    answers = fit_replicas(job, finding.fit, finding.problem, range(40))
    covers = {}
    for name in ("natural_frequency", "damping_ratio"):
        interval, quantity = finding.intervals[name], problem.system.quantity(name)
        line = coverage_of(quantity, float(quantity.value(true_values(finding.fit, problem))), answers, finding)
        low, high = (line and line.corrected) or (interval.record_low, interval.record_high)
        true = float(quantity.value(truth))
        covers[name] = (interval.white_low <= true <= interval.white_high, low <= true <= high)
    return covers


@pytest.mark.slow
def test_corrected_intervals_cover_the_true_value_under_coloured_noise() -> None:
    """Of thirty corrected intervals at least 24 cover the true value, of intervals assuming white noise fewer than 27.

    For a coverage of 95 %, fewer than 24 have a probability of 0.0006.
    """
    records = [corrected_intervals(seed) for seed in range(30)]
    for name in ("natural_frequency", "damping_ratio"):
        white, corrected = np.sum([record[name] for record in records], axis=0)
        assert corrected >= 24
        assert white < 27
