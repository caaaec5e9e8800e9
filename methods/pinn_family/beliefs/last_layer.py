"""Laplace on the output layer: the hidden layers stay where training left them.

A. Kristiadi, M. Hein and P. Hennig, ICML 2020; E. Daxberger et al., NeurIPS 2021.
"""

from __future__ import annotations

import numpy as np

from methods.pinn.laplace import laplace
from methods.pinn_family.beliefs.trained import Posterior, TrainedFit, linearised


def stated(posterior: Posterior, fit: TrainedFit, rng: np.random.Generator, members: int) -> TrainedFit:
    """The Gauss-Newton covariance of parameters and response over output layer and parameters alone."""
    heads, short = posterior.residuals.heads(posterior.z)
    state = heads.evaluate(short, posterior.deviations)
    found = laplace(heads, state, posterior.deviations)
    return linearised(posterior, fit, found.covariance, found.bands)
