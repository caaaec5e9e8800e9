"""Least squares on the lines of the DFT over the parameters, with the transient projected out.

What the transient and an offset add is linear in their coefficients, so these are fitted at every trial (variable
projection: G. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973; the derivatives with the simplification of L.
Kaufman, BIT 15:49, 1975, which leaves the gradient exact).

Unknowns: k/m and c/m where the vibration is free, which may come out negative; the logarithms of m, c and k where a
force tells the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import Linearisation, StepLimits, minimise
from methods.spectral.response import HarmonicLayout, forced_lines, transient

LARGEST = 1.0
"""Longest step of a logarithm."""
LIMIT = 40.0
"""Largest size of a logarithm."""
ROUNDS, SMALLER = 3, 0.5
"""Searches in turn, at most, and how much smaller the residuals must have become for another."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Unknowns (p,), residuals (n,) and their derivatives (n, p), transient and offset fitted; a prior adds rows."""

    unknowns: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray

    @property
    def cost(self) -> float:
        """Sum of squares; infinite where a residual is not finite."""
        total = float(self.residuals @ self.residuals)
        return total if np.isfinite(total) and np.all(np.isfinite(self.slopes)) else np.inf

    @property
    def unit(self) -> float:
        """Root mean square of the residuals; 1 where they are zero or not finite."""
        return float(np.sqrt(self.cost / self.residuals.size)) if 0.0 < self.cost < np.inf else 1.0


@dataclass(frozen=True, eq=False)
class Objective:
    """The lines ``y`` (N,) of a record, and what is fitted to them; ``offset`` frees the line of frequency zero.

    ``nominal`` and ``width`` (3,) are a normal prior on the logarithms, the width in units of the noise; or None.
    """

    layout: HarmonicLayout
    y: np.ndarray
    offset: bool
    nominal: np.ndarray | None = None
    width: np.ndarray | None = None

    def at(self, unknowns: np.ndarray) -> Trial:
        """Evaluate a trial."""
        if self.layout.forced:
            m, c, k = np.exp(unknowns)
            r, g = k / m, c / m
            known, slopes = forced_lines(self.layout, m, c, k)
            slopes = slopes * np.array([m, c, k])[:, None]
            by_unknowns = np.array([[-r, -g], [0.0, g], [r, 0.0]])
        else:
            r, g = unknowns
            known, slopes, by_unknowns = np.zeros_like(self.y), np.zeros((2, self.y.size)), np.eye(2)
        columns, turns = transient(self.layout, r, g)
        if self.offset:
            columns = np.hstack([columns, np.eye(self.y.size, 1)])
        sizes = np.linalg.norm(columns, axis=0)
        if not (np.all(np.isfinite(known)) and np.all(np.isfinite(sizes) & (sizes > 0))):
            return Trial(unknowns, np.full(self.y.size, np.inf), np.zeros((self.y.size, unknowns.size)))
        basis, triangle = np.linalg.qr(columns / sizes)
        left = self.y - known
        amplitudes = np.linalg.lstsq(triangle, basis.T @ left, rcond=None)[0] / sizes
        slopes = slopes + by_unknowns @ (turns @ amplitudes[:2])
        slopes = slopes - (slopes @ basis) @ basis.T
        return self._with_prior(Trial(unknowns, left - basis @ (basis.T @ left), -slopes.T))

    def _with_prior(self, trial: Trial) -> Trial:
        if self.nominal is None or self.width is None:
            return trial
        away = (trial.unknowns - self.nominal) / self.width
        return Trial(
            trial.unknowns,
            np.concatenate([trial.residuals, away]),
            np.concatenate([trial.slopes, np.diag(1.0 / self.width)]),
        )


def search(objective: Objective, starts: Sequence[np.ndarray], iterations: int) -> tuple[list[Trial], int]:
    """Search a minimum from each of the starts, all together; return where they end, and the number of evaluations.

    Residuals are taken in units of those that the search began with; where it has made them much smaller, it goes on
    from there.
    """
    forced, size = objective.layout.forced, starts[0].size
    limits = StepLimits(np.full(size, LARGEST), np.full(size, LIMIT)) if forced else None
    trials, spent = [objective.at(start) for start in starts], len(starts)
    for _ in range(ROUNDS):
        units = np.array([trial.unit for trial in trials])

        def evaluate(cases: np.ndarray, unknowns: np.ndarray, units: np.ndarray = units) -> Linearisation:
            return _in_units([objective.at(own) for own in unknowns], units[cases])

        end = minimise(evaluate, _in_units(trials, units), iterations, limits)
        reached = zip(end.at.unknowns, end.at.residuals, end.at.slopes, units, strict=True)
        trials = [Trial(unknowns, residuals * unit, slopes * unit) for unknowns, residuals, slopes, unit in reached]
        spent += int(end.iterations.sum())
        if all(trial.unit > SMALLER * unit for trial, unit in zip(trials, units, strict=True)):
            break
    return trials, spent


def _in_units(trials: Sequence[Trial], units: np.ndarray) -> Linearisation:
    residuals, slopes = np.stack([trial.residuals for trial in trials]), np.stack([trial.slopes for trial in trials])
    unknowns = np.stack([trial.unknowns for trial in trials])
    return Linearisation.of(unknowns, residuals / units[:, None], slopes / units[:, None, None])
