"""A very wide prior for parameters that data without a prior leave open: where noise hides a damping, say.

The likelihood then rises towards zero or without limit, and has no maximum at positive parameters.
"""

from __future__ import annotations

import numpy as np

from bench import Prior

PRIORLESS_SD = 3.0
"""Log standard deviation, a factor of 20, of the prior on parameters that the problem has none for."""


def left_open(log_variances: np.ndarray) -> np.ndarray:
    """Which log-parameters the data leave more open than the very wide prior would, from their variances (k,)."""
    return np.asarray(~(log_variances <= PRIORLESS_SD**2))  # NaN is open


def very_wide(nominal: dict[str, float]) -> Prior:
    """The prior of ``PRIORLESS_SD`` about parameters that the data gave."""
    return Prior(nominal, dict.fromkeys(nominal, PRIORLESS_SD))
