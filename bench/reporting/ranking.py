"""Rank methods in tiers that differ significantly; the methods of a tier are tied.

The loss of a fit is the logarithm of its error over the bound (root mean square over the identifiable quantities),
limited to the range from 0 (an unbiased method is below the bound by chance only) to log :data:`CAP`. An outlier fit, a
failed fit, and the refusal of a problem that the method claims to serve lose log :data:`CAP`. The loss of a method is
the mean over scenarios of the mean over a scenario's fits.

Methods are compared on the same scenarios (in a single scenario, on the same fits), which are resampled in pairs
(P. Koehn, Proc. EMNLP 2004, 388). The first tier is the model confidence set of P. R. Hansen, A. Lunde and J. M. Nason
(Econometrica 79:453, 2011) by the range of means: the worst method is removed as long as its mean differs from the
smallest by more than the range of equal means in 95 % of the resamples, and by more than 2 %. Equally good methods
therefore share a tier with 95 % probability, however many they are. The second tier is the confidence set of the rest,
and so on. A method that does not serve every scenario has no tier; it is compared with the first tier on the scenarios
that it serves.
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
from bench.scoring.summary import OUTLIER_FACTOR, below_chance
from bench.store.cell import stored_as_cell

CAP = 10.0
"""Error over bound assigned to outlier fits and failed fits."""
LOST = math.log(CAP)
ON_BOUND = math.exp(exp1(1.0) / 2)
"""Typical error over bound, 1.12, of two uncorrelated normal errors at the bound: their mean square is exponential."""
SAME = math.log(1.02)
"""Largest difference of losses that counts as a tie, even if it is significant."""
UNINFORMATIVE = 100.0
"""Bound (%) from which on a quantity counts as not identifiable from data and prior."""
FIRST_TIER = f"""**Bold**: the first tier of this column and scenario, the methods tied with the best by the mean
logarithm of error over bound, limited to the range from 1 to {CAP:g}; failed fits and outlier fits (error beyond
{OUTLIER_FACTOR:g} times the bound) count as {CAP:g}. The worst method is removed as long as it differs from the best by
more than 2 %, and by more than equal methods would in 95 % of resamples of the same replicates; one with fewer
replicates is compared with the best on these alone."""
"""Meaning of bold in a table of scenarios with several replicates."""
Fits = Mapping[str, Sequence[np.ndarray]]
"""Log error over bound of the fits in each scenario (n,), from -log CAP, by method; empty if the method was not run
there or does not serve the scenario."""


@dataclass(frozen=True)
class Ranked:
    """Rank of a method.

    Attributes:
        label: Label of the method.
        tier: Tier, from 1; 0 if the method does not serve every scenario.
        served: Number of scenarios that the method serves.
        scenarios: Number of all scenarios.
        typical: Geometric mean of errors over bounds, the exponential of the loss.
        low: Lower end of its 95 % interval.
        high: Upper end of its 95 % interval.
        first_tier: Typical error over bound of the first tier on the scenarios that the method serves.
        lost: Number of outlier fits, failed fits and refusals.
        fits: Number of all fits.
        too_good: Whether the errors are smaller than the bound allows by chance.
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
    """Rank methods by the errors of their fits; methods without a tier come last."""
    means = {
        label: np.array([np.mean(within_bound(logs)) if logs.size else np.nan for logs in by_scenario])
        for label, by_scenario in fits.items()
    }
    served = {label: np.isfinite(mean) for label, mean in means.items() if np.isfinite(mean).any()}
    only = all(serves.size == 1 for serves in served.values())  # of one scenario the fits are resampled
    units = {label: within_bound(fits[label][0]) if only else means[label][serves] for label, serves in served.items()}
    in_tiers = tiers({label: units[label] for label, serves in served.items() if serves.all()})
    place = {label: i for i, tier in enumerate(in_tiers, 1) for label in tier}
    first = np.mean([means[label] for label in in_tiers[0]], axis=0) if in_tiers else None
    rows = []
    for label in sorted(served, key=lambda label: place.get(label, len(in_tiers) + 1)):
        serves, every = served[label], np.concatenate(fits[label])
        typical, low, high = np.exp([float(np.mean(units[label])), *interval(units[label])]).tolist()
        there = math.nan if first is None else math.exp(np.mean(first[serves]))
        too_good = below_chance(math.sqrt(np.mean(np.exp(2.0 * every))), 0.0, every.size)
        lost = int(np.sum(every == LOST))
        rows.append(
            Ranked(
                label, place.get(label, 0), int(serves.sum()), serves.size, typical, low, high, there, lost, every.size,
                too_good,
            )
        )  # fmt: skip
    return rows


