"""Residuals of stored answers: the data of each replicate made anew, less the response of its k/m and c/m.

One mass in free vibration, with the start that fits best whether or not it was told: what a user who was given k/m and
c/m would look at.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.dynamics.linear_motion import linear_motion
from bench.reporting.frame import Result, group
from bench.scoring.statistics import whiteness
from bench.systems import SDOF

LEVEL = 0.05
"""Of the test: so many of the residuals of a right model look coloured."""
STEP = 1e-4
"""Of k/m and c/m, relatively, for the direction in which the response moves with them."""


def coloured(results: Sequence[Result]) -> dict[str, np.ndarray]:
    """Return by identity, of each replicate that was answered, whether its residuals are told from white noise.

    All replicates of a result have the same sample times.
    """
    found: dict[str, np.ndarray] = {}
    for same in group([result for result in results if result.n], lambda result: result.question).values():
        p, most = same[0].parameters, max(result.n for result in same)
        channels = [problem.records[0].channels[0] for problem, _ in same[0].scenario.replicates(same[0].seed, most)]
        values, true = np.stack([channel.values for channel in channels]), np.array([p["k"], p["c"]]) / p["m"]
        for result in same:
            ratios = np.stack([result.scores("k_over_m_ratio"), result.scores("c_over_m_ratio")], axis=-1)
            told = result.ok & np.all(np.isfinite(ratios), axis=-1)
            found[result.identity] = _coloured(channels[0].times, values[: result.n][told], ratios[told] * true)
    return found


def _coloured(times: np.ndarray, values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    left, start = residuals(times, values, groups)
    good = np.flatnonzero(np.all(np.isfinite(left), axis=1))
    if not good.size:
        return np.ones(len(left), bool)
    middle = good[np.argsort(groups[good, 0])[good.size // 2]]  # a usual answer, whose tangents serve for all
    here, *moved = _motions(times, groups[middle] * (1.0 + STEP * np.eye(3, 2, -1)))
    tangents = np.column_stack([here, *((motion - here) @ start[middle] / STEP for motion in moved)])
    return ~(whiteness(left, tangents) >= LEVEL)  # a response that is not finite explains nothing


def residuals(times: np.ndarray, values: np.ndarray, groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what k/m and c/m (sets, 2) leave of values (sets, n), and the best initial state (sets, 2).

    NaN where the response is not finite.
    """
    motions = _motions(times, groups)
    good = np.all(np.isfinite(motions), axis=(1, 2))
    motions[~good] = 0.0
    start = (np.linalg.pinv(motions) @ values[..., None])[..., 0]
    start[~good] = np.nan
    return values - (motions @ start[..., None])[..., 0], start


def _motions(times: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Responses (sets, n, 2) to unit displacement and to unit velocity of mass 1 with k/m and c/m (sets, 2)."""
    p = {"m": np.ones(len(groups)), "c": groups[:, 1], "k": groups[:, 0]}
    starts = np.repeat(np.eye(2)[:, None], len(groups), axis=1)
    return np.stack([linear_motion(SDOF(), p, s0, times, slopes=False)[0][..., 0] for s0 in starts], axis=-1)
