"""Comparisons of methods by errors that are paired by data set.

All methods of an experiment are fitted to the same data, so two of them are compared on each data set: the size of
their difference by the logarithm of the ratio of their errors, whether there is one by the differences. A failed
replicate is an infinite error; where both fail they are equal. Replicates of one scenario are not scenarios, so
intervals resample scenarios as clusters and replicates within them (A. C. Davison, D. V. Hinkley, Bootstrap Methods and
their Application, 1997, section 3.8).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from bench.errors import InputError
from bench.scoring.statistics import LEVEL, counted, counts, holm, medians, middle_95, more_often

RESAMPLES = 1000
MARGIN = 0.02
"""Errors whose median ratio is closer to 1 than this are a tie for any purpose, however sure the difference is."""
GROSS = 5.0
"""An error beyond this many times the bound is a gross one, as is a failure."""
STEADY = 2.0
"""A method whose excess is this many times the least is no candidate for the best: it fails grossly now and then."""
POWER = float(ndtri(0.975) + ndtri(0.8))
"""How many standard errors a difference must be to be found with 80 % probability at the 5 % level."""


@dataclass(frozen=True)
class Errors:
    """Errors of several methods on the same data: ``values[method]`` (n,), and the scenario of each data set (n,)."""

    values: Mapping[str, np.ndarray]
    scenario: np.ndarray


@dataclass(frozen=True)
class Comparison:
    """``ratio``: median of a's error over b's on the same data, with its 95 % interval ``low`` to ``high``.

    ``p_value`` is that of Wilcoxon's signed-rank test of the differences, ``adjusted`` by Holm's method over all pairs
    compared together. ``resolved``: the smallest ratio that as many data sets would find with 80 % probability.
    """

    a: str
    b: str
    ratio: float
    low: float
    high: float
    p_value: float
    adjusted: float
    resolved: float

    @property
    def tie(self) -> bool:
        """True where the difference is not significant at the 5 % level, or below 2 %."""
        return self.adjusted > LEVEL or 1.0 / (1.0 + MARGIN) < self.ratio < 1.0 + MARGIN


def log_ratios(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return ``log(a / b)`` (n,) of errors; 0 where both failed or both are nil."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.log(a) - np.log(b), nan=0.0, posinf=np.inf, neginf=-np.inf)


def differences(a: np.ndarray, b: np.ndarray, scenario: np.ndarray) -> np.ndarray:
    """Return ``a - b`` (n,) over the median error of both in the same scenario; 0 where both failed.

    Errors of one scenario are of one size, so a test of their differences finds more than one of their logarithms, in
    which the luckiest replicates weigh most.
    """
    with np.errstate(invalid="ignore"):
        result = np.nan_to_num(a - b, nan=0.0, posinf=np.inf, neginf=-np.inf)
    for label in np.unique(scenario):
        members = scenario == label
        both = np.concatenate([a[members], b[members]])
        both = both[np.isfinite(both)]
        result[members] /= (float(np.median(both)) if both.size else 1.0) or 1.0
    return result


def compare(errors: Errors, pairs: Sequence[tuple[str, str]] | None = None) -> list[Comparison]:
    """Compare every pair of methods (or the given ones), with p-values adjusted together."""
    pairs = list(itertools.combinations(errors.values, 2)) if pairs is None else list(pairs)
    often = _clustered(errors.scenario)
    return adjusted([_pair(a, b, errors.values[a], errors.values[b], errors.scenario, often) for a, b in pairs])


def adjusted(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Return the comparisons with their p-values adjusted together by Holm's method."""
    p_values = holm([c.p_value for c in comparisons]).tolist()
    return [replace(c, adjusted=p) for c, p in zip(comparisons, p_values, strict=True)]


def _pair(a: str, b: str, of_a: np.ndarray, of_b: np.ndarray, scenario: np.ndarray, often: np.ndarray) -> Comparison:
    """Compare the errors of two methods; ``often`` (n, RESAMPLES) counts each data set in each resample."""
    from scipy.stats import wilcoxon  # half a second to import

    # zeros split, by the normal approximation; infinite differences have the highest ranks
    p = float(wilcoxon(differences(of_a, of_b, scenario), zero_method="zsplit", method="asymptotic").pvalue)
    ratios = log_ratios(of_a, of_b)
    resampled = medians(ratios, often, lower=True)
    sizes = resampled[np.isfinite(resampled)]
    error = float(np.std(sizes)) if sizes.size > 1 else np.inf
    with np.errstate(over="ignore"):
        ratio, low, high, resolved = np.exp([_median(ratios), *middle_95(resampled), POWER * error]).tolist()
    return Comparison(a, b, ratio, low, high, p, p, resolved)


