"""Twins of a measured record: simulated ones of which the truth is known, and how each method does on them.

A twin has the record's times, forces and told start, moves as its fit says, and carries noise of the residuals' colour
and the record's rounding. On twins the errors of a method are seen and not only stated, and how often its interval
holds the truth; so is that of the interval that the project states. The factor by which the half-widths of a quantity's
intervals must grow for 95 % of them to hold the truth corrects the interval of the record itself: the calibrated, or
double, bootstrap (R. Beran, Biometrika 74:457, 1987; W.-Y. Loh, J. Am. Stat. Assoc. 82:155, 1987). A model that is not
right is not seen by this: a twin obeys its equation of motion.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Channel, Problem
from bench.engine import method_process as fitter
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import make_method, missing_package
from bench.isolation.processes import Children, Died
from bench.records.diagnostics import natural_frequency
from bench.records.finding import Finding
from bench.records.intervals import StatedInterval, stated_intervals
from bench.records.linearised import Linearised, linearised
from bench.records.parts import parts_of
from bench.records.strongest import strongest_frequency
from bench.scenario.stream import anonymous_stream
from bench.scoring.combination import combine_with_prior
from bench.systems import MEASURED, Quantity

LEVEL = 0.95
MOST_LOG = 50.0
"""Beyond this half-width of a logarithm an interval says nothing, and numbers overflow."""
CHANCE = 0.05
"""Level of the test of whether the twins' coverage is not 95 %."""
LEAST = 20
"""Twins below which nothing is said: the 95 % point of fewer is not among them."""
FIRST, LARGEST = 2, 64
"""Twins in a method's first and largest batch; the first may hold a compilation."""
FITTING = 0.6
"""Of a method's time, for its own work; the rest is for the stated intervals."""
MEMORY_MB = 4096.0
ROUNDED = 0.9
"""Share of the differences of distinct values that are multiples of the smallest where a sensor rounds."""
OFF = 0.05
"""Of a step that a difference may be off a multiple of it."""
LEAST_NOISE = 0.25
"""Of the noise's variance, that stays beside rounding: with none all twins would be one."""


@dataclass(frozen=True)
class TwinLine:
    """How a method tells a quantity of twins: median of its absolute error (%), and how its intervals hold the truth.

    ``n_ok``: twins that it answered. ``coverage_white``: of its own 95 % intervals; ``coverage_stated``: of those that
    the project states, of which there may be fewer where time was short. ``stretch``: by how much the half-widths of
    the latter, on the log scale, must be multiplied for 95 % to hold the truth; below 1 where they are too wide. NaN
    where there is no interval, or of fewer than 20 twins.
    """

    method: str
    quantity: str
    n_ok: int
    median_error_pct: float
    coverage_white: float
    coverage_stated: float
    stretch: float


@dataclass(frozen=True)
class Twins:
    """What ``n`` twins of a record show of methods; ``corrected``: the finding's own intervals (see `corrected_by`)."""

    n: int
    quantities: tuple[str, ...]
    lines: tuple[TwinLine, ...]
    corrected: Mapping[str, StatedInterval]


@dataclass(frozen=True, eq=False)
class Twin:
    """A simulated record and the parameters that made it."""

    problem: Problem
    truth: Mapping[str, float]


def twins_of(
    finding: Finding,
    methods: Sequence[str],
    n: int = 200,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    limit_s: float = 30.0,
) -> Twins:
    """Run methods on twins of a record and correct the finding's intervals by what its own method shows there.

    The finding's own method has half of the time, the others share the rest; each gets as many twins as fit. One that
    has no time for twenty, that needs a package which is missing, or that cannot take the record, has no lines. So a
    seed determines all but how many twins there was time for. The model's own error is not looked for on twins, which
    have none.

    Args:
        finding: Of the record, with its fit; without one there are no twins.
        methods: Registered names; each runs with its default settings, in a process of its own.
        n: How many twins; nothing is said of fewer than twenty.
        seed: Of the noise and of the methods' random streams.
        progress: Gets how much work is done, and of how much.
        limit_s: Time for all of it.
    """
    if finding.at is None:
        return Twins(0, (), (), dict(finding.intervals))
    twins = drawn(finding.at, finding.problem, n, seed)
    told = told_quantities(finding.problem)
    shown = [q for q in (*finding.problem.system.groups, *finding.problem.system.modal) if q in told]
    lines, corrected = dict[str, list[TwinLine]](), dict(finding.intervals)
    children, end = Children(), time.monotonic() + limit_s
    try:
        for i, method in enumerate(sorted(methods, key=lambda name: name != finding.method)):
            now, waiting = time.monotonic(), len(methods) - i
            until = now + max(end - now, 0.0) / (min(waiting, 2) if method == finding.method else waiting)
            pace = Pace(until, _telling(progress, 2 * n * i, 2 * n * len(methods)))
            answers = Answers.of(twins, *fitted_and_stated(method, twins, seed, pace, children))
            if len(answers.estimates) >= LEAST:
                lines[method] = [answers.line(method, quantity) for quantity in shown if answers.tells(quantity)]
                if method == finding.method:
                    corrected = corrected_by(answers, finding, told)
    finally:
        children.close()
    if progress:
        progress(2 * n * len(methods), 2 * n * len(methods))
    ordered = tuple(line for method in methods for line in lines.get(method, []))
    return Twins(n, tuple(q.name for q in shown), ordered, corrected)


