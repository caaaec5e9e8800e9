"""A very wide prior for parameters that the data do not determine and the problem has no prior for.

The likelihood of, for instance, a damping hidden by noise rises towards zero or infinity, without a maximum.
"""

from __future__ import annotations

import numpy as np

from bench import Prior

PRIORLESS_SD = 3.0
"""Standard deviation of the log-parameters under the very wide prior: a factor of 20."""


def left_open(log_variances: np.ndarray) -> np.ndarray:
    """Return which log-parameters have variances (k,) above that of the very wide prior."""
    return np.asarray(~(log_variances <= PRIORLESS_SD**2))  # NaN counts as undetermined


def very_wide(nominal: dict[str, float]) -> Prior:
    """Return the prior of ``PRIORLESS_SD`` about parameters estimated from the data."""
    return Prior(nominal, dict.fromkeys(nominal, PRIORLESS_SD))