def within_bound(logs: np.ndarray) -> np.ndarray:
    """Return losses from log errors over bounds; an error below the bound counts as one at the bound."""
    return np.maximum(logs, 0.0)


def leaders(logs: Mapping[Key, np.ndarray]) -> frozenset[Key]:
    """Return the first tier by log error over bound (n,); empty if no fit succeeded, or for a single method."""
    compared = len(logs) > 1 and any((values < LOST).any() for values in logs.values())
    return frozenset(first_of({key: within_bound(values) for key, values in logs.items()})) if compared else frozenset()


def tiers(losses: Mapping[Key, np.ndarray]) -> list[list[Key]]:
    """Return the methods by tier, each tier in the order given, from their losses per data set (n,)."""
    rest, result = dict(losses), list[list[Key]]()
    while rest:
        result.append(first_of(rest))
        rest = {label: values for label, values in rest.items() if label not in result[-1]}
    return result


def first_of(losses: Mapping[Key, np.ndarray]) -> list[Key]:
    """Return the first tier; a method with fewer data sets is compared with the best on the first of these alone."""
    most = max(values.size for values in losses.values())
    order = sorted(
        (label for label, values in losses.items() if values.size == most), key=lambda label: losses[label].mean()
    )
    best = losses[order[0]]
    tier = set(order[: tied(np.stack([losses[label] for label in order]))])
    for label, values in losses.items():
        pair = np.stack([best[: values.size], values])
        if values.size < most and (values.mean() <= pair[0].mean() or tied(pair) == 2):
            tier.add(label)
    return [label for label in losses if label in tier]


def tied(losses: np.ndarray) -> int:
    """Return the number of methods tied with the first.

    The i-th range is the range of the means of the first i methods, centred at 0, in each resample.

    Args:
        losses: Losses per data set, the best method first, shape (methods, n).
    """
    if losses.shape[1] < 2:
        return len(losses)
    means = losses.mean(axis=1)
    errors = (losses - means[:, None]) @ weights(losses.shape[1]).T
    ranges = np.maximum.accumulate(errors) - np.minimum.accumulate(errors)
    equal = means - means[0] <= np.maximum(np.quantile(ranges, 0.95, axis=1), SAME)
    return int(np.flatnonzero(equal)[-1]) + 1