def _telling(progress: Callable[[int, int], None] | None, done: int, total: int) -> Callable[[int], None]:
    return lambda more: progress(done + more, total) if progress else None


def told_quantities(problem: Problem) -> tuple[Quantity, ...]:
    """Those that the data, or the prior, tell: the groups alone where nothing tells the scale."""
    system = problem.system
    if problem.prior is not None or problem.scale_told:
        return system.quantities
    return (*system.groups, *system.modal)


# ------------------------------------------------------------------------------------------------ drawing


def drawn(at: Linearised, problem: Problem, n: int, seed: int) -> list[Twin]:
    """Draw twins of a problem, in its units; the i-th depends on the seed and on i alone.

    The nominal values of a prior are drawn too, about the twin's truth, as a prior says that they lie.
    """
    units, system = problem.natural_units(), problem.system
    natural = at.model.parameters(at.theta)
    truth = {p.name: float(natural[p.name]) * units.of(p.dimension) for p in system.parameters}
    motion = at.model.predict(at.theta)
    channels = [(c, units.of(MEASURED[c.measures])) for record in problem.records for c in record.channels]
    steps = [rounding_step(channel.values) for channel, _ in channels]
    twins = []
    for i in range(n):
        rng = np.random.default_rng([seed, i])
        made = []
        for number, ((channel, size), step, own) in enumerate(zip(channels, steps, at.channels, strict=True)):
            noise = _noise(at, number, own.size, rng) * _left_of_noise(step / size, float(at.sigma[number]))
            made.append(replace(channel, values=rounded(size * (motion[own] + noise), step, channel)))
        twins.append(Twin(_with(problem, made, truth, rng), truth))
    return twins


def _noise(at: Linearised, number: int, n: int, rng: np.random.Generator) -> np.ndarray:
    colour = at.noises[number]
    return at.sigma[number] * rng.standard_normal(n) if colour is None else colour.drawn(n, rng)


def _left_of_noise(step: float, sigma: float) -> float:
    """What noise is multiplied by that comes before rounding, whose variance (step²/12) the residuals hold already."""
    return float(np.sqrt(max(1.0 - step**2 / (12.0 * sigma**2), LEAST_NOISE)))


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
    """The step to whose multiples, and a constant, a sensor rounded its values; 0 where it did not.

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


def rounded(values: np.ndarray, step: float, like: Channel) -> np.ndarray:
    """Values rounded to steps from those of a channel; as they are without a step."""
    first = like.values[0] if like.n else 0.0
    return first + step * np.round((values - first) / step) if step > 0 else values


# ------------------------------------------------------------------------------------------------ fitting


@dataclass(eq=False)
class Pace:
    """The time that a method has, in seconds of the clock, and whom to tell of its progress."""

    until: float
    tell: Callable[[int], None]

    @property
    def left(self) -> float:
        return self.until - time.monotonic()


Intervals = Mapping[str, StatedInterval]


def fitted_and_stated(
    name: str, twins: Sequence[Twin], seed: int, pace: Pace, children: Children
) -> tuple[list[Estimate | None], list[Intervals]]:
    """A method's answers to the first of the twins, and the intervals stated of the first of these."""
    if name in REFERENCES or missing_package(name):
        return [], []
    fitting = Pace(time.monotonic() + FITTING * pace.left, pace.tell)
    try:
        estimates = _fitted(name, twins, seed, fitting, children)
    except Died:
        return [], []
    return estimates, _stated(twins, estimates, pace)


