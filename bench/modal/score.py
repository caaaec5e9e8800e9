"""Scores of a modal method on one scenario: error over the bound, coverage, modes that were missed, their number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import t as student

from bench.modal.scenario import ModalTruth

OUTLIER = 5.0
"""An error beyond so many bounds is an outlier, as in all tables."""
QUANTITIES = ("frequency", "damping_ratio")
Fitted = Mapping[str, Any]
"""What is stored of a fit: ``modes`` as rows of frequency, damping ratio and the standard error of each; ``degrees``,
``status``, ``message``, ``wall_s``."""


def match(estimates: np.ndarray, truth: ModalTruth, bound: np.ndarray) -> np.ndarray:
    """Return for each true mode the row of ``estimates`` (rows, 4) that identifies it, -1 for a mode that is missed.

    An estimate identifies at most one mode, from which its frequency is within a half-power bandwidth, or within
    :data:`OUTLIER` bounds where that is more; the sum of the distances is least.
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
    """Pool the replicates of a scenario, of which None is a fit without a result; return a row for each quantity.

    ``rms_pct`` and ``excess``: root mean square of the relative error, and of the error over its bound, of the modes
    that were identified; ``coverage_pct`` of their 95 % intervals; of all replicates, ``outliers_pct``: true modes that
    were missed or have an outlier in one of the quantities, and ``right_pct``: the number of modes is the true one.
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
    """Return the rows of an estimate that just reaches the bound."""
    return [
        {"quantity": name, "rms_pct": 100.0 * _rms(np.array(bounds)[:, q]), "excess": 1.0, "coverage_pct": float("nan")}
        for q, name in enumerate(QUANTITIES)
    ]


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.mean(known)) if known.size else float("nan")


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(_mean(values**2)))
