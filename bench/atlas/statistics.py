"""Statistics of the fits of a method at one point of the atlas, which are stored instead of the single errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Problem
from bench.scenario.truth import Truth
from bench.scoring.score import score
from bench.scoring.summary import OUTLIER_FACTOR

LARGEST = 1e6
"""Upper limit of errors over the bound; also the error of an estimate that is missing or not positive."""
DISPLACEMENT = "displacement"
COLUMNS = ("bias", "core", "median", "p90", "gross", "held", "told")
"""Statistics per quantity; errors are in units of the bound's standard deviation. ``bias``, ``core``: mean and root
mean square error without outlier fits; ``median``, ``p90``: quantiles of the absolute error of all fits; ``gross``:
share of outlier fits; ``held``: coverage of the 95 % intervals; ``told``: share of the fits that state an interval."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of the fits at one point.

    ``values`` (n_quantities, n_columns); ``fits``: their number; ``failed``: share of fits without an estimate;
    ``seconds``: median time of a fit.
    """

    values: np.ndarray
    fits: int
    failed: float
    seconds: float

    def row(self) -> np.ndarray:
        """Return all numbers as one array."""
        return np.concatenate([[self.fits, self.failed, self.seconds], self.values.ravel()]).astype(np.float32)

    @staticmethod
    def from_row(row: np.ndarray) -> Statistics:
        """Return the statistics of an array made by :meth:`row`."""
        values = row[3:].reshape(-1, len(COLUMNS))
        return Statistics(values, round(float(row[0])), float(row[1]), float(row[2]))


def columns(quantities: Sequence[str]) -> list[str]:
    """Return the names of the numbers of :meth:`Statistics.row`."""
    names = (*quantities, DISPLACEMENT)
    return ["fits", "failed", "seconds", *(f"{name}_{column}" for name in names for column in COLUMNS)]


@dataclass(frozen=True)
class PointBound:
    """The bound at a point: standard deviations of the logarithms of quantities, root mean square displacement (m)."""

    sds: Mapping[str, float]
    displacement: float


def score_fit(estimate: Estimate, problem: Problem, truth: Truth, bound: PointBound) -> np.ndarray:
    """Score a fit.

    Returns:
        Error over the bound, and coverage of the 95 % interval (1 or 0; NaN without an interval), (n_quantities, 2).
        The errors are those of the logarithms of the quantities; the last is the root mean square error of
        displacement, which has no interval.
    """
    result = np.full((len(bound.sds) + 1, 2), np.nan)
    result[:, 0] = LARGEST
    if estimate.status is not Status.OK:
        return result
    scores = score(estimate, problem, truth)
    for i, (name, sd) in enumerate(bound.sds.items()):
        ratio = scores.get(f"{name}_ratio", np.nan)
        if ratio > 0 and np.isfinite(ratio):
            result[i, 0] = np.clip(np.log(ratio) / sd, -LARGEST, LARGEST)
        result[i, 1] = scores.get(f"{name}_coverage_95", np.nan)
    if "rmse" in scores:
        result[-1, 0] = min(scores["rmse"] / bound.displacement, LARGEST)
    return result


def summarise_fits(fits: Sequence[np.ndarray], failed: Sequence[bool], seconds: Sequence[float]) -> Statistics:
    """Return the statistics of the fits at one point, each scored by :func:`score_fit`."""
    errors, covered = np.moveaxis(np.array(fits), 2, 0)
    values = np.array([_statistics(errors[:, i], covered[:, i]) for i in range(errors.shape[1])])
    return Statistics(values, len(fits), float(np.mean(failed)), float(np.median(seconds)))


def _statistics(errors: np.ndarray, covered: np.ndarray) -> list[float]:
    sizes, stated = np.abs(errors), np.isfinite(covered)
    core = errors[sizes <= OUTLIER_FACTOR]
    none = float("nan")
    return [
        float(core.mean()) if core.size else none,
        float(np.sqrt(np.mean(core**2))) if core.size else none,
        float(np.median(sizes)),
        float(np.quantile(sizes, 0.9)),
        float(np.mean(sizes > OUTLIER_FACTOR)),
        float(covered[stated].mean()) if stated.any() else none,
        float(stated.mean()),
    ]
