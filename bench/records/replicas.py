"""Simulated replicas of a measured record: how often the intervals cover the true value where it is known.

A replica (a parametric bootstrap sample) has the record's times, forces and known initial state, moves as its fit does,
and carries noise of the residuals' colour and the record's rounding. Its interval is that of *this record*: replicas
obey the equation of motion, so they show neither an error of the model nor what a repeat of the test would add. The
factor by which the half-widths must grow for 95 % to cover the true value corrects the interval of the record itself:
the calibrated, or double, bootstrap (R. Beran, Biometrika 74:457, 1987; W.-Y. Loh, J. Am. Stat. Assoc. 82:155, 1987).
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
"""Level of the test that the coverage is 95 %."""
LEAST = 20
"""Answered replicas below which nothing is stated: the 95 % quantile of fewer is not among them."""
TOGETHER = 5
"""Replicas of a call, which are fitted as one batch."""
LIMIT_S = 60.0
"""Time limit of a replica (s)."""
ROUNDED = 0.9
"""Share of the differences of distinct values that are multiples of the smallest where a sensor rounds."""
OFF = 0.05
"""Share of a step by which a difference may deviate from a multiple of it."""
LEAST_NOISE = 0.25
"""Share of the noise's variance that stays beside rounding: with none all replicas would be the same."""

Intervals = Mapping[str, StatedInterval]
OnReplicas = Callable[[int, float], None]
"""Gets the number of replicas that are done, and the seconds that the others will take; NaN where it is unknown."""


@dataclass(frozen=True)
class ReplicaCoverage:
    """How the 95 % intervals of a quantity cover the true value of ``n`` replicas that were answered.

    ``widening``: the factor on the half-widths, on the log scale, at which 95 % would; below 1 where they are too wide.
    ``corrected``: this record's interval times that factor, where the coverage differs from 95 % by more than chance.
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
    """Fit ``n`` replicas of a finding with its own method, and compare the intervals with the true values.

    Args:
        finding: An answer with its fit.
        job: Its method, with its settings; its seed is that of noise and random streams.
        n: Number of replicas.
        workers: Processes that fit.
        on_replicas: Gets the progress.
    """
    assert finding.fit is not None
    batches = [range(low, min(low + TOGETHER, n)) for low in range(0, n, TOGETHER)]
    futures = {
        workers.submit(
            LIMIT_S * len(some), answered, job, finding.fit, finding.problem, some, memory_mb=job.config.memory_mb
        ): some
        for some in batches
    }
    answers: list[Intervals] = []
    done, compiled, since = 0, 0, time.monotonic()
    for i, future in enumerate(as_completed(futures), 1):
        done += len(futures[future])
        with suppress(Died):  # its replicas have no answer
            answers += future.result()
        if i == AT_ONCE:  # each process has compiled the programmes of the method, which the others find
            compiled, since = done, time.monotonic()
        known = i >= 2 * AT_ONCE
        on_replicas(done, (time.monotonic() - since) / (done - compiled) * (n - done) if known else math.nan)
    truth = true_values(finding.fit, finding.problem)
    quantities = determined_quantities(finding.problem)
    lines = (coverage_of(q, float(q.value(truth)), answers, finding) for q in quantities)
    return tuple(line for line in lines if line is not None)


def determined_quantities(problem: Problem) -> tuple[Quantity, ...]:
    """Return the quantities that data or prior determine: the groups alone where nothing determines the scale."""
    system = problem.system
    return system.quantities if problem.prior is not None or problem.scale_known else (*system.groups, *system.modal)


# ------------------------------------------------------------------------------------------------ drawing


def true_values(at: LinearisedFit, problem: Problem) -> dict[str, float]:
    """Return the parameters of all replicas, in the problem's units: those of the fit."""
    units, natural = problem.natural_units(), at.model.parameters(at.theta)
    return {p.name: float(natural[p.name]) * units.of(p.dimension) for p in problem.system.parameters}


