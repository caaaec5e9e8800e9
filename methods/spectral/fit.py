"""Least squares on the lines of the DFT over the parameters, with the transient projected out.

What the transient and an offset add is linear in their coefficients, so these are fitted at every trial (variable
projection: G. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973; the derivatives with the simplification of L.
Kaufman, BIT 15:49, 1975, which leaves the gradient exact).

Unknowns: k/m and c/m where the vibration is free, which may come out negative; the logarithms of m, c and k where a
force tells the scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import Linearisation, StepLimits, minimise
from methods.spectral.lines import HarmonicLayout, forced_lines, transient

LARGEST = 1.0
"""Longest step of a logarithm."""
LIMIT = 40.0
"""Largest size of a logarithm."""
ROUNDS, SMALLER = 3, 0.5
"""Searches in turn, at most, and how much smaller the residuals must have become for another."""


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

    def at(self, unknowns: np.ndarray) -> Linearisation:
        """Evaluate residuals and their derivatives at unknowns (cases, p), with transient and offset fitted."""
        trials = [self._trial(row) for row in unknowns]
        residuals, slopes = np.stack([left for left, _ in trials]), np.stack([by for _, by in trials])
        if self.nominal is not None and self.width is not None:
            rows = np.broadcast_to(np.diag(1.0 / self.width), (len(slopes), self.width.size, self.width.size))
            residuals = np.concatenate([residuals, (unknowns - self.nominal) / self.width], axis=1)
            slopes = np.concatenate([slopes, rows], axis=1)
        return Linearisation.of(unknowns, residuals, slopes)

    def _trial(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N,) of the lines, and their derivatives (N, p)."""
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
            return np.full(self.y.size, np.inf), np.zeros((self.y.size, unknowns.size))
        basis, triangle = np.linalg.qr(columns / sizes)
        left = self.y - known
        amplitudes = np.linalg.lstsq(triangle, basis.T @ left, rcond=None)[0] / sizes
        slopes = slopes + by_unknowns @ (turns @ amplitudes[:2])
        return left - basis @ (basis.T @ left), -(slopes - (slopes @ basis) @ basis.T).T


def search(objective: Objective, starts: np.ndarray, iterations: int) -> tuple[Linearisation, int]:
    """Search a minimum from each of the starts (cases, p); return where they end, and the number of evaluations.

    Residuals are taken in units of those that the search began with; where it has made them much smaller, it goes on
    from there.
    """
    size, forced = starts.shape[1], objective.layout.forced
    limits = StepLimits(np.full(size, LARGEST), np.full(size, LIMIT)) if forced else None
    ends, spent = objective.at(starts), len(starts)
    for _ in range(ROUNDS):
        units = _units(ends)

        def evaluate(cases: np.ndarray, unknowns: np.ndarray, units: np.ndarray = units) -> Linearisation:
            return _scaled(objective.at(unknowns), 1.0 / units[cases])

        reached = minimise(evaluate, _scaled(ends, 1.0 / units), iterations, limits)
        ends, spent = _scaled(reached.at, units), spent + int(reached.iterations.sum())
        if np.all(_units(ends) > SMALLER * units):
            break
    return ends, spent


def _units(ends: Linearisation) -> np.ndarray:
    """Root mean square of the residuals of each case; 1 where they are zero or not finite."""
    usable = (ends.cost > 0.0) & np.isfinite(ends.cost)
    return np.sqrt(np.where(usable, ends.cost / ends.residuals.shape[1], 1.0))


def _scaled(ends: Linearisation, factors: np.ndarray) -> Linearisation:
    return Linearisation.of(ends.unknowns, ends.residuals * factors[:, None], ends.slopes * factors[:, None, None])
