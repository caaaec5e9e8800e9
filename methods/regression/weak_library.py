"""A library of terms in weak form: terms integrated against test functions, and no sample differentiated twice.

``x'' = Σ ξ_j θ_j(x, v)`` multiplied with a test function φ and integrated by parts is ``∫φ'' x = Σ ξ_j ∫φ θ_j``
(WSINDy: D. A. Messenger, D. M. Bortz, Multiscale Modeling and Simulation 19:1474, 2021). Of the terms, x and v are
integrated over the samples themselves, ``∫φ v = -∫φ' x``, the others along the smoothed motion.

A test function that is as long as many oscillations averages them away, and a short one leaves the noise in: here it
is about one period long.
"""

from __future__ import annotations

import numpy as np

from methods.regression.derivatives import Motion
from methods.regression.weak import WIDTH, Kernels

PERIODS = 1.0
"""Support of a test function, in periods of the motion."""
LEAST_SAMPLES = 6
"""In a support: fewer do not integrate it."""


def weak_rows(
    motion: Motion, samples: np.ndarray, features: np.ndarray, linear: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Features (sets, functions, terms) and target (n_dof, sets, functions) of a record.

    Args:
        motion: the smoothed motion at the times of ``samples`` (n_dof, sets, n).
        samples: measured displacements there.
        features: terms along the motion, (sets, n, terms).
        linear: columns of the terms that are a displacement, then a velocity, of each degree of freedom, (2 n_dof,).
    """
    times = motion.times
    # as many radians a second as the root mean squares of velocity and acceleration say
    period = 2.0 * np.pi * np.sqrt(np.mean(motion.v**2) / np.mean(motion.a**2))
    width = float(np.clip(PERIODS * period / (times[-1] - times[0]), LEAST_SAMPLES / times.size, WIDTH))
    kernels = Kernels.of(times, width, share=1.0).where_sampled(LEAST_SAMPLES // 2)
    weak = np.einsum("fn,snk->sfk", kernels.value, features)
    weak[..., linear] = np.moveaxis(np.concatenate([samples @ kernels.value.T, -(samples @ kernels.slope.T)]), 0, -1)
    return weak, samples @ kernels.curvature.T
