"""Powers of the lines of a multisine that tell most in steady state: D- and c-optimal, robust over likely oscillators.

In steady state the information of a linear system is linear in the power of each line, so the best powers solve a
convex problem (R. Mehra, IEEE Trans. Automatic Control 19:753, 1974; G. Goodwin, R. Payne, Dynamic System
Identification, 1977, chapter 6). The criterion is the mean over the oscillators of the logarithm of the variance of the
wanted quantity, or of the volume of the ellipsoid of k/m, c/m and 1/m (L. Pronzato, Automatica 44:303, 2008). The
powers are multiplied by a power of their sensitivities until the equivalence theorem holds (J. Kiefer, J. Wolfowitz,
Canadian J. Mathematics 12:363, 1960): at an optimum no line is more sensitive than there are wanted quantities, and
lines with power are just as much. The algorithm and, for one oscillator, its monotone convergence: Y. Yu, Annals of
Statistics 38:1593, 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.planning.free_decay import QUANTITIES, Oscillator

ALL = "all"
"""The criterion that favours no quantity."""
ENOUGH = 1e-3
"""Sensitivity above its largest value at the optimum, by share, at which the powers are good enough."""
STEPS = 20_000
FLOOR = 1e-10
"""Least share of a line: one that has died out could not come back."""


@dataclass(frozen=True, eq=False)
class Powers:
    """``shares`` (lines,) of the power, sum 1, and by how much, of the criterion, they may miss the optimum."""

    shares: np.ndarray
    gap: float


def wanted_columns(quantity: str, size: int = 3) -> np.ndarray:
    """(size, s): what the criterion weighs, of log k/m, log c/m, log 1/m and what else is unknown; s is 3 for ALL."""
    if quantity == ALL:
        return np.eye(size)[:, :3]
    return np.array([[*QUANTITIES[quantity], *np.zeros(size - 2)]]).T


def line_information(oscillator: Oscillator, frequencies: np.ndarray) -> np.ndarray:
    """(lines, 3, 3): information of one sample about log k/m, log c/m, log 1/m, by line (Hz) of mean square 1.

    The receptance times its relative derivatives: ``H = 1 / (k/m - w² + i w c/m)``, for a force over mass.
    """
    omega = 2.0 * np.pi * frequencies
    stiffness, damping = oscillator.omega**2, 2.0j * oscillator.damping_ratio * oscillator.omega * omega
    response = 1.0 / (stiffness - omega**2 + damping)
    rows = np.stack([-stiffness * response**2, -damping * response**2, response], axis=1)
    return np.asarray(np.real(rows[:, :, None] * rows[:, None, :].conj()))


def sensitivities(lines: np.ndarray, shares: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(lines,): by how much the criterion falls with the power of each, which sums to s over the power.

    ``lines`` (oscillators, lines, 3, 3), ``columns`` (3, s).
    """
    inverse = np.linalg.inv(np.einsum("l,olij->oij", shares, lines))
    wanted = inverse @ columns
    block = np.linalg.inv(columns.T @ wanted)
    weights = wanted @ block @ wanted.swapaxes(1, 2)
    return np.asarray(np.einsum("oij,olij->l", weights, lines) / len(lines))


def criterion(lines: np.ndarray, shares: np.ndarray, columns: np.ndarray) -> float:
    """The mean over oscillators of the logarithm of the volume (squared) of what is wanted."""
    inverse = np.linalg.inv(np.einsum("l,olij->oij", shares, lines))
    return float(np.mean(np.linalg.slogdet(columns.T @ inverse @ columns)[1]))


def best_powers(oscillators: Sequence[Oscillator], frequencies: np.ndarray, quantity: str) -> Powers:
    """The best shares of the power of the lines (Hz) for a quantity, or :data:`ALL`."""
    lines = np.stack([line_information(own, frequencies) for own in oscillators])
    columns = wanted_columns(quantity)
    size = columns.shape[1]
    shares, gap = np.full(frequencies.size, 1.0 / frequencies.size), np.inf
    for _ in range(STEPS):
        found = sensitivities(lines, shares, columns)
        gap = float(found.max()) - size
        if gap <= ENOUGH * size:
            break
        shares = np.maximum(shares * (found / size) ** (1.0 if quantity == ALL else 0.5), FLOOR)
        shares /= shares.sum()
    return Powers(shares, gap)
