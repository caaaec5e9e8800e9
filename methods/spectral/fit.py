"""Least squares on the lines of the DFT over the parameters, with the transient projected out.

What the transient and an offset add is linear in their coefficients, so these are fitted at every trial (variable
projection: G. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973; the derivatives with the simplification of L.
Kaufman, BIT 15:49, 1975, which leaves the gradient exact). The search is Levenberg-Marquardt with the scaling of J. J.
Moré (Lecture Notes in Mathematics 630:105, 1978).

Unknowns: k/m and c/m where the vibration is free, which may come out negative; the logarithms of m, c and k where a
force tells the scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from methods.spectral.response import Layout, forced_lines, transient

LARGEST = 1.0
"""Longest step of a logarithm."""
LIMIT = 40.0
"""Largest size of a logarithm."""


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


@dataclass(frozen=True, eq=False)
class Objective:
    """The lines ``y`` (N,) of a record, and what is fitted to them; ``offset`` frees the line of frequency zero.

    ``nominal`` and ``width`` (3,) are a normal prior on the logarithms, the width in units of the noise; or None.
    """

    layout: Layout
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


def search(objective: Objective, start: np.ndarray, iterations: int, tolerance: float = 1e-6) -> tuple[Trial, int]:
    """The minimum that Levenberg-Marquardt finds from a start, and the number of evaluations."""
    best, damping = objective.at(start), 1e-3
    scale = np.linalg.norm(best.slopes, axis=0) + 1e-300
    for i in range(iterations):
        if not np.isfinite(best.cost) or best.cost == 0.0:
            return best, i + 1
        scale = np.maximum(scale, np.linalg.norm(best.slopes, axis=0))
        rows = np.concatenate([best.slopes, np.sqrt(damping) * np.diag(scale)])
        right = np.concatenate([-best.residuals, np.zeros(start.size)])
        move = np.linalg.lstsq(rows, right, rcond=None)[0]
        if objective.layout.forced:
            move = np.clip(move, -LARGEST, LARGEST)
        if np.linalg.norm(scale * move) <= tolerance * np.sqrt(best.cost):
            return best, i + 1
        unknowns = best.unknowns + move
        trial = objective.at(np.clip(unknowns, -LIMIT, LIMIT) if objective.layout.forced else unknowns)
        if trial.cost < best.cost:
            best, damping = trial, 0.2 * damping
        else:
            damping = 8.0 * damping
            if damping > 1e12:
                return best, i + 2
    return best, iterations + 1
