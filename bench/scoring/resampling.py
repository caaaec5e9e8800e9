"""Resamples of replicates, the same ones wherever means or medians of them are asked for."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

RESAMPLES = 2000
BLOCK = 100
"""Resamples that are drawn at once: the numbers of more would not fit into the cache."""
WINDOW = 3.0
"""Ranks about the middle, over the root of n, in which medians of resamples are looked for first: six standard
deviations of theirs, so that hardly one lies outside."""


@lru_cache(maxsize=16)
def counts(n: int, resamples: int = RESAMPLES) -> np.ndarray:
    """Draw resamples of n replicates: how often each replicate is in each, shape (n, resamples)."""
    rng, often = np.random.default_rng(0), np.empty((n, resamples), np.float32)
    for first in range(0, resamples, BLOCK):
        block = often[:, first : first + BLOCK]
        block[:] = counted(rng.integers(0, n, block.shape[::-1]))
    return often


def counted(drawn: np.ndarray) -> np.ndarray:
    """Count how often each of n replicates is in each resample (resamples, n) of them, shape (n, resamples)."""
    resamples, n = drawn.shape
    places = drawn + n * np.arange(resamples)[:, None]
    return np.bincount(places.ravel(), minlength=drawn.size).reshape(resamples, n).T.astype(np.float32, order="C")


def shares(n: int) -> np.ndarray:
    """Compute how large a part of each resample each replicate is, (RESAMPLES, n): times values, the means."""
    return counts(n).T.astype(float) / n


def medians(values: np.ndarray, often: np.ndarray, lower: bool = False) -> np.ndarray:
    """Compute the median of each resample.

    Args:
        values: What was resampled (n,), some perhaps infinite: a mean of a number and infinity is infinite, never NaN.
        often: How often each of them is in each resample, (n, resamples).
        lower: Where n is even, take the lower of the middle two values instead of their mean.

    Returns:
        Medians (resamples,).
    """
    order = np.argsort(values, kind="stable")
    ordered, (low, high) = values[order], _middle_ranks(order, often)
    return ordered[low] if lower or values.size % 2 else np.asarray(0.5 * (ordered[low] + ordered[high]))


def _middle_ranks(order: np.ndarray, often: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the ranks of the lower and the upper middle value of each resample, from which half its values lie below.

    Values are counted from the lowest on: as one before a window about the middle, then rank by rank.
    """
    n, middle = order.size, (order.size - 1) // 2
    width = math.ceil(WINDOW * math.sqrt(n))
    for first, last in ((max(middle - width, 0), min(middle + width, n)), (0, n)):
        total = np.zeros(often.shape[1], np.float32)
        for replicate in order[:first]:
            total += often[replicate]
        if np.any(total > middle):
            continue
        below = np.empty((2, last - first, total.size), bool)
        for place, replicate in enumerate(order[first:last]):
            total += often[replicate]
            np.less_equal(total, middle, out=below[0, place])
            np.less_equal(total, middle + 1, out=below[1, place])
        lower, upper = (np.asarray(first + np.sum(side.view(np.uint8), axis=0, dtype=np.int32)) for side in below)
        if max(np.max(lower), np.max(upper) if n % 2 == 0 else 0) < last:
            break
    return lower, upper
