"""What a method returns: parameters with their uncertainty, the reconstructed displacement, a status, a cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from bench.contract.problem import InitialState, Problem, Units
from bench.systems import LENGTH, MEASURED, Dimension, Quantity, System

Reconstruction = Callable[[np.ndarray], np.ndarray]
"""Displacement (m) by times (s): shape (n,) to shape (n_dof, n). Must be picklable."""


class Status(StrEnum):
    """What became of one replicate, or of a cell. One list, everywhere."""

    OK = "ok"
    DIVERGED = "diverged"
    NONFINITE = "nonfinite"
    TIMEOUT = "timeout"
    KILLED = "killed"
    OOM = "oom"
    CRASHED = "crashed"
    INVALID = "invalid"
    UNSUPPORTED = "unsupported"
    MISSING_DEPENDENCY = "missing_dependency"


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


def _normal_marginal(value: float, mean: float, sd: float, dof: float | None, log: bool) -> Marginal:
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
            return _normal_marginal(float(self.mean[i]), float(self.mean[i]), sd, self.dof, False)
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
        sd = float(np.sqrt(max(weights @ self.covariance @ weights, 0.0)))
        return _normal_marginal(value, centre, sd, self.dof, True)

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

    The point value of a quantity is the one of least expected squared relative error, the error that is scored:
    ``E[1/q] / E[1/q²]`` (set the derivative of ``E[(v/q - 1)²]`` by v to zero).
    """

    names: tuple[str, ...]
    samples: np.ndarray

    def values(self) -> dict[str, float]:
        """The point value of each parameter."""
        return dict(zip(self.names, map(_least_relative_error, self.samples.T), strict=True))

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

        return Marginal(_least_relative_error(draws), ppf, cdf)

    def expressed_in(self, scale: Mapping[str, float]) -> Draws:
        """The same draws with every parameter divided by its scale."""
        return replace(self, samples=self.samples / np.array([scale[name] for name in self.names]))


def _least_relative_error(draws: np.ndarray) -> float:
    smallest = float(np.min(draws))  # divided out, so that no square underflows
    inverse = smallest / draws
    return smallest * float(np.mean(inverse) / np.mean(inverse**2))


Belief = Normal | Draws


@dataclass(frozen=True)
class Cost:
    """What an estimate took, as counted by the method itself; time and memory are the harness's to measure."""

    evaluations: int = 0
    iterations: int = 0


class NoEstimate(Exception):
    """Raised by a method that finds none: :class:`Identifier` makes of it an Estimate with status and sentence.

    Args:
        sentence: What went wrong, and what the user can do.
        status: ``diverged`` unless said otherwise.
        cost: What the attempt took.
    """

    def __init__(self, sentence: str, status: Status = Status.DIVERGED, cost: Cost | None = None) -> None:
        self.status, self.cost = status, cost or Cost()
        super().__init__(sentence)


@dataclass(frozen=True)
class _Rescaled:
    """A reconstruction in other units; picklable."""

    original: Reconstruction
    time: float
    length: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        return self.original(np.asarray(times, float) * self.time) / self.length


