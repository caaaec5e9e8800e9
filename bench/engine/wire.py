"""An estimate as plain numbers: what crosses from the process of a method to the one that scores.

Functions of time are replaced by their values at the times that the harness asks for, in the process of the method; so
nothing of the method is ever run, or rebuilt, where a truth is.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.contract.distribution import Distribution, Draws, Normal
from bench.contract.estimate import Cost, Estimate, Reconstruction, Rescaled, Status
from bench.contract.problem import InitialState
from bench.dynamics.simulate import SimulatedResponse, displacements
from bench.isolation.failure import printable

LONGEST_MESSAGE, LONGEST_NAME = 2000, 100
"""Of a method's message and of the name of a trace (characters)."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """A function of time known at some times only: shapes (n,) and (n_dof, n)."""

    times: np.ndarray
    values: np.ndarray

    def __call__(self, times: np.ndarray) -> np.ndarray:
        if not np.array_equal(times, self.times):
            raise ValueError("the displacement is known at the times that were asked for only")
        return self.values


PLAIN = (Cost, Draws, Estimate, InitialState, Normal, Sampled, Status)
MOST_ALTERNATIVES = 50
"""Of an estimate that are kept."""
WEIGHT_ROUNDING = 1e-6
REBUILT = {(kind.__module__, kind.__qualname__): kind for kind in PLAIN}
NUMPY = {"_reconstruct", "ndarray", "dtype", "scalar", "_frombuffer"}


def evaluated_together(estimates: Sequence[Estimate], times: Sequence[np.ndarray]) -> Sequence[Estimate]:
    """Evaluate free responses of one mass that are simulated from parameters for all estimates at once: faster.

    Args:
        estimates: The answers of a method to problems of one scenario.
        times: When the reconstruction of each is wanted (s).

    Returns:
        The estimates with the values of their responses at these times; as they are where any has another kind.
    """
    responses = [_simulated(estimate.reconstructions) for estimate in estimates]
    first = responses[0][0] if responses else None
    if first is None or not first.system.linear or first.system.n_dof > 1:
        return estimates
    if any(response is None or response.forces or response.system != first.system for response, _, _ in responses):
        return estimates
    if any(wanted is not times[0] and not np.array_equal(wanted, times[0]) for wanted in times):
        return estimates
    time, length = (np.array(scale) for scale in list(zip(*responses, strict=True))[1:])
    try:
        sizes = {p.name: time**p.dimension.time * length**p.dimension.length for p in first.system.parameters}
        parameters = {n: np.array([response.parameters[n] for response, _, _ in responses]) / sizes[n] for n in sizes}
        starts = [InitialState(r.start.displacement / x, r.start.velocity * t / x) for r, t, x in responses]
        (paths,) = displacements(first.system, parameters, starts, times[:1], [()] * len(starts))
    except Exception:  # each is evaluated by itself, and fails by itself
        return estimates
    return [replace(e, reconstructions=(Sampled(times[0], path),)) for e, path in zip(estimates, paths, strict=True)]


def _simulated(functions: Sequence[Reconstruction]) -> tuple[Any, float, float]:
    """Return the only reconstruction and its units of time and length, where it is simulated; else None and these."""
    time = length = 1.0
    function: Any = functions[0] if len(functions) == 1 else None
    while type(function) is Rescaled:
        function, time, length = function.original, time * function.time, length * function.length
    return (function if type(function) is SimulatedResponse else None), time, length


def plain(estimate: Estimate, times: np.ndarray) -> Estimate:
    """Return the estimate in plain numbers, without its system, for :func:`pack`.

    Its functions are evaluated at ``times`` (s, floats); raises what these raise, and TypeError and ValueError for
    what is not as the contract has it.
    """
    starts, n_dof = estimate.initial_states, estimate.system.n_dof
    bare = _plain_distributions(estimate)
    alternatives = tuple(map(_plain_distributions, estimate.alternatives[:MOST_ALTERNATIVES]))
    weights = [part.weight for part in (bare, *alternatives)]
    if not (min(weights) >= 0.0 and abs(sum(weights) - 1.0) < WEIGHT_ROUNDING):
        raise ValueError(f"weights of an answer and its alternatives that add up to 1 were expected, not {weights}")
    return replace(
        bare,
        alternatives=alternatives,
        reconstructions=tuple(_sampled(function, times, n_dof) for function in estimate.reconstructions),
        bands=tuple(_sampled(function, times, n_dof) for function in estimate.bands),
        initial_states=None
        if starts is None
        else tuple(InitialState(np.array(s.displacement, float), np.array(s.velocity, float)) for s in starts),
        offsets=None if estimate.offsets is None else tuple(float(offset) for offset in estimate.offsets),
        status=Status(estimate.status),
        message=printable(str(estimate.message), LONGEST_MESSAGE),
        cost=Cost(int(estimate.cost.evaluations), int(estimate.cost.iterations)),
        traces={printable(str(name), LONGEST_NAME): np.array(trace, float) for name, trace in estimate.traces.items()},
    )


def _plain_distributions(estimate: Estimate) -> Estimate:
    """Return what an estimate, or an alternative of one, believes of the parameters, and its weight."""
    groups = _plain_distribution(estimate.groups)
    assert groups is None or isinstance(groups, Normal)
    return Estimate(
        None,  # type: ignore[arg-type]
        parameters=_plain_distribution(estimate.parameters),
        groups=groups,
        weight=float(estimate.weight),
    )


def _sampled(function: Reconstruction, times: np.ndarray, n_dof: int) -> Sampled:
    values = np.array(function(times), float)
    if values.shape != (n_dof, times.size):
        raise ValueError(f"a reconstruction of shape {(n_dof, times.size)} was expected, not {values.shape}")
    return Sampled(times, values)


def _plain_distribution(distribution: Distribution | None) -> Distribution | None:
    if distribution is None:
        return None
    names = tuple(str(name) for name in distribution.names)
    n = len(names)
    if isinstance(distribution, Draws):
        return Draws(names, _shaped(distribution.samples, (None, n)))
    if not isinstance(distribution, Normal):
        raise TypeError(f"a distribution is a Normal or Draws, not {type(distribution).__name__}")
    covariance = None if distribution.covariance is None else _shaped(distribution.covariance, (n, n))
    dof = None if distribution.dof is None else float(distribution.dof)
    return Normal(names, _shaped(distribution.mean, (n,)), covariance, bool(distribution.log), dof)


def _shaped(values: Any, shape: Sequence[int | None]) -> np.ndarray:
    array = np.array(values, float)
    if array.ndim != len(shape) or any(want not in (None, n) for want, n in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(f"an array of shape ({wanted}) was expected, not {array.shape}")
    return array


class _PlainUnpickler(pickle.Unpickler):
    """Rebuilds numbers, texts, numpy arrays and estimates, and nothing that runs code of a method."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in REBUILT:
            return REBUILT[module, name]
        if module.partition(".")[0] == "numpy" and name in NUMPY:
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"{module}.{name} is not plain")


def pack(content: Any) -> bytes:
    """Return plain content as bytes."""
    return pickle.dumps(content, protocol=pickle.HIGHEST_PROTOCOL)


def unpack(content: bytes) -> Any:
    """Return what :func:`pack` was given; raises UnpicklingError for anything that is not plain."""
    return _PlainUnpickler(io.BytesIO(content)).load()