def gross(errors: np.ndarray, bound: float) -> np.ndarray:
    """Return which errors (n,) are gross: beyond five times the bound, or of a failure; without a bound only these."""
    limit = GROSS * bound if np.isfinite(bound) and bound > 0 else np.inf
    return np.asarray(~(errors <= limit) | np.isinf(errors))


def steady(
    values: Mapping[str, np.ndarray], excess: Mapping[str, float], bound: float
) -> tuple[set[str], dict[str, float]]:
    """Find the methods without an excess beyond :data:`STEADY` times the least, and without more gross errors (5 %).

    Also returns the p-value of each method's gross errors: that of "no more often than the method whose errors are
    gross least often", on common data sets.
    """
    outliers = {method: gross(errors, bound) for method, errors in values.items()}
    full = _most_replicates(values)
    rarest = outliers[min(full, key=lambda method: float(np.mean(outliers[method])))]
    least = min((excess.get(method, np.nan) for method in full if excess.get(method, np.nan) > 0), default=np.nan)
    p_gross = {method: more_often(each, rarest[: each.size]) for method, each in outliers.items()}
    sure = {m for m in outliers if not excess.get(m, np.nan) > STEADY * least and p_gross[m] > LEVEL}
    return sure, p_gross


def _most_replicates(values: Mapping[str, np.ndarray]) -> list[str]:
    most = max(errors.size for errors in values.values())
    return [method for method, errors in values.items() if errors.size == most]


@dataclass(frozen=True)
class ScenarioRanking:
    """The best method in one scenario by one metric, and how the others compare with it.

    ``level``: the best, and all that are tied with it and :func:`steady`, which ranks do not see. ``p_gross`` as there.
    """

    best: str
    comparisons: tuple[Comparison, ...]
    level: frozenset[str]
    p_gross: Mapping[str, float]


def standing(values: Mapping[str, np.ndarray], excess: Mapping[str, float], bound: float) -> ScenarioRanking | None:
    """Rank methods by their errors on the first n replicates, ``values[method]`` (n,); None for fewer than two.

    It is the one rule of all tables and of the page; they differ in which methods they put in. NaN errors are failures.
    The best has the least median error of the steady methods with most replicates, or of all of these where none is
    steady; every other is compared with it on the data sets that both were given.
    """
    if len(values) < 2:
        return None
    known = {method: np.where(np.isnan(errors), np.inf, errors) for method, errors in values.items()}
    sure, p_gross = steady(known, excess, bound)
    full = _most_replicates(known)
    best = min([method for method in full if method in sure] or full, key=lambda method: _median(known[method]))
    pairs = []
    for method, errors in known.items():
        if method != best:
            n = errors.size
            pairs.append(_pair(method, best, errors, known[best][:n], np.zeros(n, int), counts(n, RESAMPLES)))
    others = adjusted(pairs)
    level = {best, *(c.a for c in others if c.tie and c.a in sure)}
    return ScenarioRanking(best, tuple(others), frozenset(level), p_gross)


def _median(values: np.ndarray) -> float:
    """Return the median of values (n,), some perhaps infinite: where n is even the lower of the middle two."""
    return float(np.sort(values)[(values.size - 1) // 2])


def _clustered(scenario: np.ndarray) -> np.ndarray:
    """Resample scenarios with replacement, then replicates within each; counts (n, RESAMPLES) of each data set.

    All scenarios must have as many data sets.
    """
    labels, sizes = np.unique(scenario, return_counts=True)
    if np.unique(sizes).size > 1:
        raise InputError("replicates", sizes.tolist(), "as many of every scenario")
    if labels.size == 1:
        return counts(int(sizes[0]), RESAMPLES)
    members = np.stack([np.flatnonzero(scenario == label) for label in labels])
    rng, n = np.random.default_rng(0), int(sizes[0])
    chosen = rng.integers(0, labels.size, (RESAMPLES, labels.size))
    within = rng.integers(0, n, (RESAMPLES, labels.size, n))
    return counted(members[chosen[..., None], within].reshape(RESAMPLES, -1))
