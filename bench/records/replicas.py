"""Coverage of intervals on simulated replicas of a measured record (parametric bootstrap).

A replica is the fitted response with noise of the colour of the residuals, at the record's times and forces and with
the record's rounding. Its interval is that of *this record*: replicas obey the equation of motion, so they do not
include errors of the model or differences between repeats. The factor on the half-widths at which the coverage is 95 %
corrects the interval of the record (calibrated or double bootstrap: R. Beran, Biometrika 74:457, 1987; W.-Y. Loh, J.
Am. Stat. Assoc. 82:155, 1987).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bench.config.schema import Job
from bench.contract.estimate import Status
from bench.contract.problem import Channel, Problem
from bench.entrants.registry import make_method
from bench.isolation.processes import Died
from bench.records.finding import Finding
from bench.records.intervals import StatedInterval, stated_intervals
from bench.records.linearised_fit import LinearisedFit, linearise
from bench.records.workers import AT_ONCE, Workers
from bench.scenario.stream import anonymous_stream
from bench.scoring.combination import combine_with_prior
from bench.systems import MEASURED, Quantity

LEVEL = 0.95
CHANCE = 0.05
"""Significance level of the test that the coverage is 95 %."""
LEAST = 20
"""Least number of fitted replicas, for which the sample has a 95 % quantile."""
BATCH = 5
"""Replicas per call, which are fitted as one batch."""
LIMIT_S = 60.0
"""Time limit of a replica (s)."""
ROUNDED = 0.9
"""Share of the differences of distinct values that must be multiples of the smallest one in rounded samples."""
OFF = 0.05
"""Largest deviation of a difference from a multiple, over the rounding step."""
LEAST_NOISE = 0.25
"""Least share of the noise variance that is simulated in addition to rounding; without it all replicas are equal."""

Intervals = Mapping[str, StatedInterval]
OnReplicas = Callable[[int, float], None]
"""Called with the number of finished replicas and the estimated time left (s), NaN while it is unknown."""


@dataclass(frozen=True)
class ReplicaCoverage:
    """Coverage of the 95 % intervals of a quantity on replicas.

    Attributes:
        quantity: Name of the quantity.
        n: Number of replicas with an estimate.
        median_error_pct: Median relative error (%).
        covered: Share of the intervals that contain the true value.
        widening: Factor on the half-widths, on the log scale, at which the coverage is 95 %.
        corrected: The record's interval widened by this factor, if the coverage differs significantly from 95 %.
    """

    quantity: str
    n: int
    median_error_pct: float
    covered: float
    widening: float
    corrected: tuple[float, float] | None


def coverage_on_replicas(
    finding: Finding, job: Job, n: int, workers: Workers, on_replicas: OnReplicas
) -> tuple[ReplicaCoverage, ...]:
    """Fit replicas with the method of a finding, and compare the intervals with the true values.

    Args:
        finding: Result with a fit.
        job: Method and settings; its seed is that of noise and random streams.
        n: Number of replicas.
        workers: Worker processes.
        on_replicas: Called with the progress.

    Returns:
        The coverage of each quantity for which enough replicas have an interval.
    """
    assert finding.fit is not None
    batches = [range(low, min(low + BATCH, n)) for low in range(0, n, BATCH)]
    futures = {
        workers.submit(
            LIMIT_S * len(batch), fit_replicas, job, finding.fit, finding.problem, batch, memory_mb=job.config.memory_mb
        ): batch
        for batch in batches
    }
    answers: list[Intervals] = []
    done, compiled, since = 0, 0, time.monotonic()
    for i, future in enumerate(as_completed(futures), 1):
        done += len(futures[future])
        with suppress(Died):  # its replicas have no estimate
            answers += future.result()
        if i == AT_ONCE:  # the first call of each process includes the compilation, and is excluded from the rate
            compiled, since = done, time.monotonic()
        known = i >= 2 * AT_ONCE
        on_replicas(done, (time.monotonic() - since) / (done - compiled) * (n - done) if known else math.nan)
    truth = true_values(finding.fit, finding.problem)
    quantities = determined_quantities(finding.problem)
    lines = (coverage_of(q, float(q.value(truth)), answers, finding) for q in quantities)
    return tuple(line for line in lines if line is not None)


def determined_quantities(problem: Problem) -> tuple[Quantity, ...]:
    """Return all quantities if a force or a prior determines the scale, or else the groups and modal quantities."""
    system = problem.system
    return system.quantities if problem.prior is not None or problem.scale_known else (*system.groups, *system.modal)


# ------------------------------------------------------------------------------------------------ drawing


def true_values(fit: LinearisedFit, problem: Problem) -> dict[str, float]:
    """Return the true parameters of the replicas, which are those of the fit, in the problem's units."""
    units, natural = problem.natural_units(), fit.model.parameters(fit.theta)
    return {p.name: float(natural[p.name]) * units.of(p.dimension) for p in problem.system.parameters}


def draw_replicas(fit: LinearisedFit, problem: Problem, numbers: Sequence[int], seed: int) -> Iterator[Problem]:
    """Draw replicas of a problem; the nominal values of a prior are drawn as well, about the true ones.

    Args:
        fit: Fit of the records.
        problem: The records, in the user's units.
        numbers: Numbers of the replicas; replica i depends on the seed and i only.
        seed: Random seed.
    """
    units, truth, motion = problem.natural_units(), true_values(fit, problem), fit.model.predict(fit.theta)
    channels = [(c, units.of(MEASURED[c.measures])) for record in problem.records for c in record.channels]
    steps = [rounding_step(channel.values) for channel, _ in channels]
    for i in numbers:
        rng = np.random.default_rng([seed, i])
        made = []
        for number, ((channel, size), step, samples) in enumerate(zip(channels, steps, fit.channels, strict=True)):
            colour, sigma = fit.noises[number], float(fit.sigma[number])
            noise = sigma * rng.standard_normal(samples.size) if colour is None else colour.drawn(samples.size, rng)
            # The residuals contain the rounding noise already, whose variance is step²/12.
            noise *= np.sqrt(max(1.0 - (step / size / sigma) ** 2 / 12.0, LEAST_NOISE))
            values = size * (motion[samples] + noise)
            if step > 0:
                values = channel.values[0] + step * np.round((values - channel.values[0]) / step)
            made.append(replace(channel, values=values))
        yield _with(problem, made, truth, rng)


