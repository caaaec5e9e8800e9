"""The one ranking of methods: tiers that the data can tell apart, without a winner inside a tier.

The loss of a fit is the logarithm of its error over the bound (root mean square over the quantities that the data
determine), from 0, for no unbiased method is within the bound but by luck, to log :data:`CAP`; an outlier fit, a
failure, and a refusal of what the method says it serves lose log :data:`CAP`. The loss of a method is the mean over
scenarios of the mean over a scenario's fits.

Methods are compared on the same scenarios (of one scenario on the same fits), which are resampled in pairs (P. Koehn,
Proc. EMNLP 2004, 388). The first tier is the model confidence set of P. R. Hansen, A. Lunde and J. M. Nason
(Econometrica 79:453, 2011) by the range of means: the worst method is left out as long as its mean is farther from the
least than the means of all that are left would be apart in 95 % of the resamples, were they equal; less than 2 % is a
tie for any purpose. So methods that are equally good share it with 95 % probability, however many they are. The second
tier is found likewise among the rest, and so on. A method that does not serve every scenario stands beside the tiers,
compared with the first tier on those that it serves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial

import numpy as np
from scipy.special import exp1

from bench.contract.estimate import Status
from bench.contract.problem import Problem
from bench.entrants.registry import make_method
from bench.errors import InputError
from bench.reporting.frame import ERROR, Key, Result, group
from bench.reporting.labels import in_order
from bench.reporting.tables.pooling import pooled_quantities
from bench.scoring.statistics import counts, middle_95
from bench.scoring.summary import OUTLIER_FACTOR as GROSS
from bench.scoring.summary import below_chance
from bench.store.cell import stored_as_cell

CAP = 10.0
"""Error over bound of a lost fit."""
LOST = math.log(CAP)
ON_BOUND = math.exp(exp1(1.0) / 2)
"""Typical error over bound, 1.12, of two uncorrelated normal errors on it: their mean square is exponential."""
SAME = math.log(1.02)
"""A difference of losses that decides nothing, however sure it is."""
UNINFORMATIVE = 100.0
"""A bound (%) from which on data and prior do not determine a quantity: an error over it says nothing."""
FIRST_TIER = f"""**Bold**: the first tier of this scenario, whose methods these replicates do not tell apart; a tier has
no winner. Ranked is the mean logarithm of error over bound, of 1 at least and {CAP:g} at most, as for no answer and for
an error beyond {GROSS:g} bounds; the worst method is left out as long as it is farther from the best, and by more than
2 %, than equal methods would be in 95 % of resamples of the same replicates."""
"""What bold means in a table of scenarios with several replicates."""
Fits = Mapping[str, Sequence[np.ndarray]]
"""By method, log error over bound of its fits in each scenario (n,), from -log CAP; none where it was not asked or does
not serve it."""


@dataclass(frozen=True)
class Ranked:
    """Where a method stands.

    ``tier`` counts from 1; 0 stands beside the tiers, and serves ``served`` of the ``scenarios`` only. ``typical`` is
    the exponential of its loss, a geometric mean of errors over bounds, with its 95 % interval ``low`` to ``high``;
    ``first_tier`` is that of the first tier on the scenarios that the method serves. ``lost`` of its ``fits`` are
    outliers, failures or refusals. ``too_good``: its errors are smaller than the bound allows by chance.
    """

    label: str
    tier: int
    served: int
    scenarios: int
    typical: float
    low: float
    high: float
    first_tier: float
    lost: int
    fits: int
    too_good: bool


# ---- tiers of losses


def ranked(fits: Fits) -> list[Ranked]:
    """Rank methods by the errors of their fits; those that stand beside the tiers come last."""
    means = {
        label: np.array([np.mean(within_bound(own)) if own.size else np.nan for own in each])
        for label, each in fits.items()
    }
    served = {label: np.isfinite(mean) for label, mean in means.items() if np.isfinite(mean).any()}
    only = all(those.size == 1 for those in served.values())  # of one scenario the fits are resampled
    units = {label: within_bound(fits[label][0]) if only else means[label][those] for label, those in served.items()}
    in_tiers = tiers({label: units[label] for label, those in served.items() if those.all()})
    place = {label: i for i, tier in enumerate(in_tiers, 1) for label in tier}
    first = np.mean([means[label] for label in in_tiers[0]], axis=0) if in_tiers else None
    rows = []
    for label in sorted(served, key=lambda label: place.get(label, len(in_tiers) + 1)):
        those, every = served[label], np.concatenate(fits[label])
        typical, low, high = np.exp([float(np.mean(units[label])), *interval(units[label])]).tolist()
        there = math.nan if first is None else math.exp(np.mean(first[those]))
        too_good = below_chance(math.sqrt(np.mean(np.exp(2.0 * every))), 0.0, every.size)
        lost = int(np.sum(every == LOST))
        rows.append(
            Ranked(
                label, place.get(label, 0), int(those.sum()), those.size, typical, low, high, there, lost, every.size,
                too_good,
            )
        )  # fmt: skip
    return rows


def within_bound(logs: np.ndarray) -> np.ndarray:
    """Return losses from logarithms of errors over bounds: an error within the bound is as one on it."""
    return np.maximum(logs, 0.0)


def leaders(logs: Mapping[Key, np.ndarray]) -> frozenset[Key]:
    """Return the first tier by log error over bound (n,); none where all are lost, or a method has no rival."""
    compared = len(logs) > 1 and any((own < LOST).any() for own in logs.values())
    return frozenset(first_of({key: within_bound(own) for key, own in logs.items()})) if compared else frozenset()


def tiers(losses: Mapping[Key, np.ndarray]) -> list[list[Key]]:
    """Return the methods by tier, in the order given within it, from what each loses by data set (n,)."""
    rest, result = dict(losses), list[list[Key]]()
    while rest:
        result.append(first_of(rest))
        rest = {label: own for label, own in rest.items() if label not in result[-1]}
    return result


def first_of(losses: Mapping[Key, np.ndarray]) -> list[Key]:
    """Return the first tier; a method of fewer data sets is compared with the best alone, on the first of these."""
    most = max(own.size for own in losses.values())
    order = sorted((label for label, own in losses.items() if own.size == most), key=lambda label: losses[label].mean())
    best = losses[order[0]]
    tier = set(order[: tied(np.stack([losses[label] for label in order]))])
    for label, own in losses.items():
        pair = np.stack([best[: own.size], own])
        if own.size < most and (own.mean() <= pair[0].mean() or tied(pair) == 2):
            tier.add(label)
    return [label for label in losses if label in tier]


def tied(losses: np.ndarray) -> int:
    """Return how many of some methods, the best first, are not told apart by what they lose (methods, n).

    The i-th range is that of the first i methods, whose means are all made 0, in each resample.
    """
    if losses.shape[1] < 2:
        return len(losses)
    means = losses.mean(axis=1)
    errors = (losses - means[:, None]) @ weights(losses.shape[1]).T
    ranges = np.maximum.accumulate(errors) - np.minimum.accumulate(errors)
    equal = means - means[0] <= np.maximum(np.quantile(ranges, 0.95, axis=1), SAME)
    return int(np.flatnonzero(equal)[-1]) + 1


def interval(values: np.ndarray) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean of ``values`` (n,); one alone has no limits."""
    if values.size < 2:
        return -math.inf, math.inf
    return middle_95(weights(values.size) @ values)


