"""What is believed of the parameters after a fit: a normal in their logarithms, or draws.

Distributions of many replicates that differ in their numbers alone are one distribution whose arrays have leading axes
(*sets).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol, Self

import numpy as np

from bench.systems import Quantity

ROUNDING = 4.0 * float(np.finfo(float).eps)
"""What a variance may be off by, over that of the parts whose covariances cancel in it."""
DOF_DEGREE, DOF_RANGE = 9, 1.1
"""Quantiles of Student's t are interpolated by polynomials of this degree between degrees of freedom that differ by
less than this factor, to 1e-12 of their size: each takes 0.3 µs, and a replicate has 200 of them."""


@dataclass(frozen=True)
class Marginal:
    """The distribution about one quantity: its point value and its quantile function.

    ``value`` is a number, or an array (*sets). ``ppf`` maps levels (n,) in (0, 1) to quantiles (*sets, n), ``cdf`` a
    value, or values (*sets), to levels (*sets); both are None where the method gives no uncertainty. ``parts``: the
    distributions that this one is a mixture of, the leading one first; none where it is not a mixture.
    """

    value: Any
    ppf: Callable[[np.ndarray], np.ndarray] | None = None
    cdf: Callable[[Any], Any] | None = None
    parts: tuple[Marginal, ...] = ()

    def interval(self, level: float) -> tuple[Any, Any]:
        """The equal-tailed interval of the given level, e.g. 0.95; NaNs without an uncertainty.

        Of a mixture, the hull of :meth:`intervals`.
        """
        if self.ppf is None:
            return float("nan"), float("nan")
        if self.parts:
            pieces = self.intervals(level)
            return pieces[0][0], pieces[-1][1]
        ends = self.ppf(np.array([0.5 - level / 2, 0.5 + level / 2]))
        return _number(ends[..., 0]), _number(ends[..., 1])

    def intervals(self, level: float) -> list[tuple[Any, Any]]:
        """The interval of the given level; of a mixture, the union of its parts' intervals, in increasing order."""
        pieces: list[tuple[Any, Any]] = []
        for low, high in sorted(part.interval(level) for part in self.parts or (self,)):
            if pieces and low <= pieces[-1][1]:
                pieces[-1] = pieces[-1][0], max(pieces[-1][1], high)
            else:
                pieces.append((low, high))
        return pieces


MIXTURE_STEPS = 60
"""Bisections for a quantile of a mixture: more than the digits of a double."""


def mixed(parts: Sequence[Marginal], weights: Sequence[float]) -> Marginal:
    """Mix distributions about one quantity; its value is that of the first part, its quantiles are those of the
    mixture.

    Args:
        parts: Distributions, each of one number; the first one alone where any gives no uncertainty.
        weights: Their probabilities, which add up to 1.
    """
    if len(parts) == 1 or any(part.ppf is None or part.cdf is None for part in parts):
        return parts[0]

    def cdf(true: Any) -> Any:
        return sum(weight * part.cdf(true) for weight, part in zip(weights, parts, strict=True) if part.cdf)

    def ppf(levels: np.ndarray) -> np.ndarray:
        quantiles = np.array([part.ppf(levels) for part in parts if part.ppf])
        low, high = quantiles.min(axis=0), quantiles.max(axis=0)  # the mixture's lie between those of its parts
        for _ in range(MIXTURE_STEPS):
            middle = 0.5 * (low + high)
            below = np.array([cdf(value) for value in middle]) < levels
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return np.asarray(0.5 * (low + high))

    return Marginal(parts[0].value, ppf, cdf, tuple(parts))


def _number(value: Any) -> Any:
    """Return an array as it is, and one without axes as a float."""
    return float(value) if np.ndim(value) == 0 else value


def standard_quantile(levels: Any, dof: Any) -> Any:
    """Quantiles of the standard normal, or of Student's t with ``dof`` degrees of freedom, a number or (*sets).

    Of levels (n,) they have the shape (n,), or (*sets, n).
    """
    from scipy.special import ndtri  # slow to import, and few need it

    if dof is None:
        return ndtri(levels)
    quantiles = _student_quantiles(np.asarray(levels, float).tobytes(), np.asarray(dof, float).tobytes())
    return quantiles.reshape(np.shape(dof) + np.shape(levels))[()]


@lru_cache(maxsize=8)
def _student_quantiles(levels: bytes, dof: bytes) -> np.ndarray:
    """Compute quantiles of Student's t, (n_dof, n_levels), once for all quantities of the same replicates."""
    from numpy.polynomial.chebyshev import chebinterpolate, chebval
    from scipy.special import stdtrit

    probabilities, (distinct, place) = np.frombuffer(levels), np.unique(np.frombuffer(dof), return_inverse=True)
    if distinct.size <= DOF_DEGREE or not distinct[-1] < DOF_RANGE * distinct[0]:
        return np.asarray(stdtrit(distinct[:, None], probabilities)[place])
    centre, half = np.mean(distinct[[0, -1]]), np.ptp(distinct[[0, -1]]) / 2.0
    coefficients = chebinterpolate(lambda x: stdtrit((centre + half * x)[:, None], probabilities), DOF_DEGREE)
    return np.asarray(chebval((distinct - centre) / half, coefficients).T[place])


