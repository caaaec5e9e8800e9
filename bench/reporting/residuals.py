"""Residuals of stored estimates: the data of each replicate, regenerated, minus the response of the estimated k/m, c/m.

One mass in free vibration. The initial state is fitted to the data, known or not, as a user with k/m and c/m would do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.dynamics.linear_motion import linear_motion
from bench.reporting.frame import Result, group
from bench.scoring.statistics import whiteness
from bench.systems import SDOF

LEVEL = 0.05
"""Level of the whiteness test: the share of the residuals of a right model that it rejects."""
STEP = 1e-4
"""Relative step of k/m and c/m for the derivatives of the response."""


def coloured(results: Sequence[Result]) -> dict[str, np.ndarray]:
    """Test the residuals of each successful replicate for whiteness.

    All replicates of a result have the same sample times.

    Returns:
        Whether white noise is rejected for each successful replicate (n_ok,), by the identity of the result.
    """
    rejected: dict[str, np.ndarray] = {}
    for members in group([result for result in results if result.n], lambda result: result.question).values():
        p, most, first = members[0].parameters, max(result.n for result in members), members[0]
        channels = [problem.records[0].channels[0] for problem, _ in first.scenario.replicates(first.seed, most)]
        values, true = np.stack([channel.values for channel in channels]), np.array([p["k"], p["c"]]) / p["m"]
        for result in members:
            ratios = np.stack([result.scores("k_over_m_ratio"), result.scores("c_over_m_ratio")], axis=-1)
            usable = result.ok & np.all(np.isfinite(ratios), axis=-1)
            rejected[result.identity] = _coloured(channels[0].times, values[: result.n][usable], ratios[usable] * true)
    return rejected


def _coloured(times: np.ndarray, values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    remainders, initial_states = residuals(times, values, groups)
    good = np.flatnonzero(np.all(np.isfinite(remainders), axis=1))
    if not good.size:
        return np.ones(len(remainders), bool)
    middle = good[np.argsort(groups[good, 0])[good.size // 2]]  # the median estimate; its tangents serve for all
    here, *moved = _motions(times, groups[middle] * (1.0 + STEP * np.eye(3, 2, -1)))
    tangents = np.column_stack([here, *((motion - here) @ initial_states[middle] / STEP for motion in moved)])
    return ~(whiteness(remainders, tangents) >= LEVEL)  # also rejected where the response is not finite


def residuals(times: np.ndarray, values: np.ndarray, groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit the initial state for given k/m and c/m, and return the residuals.

    Args:
        times: Sample times (s), shape (n,).
        values: Displacements, shape (sets, n).
        groups: k/m and c/m, shape (sets, 2).

    Returns:
        Residuals (sets, n) and initial states (sets, 2); NaN where the response is not finite.
    """
    motions = _motions(times, groups)
    good = np.all(np.isfinite(motions), axis=(1, 2))
    motions[~good] = 0.0
    initial_states = (np.linalg.pinv(motions) @ values[..., None])[..., 0]
    initial_states[~good] = np.nan
    return values - (motions @ initial_states[..., None])[..., 0], initial_states


def _motions(times: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Return the responses to unit displacement and to unit velocity of a mass 1 (sets, n, 2)."""
    p = {"m": np.ones(len(groups)), "c": groups[:, 1], "k": groups[:, 0]}
    unit_states = np.repeat(np.eye(2)[:, None], len(groups), axis=1)
    return np.stack([linear_motion(SDOF(), p, s0, times, slopes=False)[0][..., 0] for s0 in unit_states], axis=-1)