def interval(values: np.ndarray) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean of ``values`` (n,); infinite for a single value."""
    if values.size < 2:
        return -math.inf, math.inf
    return middle_95(weights(values.size) @ values)


@lru_cache(maxsize=16)
def weights(n: int) -> np.ndarray:
    """Return the weight of each of n values in each resample, shape (resamples, n); every call gives the same."""
    return counts(n).T / n


# ---- losses of stored fits


def median_time(results: Iterable[Result]) -> float:
    """Return the median processor time (s) of the successful fits; NaN without any."""
    times = np.concatenate([np.empty(0), *(result.cpu_s[result.ok] for result in results if result.stored)])
    return float(np.nanmedian(times)) if np.isfinite(times).any() else math.nan


def ranking(results: Iterable[Result]) -> list[Ranked]:
    """Rank the methods of some scenarios, the first tier first; reference rows are left out."""
    return ranked(fits_of(results))


def first_tier(results: Iterable[Result], metrics: Iterable[str]) -> frozenset[Result]:
    """Return the first tier in one scenario by some metrics; reference rows are left out."""
    rivals = [result for result in results if result.stored and not result.is_reference]
    bounds = informative_bounds(rivals, metrics)
    return leaders({result: log_errors(result, bounds) for result in rivals if bounds})


def fits_of(results: Iterable[Result]) -> Fits:
    """Return the errors of all methods' fits in the scenarios with an identifiable quantity.

    Scenarios are sorted, since the resamples depend on their order, and with them a method at the edge of a tier.
    """
    stored = [result for result in results if result.stored]
    by_scenario = sorted(group(stored, lambda result: result.question).items())
    informative = [(members, bounds) for _, members in by_scenario if (bounds := determined_bounds(members))]
    labels = in_order(result.label for result in stored if not result.is_reference)
    fits = {label: [np.empty(0)] * len(informative) for label in labels}
    for place, (members, bounds) in enumerate(informative):
        example = cache(partial(example_problem, members[0]))
        for result in members:
            if not result.is_reference and competes(result, example):
                fits[result.label][place] = log_errors(result, bounds)
    return fits


def determined_bounds(members: Sequence[Result]) -> dict[str, float]:
    """Return the bounds (%) of a scenario's identifiable quantities, by metric; none for an unknown system."""
    model = members[0].known_model
    if model is None:
        return {}
    identifiable = {name: value for result in reversed(members) for name, value in result.identifiable.items()}
    return informative_bounds(members, [name + ERROR for name in pooled_quantities(model, identifiable)])


def informative_bounds(members: Sequence[Result], metrics: Iterable[str]) -> dict[str, float]:
    """Return the bounds of metrics, each from the first method that stored one (a failed fit may not)."""
    stored = {metric: filter(math.isfinite, [result.bound(metric) for result in members]) for metric in metrics}
    bounds = {metric: next(known, math.nan) for metric, known in stored.items()}
    return {metric: bound for metric, bound in bounds.items() if 0 < bound < UNINFORMATIVE}


def log_errors(result: Result, bounds: Mapping[str, float]) -> np.ndarray:
    """Return the log error over bound of each fit (n,), from the bounds by metric."""
    with np.errstate(invalid="ignore"):  # a failed fit has an infinite error, which may meet an infinite bound
        ratios = np.stack([result.errors(metric) / bound for metric, bound in bounds.items()])
    return log_sizes(ratios)


def log_sizes(errors: np.ndarray) -> np.ndarray:
    """Return the log error over bound of each fit (n,), from errors over bounds by quantity (quantities, n)."""
    with np.errstate(over="ignore"):
        size = np.sqrt(np.mean(errors**2, axis=0))
    return np.where(np.max(errors, axis=0) <= OUTLIER_FACTOR, capped(size), LOST)


def capped(size: np.ndarray) -> np.ndarray:
    """Return the logarithm of errors over bounds, limited to ±log CAP."""
    return np.asarray(np.log(np.clip(size, 1.0 / CAP, CAP)))


def competes(result: Result, example: Callable[[], Problem]) -> bool:
    """Return whether a method returned an estimate, or failed on a problem that it claims to serve."""
    if result.status is not Status.UNSUPPORTED:
        return result.status is not Status.MISSING_DEPENDENCY
    try:
        return make_method(result.method, dict(result.settings)).objection(example()) is None
    except InputError:  # a method that is not installed, or a scenario that this version cannot make
        return False


def example_problem(result: Result) -> Problem:
    """Return a problem as methods see those of a scenario; raises InputError where this version cannot make it."""
    assert result.stored is not None
    cell = result.cell or stored_as_cell(result.stored)
    return cell.scenario.example(cell.seed)