def normal_marginal(value: Any, mean: Any, sd: Any, dof: Any, log: bool) -> Marginal:
    """Normal, or Student's t with ``dof`` degrees of freedom, in the quantity or in its logarithm.

    Value, mean, standard deviation and degrees of freedom are numbers, or arrays of one shape (*sets).
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


class Distribution(Protocol):
    """What both kinds of distribution can say. Who needs no more names no kind, and does not change with one."""

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters, or groups, that it is about."""
        ...

    def values(self) -> dict[str, Any]:
        """The point value of each of them: a number, or an array (*sets)."""
        ...

    def finite(self) -> bool:
        """Whether every number in it is."""
        ...

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """The distribution about a product of powers; None where its names do not determine it."""
        ...

    def expressed_in(self, scale: Mapping[str, float]) -> Self:
        """The same distribution with every named quantity divided by its scale."""
        ...


@dataclass(frozen=True, eq=False)
class Normal:
    """A normal distribution over named positive parameters, in their logarithms; or over groups, in themselves.

    ``names`` of shape (d,), ``mean`` (*sets, d) and ``covariance`` (*sets, d, d). With ``log`` the mean is that of the
    logarithms. ``covariance`` None: a point without uncertainty. With ``dof``, a number or (*sets), the intervals use
    Student's t with that many degrees of freedom (the noise was estimated), else the normal.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray | None
    log: bool
    dof: Any = None

    def values(self) -> dict[str, Any]:
        """The point value of each named quantity."""
        centre = np.exp(self.mean) if self.log else self.mean
        return dict(zip(self.names, map(_number, np.moveaxis(centre, -1, 0)), strict=True))

    def finite(self) -> bool:
        """Whether every number is."""
        arrays = [self.mean] if self.covariance is None else [self.mean, self.covariance]
        return all(bool(np.all(np.isfinite(array))) for array in arrays)

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """The distribution about a product of powers; None where these names do not determine it."""
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
        rounding = ROUNDING * (sds @ np.abs(weights)) ** 2  # of a ratio that is known far better than its parts
        sd = np.sqrt(np.maximum(self.covariance @ weights @ weights, 0.0) + rounding)
        return normal_marginal(value, centre, sd, self.dof, True)

    def expressed_in(self, scale: Mapping[str, float]) -> Normal:
        """The same distribution with every named quantity divided by its scale."""
        s = np.array([scale[name] for name in self.names])
        if self.log:
            return replace(self, mean=self.mean - np.log(s))
        covariance = None if self.covariance is None else self.covariance / np.outer(s, s)
        return replace(self, mean=self.mean / s, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Draws:
    """A distribution as draws of the parameters: ``samples`` of shape (*sets, n_draws, n_parameters), all positive.

    The point value of a quantity is the median of its draws: the one functional of a skewed posterior that a monotone
    change of the quantity leaves in its place, so that ``1/q`` and ``log q`` have theirs at the same draw.
    """

    names: tuple[str, ...]
    samples: np.ndarray

    def values(self) -> dict[str, Any]:
        """The point value of each parameter."""
        return dict(zip(self.names, map(_number, np.moveaxis(np.median(self.samples, axis=-2), -1, 0)), strict=True))

    def finite(self) -> bool:
        """Whether every draw is."""
        return bool(np.all(np.isfinite(self.samples)))

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """The distribution about a product of powers; None where these names do not determine it."""
        if not set(quantity.exponents) <= set(self.names):
            return None
        columns = {name: self.samples[..., i] for i, name in enumerate(self.names)}
        draws = np.sort(quantity.value(columns), axis=-1)

        def ppf(levels: np.ndarray) -> np.ndarray:
            return np.moveaxis(np.quantile(draws, levels, axis=-1), 0, -1)

        def cdf(true: Any) -> Any:
            # mid-rank over n + 1: the rank statistic of simulation-based calibration, never 0 or 1
            below = np.sum(draws < np.expand_dims(true, -1), axis=-1)
            return _number((below + 0.5) / (draws.shape[-1] + 1.0))

        return Marginal(_number(np.median(draws, axis=-1)), ppf, cdf)

    def expressed_in(self, scale: Mapping[str, float]) -> Draws:
        """The same draws with every parameter divided by its scale."""
        return replace(self, samples=self.samples / np.array([scale[name] for name in self.names]))