def _with(problem: Problem, made: list[Channel], truth: Mapping[str, float], rng: np.random.Generator) -> Problem:
    channels = iter(made)
    records = tuple(replace(r, channels=tuple(next(channels) for _ in r.channels)) for r in problem.records)
    prior = problem.prior
    if prior is not None:
        moved = np.exp(prior.log_sds * rng.standard_normal(len(prior.names)))
        nominal = {name: truth[name] * float(by) for name, by in zip(prior.names, moved, strict=True)}
        prior = replace(prior, nominal=nominal)
    return replace(problem, records=records, prior=prior)


def rounding_step(values: np.ndarray) -> float:
    """Return the rounding step of values; 0 if they are not rounded.

    It is the smallest difference between distinct values, if most others are multiples, averaged over all of them.
    """
    differences = np.diff(np.unique(values))
    differences = differences[differences > 1e-9 * np.ptp(values)] if differences.size else differences
    if differences.size < 2:
        return 0.0
    multiples = differences / np.min(differences)
    whole = np.abs(multiples - np.round(multiples)) <= OFF
    if np.mean(whole) < ROUNDED:
        return 0.0
    return float(np.sum(differences[whole]) / np.sum(np.round(multiples[whole])))


# ------------------------------------------------------------------------------------------------ fitting


def fit_replicas(job: Job, fit: LinearisedFit, problem: Problem, numbers: Sequence[int]) -> list[Intervals]:
    """Fit replicas; return the intervals of those with an estimate. For the arguments see :func:`draw_replicas`."""
    seed, method = int(job.config.seed), make_method(job.config.method["name"], job.settings())
    replicas = list(draw_replicas(fit, problem, numbers, seed))
    streams = [anonymous_stream([seed, i, 1]) for i in numbers]
    estimates = method.identify_many(replicas, streams)
    answers: list[Intervals] = []
    for replica, answer in zip(replicas, estimates, strict=True):
        estimate = replace(answer, system=problem.system).checked()
        if estimate.status is Status.OK:
            estimate = combine_with_prior(estimate, replica.prior)
            with np.errstate(all="ignore"):
                answers.append(stated_intervals(estimate, linearise(replica, estimate)))
    return answers


# ------------------------------------------------------------------------------------------------ judging


def coverage_of(
    quantity: Quantity, true: float, answers: Sequence[Intervals], finding: Finding
) -> ReplicaCoverage | None:
    """Compare the intervals of a quantity on replicas with its true value.

    The record's interval is corrected if the coverage differs from 95 % (exact binomial test, two-sided).

    Args:
        quantity: The quantity.
        true: Its true value.
        answers: Intervals of the replicas.
        finding: Result of the record.

    Returns:
        The coverage; None for fewer than ``LEAST`` intervals.
    """
    from scipy.stats import binomtest

    stated = [intervals[quantity.name] for intervals in answers if quantity.name in intervals]
    if len(stated) < LEAST:
        return None
    errors = [100.0 * abs(i.value / true - 1.0) for i in stated]
    misses = np.array([miss(i.value, i.record_low, i.record_high, true) for i in stated])
    misses = misses[~np.isnan(misses)]
    widening, interval, covered = widening_of(misses), finding.intervals.get(quantity.name), misses <= 1.0
    chance = binomtest(int(np.sum(covered)), misses.size, LEVEL).pvalue if misses.size >= LEAST else 1.0
    corrected = None
    if interval is not None and chance < CHANCE:
        corrected = widened(interval.value, interval.record_low, interval.record_high, widening)
    share = float(np.mean(covered))
    return ReplicaCoverage(quantity.name, len(stated), float(np.median(errors)), share, widening, corrected)


def miss(value: float, low: float, high: float, true: float) -> float:
    """Return the distance of the true value from the estimate over the half-width on its side.

    The scale is logarithmic, or linear for an interval that includes zero. NaN if an end is NaN.
    """
    if low > 0 and value > 0:
        value, low, high, true = (float(np.log(v)) for v in (value, low, high, true))
    off, half = abs(true - value), high - value if true > value else value - low
    if np.isnan(half) or np.isnan(off):
        return float("nan")
    return off / half if half > 0 else (float("inf") if off > 0 else 0.0)


def widening_of(misses: np.ndarray) -> float:
    """Return the factor on half-widths at which 95 % of intervals cover the true value; NaN for too few.

    It is the 0.95 quantile of the misses (n,) by the (n + 1) rule, at which another interval covers its true value with
    probability 0.95 (R. J. Hyndman, Y. Fan, Am. Stat. 50:361, 1996, definition 6).
    """
    return float(np.quantile(misses, LEVEL, method="weibull")) if misses.size >= LEAST else float("nan")


def widened(value: float, low: float, high: float, by: float) -> tuple[float, float]:
    """Return an interval with half-widths multiplied by a factor, on the log scale if it does not include zero."""
    if low > 0 and value > 0:
        return value * float((low / value) ** by), value * float((high / value) ** by)
    return value + by * (low - value), value + by * (high - value)
