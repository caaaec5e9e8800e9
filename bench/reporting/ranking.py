"""The one ranking of methods: tiers that the data can tell apart, without a winner inside a tier.

The loss of a fit is the logarithm of its error over the bound (root mean square over the quantities that the data
determine), from -log :data:`CAP` to log :data:`CAP`; an outlier fit, a failure, and a refusal of what the method says
it serves lose log :data:`CAP`. The loss of a method is the mean over scenarios of the mean over a scenario's fits.

Methods are compared on the same scenarios (of one scenario on the same fits) by the paired bootstrap (P. Koehn, Proc.
EMNLP 2004, 388; the percentile interval of A. C. Davison, D. V. Hinkley, Bootstrap Methods and their Application, 1997,
section 5.3): the first tier is the method of the least loss with all whose mean difference to it has a 95 % interval
that reaches 0 (or 2 %: less is a tie for any purpose), the second is found likewise among the rest, and so on. A method
that does not serve every scenario stands beside the tiers, compared with the first tier on those that it serves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial

import numpy as np

from bench.contract.estimate import Status
from bench.contract.problem import Problem
from bench.entrants.registry import make_method
from bench.errors import InputError
from bench.reporting.frame import ERROR, Key, Result, group
from bench.reporting.labels import in_order
from bench.reporting.tables.pooling import pooled_quantities
from bench.scoring.statistics import counts, middle_95
from bench.scoring.summary import GROSS, below_chance
from bench.store.cell import stored_as_cell

CAP = 10.0
"""Error over bound of a lost fit. Its inverse is the least that counts: an error below that is luck."""
LOST = math.log(CAP)
ON_BOUND = math.exp(-np.euler_gamma / 2)
"""Typical error over bound, 0.75, of two uncorrelated normal errors on it: E log(χ²/2)/2 = -γ/2 of 2 degrees."""
SAME = math.log(1.02)
"""A difference of losses that decides nothing, however sure it is."""
UNINFORMATIVE = 100.0
"""A bound (%) from which on data and prior do not determine a quantity: an error over it says nothing."""
FIRST_TIER = f"""**Bold**: the first tier of this scenario, whose methods these replicates do not tell apart; a tier has
no winner. Ranked is the mean logarithm of error over bound ({CAP:g} at most, as for no answer and for an error beyond
{GROSS:g} bounds); in the first tier is the method of the least mean with all whose mean difference to it has a 95 %
bootstrap interval, over the same replicates, that reaches 0, or 2 %."""
"""What bold means in a table of scenarios with several replicates."""
Fits = Mapping[str, Sequence[np.ndarray]]
"""By method, the losses of its fits in each scenario (n,); none where it was not asked or does not serve it."""


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
    """Rank methods by the losses of their fits; those that stand beside the tiers come last."""
    means = {label: np.array([np.mean(own) if own.size else np.nan for own in each]) for label, each in fits.items()}
    served = {label: np.isfinite(mean) for label, mean in means.items() if np.isfinite(mean).any()}
    only = all(those.size == 1 for those in served.values())  # of one scenario the fits are resampled
    units = {label: fits[label][0] if only else means[label][those] for label, those in served.items()}
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


def leaders(losses: Mapping[Key, np.ndarray]) -> frozenset[Key]:
    """Return the first tier; none where all are lost, or a method has no rival."""
    compared = len(losses) > 1 and any((own < LOST).any() for own in losses.values())
    return frozenset(first_of(losses)) if compared else frozenset()


def tiers(losses: Mapping[Key, np.ndarray]) -> list[list[Key]]:
    """Return the methods by tier, in the order given within it, from what each loses by data set (n,)."""
    rest, result = dict(losses), list[list[Key]]()
    while rest:
        result.append(first_of(rest))
        rest = {label: own for label, own in rest.items() if label not in result[-1]}
    return result


def first_of(losses: Mapping[Key, np.ndarray]) -> list[Key]:
    """Return the first tier; who has fewer data sets is compared on the first ones, and nobody with him."""
    most = max(own.size for own in losses.values())
    best = min((own for own in losses.values() if own.size == most), key=lambda own: float(np.mean(own)))
    return [label for label, own in losses.items() if own is best or not surely_worse(own, best)]


def surely_worse(losses: np.ndarray, best: np.ndarray) -> bool:
    """Return whether paired losses are beyond those of the best by chance or :data:`SAME`."""
    return interval(losses - best[: losses.size])[0] > SAME


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
    return leaders({result: losses(result, bounds) for result in rivals if bounds})


def fits_of(results: Iterable[Result]) -> Fits:
    """Return the losses of all methods' fits in the scenarios whose data determine something."""
    stored = [result for result in results if result.stored]
    by_scenario = list(group(stored, lambda result: result.question).values())
    informative = [(asked, bounds) for asked in by_scenario if (bounds := determined_bounds(asked))]
    labels = in_order(result.label for result in stored if not result.is_reference)
    fits = {label: [np.empty(0)] * len(informative) for label in labels}
    for place, (asked, bounds) in enumerate(informative):
        example = cache(partial(example_problem, asked[0]))
        for result in asked:
            if not result.is_reference and competes(result, example):
                fits[result.label][place] = losses(result, bounds)
    return fits


def determined_bounds(asked: Sequence[Result]) -> dict[str, float]:
    """Return the bounds (%) of the quantities that a scenario's data determine, by metric; of unknown systems none."""
    model = asked[0].known_model
    if model is None:
        return {}
    identifiable = {name: told for result in reversed(asked) for name, told in result.identifiable.items()}
    return informative_bounds(asked, [name + ERROR for name in pooled_quantities(model, identifiable)])


def informative_bounds(asked: Iterable[Result], metrics: Iterable[str]) -> dict[str, float]:
    """Return the bounds of metrics, each from the first method that stored it: one that failed may have none."""
    asked = list(asked)
    bounds = {
        metric: next((result.bound(metric) for result in asked if math.isfinite(result.bound(metric))), math.nan)
        for metric in metrics
    }
    return {metric: bound for metric, bound in bounds.items() if 0 < bound < UNINFORMATIVE}


def losses(result: Result, bounds: Mapping[str, float]) -> np.ndarray:
    """Return the loss of each fit (n,) from the bounds by metric."""
    errors = np.stack([result.errors(metric) / bound for metric, bound in bounds.items()])
    with np.errstate(over="ignore"):
        size = np.sqrt(np.mean(errors**2, axis=0))
    return np.where(np.max(errors, axis=0) <= GROSS, loss(size), LOST)


def loss(size: np.ndarray) -> np.ndarray:
    """Return the loss of errors over bounds."""
    return np.asarray(np.log(np.clip(size, 1.0 / CAP, CAP)))


def competes(result: Result, example: Callable[[], Problem | None]) -> bool:
    """Return whether a method answered, or failed on a problem that it says it serves."""
    if result.status is Status.MISSING_DEPENDENCY:
        return False
    if result.status is not Status.UNSUPPORTED:
        return True
    try:
        method = make_method(result.method, dict(result.settings))
    except InputError:  # a method that is not installed says nothing
        return False
    problem = example()
    return problem is not None and method.objection(problem) is None


def example_problem(result: Result) -> Problem | None:
    """Return a problem as methods see those of a scenario; None where this version cannot make it."""
    assert result.stored is not None
    try:
        cell = result.cell or stored_as_cell(result.stored)
    except InputError:
        return None
    return cell.scenario.example(cell.seed)
