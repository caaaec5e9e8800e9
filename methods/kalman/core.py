"""The Kalman filter for NumPy and JAX: linearisation, prediction, update, smoothing and mixtures.

Leading axes of all arrays hold independent filters. A filter of a nonlinear system is defined by a rule that replaces
each map by an affine one about a normal distribution N(m, P); for affine maps the Kalman filter is exact.

- :func:`tangent` gives the extended filter: ``f(s) ~ f(m) + F (s - m)``.
- :func:`regression` gives the unscented filter. The distribution is represented by sigma points at m and at
  ``m ± sqrt(d + kappa)`` times each column of a square root of P (S. J. Julier, J. K. Uhlmann, Proc. SPIE 3068:182,
  1997), where d is the size of the state. The linear regression of the map's values on these points is the affine map
  of least mean square error, and its residuals give the error covariance (statistical linear regression; T. Lefebvre et
  al., IEEE Trans. Automatic Control 47:1406, 2002). Mean and covariance then equal those of the unscented transform.

A distribution is represented by its covariance (:data:`COVARIANCE`) or by a square root of it (:data:`ROOT`; P.
Kaminski, A. Bryson, S. Schmidt, IEEE Trans. Automatic Control 16:727, 1971). Channels have independent noise and are
processed one by one, without matrix inversion. The covariance update has Joseph's form, which keeps it positive. The
smoother is the modified Bryson-Frazier form (G. J. Bierman, Int. J. Control 18:65, 1973), which needs no inverse and
thus allows a singular covariance, as of a known initial state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Array = Any
"""An array of NumPy or JAX."""
Map = Callable[[Array], Array]
"""A function from points (L, S, d) to values (L, S, m)."""
SMALL = 1e-5
"""Step of the central differences, in natural units and in log-parameters."""


class Affine(NamedTuple):
    """Slopes (..., m, d), constants (..., m) and scatter (..., r, m): ``scatter' scatter`` is the error covariance."""

    slopes: Array
    constants: Array
    scatter: Array


Rule = Callable[[Map, Array, Array], Affine]
"""A function that linearises a map about distributions with means (L, d) and covariances (L, d, d)."""


class Update(NamedTuple):
    """The distribution after an update, and the quantities that the smoother needs.

    ``spread`` is the covariance. Per channel: ``gains`` (..., d); ``innovations`` (...), each over its variance;
    ``precisions`` (...): reciprocals of these variances, 0 where a channel has no value. ``likelihood`` (...):
    log-likelihood up to a constant.
    """

    mean: Array
    spread: Array
    gains: list[Array]
    innovations: list[Array]
    precisions: list[Array]
    likelihood: Array


# ------------------------------------------------------------------------------------------------------------- rules


def tangent(function: Map, means: Array, covariances: Array) -> Affine:
    """Linearise a map at the means by central differences, with zero error covariance."""
    d = means.shape[1]
    values = function(means[:, None] + SMALL * np.concatenate([np.zeros((1, d)), np.eye(d), -np.eye(d)]))
    slopes = transposed(values[:, 1 : d + 1] - values[:, d + 1 :]) / (2 * SMALL)
    return Affine(slopes, values[:, 0] - apply(slopes, means), np.zeros_like(values[:, :1]))


def regression(
    function: Map, means: Array, covariances: Array, kappa: float = 0.0, least: float = SMALL, relative: float = 0.0
) -> Affine:
    """Regress a map on sigma points; the residuals give the scatter.

    The square root of a covariance uses its eigenvectors. Since the points are symmetric, the odd part of the values is
    fitted exactly, and the even part gives the error.

    Args:
        function: The map.
        means: Means of the distributions, (L, d).
        covariances: Covariances of the distributions, (L, d, d).
        kappa: Relative weight of the central point; 0 is the cubature rule (I. Arasaratnam, S. Haykin,
            IEEE Trans. Automatic Control 54:1254, 2009).
        least: Least standard deviation of a direction, which gives a tangent for a singular covariance.
        relative: The same relative to the largest standard deviation.
    """
    xp, d = means.__array_namespace__(), means.shape[1]
    values, axes = xp.linalg.eigh(xp.where(xp.isfinite(covariances), covariances, 0.0))
    floor = xp.maximum(least**2, relative**2 * values[:, -1:])
    sizes = xp.sqrt(xp.maximum(values, floor) * (d + kappa))
    moves = transposed(axes * sizes[:, None])
    images = function(xp.concatenate([means[:, None], means[:, None] + moves, means[:, None] - moves], axis=1))
    centre, plus, minus = images[:, :1], images[:, 1 : d + 1], images[:, d + 1 :]
    even, weight = 0.5 * (plus + minus), 1.0 / (d + kappa)
    mean = kappa * weight * centre + weight * xp.sum(even, axis=1, keepdims=True)
    slopes = transposed(0.5 * (plus - minus) / sizes[..., None]) @ transposed(axes)
    scatter = xp.concatenate([weight**0.5 * (even - mean), (kappa * weight) ** 0.5 * (centre - mean)], axis=1)
    return Affine(slopes, mean[:, 0] - apply(slopes, means), scatter)


# ------------------------------------------------------------------------------------- prediction, update, smoothing


def error(affine: Affine, walk: Array) -> Array:
    """Return the covariance added by the error of an affine map and by random walks of variances (..., d)."""
    return transposed(affine.scatter) @ affine.scatter + walk[..., None] * np.eye(walk.shape[-1])


