"""Of many ends of a search those that are worth keeping: apart from each other, best first, aliases behind."""

from __future__ import annotations

import numpy as np

from bench import OutputError, state_matrix

ALIAS_MARGIN = 6.0
"""By how much in minus twice the log-posterior an alias must be better: odds of 20 to 1."""
APART = 1e-2
"""Log-parameters nearer than this are one end."""


def separate(
    model: OutputError, values: np.ndarray, thetas: np.ndarray, aliases: np.ndarray | None = None
) -> list[int]:
    """Places, best first, of the ends that are finite and apart, by their ``values`` (n,), minus twice a log-posterior.

    The sampling is taken to resolve the motion: where the slowest oscillation of a linear system came to lie above
    half the sampling rate, it comes behind a slower one of which it is the alias, unless data and prior clearly prefer
    it. Without a prior, which could weigh both, it is dropped. ``aliases`` (n,): those of :func:`aliased`, where known.
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
    """Whether the slowest oscillation at each vector (n, size) is above half the sampling rate."""
    gaps = [float(np.median(np.diff(c.times))) for _, c in model.channels if c.n > 1]
    if not model.system.linear or not gaps:
        return np.zeros(len(thetas), bool)
    oscillations = np.abs(_eigenvalues(state_matrix(model.system, model.parameters(thetas))[0]).imag)
    slowest = np.min(np.where(oscillations > 0, oscillations, np.inf), axis=1)
    return np.isfinite(slowest) & (slowest * min(gaps) > np.pi)


def _eigenvalues(a: np.ndarray) -> np.ndarray:
    """Those of each matrix (n, 2, 2) or larger; of one degree of freedom, ``[[0, 1], [-r, -g]]``, in closed form."""
    if a.shape[-1] > 2:
        return np.linalg.eigvals(a)
    half = 0.5 * a[:, 1, 1]
    root = np.sqrt((half**2 + a[:, 1, 0]).astype(complex))
    return np.stack([half - root, half + root], axis=1)
