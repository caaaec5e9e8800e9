"""How much of an error is bias: its mean, as opposed to its scatter about the mean."""

from __future__ import annotations

import math

import numpy as np


def bias_share(ratios: np.ndarray) -> float:
    """The share of the mean square error of ``ratios`` (estimate over truth, shape (n,)) that is bias squared.

    The mean square of an error is its mean squared plus its variance. The square of the mean of n errors is too large
    by their variance over n on average, which is taken off, down to nothing; NaN below three replicates and where there
    is no error.
    """
    if ratios.size < 3:
        return math.nan
    errors = ratios - 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        total = float(np.mean(errors**2))
        bias = float(np.mean(errors) ** 2 - np.var(errors, ddof=1) / errors.size)
    return max(bias, 0.0) / total if 0 < total < math.inf else math.nan
