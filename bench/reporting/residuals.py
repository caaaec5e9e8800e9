"""Residuals of stored answers: the data of each replicate made anew, less the response of its k/m and c/m.

One mass in free vibration, with the start that fits best whether or not it was told: what a user who was given k/m and
c/m would look at.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.dynamics.linear_response import linear_response
from bench.reporting.frame import Result, group
from bench.scoring.whiteness import ljung_box
from bench.systems import SDOF

LEVEL = 0.05
"""Of the test: so many of the residuals of a right model look coloured."""


def coloured(results: Sequence[Result]) -> dict[str, np.ndarray]:
    """By identity, of each replicate that was answered whether its residuals are told from white noise, booleans."""
    found: dict[str, np.ndarray] = {}
    for own in group([result for result in results if result.n], lambda result: result.question).values():
        most, p = max(result.n for result in own), own[0].parameters
        channels = [problem.records[0].channels[0] for problem, _ in own[0].scenario.replicates(own[0].seed, most)]
        values, true = np.stack([channel.values for channel in channels]), np.array([p["k"], p["c"]]) / p["m"]
        for result in own:
            ratios = np.stack([result.scores("k_over_m_ratio"), result.scores("c_over_m_ratio")], axis=-1)
            told = np.flatnonzero(result.ok & np.all(np.isfinite(ratios), axis=-1))
            times = np.stack([channels[i].times for i in told]) if told.size else np.empty((0, 0))
            left = residuals(times, values[told], ratios[told] * true)
            found[result.identity] = np.asarray(ljung_box(left) < LEVEL) if told.size else np.empty(0, bool)
    return found


def residuals(times: np.ndarray, values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """What k/m and c/m (sets, 2) leave of values (sets, n) at times (sets, n), from the best start of each set.

    NaN where the response is not finite.
    """
    left = np.full(values.shape, np.nan)
    for which in dict.fromkeys(map(tuple, times)):
        mine = np.flatnonzero(np.all(times == which, axis=1))
        p = {"m": np.ones(mine.size), "c": groups[mine, 1], "k": groups[mine, 0]}
        starts = np.repeat(np.eye(2)[:, None], mine.size, axis=1)
        basis = [linear_response(SDOF(), p, start, np.array(which), ())[0] for start in starts]
        columns = np.stack(basis, axis=-1)
        good = np.all(np.isfinite(columns), axis=(1, 2))
        columns, y = columns[good], values[mine[good], :, None]
        left[mine[good]] = (y - columns @ (np.linalg.pinv(columns) @ y))[..., 0]
    return left