@dataclass(frozen=True, eq=False)
class Estimate:
    """The answer of a method to one problem.

    Exactly one of these is given by a method that succeeded: ``parameters`` (all of them, natively, with the prior
    used), or ``groups`` (the identifiable groups only, in themselves and without the prior; the harness then combines
    them with the prior, once). ``reconstructions`` holds the displacement as a function of time, one a record;
    empty where the method has none, and the response simulated from its parameters stands in. ``bands`` holds the
    standard deviation (m) of the displacement as a function of time, one a record, where the method has it.
    ``initial_states`` (one a record) and ``offsets`` (one a channel, record by record) are the method's own, where it
    has them.
    ``traces`` keeps named arrays worth a picture (loss history, parameter trajectory); ``dimensions`` gives, of those
    that depend on the units, the dimension of each entry of the last axis (or one for all).
    """

    system: System
    parameters: Belief | None = None
    groups: Normal | None = None
    reconstructions: tuple[Reconstruction, ...] = ()
    bands: tuple[Reconstruction, ...] = ()
    initial_states: tuple[InitialState, ...] | None = None
    offsets: tuple[float, ...] | None = None
    status: Status = Status.OK
    message: str = ""
    cost: Cost = Cost()
    traces: Mapping[str, np.ndarray] = field(default_factory=dict)
    dimensions: Mapping[str, Sequence[Dimension]] = field(default_factory=dict)

    @staticmethod
    def failed(system: System, status: Status, message: str, cost: Cost = Cost()) -> Estimate:
        """An estimate that says only what went wrong, in a sentence."""
        return Estimate(system, status=status, message=message, cost=cost)

    @property
    def belief(self) -> Belief | None:
        """The parameters' belief, or the groups' where the method has only those."""
        return self.parameters if self.parameters is not None else self.groups

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """The belief about a quantity of the system; None where this estimate does not determine it."""
        if self.parameters is not None:
            return self.parameters.marginal(quantity)
        if self.groups is None:
            return None
        return self.groups.marginal(quantity) or self._from_groups(quantity)

    def _from_groups(self, quantity: Quantity) -> Marginal | None:
        """A product of powers of the groups, with the first-order (delta method) variance of its logarithm."""
        assert self.groups is not None
        names = self.system.names
        basis = np.array([self.system.quantity(name).vector(names) for name in self.groups.names]).T
        target = np.array(quantity.vector(names))
        powers, *_ = np.linalg.lstsq(basis, target, rcond=None)
        if not np.allclose(basis @ powers, target) or np.any(self.groups.mean <= 0):
            return None
        coefficients = np.array([self.system.quantity(name).coefficient for name in self.groups.names])
        centre = float(powers @ np.log(self.groups.mean / coefficients) + np.log(quantity.coefficient))
        if self.groups.covariance is None:
            return Marginal(float(np.exp(centre)))
        gradient = powers / self.groups.mean
        sd = float(np.sqrt(max(gradient @ self.groups.covariance @ gradient, 0.0)))
        return _normal_marginal(float(np.exp(centre)), centre, sd, self.groups.dof, True)

    def expressed_in(self, units: Units) -> Estimate:
        """Convert to other units (see :meth:`Problem.expressed_in`; ``units.inverse`` leads back).

        Offsets stay as they are, since what their channels measure is not known here: see :meth:`returned`.
        """
        scale = {q.name: units.of(self.system.dimension(q)) for q in self.system.quantities}
        starts = self.initial_states
        return replace(
            self,
            system=self.system.rescaled(units.of),
            parameters=self.parameters.expressed_in(scale) if self.parameters is not None else None,
            groups=self.groups.expressed_in(scale) if self.groups is not None else None,
            reconstructions=tuple(_Rescaled(r, units.time, units.of(LENGTH)) for r in self.reconstructions),
            bands=tuple(_Rescaled(b, units.time, units.of(LENGTH)) for b in self.bands),
            initial_states=tuple(s.expressed_in(units) for s in starts) if starts is not None else None,
            traces={**self.traces, **self._traces_in(units)},
        )

    def _traces_in(self, units: Units) -> dict[str, np.ndarray]:
        return {n: self.traces[n] / np.array([units.of(d) for d in own]) for n, own in self.dimensions.items()}

    def returned(self, problem: Problem, units: Units) -> Estimate:
        """Convert the answer to ``problem.expressed_in(units)``, offsets too, to the units of ``problem``."""
        offsets = self.offsets
        if offsets is not None:
            sizes = [units.of(MEASURED[c.measures]) for record in problem.records for c in record.channels]
            offsets = tuple(offset * size for offset, size in zip(offsets, sizes, strict=True))
        return replace(self.expressed_in(units.inverse), system=problem.system, offsets=offsets)

    def checked(self) -> Estimate:
        """Itself, or a failure with status ``nonfinite`` where a number in it is not finite."""
        if self.status is Status.OK and (self.belief is None or not self.belief.finite()):
            return Estimate.failed(self.system, Status.NONFINITE, "the estimate is not finite", self.cost)
        return self
