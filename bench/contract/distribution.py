"""Estimated distributions of parameters: normal (usually in the logarithms), or samples.

Distributions of many replicates are stored as one distribution whose arrays have leading axes (*sets).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from bench.systems import Quantity

ROUNDING = 4.0 * float(np.finfo(float).eps)
"""Relative rounding error of a variance in which covariances cancel, times the variance of the parts."""
DOF_DEGREE, DOF_RANGE = 9, 1.1
"""Quantiles of Student's t are interpolated by polynomials of this degree in the degrees of freedom if these differ by
less than this factor; the relative error is 1e-12. A direct evaluation takes 0.3 µs, and a replicate needs 200."""


@dataclass(frozen=True)
class Marginal:
    """Estimated distribution of one quantity.

    Attributes:
        value: Point estimate, a number or an array (*sets).
        ppf: Quantile function, levels (n,) in (0, 1) to quantiles (*sets, n); None without uncertainty.
        cdf: Distribution function, values (*sets) to levels (*sets); None without uncertainty.
        parts: Components of a mixture, the one with the point estimate first; empty if it is not a mixture.
    """

    value: Any
    ppf: Callable[[np.ndarray], np.ndarray] | None = None
    cdf: Callable[[Any], Any] | None = None
    parts: tuple[Marginal, ...] = ()

    def interval(self, level: float) -> tuple[Any, Any]:
        """Return the equal-tailed interval of a level, e.g. 0.95; NaNs without uncertainty.

        For a mixture it is the hull of :meth:`intervals`.
        """
        if self.ppf is None:
            return float("nan"), float("nan")
        if self.parts:
            pieces = self.intervals(level)
            return pieces[0][0], pieces[-1][1]
        ends = self.ppf(np.array([0.5 - level / 2, 0.5 + level / 2]))
        return _number(ends[..., 0]), _number(ends[..., 1])

    def intervals(self, level: float) -> list[tuple[Any, Any]]:
        """Return the interval of a level; for a mixture, the union of the intervals of its components, sorted."""
        pieces: list[tuple[Any, Any]] = []
        for low, high in sorted(part.interval(level) for part in self.parts or (self,)):
            if pieces and low <= pieces[-1][1]:
                pieces[-1] = pieces[-1][0], max(pieces[-1][1], high)
            else:
                pieces.append((low, high))
        return pieces


MIXTURE_STEPS = 60
"""Number of bisections for a quantile of a mixture, enough for double precision."""


def mixed(parts: Sequence[Marginal], weights: Sequence[float]) -> Marginal:
    """Return the mixture of distributions of one quantity.

    Args:
        parts: Distributions of scalar quantities; if any has no uncertainty, the first is returned.
        weights: Their probabilities, which sum to 1.

    Returns:
        Distribution with the point estimate of the first component and the quantiles of the mixture.
    """
    if len(parts) == 1 or any(part.ppf is None or part.cdf is None for part in parts):
        return parts[0]

    def cdf(true: Any) -> Any:
        return sum(weight * part.cdf(true) for weight, part in zip(weights, parts, strict=True) if part.cdf)

    def ppf(levels: np.ndarray) -> np.ndarray:
        quantiles = np.array([part.ppf(levels) for part in parts if part.ppf])
        low, high = (
            quantiles.min(axis=0),
            quantiles.max(axis=0),
        )  # bounds of the mixture quantiles
        for _ in range(MIXTURE_STEPS):
            middle = 0.5 * (low + high)
            below = np.array([cdf(value) for value in middle]) < levels
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return np.asarray(0.5 * (low + high))

    return Marginal(parts[0].value, ppf, cdf, tuple(parts))


def _number(value: Any) -> Any:
    """Return an array unchanged, and an array without axes as a float."""
    return float(value) if np.ndim(value) == 0 else value


def standard_quantile(levels: Any, dof: Any) -> Any:
    """Return quantiles of the standard normal distribution or of Student's t.

    Args:
        levels: Probabilities, a number or (n,).
        dof: Degrees of freedom, a number or (*sets); None for the normal distribution.

    Returns:
        Quantiles, shape (*sets, n).
    """
    from scipy.special import ndtri  # slow to import, rarely needed

    if dof is None:
        return ndtri(levels)
    quantiles = _student_quantiles(np.asarray(levels, float).tobytes(), np.asarray(dof, float).tobytes())
    return quantiles.reshape(np.shape(dof) + np.shape(levels))[()]


@lru_cache(maxsize=8)
def _student_quantiles(levels: bytes, dof: bytes) -> np.ndarray:
    """Return quantiles of Student's t, (n_dof, n_levels); cached, since all quantities of a replicate share them."""
    from numpy.polynomial.chebyshev import chebinterpolate, chebval
    from scipy.special import stdtrit

    probabilities, (distinct, place) = np.frombuffer(levels), np.unique(np.frombuffer(dof), return_inverse=True)
    if distinct.size <= DOF_DEGREE or not distinct[-1] < DOF_RANGE * distinct[0]:
        return np.asarray(stdtrit(distinct[:, None], probabilities)[place])
    centre, half = np.mean(distinct[[0, -1]]), np.ptp(distinct[[0, -1]]) / 2.0
    coefficients = chebinterpolate(lambda x: stdtrit((centre + half * x)[:, None], probabilities), DOF_DEGREE)
    return np.asarray(chebval((distinct - centre) / half, coefficients).T[place])


