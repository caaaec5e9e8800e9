"""What is believed of the parameters after a fit: a normal in their logarithms, or draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np

from bench.systems import Quantity

ROUNDING = 4.0 * float(np.finfo(float).eps)
"""What a variance may be off by, over that of the parts whose covariances cancel in it."""


@dataclass(frozen=True)
class Marginal:
    """The belief about one quantity: its point value and its quantile function.

    ``ppf`` maps levels in (0, 1) to quantiles, ``cdf`` a value to its level; both are None where the method gives no
    uncertainty.
    """

    value: float
    ppf: Callable[[np.ndarray], np.ndarray] | None = None
    cdf: Callable[[float], float] | None = None

    def interval(self, level: float) -> tuple[float, float]:
        """The equal-tailed interval of the given level, e.g. 0.95; NaNs without an uncertainty."""
        if self.ppf is None:
            return float("nan"), float("nan")
        low, high = self.ppf(np.array([0.5 - level / 2, 0.5 + level / 2]))
        return float(low), float(high)


def standard_quantile(levels: Any, dof: float | None) -> Any:
    """Quantiles of the standard normal, or of Student's t with ``dof`` degrees of freedom."""
    from scipy.special import ndtri, stdtrit  # slow to import, and few need it

    return ndtri(levels) if dof is None else stdtrit(dof, levels)


def normal_marginal(value: float, mean: float, sd: float, dof: float | None, log: bool) -> Marginal:
    """Normal, or Student's t with ``dof`` degrees of freedom, in the quantity or in its logarithm."""

    def ppf(levels: np.ndarray) -> np.ndarray:
        z = standard_quantile(levels, dof)
        with np.errstate(over="ignore"):
            return np.asarray(np.exp(mean + sd * z) if log else mean + sd * z)

    def cdf(true: float) -> float:
        from scipy.special import ndtr, stdtr

        with np.errstate(over="ignore"):
            z = ((np.log(true) if log else true) - mean) / np.maximum(sd, 1e-300)
        return float(ndtr(z) if dof is None else stdtr(dof, z))

    return Marginal(value, ppf, cdf)


class Belief(Protocol):
    """What both kinds of belief can say. Who needs no more names no kind, and does not change with one."""

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters, or groups, that it is about."""
        ...

    def values(self) -> dict[str, float]:
        """The point value of each of them."""
        ...

    def finite(self) -> bool:
        """Whether every number in it is."""
        ...

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """The belief about a product of powers; None where its names do not determine it."""
        ...

    def expressed_in(self, scale: Mapping[str, float]) -> Self:
        """The same belief with every named quantity divided by its scale."""
        ...


@dataclass(frozen=True, eq=False)
class Normal:
    """A normal belief over named positive parameters, in their logarithms; or over groups, in themselves.

    ``names`` of shape (d,), ``mean`` (d,) and ``covariance`` (d, d). With ``log`` the mean is that of the logarithms.
    ``covariance`` None: a point without uncertainty. With ``dof`` the intervals use Student's t with that many
    degrees of freedom (the noise was estimated), else the normal.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray | None
    log: bool
    dof: float | None = None

    def values(self) -> dict[str, float]:
        """The point value of each named quantity."""
        centre = np.exp(self.mean) if self.log else self.mean
        return dict(zip(self.names, map(float, centre), strict=True))

    def finite(self) -> bool:
        """Whether every number is."""
        arrays = [self.mean] if self.covariance is None else [self.mean, self.covariance]
        return all(bool(np.all(np.isfinite(array))) for array in arrays)

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """The belief about a product of powers; None where these names do not determine it."""
        if self.log:
            return self._log_marginal(quantity)
        if quantity.name in self.names:
            i = self.names.index(quantity.name)
            if self.covariance is None:
                return Marginal(float(self.mean[i]))
            sd = float(np.sqrt(self.covariance[i, i]))
            return normal_marginal(float(self.mean[i]), float(self.mean[i]), sd, self.dof, False)
        return None

    def _log_marginal(self, quantity: Quantity) -> Marginal | None:
        if not set(quantity.exponents) <= set(self.names):
            return None
        weights = np.array(quantity.vector(self.names))
        centre = float(weights @ self.mean + np.log(quantity.coefficient))
        with np.errstate(over="ignore"):
            value = float(np.exp(centre))
        if self.covariance is None:
            return Marginal(value)
        terms = np.abs(weights) * np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        rounding = ROUNDING * float(np.sum(terms)) ** 2  # of a ratio that is known far better than its parts
        sd = float(np.sqrt(max(weights @ self.covariance @ weights, 0.0) + rounding))
        return normal_marginal(value, centre, sd, self.dof, True)

    def expressed_in(self, scale: Mapping[str, float]) -> Normal:
        """The same belief with every named quantity divided by its scale."""
        s = np.array([scale[name] for name in self.names])
        if self.log:
            return replace(self, mean=self.mean - np.log(s))
        covariance = None if self.covariance is None else self.covariance / np.outer(s, s)
        return replace(self, mean=self.mean / s, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Draws:
    """A belief as draws of the parameters: ``samples`` of shape (n_draws, n_parameters), all positive.

    The point value of a quantity is the median of its draws: the one functional of a skewed posterior that a monotone
    change of the quantity leaves in its place, so that ``1/q`` and ``log q`` have theirs at the same draw.
    """

    names: tuple[str, ...]
    samples: np.ndarray

    def values(self) -> dict[str, float]:
        """The point value of each parameter."""
        return dict(zip(self.names, map(float, np.median(self.samples, axis=0)), strict=True))

    def finite(self) -> bool:
        """Whether every draw is."""
        return bool(np.all(np.isfinite(self.samples)))

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """The belief about a product of powers; None where these names do not determine it."""
        if not set(quantity.exponents) <= set(self.names):
            return None
        columns = {name: self.samples[:, i] for i, name in enumerate(self.names)}
        draws = np.sort(quantity.value(columns))

        def ppf(levels: np.ndarray) -> np.ndarray:
            return np.asarray(np.quantile(draws, levels))

        def cdf(true: float) -> float:
            # mid-rank over n + 1: the rank statistic of simulation-based calibration, never 0 or 1
            return float((np.searchsorted(draws, true) + 0.5) / (draws.size + 1.0))

        return Marginal(float(np.median(draws)), ppf, cdf)

    def expressed_in(self, scale: Mapping[str, float]) -> Draws:
        """The same draws with every parameter divided by its scale."""
        return replace(self, samples=self.samples / np.array([scale[name] for name in self.names]))
