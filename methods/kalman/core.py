"""The Kalman filter, written once for numpy and jax: maps made affine, prediction, update, smoothing, mixtures.

Any number of filters stand side by side along the leading axes of all arrays. A filter of a nonlinear system is a rule
that replaces each map by an affine one about a belief N(m, P); for these the Kalman filter is exact.

- :func:`tangent` makes the extended filter: ``f(s) ~ f(m) + F (s - m)``.
- :func:`regression` makes the unscented one. The belief is replaced by points at ``m ± sqrt(d + kappa)`` times each
  column of a square root of P, and at m (S. J. Julier, J. K. Uhlmann, Proc. SPIE 3068:182, 1997), where d is the size
  of the state. The straight line through what the map makes of them is the affine map of least mean square error, and
  what it leaves is that map's error covariance (statistical linear regression; T. Lefebvre et al., IEEE Trans.
  Automatic Control 47:1406, 2002): mean and covariance are then those of the unscented transform.
- The ``square_root`` functions carry a root of the covariance (P. Kaminski, A. Bryson, S. Schmidt, IEEE Trans.
  Automatic Control 16:727, 1971).

Channels have independent noise, so their values are taken one by one, and nothing is inverted. The update is Joseph's,
which keeps a covariance positive. The smoother is the modified Bryson-Frazier one (G. J. Bierman, Int. J. Control
18:65, 1973): it needs no inverse either, so a state that is known exactly, a singular covariance, does no harm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Array = Any
"""Of numpy or of jax."""
Map = Callable[[Array], Array]
"""Points (L, S, d) to values (L, S, m)."""
SMALL = 1e-5
"""Step of the differences, in natural units and in log-parameters."""


class Affine(NamedTuple):
    """Slopes (..., m, d), constants (..., m) and error covariance (..., m, m)."""

    slopes: Array
    constants: Array
    error: Array


Rule = Callable[[Map, Array, Array], Affine]
"""How a map becomes affine about beliefs: means (L, d) and covariances (L, d, d)."""


class Update(NamedTuple):
    """A belief after its samples, and what the smoother needs of them.

    ``gains`` (..., C, d); ``innovations`` (..., C), each over its variance; ``precisions`` (..., C): 1 over these
    variances, 0 where a channel gave nothing; ``likelihood`` (...): log-likelihood up to a constant.
    """

    mean: Array
    covariance: Array
    gains: Array
    innovations: Array
    precisions: Array
    likelihood: Array


# ------------------------------------------------------------------------------------------------------------- rules


def tangent(function: Map, means: Array, covariances: Array) -> Affine:
    """Return the map's value and slopes at the means, by central differences; no error is attributed to it."""
    d = means.shape[1]
    values = function(means[:, None] + SMALL * np.concatenate([np.zeros((1, d)), np.eye(d), -np.eye(d)]))
    slopes = transposed(values[:, 1 : d + 1] - values[:, d + 1 :]) / (2 * SMALL)
    constants = values[:, 0] - apply(slopes, means)
    return Affine(slopes, constants, np.zeros((*constants.shape, constants.shape[1])))


def regression(
    function: Map, means: Array, covariances: Array, kappa: float = 0.0, least: float = SMALL, relative: float = 0.0
) -> Affine:
    """Return the line through the map's values at the sigma points, and the covariance of what it leaves.

    The root is that of the eigenvectors. The points lie symmetrically, so the odd part of the values is the line's
    exactly; the even part is its error.

    Args:
        function: The map.
        means: Means of the beliefs, (L, d).
        covariances: Covariances of the beliefs, (L, d, d).
        kappa: Weight of the central point against those about it; 0 is the cubature rule (I. Arasaratnam, S. Haykin,
            IEEE Trans. Automatic Control 54:1254, 2009).
        least: Least standard deviation of a direction, which makes the line a tangent where a belief is certain.
        relative: The same, over the largest one.
    """
    xp, d = means.__array_namespace__(), means.shape[1]
    values, axes = xp.linalg.eigh(xp.where(xp.isfinite(covariances), covariances, 0.0))
    floor = xp.maximum(least**2, relative**2 * values[:, -1:])
    sizes = xp.sqrt(xp.maximum(values, floor) * (d + kappa))
    moves = transposed(axes * sizes[:, None])
    seen = function(xp.concatenate([means[:, None], means[:, None] + moves, means[:, None] - moves], axis=1))
    centre, plus, minus = seen[:, 0], seen[:, 1 : d + 1], seen[:, d + 1 :]
    weight = 0.5 / (d + kappa)
    mean = kappa / (d + kappa) * centre + weight * xp.sum(plus + minus, axis=1)
    slopes = transposed(0.5 * (plus - minus) / sizes[..., None]) @ transposed(axes)
    bent = 0.5 * (plus + minus) - mean[:, None]
    middle = centre - mean
    error = 2 * weight * transposed(bent) @ bent + kappa / (d + kappa) * middle[..., None] * middle[:, None]
    return Affine(slopes, mean - apply(slopes, means), error)


# ------------------------------------------------------------------------------------- prediction, update, smoothing


