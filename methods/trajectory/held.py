"""A problem held by a very wide prior where the likelihood has no maximum at positive parameters.

So it is where all parameters are told without a prior (a known force, an added mass) and the noise hides one of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench import OutputError
from methods.starts.open_parameters import left_open, very_wide

HELD = "the likelihood has no maximum at positive parameters: held by a prior of a factor of 20 about the data's start"


def opened(model: OutputError, covariance: np.ndarray | None) -> np.ndarray:
    """Which parameters the data leave more open than the very wide prior would, shape (free,).

    All where the ``covariance`` is None; none where a prior or an unknown scale already says what can be said.
    """
    k = len(model.free)
    if model.prior is not None or not model.problem.scale_told:
        return np.zeros(k, bool)
    return np.ones(k, bool) if covariance is None else left_open(np.diag(covariance)[:k])


def held(model: OutputError, theta: np.ndarray, first: np.ndarray, which: np.ndarray) -> tuple[OutputError, np.ndarray]:
    """The same problem with a very wide prior, and where to search it from.

    The prior is about the data's start ``first`` in the parameters ``which`` are open, and about ``theta``, what was
    found, in the others: there it says next to nothing.
    """
    theta, k = theta.copy(), len(model.free)
    theta[:k] = np.where(which, first[:k], theta[:k])
    prior = very_wide({name: float(value) for name, value in model.parameters(theta).items()})
    return OutputError(replace(model.problem, prior=prior)), theta