@lru_cache(maxsize=16)
def weights(n: int) -> np.ndarray:
    """Return the weight of each of n values in each resample, the same ones at every call, shape (resamples, n)."""
    return counts(n).T / n


# ---- losses of stored fits


def median_time(results: Iterable[Result]) -> float:
    """Return the median processor time (s) of the fits that gave an answer; NaN without any."""
    times = np.concatenate([np.empty(0), *(result.cpu_s[result.ok] for result in results if result.stored)])
    return float(np.nanmedian(times)) if np.isfinite(times).any() else math.nan


def ranking(results: Iterable[Result]) -> list[Ranked]:
    """Rank the methods of some scenarios, the first tier first; reference rows compete with nobody."""
    return ranked(fits_of(results))


def first_tier(results: Iterable[Result], metrics: Iterable[str]) -> frozenset[Result]:
    """Return the first tier in one scenario by some metrics; reference rows compete with nobody."""
    rivals = [result for result in results if result.stored and not result.is_reference]
    bounds = informative_bounds(rivals, metrics)
    return leaders({result: log_errors(result, bounds) for result in rivals if bounds})


def fits_of(results: Iterable[Result]) -> Fits:
    """Return the errors of all methods' fits in the scenarios whose data determine something.

    Scenarios have one order, whoever asks: resamples hang on it, and with them a tier at the edge.
    """
    stored = [result for result in results if result.stored]
    by_scenario = sorted(group(stored, lambda result: result.question).items())
    informative = [(asked, bounds) for _, asked in by_scenario if (bounds := determined_bounds(asked))]
    labels = in_order(result.label for result in stored if not result.is_reference)
    fits = {label: [np.empty(0)] * len(informative) for label in labels}
    for place, (asked, bounds) in enumerate(informative):
        example = cache(partial(example_problem, asked[0]))
        for result in asked:
            if not result.is_reference and competes(result, example):
                fits[result.label][place] = log_errors(result, bounds)
    return fits


