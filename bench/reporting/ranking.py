"""The one ranking of methods: tiers that the scenarios can tell apart, without a winner inside a tier.

The loss of a fit is the logarithm of its error over the bound (root mean square over the quantities that the data
determine), from -log :data:`CAP` to log :data:`CAP`; an outlier fit, a failure, and a refusal of what the method says
it serves lose log :data:`CAP`. The loss of a method is the mean over scenarios of the mean over a scenario's fits.

Methods are compared on the same scenarios by the paired bootstrap (P. Koehn, Proc. EMNLP 2004, 388; the percentile
interval of A. C. Davison, D. V. Hinkley, Bootstrap Methods and their Application, 1997, section 5.3): the first tier is
the method of the least loss with all whose mean difference to it has a 95 % interval that reaches 0 (or 2 %: less is a
tie for any purpose), the second is found likewise among the rest, and so on. A method that does not serve every
scenario stands beside the tiers, compared with the first tier on the scenarios that it serves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from bench.contract.estimate import Status
from bench.contract.problem import Problem
from bench.entrants.registry import make_method
from bench.errors import InputError
from bench.reporting.frame import ERROR, Result, group
from bench.reporting.labels import in_order
from bench.reporting.tables.pooling import pooled_quantities
from bench.scoring.comparison import GROSS, MARGIN
from bench.scoring.statistics import counts, middle_95
from bench.scoring.summary import below_chance
from bench.store.cell import stored_as_cell

CAP = 10.0
"""Error over bound of a lost fit. Its inverse is the least that counts: an error below that is luck."""
LOST = math.log(CAP)
ON_BOUND = math.exp(-np.euler_gamma / 2)
"""Typical error over bound, 0.75, of two uncorrelated normal errors on it: E log(χ²/2)/2 = -γ/2 of 2 degrees."""
SAME = math.log1p(MARGIN)
"""A difference of losses that decides nothing, however sure it is."""
UNINFORMATIVE = 100.0
"""A bound (%) from which on data and prior do not determine a quantity: an error over it says nothing."""
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


def ranking(results: Iterable[Result]) -> list[Ranked]:
    """Rank the methods of some scenarios, the first tier first; reference rows compete with nobody."""
    return ranked(fits_of(results))


def fits_of(results: Iterable[Result]) -> Fits:
    """Return the losses of all methods' fits in the scenarios whose data determine something."""
    stored = [result for result in results if result.stored]
    by_scenario = {key: (asked, told_bounds(asked)) for key, asked in group(stored, lambda r: r.question).items()}
    informative = {key: (asked, bounds) for key, (asked, bounds) in by_scenario.items() if bounds}
    labels = in_order(result.label for result in stored if not result.is_reference)
    fits = {label: [np.empty(0)] * len(informative) for label in labels}
    for place, (asked, bounds) in enumerate(informative.values()):
        problem = cache(partial(first_problem, asked[0]))
        for result in asked:
            if not result.is_reference and tried(result, problem):
                fits[result.label][place] = losses(result, bounds)
    return fits


def told_bounds(asked: Sequence[Result]) -> dict[str, float]:
    """Return the bounds (%) of the quantities that a scenario's data determine, by metric.

    A method that failed may have stored none: each is the first that any method stored. Of a system that is not
    registered here nothing is known.
    """
    model = asked[0].known_model
    if model is None:
        return {}
    identifiable = {name: told for result in reversed(asked) for name, told in result.identifiable.items()}
    metrics = [name + ERROR for name in pooled_quantities(model, identifiable)]
    bounds = {
        metric: next((result.bound(metric) for result in asked if math.isfinite(result.bound(metric))), math.nan)
        for metric in metrics
    }
    return {metric: bound for metric, bound in bounds.items() if 0 < bound < UNINFORMATIVE}


def first_problem(result: Result) -> Problem | None:
    """Return the first data set of a scenario as methods see it; None where this version cannot make it."""
    assert result.stored is not None
    try:
        cell = result.cell or stored_as_cell(result.stored)
    except InputError:
        return None
    return cell.scenario.maker(cell.seed)(0)[0]


def tried(result: Result, problem: Callable[[], Problem | None]) -> bool:
    """Return whether a method answered, or failed on a problem that it says it serves."""
    if result.status is Status.MISSING_DEPENDENCY:
        return False
    if result.status is not Status.UNSUPPORTED:
        return True
    try:
        method = make_method(result.method, dict(result.settings))
    except InputError:  # a method that is not installed says nothing
        return False
    example = problem()
    return example is not None and method.objection(example) is None


def losses(result: Result, bounds: Mapping[str, float]) -> np.ndarray:
    """Return the loss of each fit (n,) from the bounds by metric."""
    errors = np.stack([result.errors(metric) / bound for metric, bound in bounds.items()])
    with np.errstate(over="ignore"):
        size = np.sqrt(np.mean(errors**2, axis=0))
    lost = ~(np.max(errors, axis=0) <= GROSS)
    return np.where(lost, LOST, np.log(np.clip(size, 1.0 / CAP, CAP)))


def ranked(fits: Fits) -> list[Ranked]:
    """Rank methods by the losses of their fits; those that stand beside the tiers come last."""
    means = {label: np.array([np.mean(own) if own.size else np.nan for own in each]) for label, each in fits.items()}
    served = {label: np.isfinite(mean) for label, mean in means.items() if np.isfinite(mean).any()}
    whole = {label: means[label] for label, those in served.items() if those.all()}
    alone = all(
        mean.size == 1 for mean in whole.values()
    )  # the fits of the only scenario are all that can be resampled
    in_tiers = tiers({label: fits[label][0] for label in whole} if alone else whole)
    place = {label: i for i, tier in enumerate(in_tiers, 1) for label in tier}
    first = np.mean([whole[label] for label in in_tiers[0]], axis=0) if in_tiers else None
    rows = []
    for label in sorted(served, key=lambda label: place.get(label, len(in_tiers) + 1)):
        those, every = served[label], np.concatenate(fits[label])
        low, high = interval(means[label][those])
        rows.append(
            Ranked(
                label, place.get(label, 0), int(those.sum()), those.size,
                float(np.exp(np.mean(means[label][those]))), math.exp(low), math.exp(high),
                math.nan if first is None else float(np.exp(np.mean(first[those]))),
                int(np.sum(every == LOST)), every.size,
                below_chance(float(np.sqrt(np.mean(np.exp(2.0 * every)))), 0.0, every.size),
            )
        )  # fmt: skip
    return rows


def tiers(means: Mapping[str, np.ndarray]) -> list[list[str]]:
    """Return the methods by tier, in the order given within it.

    ``means`` has the losses of each method by scenario (n,); those of fewer are compared on the first ones.
    """
    rest, found = dict(means), []
    while rest:
        best = min(rest.values(), key=lambda own: float(np.mean(own)))
        found.append([label for label, own in rest.items() if own is best or not surely_worse(own, best)])
        rest = {label: own for label, own in rest.items() if label not in found[-1]}
    return found


def surely_worse(losses: np.ndarray, best: np.ndarray) -> bool:
    """Return whether paired losses are beyond those of the best by chance or :data:`SAME`."""
    n = min(losses.size, best.size)
    return interval(losses[:n] - best[:n])[0] > SAME


def interval(values: np.ndarray) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean over scenarios of ``values`` (n,); one alone has no limits."""
    if values.size < 2:
        return -math.inf, math.inf
    return middle_95(values @ counts(values.size) / values.size)
