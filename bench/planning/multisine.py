"""Optimal powers of the lines of a multisine in steady state: D- and c-optimal, averaged over likely oscillators.

In steady state the information of a linear system is linear in the power of each line, so the optimal powers solve a
convex problem (R. Mehra, IEEE Trans. Automatic Control 19:753, 1974; G. Goodwin, R. Payne, Dynamic System
Identification, 1977, chapter 6). The criterion is the mean over the oscillators of the logarithm of the variance of one
quantity, or of the volume of the confidence ellipsoid of k/m, c/m and 1/m (L. Pronzato, Automatica 44:303, 2008). The
multiplicative algorithm scales the powers by a power of their sensitivities until the equivalence theorem holds (J.
Kiefer, J. Wolfowitz, Canadian J. Mathematics 12:363, 1960): at the optimum no sensitivity exceeds the number s of
quantities in the criterion, and that of a line with power equals s. Algorithm and, for one oscillator, monotone
convergence: Y. Yu, Annals of Statistics 38:1593, 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.planning.free_decay import QUANTITIES, Oscillator

ALL = "all"
"""The criterion of all quantities (D-optimality)."""
ENOUGH = 1e-3
"""Relative excess of the largest sensitivity over its value at the optimum at which the iteration stops."""
STEPS = 20_000
FLOOR = 1e-10
"""Smallest share of a line; a multiplicative update cannot recover from zero."""


@dataclass(frozen=True, eq=False)
class Powers:
    """``shares`` (lines,) of the power, with sum 1; ``gap``: upper limit of the criterion's distance from its
    optimum."""

    shares: np.ndarray
    gap: float


def criterion_columns(quantity: str, size: int = 3) -> np.ndarray:
    """Return the quantities of the criterion as columns (size, s); s is 3 for :data:`ALL`, otherwise 1.

    The rows belong to log k/m, log c/m, log 1/m and further unknowns.
    """
    if quantity == ALL:
        return np.eye(size)[:, :3]
    return np.array([[*QUANTITIES[quantity], *np.zeros(size - 2)]]).T


def line_information(oscillator: Oscillator, frequencies: np.ndarray) -> np.ndarray:
    """Return the information (lines, 3, 3) per sample about log k/m, log c/m, log 1/m for each line of unit mean
    square.

    It follows from the derivatives of the receptance ``H = 1 / (k/m - w² + i w c/m)`` for a force over mass.
    ``frequencies`` (lines,) are in Hz.
    """
    omega = 2.0 * np.pi * frequencies
    stiffness, damping = oscillator.omega**2, 2.0j * oscillator.damping_ratio * oscillator.omega * omega
    response = 1.0 / (stiffness - omega**2 + damping)
    rows = np.stack([-stiffness * response**2, -damping * response**2, response], axis=1)
    return np.asarray(np.real(rows[:, :, None] * rows[:, None, :].conj()))


def sensitivities(lines: np.ndarray, shares: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the negative derivatives (lines,) of the criterion by the share of each line; their mean over the power is
    s.

    Args:
        lines: Information per line, (oscillators, lines, 3, 3).
        shares: Shares of the power, (lines,).
        columns: Quantities of the criterion, (3, s).
    """
    inverse = np.linalg.inv(np.einsum("l,olij->oij", shares, lines))
    solved = inverse @ columns
    block = np.linalg.inv(columns.T @ solved)
    weights = solved @ block @ solved.swapaxes(1, 2)
    return np.asarray(np.einsum("oij,olij->l", weights, lines) / len(lines))


def criterion(lines: np.ndarray, shares: np.ndarray, columns: np.ndarray) -> float:
    """Return the mean over oscillators of the log squared volume of the confidence region of the quantities."""
    inverse = np.linalg.inv(np.einsum("l,olij->oij", shares, lines))
    return float(np.mean(np.linalg.slogdet(columns.T @ inverse @ columns)[1]))


def best_powers(oscillators: Sequence[Oscillator], frequencies: np.ndarray, quantity: str) -> Powers:
    """Return the optimal powers of the lines at ``frequencies`` (Hz) for a quantity or :data:`ALL`."""
    lines = np.stack([line_information(oscillator, frequencies) for oscillator in oscillators])
    columns = criterion_columns(quantity)
    size = columns.shape[1]
    shares, gap = np.full(frequencies.size, 1.0 / frequencies.size), np.inf
    for _ in range(STEPS):
        slopes = sensitivities(lines, shares, columns)
        gap = float(slopes.max()) - size
        if gap <= ENOUGH * size:
            break
        shares = np.maximum(shares * (slopes / size) ** (1.0 if quantity == ALL else 0.5), FLOOR)
        shares /= shares.sum()
    return Powers(shares, gap)
