"""Resamples of replicates, the same ones wherever means or medians of them are asked for."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

RESAMPLES = 2000


@lru_cache(maxsize=16)
def resamples(n: int, count: int = RESAMPLES) -> np.ndarray:
    """Draw ``count`` resamples of n replicates: the numbers of the replicates in each, (count, n)."""
    return np.random.default_rng(0).integers(0, n, (count, n))


@lru_cache(maxsize=16)
def shares(n: int) -> np.ndarray:
    """Compute how large a part of each resample each replicate is, (RESAMPLES, n): times values, the means."""
    return np.stack([np.bincount(one, minlength=n) for one in resamples(n)]) / n


def medians(values: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """Compute the median of each resample.

    Args:
        values: What was resampled (n,), some perhaps infinite: a mean of a number and infinity is infinite, never NaN.
        drawn: Which of them are in each resample, (count, n).

    Returns:
        Medians (count,), where n is even those between the middle two values.
    """
    ordered, ranks = _ranked(values, drawn)
    middle = (values.size - 1) // 2
    if values.size % 2:
        return ordered[ranks[:, middle]]
    return np.asarray(0.5 * (ordered[ranks[:, middle]] + ordered[np.min(ranks[:, middle + 1 :], axis=1)]))


def lower_medians(values: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """Compute the median of each resample, see :func:`medians`; where n is even the lower of the middle two values."""
    ordered, ranks = _ranked(values, drawn)
    return ordered[ranks[:, (values.size - 1) // 2]]


def _ranked(values: np.ndarray, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the values in order, and their ranks in each resample, the median's in the middle, lower ones before it.

    Ranks take half the memory of values, and half the time to sort.
    """
    order = np.argsort(values, kind="stable")
    ranks = np.empty(values.size, np.int32)
    ranks[order] = np.arange(values.size)
    ranked = ranks[drawn]
    ranked.partition((values.size - 1) // 2, axis=1)
    return values[order], ranked
