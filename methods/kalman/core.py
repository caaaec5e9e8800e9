"""The Kalman filter, written once for numpy and jax: maps made affine, prediction, update, smoothing, mixtures.

Any number of filters stand side by side along the leading axes of all arrays. A filter of a nonlinear system is a rule
that replaces each map by an affine one about a distribution N(m, P); for these the Kalman filter is exact.

- :func:`tangent` makes the extended filter: ``f(s) ~ f(m) + F (s - m)``.
- :func:`regression` makes the unscented one. The distribution is replaced by points at ``m ± sqrt(d + kappa)`` times
  each column of a square root of P, and at m (S. J. Julier, J. K. Uhlmann, Proc. SPIE 3068:182, 1997), where d is the
  size of the state. The straight line through what the map makes of them is the affine map of least mean square error,
  and what it leaves is that map's error (statistical linear regression; T. Lefebvre et al., IEEE Trans. Automatic
  Control 47:1406, 2002): mean and covariance are then those of the unscented transform.

A distribution is carried by its covariance (:data:`COVARIANCE`) or by a root of it (:data:`ROOT`; P. Kaminski, A.
Bryson, S. Schmidt, IEEE Trans. Automatic Control 16:727, 1971). Channels have independent noise, so their values are
taken one by one, and nothing is inverted. The update of a covariance is Joseph's, which keeps it positive. The smoother
is the modified Bryson-Frazier one (G. J. Bierman, Int. J. Control 18:65, 1973): it needs no inverse either, so a state
that is known exactly, a singular covariance, does no harm.
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
    """Slopes (..., m, d), constants (..., m) and scatter (..., r, m): ``scatter' scatter`` is the error covariance."""

    slopes: Array
    constants: Array
    scatter: Array


Rule = Callable[[Map, Array, Array], Affine]
"""How a map becomes affine about distributions: means (L, d) and covariances (L, d, d)."""


class Update(NamedTuple):
    """A distribution after its samples, and what the smoother needs of them.

    ``spread`` is the covariance. By channel: ``gains`` (..., d); ``innovations`` (...), each over its variance;
    ``precisions`` (...): 1 over these variances, 0 where a channel gave nothing. ``likelihood`` (...): log-likelihood
    up to a constant.
    """

    mean: Array
    spread: Array
    gains: list[Array]
    innovations: list[Array]
    precisions: list[Array]
    likelihood: Array


# ------------------------------------------------------------------------------------------------------------- rules


def tangent(function: Map, means: Array, covariances: Array) -> Affine:
    """Return the map's value and slopes at the means, by central differences; no error is attributed to it."""
    d = means.shape[1]
    values = function(means[:, None] + SMALL * np.concatenate([np.zeros((1, d)), np.eye(d), -np.eye(d)]))
    slopes = transposed(values[:, 1 : d + 1] - values[:, d + 1 :]) / (2 * SMALL)
    return Affine(slopes, values[:, 0] - apply(slopes, means), np.zeros_like(values[:, :1]))


def regression(
    function: Map, means: Array, covariances: Array, kappa: float = 0.0, least: float = SMALL, relative: float = 0.0
) -> Affine:
    """Return the line through the map's values at the sigma points, and the scatter of the values about it.

    The root is that of the eigenvectors. The points lie symmetrically, so the odd part of the values is the line's
    exactly; the even part is its error.

    Args:
        function: The map.
        means: Means of the distributions, (L, d).
        covariances: Covariances of the distributions, (L, d, d).
        kappa: Weight of the central point against those about it; 0 is the cubature rule (I. Arasaratnam, S. Haykin,
            IEEE Trans. Automatic Control 54:1254, 2009).
        least: Least standard deviation of a direction, which makes the line a tangent where a distribution is certain.
        relative: The same, over the largest one.
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
    """Return the covariance that a distribution gains by an affine map and by random walks of variances (..., d)."""
    return transposed(affine.scatter) @ affine.scatter + walk[..., None] * np.eye(walk.shape[-1])


def predict(slopes: Array, constants: Array, gained: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Carry a distribution through an affine map, by which it gains a covariance (..., d, d)."""
    return apply(slopes, mean) + constants, slopes @ covariance @ transposed(slopes) + gained


def update(
    mean: Array, covariance: Array, slopes: Array, constants: Array, variances: Array, values: Array, used: Array
) -> Update:
    """Update a distribution by the values of channels whose noise is independent.

    Args:
        mean: Of the distribution, (..., d).
        covariance: Of the distribution, (..., d, d).
        slopes: Of the measurement, (..., C, d).
        constants: Of the measurement, (..., C).
        variances: Of the noise, (..., C).
        values: What the channels gave, finite, (C,) or (..., C).
        used: Which of them count, (C,) or (..., C).
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
    """Carry Bierman's adjoint vector (..., d) and matrix (..., d, d) from behind an update to before it."""
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
    """Carry a covariance root through an affine map; ``walk`` (..., d) are the variances of the added random walk."""
    xp = mean.__array_namespace__()
    noise = xp.sqrt(walk)[..., None] * np.eye(walk.shape[-1])
    wide = xp.concatenate([affine.slopes @ root, transposed(affine.scatter), noise], axis=-1)
    return apply(affine.slopes, mean) + affine.constants, transposed(xp.linalg.qr(transposed(wide), mode="r"))


def update_root(
    mean: Array, root: Array, slopes: Array, constants: Array, variances: Array, values: Array, used: Array
) -> tuple[Array, Array, Array]:
    """Do as :func:`update` with a root of the covariance, in Potter's form; return mean, root and log-likelihood."""
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
    """Form in which a distribution carries its spread: prediction, update, and conversion from and to a covariance."""

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
    """Return mean and covariance of mixtures of the same M distributions, with shares (..., M)."""
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