def _fitted(name: str, twins: Sequence[Twin], seed: int, pace: Pace, children: Children) -> list[Estimate | None]:
    """Answers in batches, each as large as the last one's time allows; none where twenty would take too long."""
    method = make_method(name, {})
    if method.objection(twins[0].problem):
        return []
    child = fitter.ready(children, None, method.requires, MEMORY_MB)
    fit, found, size = pickle.dumps(method.identify_many), list[Estimate | None](), FIRST
    while size > 0 and pace.left > 0:
        own = range(len(found), len(found) + size)
        problems = tuple(twins[i].problem for i in own)
        rngs, instants = tuple(anonymous_stream([seed, i, 1]) for i in own), (np.zeros(1),) * size
        started, each = time.monotonic(), pace.left / size
        task = fitter.FitTask(fit, tuple(own), problems, rngs, instants, each)
        try:
            outcomes = fitter.solve(child, task, MEMORY_MB)
        except Died:
            return found if len(found) >= LEAST else []
        found += [_estimate(outcome, problem) for outcome, problem in zip(outcomes, problems, strict=True)]
        pace.tell(len(found))
        took = (time.monotonic() - started) / size
        affordable = int(max(pace.left, 0.0) / took)
        if len(found) > FIRST and len(found) + affordable < LEAST:
            break
        size = min(2 * size, LARGEST, affordable, len(twins) - len(found))
    child.kill()
    return found if len(found) >= min(LEAST, len(twins)) else []


def _estimate(outcome: Mapping[str, object], problem: Problem) -> Estimate | None:
    if "answer" not in outcome:
        return None
    answer = outcome["answer"]
    assert isinstance(answer, Estimate)
    estimate = replace(answer, system=problem.system).checked()
    return combine_with_prior(estimate, problem.prior) if estimate.status is Status.OK else None


def _stated(twins: Sequence[Twin], estimates: Sequence[Estimate | None], pace: Pace) -> list[Intervals]:
    """The stated intervals, one mapping a twin (empty for one without an answer), until time is out."""
    found: list[Intervals] = []
    for twin, estimate in zip(twins, estimates, strict=False):
        if pace.left < 0:
            break
        found.append({} if estimate is None else stated_on(twin.problem, estimate))
        pace.tell(len(estimates) + len(found))
    return found


def stated_on(problem: Problem, estimate: Estimate) -> Intervals:
    """What the project states of an answer to a twin: as of a record (:func:`bench.records.finding.judged`)."""
    with np.errstate(all="ignore"):
        at = linearised(problem, estimate)
        if at is None:
            return stated_intervals(estimate, None)
        channel = at.model.channels[0][1]
        frequency = natural_frequency(at) or strongest_frequency(channel.times, channel.values)
        return stated_intervals(estimate, at, parts_of(at, frequency))


# ------------------------------------------------------------------------------------------------ judging


@dataclass(frozen=True, eq=False)
class Answers:
    """What a method said of twins, with their truths, and what was stated of the first of them."""

    truths: tuple[Mapping[str, float], ...]
    estimates: tuple[Estimate | None, ...]
    intervals: tuple[Intervals, ...]

    @staticmethod
    def of(twins: Sequence[Twin], estimates: Sequence[Estimate | None], stated: Sequence[Intervals]) -> Answers:
        """Of the twins that were run."""
        return Answers(tuple(t.truth for t in twins[: len(estimates)]), tuple(estimates), tuple(stated))

    def tells(self, quantity: Quantity) -> bool:
        """Whether any answer tells a quantity."""
        return any(e is not None and e.marginal(quantity) is not None for e in self.estimates)

    def line(self, method: str, quantity: Quantity) -> TwinLine:
        """What they amount to for a quantity."""
        errors, own = [], []
        for truth, estimate in zip(self.truths, self.estimates, strict=True):
            marginal = None if estimate is None else estimate.marginal(quantity)
            if marginal is not None:
                true = float(quantity.value(truth))
                errors.append(100.0 * abs(marginal.value / true - 1.0))
                own.append(miss(marginal.value, *marginal.interval(LEVEL), true))
        stated = self.misses(quantity)
        median = float(np.median(errors)) if errors else float("nan")
        return TwinLine(method, quantity.name, len(errors), median, held(own), held(stated), stretch_of(stated))

    def misses(self, quantity: Quantity) -> list[float]:
        """Of the stated intervals, see `miss`."""
        return [
            miss(own.value, own.record_low, own.record_high, float(quantity.value(truth)))
            for truth, intervals in zip(self.truths, self.intervals, strict=False)
            if (own := intervals.get(quantity.name)) is not None
        ]