def determined_bounds(asked: Sequence[Result]) -> dict[str, float]:
    """Return the bounds (%) of the quantities that a scenario's data determine, by metric; of unknown systems none."""
    model = asked[0].known_model
    if model is None:
        return {}
    identifiable = {name: told for result in reversed(asked) for name, told in result.identifiable.items()}
    return informative_bounds(asked, [name + ERROR for name in pooled_quantities(model, identifiable)])


def informative_bounds(asked: Sequence[Result], metrics: Iterable[str]) -> dict[str, float]:
    """Return the bounds of metrics, each from the first method that stored it: one that failed may have none."""
    stored = {metric: filter(math.isfinite, [result.bound(metric) for result in asked]) for metric in metrics}
    bounds = {metric: next(known, math.nan) for metric, known in stored.items()}
    return {metric: bound for metric, bound in bounds.items() if 0 < bound < UNINFORMATIVE}


def log_errors(result: Result, bounds: Mapping[str, float]) -> np.ndarray:
    """Return log error over bound of each fit (n,) from the bounds by metric."""
    return log_sizes(np.stack([result.errors(metric) / bound for metric, bound in bounds.items()]))


def log_sizes(errors: np.ndarray) -> np.ndarray:
    """Return log error over bound of each fit (n,) from the errors over bounds of its quantities (quantities, n)."""
    with np.errstate(over="ignore"):
        size = np.sqrt(np.mean(errors**2, axis=0))
    return np.where(np.max(errors, axis=0) <= GROSS, capped(size), LOST)


def capped(size: np.ndarray) -> np.ndarray:
    """Return the logarithm of errors over bounds, from -log CAP to log CAP."""
    return np.asarray(np.log(np.clip(size, 1.0 / CAP, CAP)))


def competes(result: Result, example: Callable[[], Problem]) -> bool:
    """Return whether a method answered, or failed on a problem that it says it serves."""
    if result.status is not Status.UNSUPPORTED:
        return result.status is not Status.MISSING_DEPENDENCY
    try:
        return make_method(result.method, dict(result.settings)).objection(example()) is None
    except InputError:  # a method that is not installed says nothing, nor does a scenario that cannot be made here
        return False


def example_problem(result: Result) -> Problem:
    """Return a problem as methods see those of a scenario; raises InputError where this version cannot make it."""
    assert result.stored is not None
    cell = result.cell or stored_as_cell(result.stored)
    return cell.scenario.example(cell.seed)
