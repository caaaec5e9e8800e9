"""Resamples of replicates, the same ones wherever means of them are asked for."""

from __future__ import annotations

from functools import cache

import numpy as np

RESAMPLES = 2000


@cache
def shares(n: int) -> np.ndarray:
    """How large a part of each resample of n replicates each is, (RESAMPLES, n): times values, the resamples' means."""
    drawn = np.random.default_rng(0).integers(0, n, (RESAMPLES, n))
    return np.stack([np.bincount(one, minlength=n) for one in drawn]) / n