def predict(affine: Affine, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Carry a belief through an affine map."""
    slopes, constants, error = affine
    return apply(slopes, mean) + constants, slopes @ covariance @ transposed(slopes) + error


def update(
    mean: Array, covariance: Array, slopes: Array, constants: Array, variances: Array, values: Array, used: Array
) -> Update:
    """Update a belief by the values of channels whose noise is independent.

    Args:
        mean: Of the belief, (..., d).
        covariance: Of the belief, (..., d, d).
        slopes: Of the measurement, (..., C, d).
        constants: Of the measurement, (..., C).
        variances: Of the noise, (..., C).
        values: What the channels gave, (C,) or (..., C).
        used: Which of them count, (C,) or (..., C).
    """
    xp = mean.__array_namespace__()
    gains, innovations, precisions, likelihood = [], [], [], 0.0
    for i in range(slopes.shape[-2]):
        h, r, use = slopes[..., i, :], variances[..., i], used[..., i]
        cross = apply(covariance, h)
        total = xp.sum(h * cross, axis=-1) + r
        innovation = xp.where(use, values[..., i] - constants[..., i] - xp.sum(h * mean, axis=-1), 0.0)
        gain = xp.where(use[..., None], cross / total[..., None], 0.0)
        mean = mean + gain * innovation[..., None]
        # Joseph's (I - g h') P (I - g h')' + r g g', by two updates of rank one
        left = covariance - outer(gain, cross)
        covariance = left - outer(apply(left, h), gain) + r[..., None, None] * outer(gain, gain)
        likelihood = likelihood - xp.where(use, 0.5 * (innovation**2 / total + xp.log(total)), 0.0)
        gains.append(gain)
        innovations.append(innovation / total)
        precisions.append(xp.where(use, 1.0 / total, 0.0))
    stacked = (xp.stack(gains, axis=-2), xp.stack(innovations, axis=-1), xp.stack(precisions, axis=-1))
    return Update(mean, 0.5 * (covariance + transposed(covariance)), *stacked, likelihood)


def backward(adjoint: Array, weight: Array, slopes: Array, updated: Update) -> tuple[Array, Array]:
    """Carry Bierman's adjoint vector (..., d) and matrix (..., d, d) from behind an update to before it."""
    for i in reversed(range(slopes.shape[-2])):
        h, gain, precision = slopes[..., i, :], updated.gains[..., i, :], updated.precisions[..., i]
        adjoint = adjoint - h * ((gain * adjoint).sum(-1) + updated.innovations[..., i])[..., None]
        right = weight - outer(apply(weight, gain), h)
        weight = right - outer(h, apply(transposed(right), gain)) + precision[..., None, None] * outer(h, h)
    return adjoint, weight


# -------------------------------------------------------------------------------------------------- roots, mixtures


def predict_root(affine: Affine, mean: Array, root: Array, walk: Array) -> tuple[Array, Array]:
    """Carry a belief by a root of its covariance through an affine map; ``walk`` (..., d): variances that it gains."""
    xp = mean.__array_namespace__()
    noise = xp.sqrt(walk)[..., None] * xp.eye(mean.shape[-1])
    wide = xp.concatenate([affine.slopes @ root, noise], axis=-1)
    return apply(affine.slopes, mean) + affine.constants, transposed(xp.linalg.qr(transposed(wide), mode="r"))


def update_root(
    mean: Array, root: Array, slopes: Array, constants: Array, variances: Array, values: Array, used: Array
) -> tuple[Array, Array, Array]:
    """Update a belief by a root of its covariance, in Potter's form, as :func:`update` does.

    Returns:
        Mean, root and log-likelihood.
    """
    xp, likelihood = mean.__array_namespace__(), 0.0
    for i in range(slopes.shape[-2]):
        h, r, use = slopes[..., i, :], variances[..., i], used[..., i]
        seen = apply(transposed(root), h)
        total = xp.sum(seen**2, axis=-1) + r
        innovation = xp.where(use, values[..., i] - constants[..., i] - xp.sum(h * mean, axis=-1), 0.0)
        gain = xp.where(use[..., None], apply(root, seen) / total[..., None], 0.0)
        mean = mean + gain * innovation[..., None]
        root = root - outer(gain / (1.0 + xp.sqrt(r / total))[..., None], seen)
        likelihood = likelihood - xp.where(use, 0.5 * (innovation**2 / total + xp.log(total)), 0.0)
    return mean, root, likelihood


def mixture(share: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Return mean and covariance of mixtures of M beliefs, with shares (..., M)."""
    mean = share @ means
    off = means - mean[..., None, :]
    spread = covariances + off[..., :, None] * off[..., None, :]
    return mean, (share[..., None, None] * spread).sum(-3)


def apply(matrix: Array, vector: Array) -> Array:
    """Return the product of matrices (..., m, d) and vectors (..., d)."""
    return (matrix @ vector[..., None])[..., 0]


def outer(a: Array, b: Array) -> Array:
    """Return the outer products of vectors (..., d)."""
    return a[..., :, None] * b[..., None, :]


def transposed(matrix: Array) -> Array:
    """Return the transposes of matrices (..., m, d)."""
    return matrix.swapaxes(-1, -2)
