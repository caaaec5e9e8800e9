"""Scores of a modal method on a scenario: error over the bound, coverage, missed modes, number of modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import t as student

from bench.modal.scenario import ModalTruth

OUTLIER = 5.0
"""Ratio of error to bound above which a fit is an outlier, as in all tables."""
QUANTITIES = ("frequency", "damping_ratio")
Fitted = Mapping[str, Any]
"""Stored fit: ``modes`` as rows of frequency, damping ratio and the standard errors of both; ``degrees``, ``status``,
``message``, ``wall_s``."""


def match(estimates: np.ndarray, truth: ModalTruth, bound: np.ndarray) -> np.ndarray:
    """Assign estimated modes to true modes, so that the sum of the frequency distances is smallest.

    A distance is at most a half-power bandwidth, or :data:`OUTLIER` bounds if that is more.

    Args:
        estimates: Rows of frequency, damping ratio and standard errors, shape (rows, 4).
        truth: True modes.
        bound: Relative Cramér-Rao bounds, shape (2, modes).

    Returns:
        The row of each true mode, -1 for a missed one; shape (modes,).
    """
    reach = truth.frequencies * np.maximum(2.0 * truth.damping_ratios, OUTLIER * bound[0])
    distances = np.abs(estimates[:, 0] - truth.frequencies[:, None]) / reach[:, None]
    chosen = np.full(len(reach), -1)
    for mode, row in zip(*linear_sum_assignment(np.where(distances <= 1.0, distances, 1e6)), strict=True):
        chosen[mode] = row if distances[mode, row] <= 1.0 else -1
    return chosen


def modal_scores(
    fits: Sequence[Fitted | None], truths: Sequence[ModalTruth], bounds: Sequence[np.ndarray]
) -> list[dict[str, Any]]:
    """Score the replicates of a scenario.

    Args:
        fits: Stored fits; None for a missing one.
        truths: True modes of each replicate.
        bounds: Bounds of each replicate, shape (2, modes).

    Returns:
        A row per quantity. ``rms_pct`` and ``excess`` are the root mean squares of the relative error (%) and of the
        error over its bound, for identified modes; ``coverage_pct`` is the coverage of their 95 % intervals.
        ``outliers_pct`` is the share of true modes that were missed or have an outlier in a quantity, ``right_pct``
        that of replicates with the true number of modes.
    """
    errors, halves = np.full((2, len(fits), 2, len(truths[0].frequencies)), np.nan)
    answers = {i: fit for i, fit in enumerate(fits) if fit is not None and fit["status"] == "ok"}
    for i, fit in answers.items():
        estimates, true = (
            np.array(fit["modes"], float).reshape(-1, 4),
            [truths[i].frequencies, truths[i].damping_ratios],
        )
        rows = match(estimates, truths[i], bounds[i])
        identified = np.vstack([estimates, np.full(4, np.nan)])[rows].T
        errors[i] = identified[:2] / true - 1.0
        halves[i] = student.ppf(0.975, fit["degrees"]) * identified[2:] / true
    over = np.abs(errors) / np.array(bounds)
    shared = {
        "outliers_pct": 100.0 * float(np.mean(~(over <= OUTLIER).all(axis=1))),
        "right_pct": 100.0 * sum(len(fit["modes"]) == errors.shape[2] for fit in answers.values()) / len(fits),
        "wall_ms": 1000.0 * float(np.median([fit["wall_s"] for fit in answers.values()])),
        "ok": len(answers),
        "replicates": len(fits),
    }
    covered = np.where(np.isfinite(halves) & np.isfinite(errors), np.abs(errors) <= halves, np.nan)
    return [
        {
            "quantity": name, "rms_pct": 100.0 * _rms(errors[:, q]), "excess": _rms(over[:, q]),
            "coverage_pct": 100.0 * _mean(covered[:, q]), **shared,
        }
        for q, name in enumerate(QUANTITIES)
    ]  # fmt: skip


def bound_scores(bounds: Sequence[np.ndarray]) -> list[dict[str, Any]]:
    """Return the rows of an efficient estimator, whose error is the bound."""
    return [
        {"quantity": name, "rms_pct": 100.0 * _rms(np.array(bounds)[:, q]), "excess": 1.0, "coverage_pct": float("nan")}
        for q, name in enumerate(QUANTITIES)
    ]


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.mean(known)) if known.size else float("nan")


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(_mean(values**2)))