def miss(value: float, low: float, high: float, true: float) -> float:
    """How far the truth is from the value, over the half of the interval on its side; 1: at its end.

    On the log scale; in the quantity itself where the interval reaches zero. NaN where an end is.
    """
    if low > 0 and value > 0:
        value, low, high, true = (float(np.log(v)) for v in (value, low, high, true))
    off, half = abs(true - value), high - value if true > value else value - low
    if np.isnan(half) or np.isnan(off):
        return float("nan")
    return off / half if half > 0 else (float("inf") if off > 0 else 0.0)


def held(misses: Sequence[float]) -> float:
    """The share of intervals that hold the truth; NaN of fewer than twenty."""
    known = np.array(misses)[~np.isnan(misses)] if misses else np.zeros(0)
    return float(np.mean(known <= 1.0)) if known.size >= LEAST else float("nan")


def stretch_of(misses: Sequence[float]) -> float:
    """The factor on half-widths at which 95 % of intervals hold the truth; NaN of fewer than twenty.

    The quantile of level 0.95 of the misses by the (n + 1) rule, at which one more interval holds its truth with
    probability 0.95 (R. J. Hyndman, Y. Fan, Am. Stat. 50:361, 1996, definition 6).
    """
    known = np.sort(np.array(misses)[~np.isnan(misses)]) if misses else np.zeros(0)
    if known.size < LEAST:
        return float("nan")
    place = LEVEL * (known.size + 1) - 1.0
    below = min(int(place), known.size - 2)
    low, high = known[below], known[below + 1]
    return float(low if low == high else low + min(place - below, 1.0) * (high - low))


def beyond_chance(misses: Sequence[float]) -> bool:
    """Whether the share that holds the truth differs from 95 %: the exact binomial test, two-sided, at 5 %."""
    from scipy.stats import binomtest

    known = np.array(misses)[~np.isnan(misses)] if misses else np.zeros(0)
    if known.size < LEAST:
        return False
    return bool(binomtest(int(np.sum(known <= 1.0)), known.size, LEVEL).pvalue < CHANCE)


def corrected_by(answers: Answers, finding: Finding, quantities: Sequence[Quantity]) -> dict[str, StatedInterval]:
    """The finding's stated intervals, stretched where the twins show that they do not hold 95 %.

    The rule: where the coverage of the stated intervals of the twins is not 95 % (exact binomial test, two-sided, at
    5 %), both half-widths of the record's interval are multiplied, on the log scale, by the twins' stretch: above 1 for
    too short ones, below 1 for too wide ones. Otherwise they stay. The interval of a repeat holds that of the record;
    twins know of no more. A parameter that follows from a told mass goes with its ratio.
    """
    found = dict(finding.intervals)
    gauge = finding.problem.system.gauge
    for quantity in quantities:
        misses = answers.misses(quantity)
        if not beyond_chance(misses):
            continue
        names = (quantity.name, *(p for p in finding.problem.system.names if f"{p}_over_{gauge}" == quantity.name))
        for name in names:
            own = found.get(name)
            told_itself = name != quantity.name and any(q.name == name for q in quantities)
            if own is not None and not told_itself:
                by = stretch_of(misses)
                found[name] = stretched(own, by)
    return found


def stretched(own: StatedInterval, by: float) -> StatedInterval:
    """The interval with its half-widths multiplied, on the log scale where it does not reach zero."""
    if own.record_low > 0 and own.value > 0:
        halves = (abs(float(np.log(end / own.value))) for end in (own.record_low, own.record_high))
        below, above = (min(by * half, MOST_LOG) for half in halves)
        low, high = own.value * float(np.exp(-below)), own.value * float(np.exp(above))
    else:
        low, high = (own.value + by * (end - own.value) for end in (own.record_low, own.record_high))
    return replace(own, record_low=low, record_high=high, low=min(own.low, low), high=max(own.high, high))