def predict(slopes: Array, constants: Array, gained: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Propagate mean and covariance through an affine map; ``gained``: covariance of the process noise."""
    return apply(slopes, mean) + constants, slopes @ covariance @ transposed(slopes) + gained


def update(
    mean: Array, covariance: Array, slopes: Array, constants: Array, variances: Array, values: Array, used: Array
) -> Update:
    """Update a distribution by the values of channels with independent noise.

    Args:
        mean: Predicted mean, (..., d).
        covariance: Predicted covariance, (..., d, d).
        slopes: Measurement matrix, (..., C, d).
        constants: Measurement offsets, (..., C).
        variances: Noise variances, (..., C).
        values: Measured values, finite, (C,) or (..., C).
        used: Which values to use, (C,) or (..., C).
    """
    xp = mean.__array_namespace__()
    gains, innovations, precisions, likelihood = [], [], [], 0.0
    for i in range(slopes.shape[-2]):
        h, r, use = slopes[..., i, :], variances[..., i], used[..., i]
        cross = apply(covariance, h)
        total = (h * cross).sum(-1) + r
        precision, off = use / total, values[..., i] - constants[..., i] - (h * mean).sum(-1)
        gain, innovation = precision[..., None] * cross, precision * off
        mean = mean + innovation[..., None] * cross
        # Joseph's (I - g h') P (I - g h')' + r g g', by two updates of rank one
        left = covariance - outer(gain, cross)
        covariance = left + outer(r[..., None] * gain - apply(left, h), gain)
        likelihood = likelihood - 0.5 * (innovation * off + use * xp.log(total))
        gains.append(gain)
        innovations.append(innovation)
        precisions.append(precision)
    return Update(mean, 0.5 * (covariance + transposed(covariance)), gains, innovations, precisions, likelihood)


def backward(adjoint: Array, weight: Array, slopes: Array, updated: Update) -> tuple[Array, Array]:
    """Propagate Bierman's adjoint vector (..., d) and matrix (..., d, d) backwards through an update."""
    for i in reversed(range(slopes.shape[-2])):
        h, gain = slopes[..., i, :], updated.gains[i]
        adjoint = adjoint - h * ((gain * adjoint).sum(-1) + updated.innovations[i])[..., None]
        right = weight - outer(apply(weight, gain), h)
        weight = right + outer(h, updated.precisions[i][..., None] * h - apply(transposed(right), gain))
    return adjoint, weight


# ------------------------------------------------------------------------------------- covariances, or roots of them


def _predict_covariance(affine: Affine, walk: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    return predict(affine.slopes, affine.constants, error(affine, walk), mean, covariance)


def predict_root(affine: Affine, walk: Array, mean: Array, root: Array) -> tuple[Array, Array]:
    """Propagate mean and covariance root through an affine map; ``walk`` (..., d): process noise variances."""
    xp = mean.__array_namespace__()
    noise = xp.sqrt(walk)[..., None] * np.eye(walk.shape[-1])
    wide = xp.concatenate([affine.slopes @ root, transposed(affine.scatter), noise], axis=-1)
    return apply(affine.slopes, mean) + affine.constants, transposed(xp.linalg.qr(transposed(wide), mode="r"))


def update_root(
    mean: Array, root: Array, slopes: Array, constants: Array, variances: Array, values: Array, used: Array
) -> tuple[Array, Array, Array]:
    """Update as :func:`update`, with a covariance root in Potter's form; return mean, root and log-likelihood."""
    xp, likelihood = mean.__array_namespace__(), 0.0
    for i in range(slopes.shape[-2]):
        h, r, use = slopes[..., i, :], variances[..., i], used[..., i]
        cross = apply(transposed(root), h)
        total = (cross**2).sum(-1) + r
        off, gain = values[..., i] - constants[..., i] - (h * mean).sum(-1), apply(root, cross)
        mean = mean + gain * (use * off / total)[..., None]
        root = root - outer(gain * (use / (total + xp.sqrt(r * total)))[..., None], cross)
        likelihood = likelihood - 0.5 * use * (off**2 / total + xp.log(total))
    return mean, root, likelihood


class SpreadForm(NamedTuple):
    """Representation of a covariance: its prediction, update, and conversion from and to a covariance."""

    predict: Callable[..., tuple[Array, Array]]
    update: Callable[..., Any]
    spread: Callable[[Array], Array]
    covariance: Callable[[Array], Array]


def _root(covariance: Array) -> Array:
    xp = covariance.__array_namespace__()
    values, axes = xp.linalg.eigh(covariance)
    return axes * xp.sqrt(xp.maximum(values, 0.0))[..., None, :]


COVARIANCE = SpreadForm(_predict_covariance, update, lambda covariance: covariance, lambda spread: spread)
ROOT = SpreadForm(predict_root, update_root, _root, lambda root: root @ transposed(root))

# ---------------------------------------------------------------------------------------------------------- algebra


def mixture(share: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Return mean and covariance of mixtures of M distributions, with weights ``share`` (..., M)."""
    mean = share @ means
    off = means - mean[..., None, :]
    return mean, (share[..., None, None] * (covariances + outer(off, off))).sum(-3)


def apply(matrix: Array, vector: Array) -> Array:
    """Return the product of matrices (..., m, d) and vectors (..., d)."""
    return (matrix @ vector[..., None])[..., 0]


def outer(a: Array, b: Array) -> Array:
    """Return the outer products of vectors (..., d)."""
    return a[..., :, None] * b[..., None, :]


def transposed(matrix: Array) -> Array:
    """Return the transposes of matrices (..., m, d)."""
    return matrix.swapaxes(-1, -2)
