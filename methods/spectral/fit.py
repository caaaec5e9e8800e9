"""Least squares on the lines of the DFT, with the transient projected out.

The transient and an offset are linear in their coefficients, which are fitted at every trial (variable projection: G.
Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973; derivatives with the simplification of L. Kaufman, BIT 15:49,
1975, which keeps the gradient exact).

The unknowns are k/m and c/m of a free vibration, which may become negative, and the logarithms of m, c and k under a
known force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import Linearisation, StepLimits, minimise
from methods.spectral.lines import HarmonicLayout, forced_lines, transient

LARGEST = 1.0
"""Largest step of a logarithm."""
LIMIT = 40.0
"""Largest size of a logarithm."""
ROUNDS, SMALLER = 3, 0.5
"""Largest number of successive searches, and the decrease of the residuals that requires another."""


@dataclass(frozen=True, eq=False)
class Objective:
    """The objective of the fit to the DFT lines ``y`` (N,) of a record; ``offset`` frees the line of frequency zero.

    ``nominal`` and ``width`` (3,): mean and standard deviation, over the noise, of a normal prior on the logarithms.
    """

    layout: HarmonicLayout
    y: np.ndarray
    offset: bool
    nominal: np.ndarray | None = None
    width: np.ndarray | None = None

    def linearise(self, unknowns: np.ndarray) -> Linearisation:
        """Evaluate residuals and their derivatives at unknowns (cases, p), with transient and offset fitted."""
        trials = [self._trial(row) for row in unknowns]
        residuals, slopes = np.stack([rows for rows, _ in trials]), np.stack([by for _, by in trials])
        if self.nominal is not None and self.width is not None:
            rows = np.broadcast_to(np.diag(1.0 / self.width), (len(slopes), self.width.size, self.width.size))
            residuals = np.concatenate([residuals, (unknowns - self.nominal) / self.width], axis=1)
            slopes = np.concatenate([slopes, rows], axis=1)
        return Linearisation.of(unknowns, residuals, slopes)

    def _trial(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the residuals (N,) of the lines, and their derivatives (N, p)."""
        if self.layout.forced:
            m, c, k = np.exp(unknowns)
            r, g = k / m, c / m
            known, slopes = forced_lines(self.layout, m, c, k)
            slopes = slopes * np.array([m, c, k])[:, None]
            by_unknowns = np.array([[-r, -g], [0.0, g], [r, 0.0]])
        else:
            r, g = unknowns
            known, slopes, by_unknowns = np.zeros_like(self.y), np.zeros((2, self.y.size)), np.eye(2)
        columns, column_slopes = transient(self.layout, r, g)
        if self.offset:
            columns = np.hstack([columns, np.eye(self.y.size, 1)])
        sizes = np.linalg.norm(columns, axis=0)
        if not (np.all(np.isfinite(known)) and np.all(np.isfinite(sizes) & (sizes > 0))):
            return np.full(self.y.size, np.inf), np.zeros((self.y.size, unknowns.size))
        basis, triangle = np.linalg.qr(columns / sizes)
        remainder = self.y - known
        amplitudes = np.linalg.lstsq(triangle, basis.T @ remainder, rcond=None)[0] / sizes
        slopes = slopes + by_unknowns @ (column_slopes @ amplitudes[:2])
        return remainder - basis @ (basis.T @ remainder), -(slopes - (slopes @ basis) @ basis.T).T


def search(objective: Objective, starts: np.ndarray, iterations: int) -> tuple[Linearisation, int]:
    """Search a minimum from each initial guess (cases, p); return the ends and the number of evaluations.

    Residuals are scaled by their initial size; a search that reduced them much is repeated with the new scale.
    """
    size, forced = starts.shape[1], objective.layout.forced
    limits = StepLimits(np.full(size, LARGEST), np.full(size, LIMIT)) if forced else None
    ends, spent = objective.linearise(starts), len(starts)
    for _ in range(ROUNDS):
        units = _units(ends)

        def evaluate(cases: np.ndarray, unknowns: np.ndarray, units: np.ndarray = units) -> Linearisation:
            return _scaled(objective.linearise(unknowns), 1.0 / units[cases])

        reached = minimise(evaluate, _scaled(ends, 1.0 / units), iterations, limits)
        ends, spent = _scaled(reached.point, units), spent + int(reached.iterations.sum())
        if np.all(_units(ends) > SMALLER * units):
            break
    return ends, spent


def _units(ends: Linearisation) -> np.ndarray:
    """Return the root mean square of the residuals of each case; 1 where they are zero or not finite."""
    usable = (ends.cost > 0.0) & np.isfinite(ends.cost)
    return np.sqrt(np.where(usable, ends.cost / ends.residuals.shape[1], 1.0))


def _scaled(ends: Linearisation, factors: np.ndarray) -> Linearisation:
    return Linearisation.of(ends.unknowns, ends.residuals * factors[:, None], ends.slopes * factors[:, None, None])