def normal_marginal(value: Any, mean: Any, sd: Any, dof: Any, log: bool) -> Marginal:
    """Return a normal or Student's t distribution of a quantity or of its logarithm.

    Args:
        value: Point estimate, a number or (*sets), as are the following.
        mean: Mean of the quantity, or of its logarithm.
        sd: Standard deviation of the same.
        dof: Degrees of freedom of Student's t; None for the normal distribution.
        log: True if mean and standard deviation are those of the logarithm.

    Returns:
        The distribution.
    """

    def ppf(levels: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore"):
            quantiles = np.expand_dims(mean, -1) + np.expand_dims(sd, -1) * standard_quantile(levels, dof)
            return np.asarray(np.exp(quantiles) if log else quantiles)

    def cdf(true: Any) -> Any:
        from scipy.special import ndtr, stdtr

        with np.errstate(over="ignore"):
            z = ((np.log(true) if log else true) - mean) / np.maximum(sd, 1e-300)
        return _number(ndtr(z) if dof is None else stdtr(dof, z))

    return Marginal(_number(value), ppf, cdf)


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal distribution of the logarithms of parameters, or of groups.

    Attributes:
        names: Names of the parameters or groups, length d.
        mean: Mean, shape (*sets, d).
        covariance: Covariance, shape (*sets, d, d); None for a point estimate without uncertainty.
        log: True if mean and covariance are those of the logarithms.
        dof: Degrees of freedom of Student's t, a number or (*sets), if the noise level was estimated; None for normal
            intervals.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray | None
    log: bool
    dof: Any = None

    def values(self) -> dict[str, Any]:
        """Return the point estimates by name."""
        centre = np.exp(self.mean) if self.log else self.mean
        return dict(zip(self.names, map(_number, np.moveaxis(centre, -1, 0)), strict=True))

    def finite(self) -> bool:
        """Return True if mean and covariance are finite."""
        arrays = [self.mean] if self.covariance is None else [self.mean, self.covariance]
        return all(bool(np.all(np.isfinite(array))) for array in arrays)

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """Return the distribution of a product of powers; None if it is not determined by the named quantities."""
        if self.log:
            return self._log_marginal(quantity)
        if quantity.name in self.names:
            i = self.names.index(quantity.name)
            centre = self.mean[..., i]
            if self.covariance is None:
                return Marginal(_number(centre))
            return normal_marginal(centre, centre, np.sqrt(self.covariance[..., i, i]), self.dof, False)
        return None

    def _log_marginal(self, quantity: Quantity) -> Marginal | None:
        if not set(quantity.exponents) <= set(self.names):
            return None
        weights = np.array(quantity.vector(self.names))
        centre = self.mean @ weights + np.log(quantity.coefficient)
        with np.errstate(over="ignore"):
            value = np.exp(centre)
        if self.covariance is None:
            return Marginal(_number(value))
        sds = np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=-2, axis2=-1), 0.0))
        rounding = ROUNDING * (sds @ np.abs(weights)) ** 2  # matters for a ratio known much better than its terms
        sd = np.sqrt(np.maximum(self.covariance @ weights @ weights, 0.0) + rounding)
        return normal_marginal(value, centre, sd, self.dof, True)

    def expressed_in(self, scale: Mapping[str, float]) -> Normal:
        """Return the distribution of the named quantities divided by their scales."""
        s = np.array([scale[name] for name in self.names])
        if self.log:
            return replace(self, mean=self.mean - np.log(s))
        covariance = None if self.covariance is None else self.covariance / np.outer(s, s)
        return replace(self, mean=self.mean / s, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Draws:
    """Distribution represented by samples of the parameters.

    The point estimate of a quantity is the median of its samples, which is invariant under monotone transformations:
    the estimates of ``1/q`` and ``log q`` are those of the same sample.

    Attributes:
        names: Names of the parameters.
        samples: Positive samples, shape (*sets, n_draws, n_parameters).
    """

    names: tuple[str, ...]
    samples: np.ndarray

    def values(self) -> dict[str, Any]:
        """Return the median of each parameter, by name."""
        return dict(zip(self.names, map(_number, np.moveaxis(np.median(self.samples, axis=-2), -1, 0)), strict=True))

    def finite(self) -> bool:
        """Return True if all samples are finite."""
        return bool(np.all(np.isfinite(self.samples)))

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """Return the distribution of a product of powers; None if it is not determined by the named quantities."""
        if not set(quantity.exponents) <= set(self.names):
            return None
        columns = {name: self.samples[..., i] for i, name in enumerate(self.names)}
        draws = np.sort(quantity.value(columns), axis=-1)

        def ppf(levels: np.ndarray) -> np.ndarray:
            return np.moveaxis(np.quantile(draws, levels, axis=-1), 0, -1)

        def cdf(true: Any) -> Any:
            # mid-rank over n + 1, the rank statistic of simulation-based calibration; it is never 0 or 1
            below = np.sum(draws < np.expand_dims(true, -1), axis=-1)
            return _number((below + 0.5) / (draws.shape[-1] + 1.0))

        return Marginal(_number(np.median(draws, axis=-1)), ppf, cdf)

    def expressed_in(self, scale: Mapping[str, float]) -> Draws:
        """Return the samples of the parameters divided by their scales."""
        return replace(self, samples=self.samples / np.array([scale[name] for name in self.names]))


Distribution = Normal | Draws
"""Estimated distribution of parameters or groups."""
