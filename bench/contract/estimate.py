"""What a method returns: parameters with their uncertainty, the reconstructed displacement, a status, a cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from bench.contract.distribution import Distribution, Marginal, Normal, mixed, normal_marginal
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
class Rescaled:
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
    ``alternatives``: other answers that the data support, of the same kind, each with its ``weight``, the probability
    that it is the right one; an interval then covers them too (:meth:`Marginal.intervals`).
    """

    system: System
    parameters: Distribution | None = None
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
    alternatives: tuple[Estimate, ...] = ()
    weight: float = 1.0

    @staticmethod
    def failed(system: System, status: Status, message: str, cost: Cost = Cost()) -> Estimate:
        """An estimate that says only what went wrong, in a sentence."""
        return Estimate(system, status=status, message=message, cost=cost)

    @property
    def distribution(self) -> Distribution | None:
        """The parameters' distribution, or the groups' where the method has only those."""
        return self.parameters if self.parameters is not None else self.groups

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """The distribution about a quantity of the system; None where this estimate does not determine it.

        With ``alternatives`` a mixture, whose value is that of this estimate without them.
        """
        own = self._own_marginal(quantity)
        if own is None or not self.alternatives:
            return own
        others = [(other.marginal(quantity), other.weight) for other in self.alternatives]
        known = [(own, self.weight), *((other, weight) for other, weight in others if other is not None)]
        return mixed([part for part, _ in known], [weight for _, weight in known])

    def _own_marginal(self, quantity: Quantity) -> Marginal | None:
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
        centre = np.log(self.groups.mean / coefficients) @ powers + np.log(quantity.coefficient)
        if self.groups.covariance is None:
            return Marginal(np.exp(centre)[()])
        gradient = powers / self.groups.mean
        variance = np.einsum("...i,...ij,...j", gradient, self.groups.covariance, gradient)
        return normal_marginal(np.exp(centre), centre, np.sqrt(np.maximum(variance, 0.0)), self.groups.dof, True)

    def expressed_in(self, units: Units) -> Estimate:
        """Convert to other units (see :meth:`Problem.expressed_in`; ``units.inverse`` leads back).

        Offsets stay as they are, since what their channels measure is not known here: see :meth:`returned`.
        """
        scale = {name: units.of(dimension) for name, dimension in self.system.dimensions.items()}
        starts = self.initial_states
        return replace(
            self,
            system=self.system.rescaled(units.of),
            parameters=self.parameters.expressed_in(scale) if self.parameters is not None else None,
            groups=self.groups.expressed_in(scale) if self.groups is not None else None,
            reconstructions=tuple(Rescaled(r, units.time, units.of(LENGTH)) for r in self.reconstructions),
            bands=tuple(Rescaled(b, units.time, units.of(LENGTH)) for b in self.bands),
            initial_states=tuple(s.expressed_in(units) for s in starts) if starts is not None else None,
            traces={**self.traces, **self._traces_in(units)},
            alternatives=tuple(other.expressed_in(units) for other in self.alternatives),
        )

    def _traces_in(self, units: Units) -> dict[str, np.ndarray]:
        return {n: self.traces[n] / np.array([units.of(d) for d in own]) for n, own in self.dimensions.items()}

    def returned(self, problem: Problem, units: Units) -> Estimate:
        """Convert the answer to ``problem.expressed_in(units)``, offsets too, to the units of ``problem``."""
        offsets = self.offsets
        if offsets is not None:
            sizes = [units.of(MEASURED[c.measures]) for record in problem.records for c in record.channels]
            offsets = tuple(offset * size for offset, size in zip(offsets, sizes, strict=True))
        alternatives = tuple(other.returned(problem, units) for other in self.alternatives)
        answer = self.expressed_in(units.inverse)
        return replace(answer, system=problem.system, offsets=offsets, alternatives=alternatives)

    def checked(self) -> Estimate:
        """Itself, or a failure with status ``nonfinite`` where a number in it is not finite."""
        distributions = [part.distribution for part in (self, *self.alternatives)]
        if self.status is Status.OK and not all(
            distribution is not None and distribution.finite() for distribution in distributions
        ):
            return Estimate.failed(self.system, Status.NONFINITE, "the estimate is not finite", self.cost)
        return self
