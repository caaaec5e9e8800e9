"""Result of a method: parameters with uncertainty, reconstructed displacement, status and cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from bench.contract.distribution import Distribution, Marginal, Normal, mixed, normal_marginal
from bench.contract.problem import InitialState, Problem, Units
from bench.systems import LENGTH, MEASURED, Dimension, Quantity, System

Reconstruction = Callable[[np.ndarray], np.ndarray]
"""Function from times (s), shape (n,), to displacement (m), shape (n_dof, n). Must be picklable."""


class Status(StrEnum):
    """Outcome of a replicate or of a cell."""

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
    """Computational effort as counted by the method; time and memory are measured by the benchmark.

    Attributes:
        evaluations: Number of evaluations of the model.
        iterations: Number of iterations.
    """

    evaluations: int = 0
    iterations: int = 0


class NoEstimate(Exception):
    """Raised by a method that cannot find an estimate; :class:`Identifier` converts it to a failed Estimate.

    Args:
        sentence: Cause, and what the user can do.
        status: Status of the estimate.
        cost: Effort of the attempt.
    """

    def __init__(self, sentence: str, status: Status = Status.DIVERGED, cost: Cost | None = None) -> None:
        self.status, self.cost = status, cost or Cost()
        super().__init__(sentence)


@dataclass(frozen=True)
class Rescaled:
    """Reconstruction converted to other units; picklable."""

    original: Reconstruction
    time: float
    length: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        return self.original(np.asarray(times, float) * self.time) / self.length


@dataclass(frozen=True, eq=False)
class Estimate:
    """Result of a method for one problem. A successful method gives either ``parameters`` or ``groups``.

    Attributes:
        system: System of the problem.
        parameters: Distribution of all parameters, with the prior included.
        groups: Distribution of the identifiable groups, without the prior; the benchmark combines it with the prior.
        reconstructions: Displacement as a function of time, one per record; if empty, the response is simulated from
            the estimated parameters.
        bands: Standard deviation (m) of the displacement as a function of time, one per record, or empty.
        initial_states: Estimated initial states, one per record.
        offsets: Estimated sensor offsets, one per channel, record by record.
        status: Outcome.
        message: Explanation for the user, in one sentence.
        cost: Effort as counted by the method.
        traces: Named arrays for figures, such as the history of the loss.
        dimensions: For traces that depend on the units, the dimension of each entry of the last axis (or one for all).
        alternatives: Other estimates that the data support, each with its ``weight``; intervals include them (see
            :meth:`Marginal.intervals`).
        weight: Probability that this estimate, among its alternatives, is the right one.
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
        """Return an estimate without values.

        Args:
            system: System of the problem.
            status: Outcome.
            message: Cause of the failure, in one sentence.
            cost: Effort of the attempt.

        Returns:
            The failed estimate.
        """
        return Estimate(system, status=status, message=message, cost=cost)

    @property
    def distribution(self) -> Distribution | None:
        """Distribution of the parameters, or of the groups if the method estimates only these."""
        return self.parameters if self.parameters is not None else self.groups

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """Return the distribution of a quantity of the system; None if the estimate does not determine it.

        With ``alternatives`` it is a mixture whose point estimate is that of this estimate.
        """
        main = self._main_marginal(quantity)
        if main is None or not self.alternatives:
            return main
        others = [(other.marginal(quantity), other.weight) for other in self.alternatives]
        known = [(main, self.weight), *((other, weight) for other, weight in others if other is not None)]
        return mixed([part for part, _ in known], [weight for _, weight in known])

    def _main_marginal(self, quantity: Quantity) -> Marginal | None:
        """Return the distribution of a quantity without the alternatives."""
        if self.parameters is not None:
            return self.parameters.marginal(quantity)
        if self.groups is None:
            return None
        return self.groups.marginal(quantity) or self._from_groups(quantity)

    def _from_groups(self, quantity: Quantity) -> Marginal | None:
        """Return the distribution of a product of powers of groups, by the delta method in its logarithm."""
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
        """Convert to other units (see :meth:`Problem.expressed_in`); ``units.inverse`` converts back.

        Offsets are not converted, since the measured quantities of their channels are not known here; see
        :meth:`returned`.
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
        return {n: self.traces[n] / np.array([units.of(d) for d in dims]) for n, dims in self.dimensions.items()}

    def returned(self, problem: Problem, units: Units) -> Estimate:
        """Convert the estimate for ``problem.expressed_in(units)``, including offsets, to the units of ``problem``.

        Args:
            problem: Problem in the user's units.
            units: Units in which the estimate was computed.

        Returns:
            The estimate in the user's units.
        """
        offsets = self.offsets
        if offsets is not None:
            sizes = [units.of(MEASURED[c.measures]) for record in problem.records for c in record.channels]
            offsets = tuple(offset * size for offset, size in zip(offsets, sizes, strict=True))
        alternatives = tuple(other.returned(problem, units) for other in self.alternatives)
        answer = self.expressed_in(units.inverse)
        return replace(answer, system=problem.system, offsets=offsets, alternatives=alternatives)

    def checked(self) -> Estimate:
        """Return this estimate, or a failure with status ``nonfinite`` if it contains a number that is not finite."""
        distributions = [part.distribution for part in (self, *self.alternatives)]
        if self.status is Status.OK and not all(
            distribution is not None and distribution.finite() for distribution in distributions
        ):
            return Estimate.failed(self.system, Status.NONFINITE, "the estimate is not finite", self.cost)
        return self
