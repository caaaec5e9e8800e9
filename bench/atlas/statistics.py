"""What is kept of the fits of a method at one point: numbers enough to know its errors, not the errors themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Problem
from bench.scenario.truth import Truth
from bench.scoring.score import score

OUTLIER_FACTOR = 5.0
"""An error beyond so many times the bound is gross: hardly one in a million of those that reach the bound."""
LARGEST = 1e6
"""Errors over the bound count as at most so large; an answer that is not positive, or absent, as this."""
DISPLACEMENT = "displacement"
OF_SCORED = ("bias", "core", "median", "p90", "gross", "held", "told")
"""Of each quantity, in units of the bound's standard deviation or as a share: mean error and root mean square error of
the fits that are not gross; median and 90 % quantile of the error of all fits; share of gross fits; share of 95 %
intervals that hold the truth, of the fits that told one, and the share of those that did."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """``values`` (n_scored, n_of_scored) float32; ``fits``; ``failed``: the share without an estimate; ``seconds``: the
    median of a fit."""

    values: np.ndarray
    fits: int
    failed: float
    seconds: float

    def row(self) -> np.ndarray:
        """Everything, one behind the other."""
        return np.concatenate([[self.fits, self.failed, self.seconds], self.values.ravel()]).astype(np.float32)

    @staticmethod
    def of_row(row: np.ndarray) -> Statistics:
        """The statistics of :meth:`row`."""
        values = row[3:].reshape(-1, len(OF_SCORED))
        return Statistics(values, round(float(row[0])), float(row[1]), float(row[2]))


def columns(quantities: Sequence[str]) -> list[str]:
    """What the numbers of a row are: of the quantities, and of the displacement."""
    return ["fits", "failed", "seconds", *(f"{name}_{of}" for name in (*quantities, DISPLACEMENT) for of in OF_SCORED)]


@dataclass(frozen=True)
class Least:
    """The bound at a point: standard deviations of the quantities' logarithms, root mean square displacement (m)."""

    sds: Mapping[str, float]
    displacement: float


def one_fit(estimate: Estimate, problem: Problem, truth: Truth, least: Least) -> np.ndarray:
    """Error over the bound and whether the 95 % interval holds the truth (NaN without one), (n_scored, 2).

    Errors of the quantities are of their logarithms; that of the displacement is a root mean square, and has no
    interval.
    """
    found = np.full((len(least.sds) + 1, 2), np.nan)
    found[:, 0] = LARGEST
    if estimate.status is not Status.OK:
        return found
    scores = score(estimate, problem, truth)
    for i, (name, sd) in enumerate(least.sds.items()):
        ratio = scores.get(f"{name}_ratio", np.nan)
        if ratio > 0 and np.isfinite(ratio):
            found[i, 0] = np.clip(np.log(ratio) / sd, -LARGEST, LARGEST)
        found[i, 1] = scores.get(f"{name}_coverage_95", np.nan)
    if "rmse" in scores:
        found[-1, 0] = min(scores["rmse"] / least.displacement, LARGEST)
    return found


def pooled(fits: Sequence[np.ndarray], failed: Sequence[bool], seconds: Sequence[float]) -> Statistics:
    """The statistics of the fits at one point; each of ``fits`` is from :func:`one_fit`."""
    errors, held = np.moveaxis(np.array(fits), 2, 0)
    values = np.array([_of_quantity(errors[:, i], held[:, i]) for i in range(errors.shape[1])])
    return Statistics(values, len(fits), float(np.mean(failed)), float(np.median(seconds)))


def _of_quantity(errors: np.ndarray, held: np.ndarray) -> list[float]:
    sizes, told = np.abs(errors), np.isfinite(held)
    core = errors[sizes <= OUTLIER_FACTOR]
    none = float("nan")
    return [
        float(core.mean()) if core.size else none,
        float(np.sqrt(np.mean(core**2))) if core.size else none,
        float(np.median(sizes)),
        float(np.quantile(sizes, 0.9)),
        float(np.mean(sizes > OUTLIER_FACTOR)),
        float(held[told].mean()) if told.any() else none,
        float(told.mean()),
    ]