def drawn(at: LinearisedFit, problem: Problem, numbers: Sequence[int], seed: int) -> Iterator[Problem]:
    """Draw replicas of a problem, in its units; the i-th depends on the seed and on i alone.

    The nominal values of a prior are drawn too, about the true ones, as a prior assumes.
    """
    units, truth, motion = problem.natural_units(), true_values(at, problem), at.model.predict(at.theta)
    channels = [(c, units.of(MEASURED[c.measures])) for record in problem.records for c in record.channels]
    steps = [rounding_step(channel.values) for channel, _ in channels]
    for i in numbers:
        rng = np.random.default_rng([seed, i])
        made = []
        for number, ((channel, size), step, samples) in enumerate(zip(channels, steps, at.channels, strict=True)):
            colour, sigma = at.noises[number], float(at.sigma[number])
            noise = sigma * rng.standard_normal(samples.size) if colour is None else colour.drawn(samples.size, rng)
            # the residuals contain the noise of rounding already, whose variance is step²/12
            noise *= np.sqrt(max(1.0 - (step / size / sigma) ** 2 / 12.0, LEAST_NOISE))
            values = size * (motion[samples] + noise)
            if step > 0:
                values = channel.values[0] + step * np.round((values - channel.values[0]) / step)
            made.append(replace(channel, values=values))
        yield _with(problem, made, truth, rng)


def _with(problem: Problem, made: list[Channel], truth: Mapping[str, float], rng: np.random.Generator) -> Problem:
    left = iter(made)
    records = tuple(replace(r, channels=tuple(next(left) for _ in r.channels)) for r in problem.records)
    prior = problem.prior
    if prior is not None:
        moved = np.exp(prior.log_sds * rng.standard_normal(len(prior.names)))
        nominal = {name: truth[name] * float(by) for name, by in zip(prior.names, moved, strict=True)}
        prior = replace(prior, nominal=nominal)
    return replace(problem, records=records, prior=prior)


def rounding_step(values: np.ndarray) -> float:
    """Return the step to whose multiples, and a constant, a sensor rounded its values; 0 where it did not.

    The smallest step between distinct values if most of the others are its multiples; then their mean over those.
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


def answered(job: Job, at: LinearisedFit, problem: Problem, numbers: Sequence[int]) -> list[Intervals]:
    """Fit replicas and state the intervals of each answer; a replica without an answer has none."""
    seed, method = int(job.config.seed), make_method(job.config.method["name"], job.settings())
    replicas = list(drawn(at, problem, numbers, seed))
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
    """Compare the intervals of answers with the true value of a quantity; None of fewer than twenty.

    They need correction where the share that covers it differs from 95 % (exact binomial test, two-sided).
    """
    from scipy.stats import binomtest

    stated = [one[quantity.name] for one in answers if quantity.name in one]
    if len(stated) < LEAST:
        return None
    errors = [100.0 * abs(one.value / true - 1.0) for one in stated]
    misses = np.array([miss(one.value, one.record_low, one.record_high, true) for one in stated])
    misses = misses[~np.isnan(misses)]
    widening, interval, covered = widening_of(misses), finding.intervals.get(quantity.name), misses <= 1.0
    chance = binomtest(int(np.sum(covered)), misses.size, LEVEL).pvalue if misses.size >= LEAST else 1.0
    corrected = None
    if interval is not None and chance < CHANCE:
        corrected = widened(interval.value, interval.record_low, interval.record_high, widening)
    share = float(np.mean(covered))
    return ReplicaCoverage(quantity.name, len(stated), float(np.median(errors)), share, widening, corrected)


def miss(value: float, low: float, high: float, true: float) -> float:
    """Return the distance of the true value over the half of the interval on its side; 1: at its end.

    On the log scale; in the quantity itself where the interval reaches zero. NaN where an end is.
    """
    if low > 0 and value > 0:
        value, low, high, true = (float(np.log(v)) for v in (value, low, high, true))
    off, half = abs(true - value), high - value if true > value else value - low
    if np.isnan(half) or np.isnan(off):
        return float("nan")
    return off / half if half > 0 else (float("inf") if off > 0 else 0.0)


def widening_of(misses: np.ndarray) -> float:
    """Return the factor on half-widths at which 95 % of intervals cover the true value.

    The quantile of level 0.95 of the misses by the (n + 1) rule, at which one more interval covers its true value with
    probability 0.95 (R. J. Hyndman, Y. Fan, Am. Stat. 50:361, 1996, definition 6); infinite misses stay so.
    """
    return float(np.quantile(misses, LEVEL, method="weibull")) if misses.size >= LEAST else float("nan")


def widened(value: float, low: float, high: float, by: float) -> tuple[float, float]:
    """Return an interval with its half-widths multiplied, on the log scale where it does not reach zero."""
    if low > 0 and value > 0:
        return value * float((low / value) ** by), value * float((high / value) ** by)
    return value + by * (low - value), value + by * (high - value)
