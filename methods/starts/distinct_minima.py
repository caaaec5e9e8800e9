"""Selection of the distinct minima among the ends of several searches."""

from __future__ import annotations

import numpy as np

from bench import OutputError, state_matrix

ALIAS_MARGIN = 6.0
"""Decrease of minus twice the log-posterior by which an alias must be better: odds of 20 to 1."""
APART = 1e-2
"""Ends whose log-parameters differ by less are the same minimum."""


def distinct_minima(
    model: OutputError, values: np.ndarray, thetas: np.ndarray, aliases: np.ndarray | None = None
) -> list[int]:
    """Return the indices of the finite, distinct ends of searches, best first.

    An end whose slowest oscillation lies above half the sampling rate ranks after the best end below it, unless data
    and prior clearly prefer it. Without a prior, which could decide between aliases, it is dropped.

    Args:
        model: The model of the searches.
        values: Minus twice the log-posterior of each end, (n,).
        thetas: The ends, (n, size).
        aliases: The result of :func:`aliased` for them, (n,), computed where it is None.
    """
    k, kept = len(model.free), list[int]()
    for i in map(int, np.flatnonzero(np.isfinite(values))):
        if not any(np.max(np.abs(thetas[i] - thetas[other])[:k]) < APART for other in kept):
            kept.append(i)
    kept.sort(key=lambda i: float(values[i]))
    if aliases is None:
        aliases = np.zeros(len(thetas), bool)
        aliases[kept] = aliased(model, thetas[kept])
    resolved = [i for i in kept if not aliases[i]]
    if not resolved or values[kept[0]] + ALIAS_MARGIN < values[resolved[0]]:
        return kept
    return resolved if model.prior is None else [resolved[0], *(i for i in kept if i != resolved[0])]


def aliased(model: OutputError, thetas: np.ndarray) -> np.ndarray:
    """Return which vectors (n, size) have their slowest oscillation above half the sampling rate."""
    gaps = [float(np.median(np.diff(c.times))) for _, c in model.channels if c.n > 1]
    if not model.system.linear or not gaps:
        return np.zeros(len(thetas), bool)
    oscillations = np.abs(_eigenvalues(state_matrix(model.system, model.parameters(thetas))[0]).imag)
    slowest = np.min(np.where(oscillations > 0, oscillations, np.inf), axis=1)
    return np.isfinite(slowest) & (slowest * min(gaps) > np.pi)


def _eigenvalues(a: np.ndarray) -> np.ndarray:
    """Return eigenvalues of matrices (n, d, d); one degree of freedom, ``[[0, 1], [-r, -g]]``, has a closed form."""
    if a.shape[-1] > 2:
        return np.linalg.eigvals(a)
    half = 0.5 * a[:, 1, 1]
    root = np.sqrt((half**2 + a[:, 1, 0]).astype(complex))
    return np.stack([half - root, half + root], axis=1)
