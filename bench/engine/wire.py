"""Serialisation of estimates as plain numbers, from the process of a method to the scoring process.

Functions of time are evaluated in the process of the method, so that no code of the method runs, or is unpickled, in
the process that knows the true values.
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
"""Largest lengths of a method's message and of the name of a trace (characters)."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """A function of time given by its values (n_dof, n) at times (n,)."""

    times: np.ndarray
    values: np.ndarray

    def __call__(self, times: np.ndarray) -> np.ndarray:
        if not np.array_equal(times, self.times):
            raise ValueError("the displacement is known at the requested times only")
        return self.values


PLAIN = (Cost, Draws, Estimate, InitialState, Normal, Sampled, Status)
MOST_ALTERNATIVES = 50
"""Largest number of alternatives of an estimate; further ones are dropped."""
WEIGHT_ROUNDING = 1e-6
REBUILT = {(kind.__module__, kind.__qualname__): kind for kind in PLAIN}
NUMPY = {"_reconstruct", "ndarray", "dtype", "scalar", "_frombuffer"}


def evaluated_together(estimates: Sequence[Estimate], times: Sequence[np.ndarray]) -> Sequence[Estimate]:
    """Evaluate the simulated free responses of a single mass for all estimates at once, which is faster.

    Args:
        estimates: Estimates of a method for problems of one scenario.
        times: Times at which the reconstruction of each is evaluated, s.

    Returns:
        The estimates with sampled reconstructions; unchanged if any reconstruction is of another kind.
    """
    responses = [_simulated(estimate.reconstructions) for estimate in estimates]
    first = responses[0][0] if responses else None
    if first is None or not first.system.linear or first.system.n_dof > 1:
        return estimates
    if any(response is None or response.forces or response.system != first.system for response, _, _ in responses):
        return estimates
    if any(grid is not times[0] and not np.array_equal(grid, times[0]) for grid in times):
        return estimates
    time, length = (np.array(scale) for scale in list(zip(*responses, strict=True))[1:])
    try:
        sizes = {p.name: time**p.dimension.time * length**p.dimension.length for p in first.system.parameters}
        parameters = {n: np.array([response.parameters[n] for response, _, _ in responses]) / sizes[n] for n in sizes}
        initial_states = [InitialState(r.start.displacement / x, r.start.velocity * t / x) for r, t, x in responses]
        (values,) = displacements(first.system, parameters, initial_states, times[:1], [()] * len(initial_states))
    except Exception:  # evaluated one by one later, so that only the invalid ones fail
        return estimates
    return [replace(e, reconstructions=(Sampled(times[0], path),)) for e, path in zip(estimates, values, strict=True)]


def _simulated(functions: Sequence[Reconstruction]) -> tuple[Any, float, float]:
    """Return the reconstruction, or None if it is not a single simulated response, and its units of time and length."""
    time = length = 1.0
    function: Any = functions[0] if len(functions) == 1 else None
    while type(function) is Rescaled:
        function, time, length = function.original, time * function.time, length * function.length
    return (function if type(function) is SimulatedResponse else None), time, length


def plain(estimate: Estimate, times: np.ndarray) -> Estimate:
    """Convert an estimate to plain numbers, without its system, for :func:`pack`.

    Args:
        estimate: The estimate of a method.
        times: Times at which its functions are evaluated, s.

    Raises:
        TypeError, ValueError: The estimate violates the contract.
        Exception: Whatever the functions of the estimate raise.
    """
    initial_states, n_dof = estimate.initial_states, estimate.system.n_dof
    bare = _plain_distributions(estimate)
    alternatives = tuple(map(_plain_distributions, estimate.alternatives[:MOST_ALTERNATIVES]))
    weights = [part.weight for part in (bare, *alternatives)]
    if not (min(weights) >= 0.0 and abs(sum(weights) - 1.0) < WEIGHT_ROUNDING):
        raise ValueError(f"the weights of an estimate and its alternatives must add up to 1, not {weights}")
    return replace(
        bare,
        alternatives=alternatives,
        reconstructions=tuple(_sampled(function, times, n_dof) for function in estimate.reconstructions),
        bands=tuple(_sampled(function, times, n_dof) for function in estimate.bands),
        initial_states=None
        if initial_states is None
        else tuple(InitialState(np.array(s.displacement, float), np.array(s.velocity, float)) for s in initial_states),
        offsets=None if estimate.offsets is None else tuple(float(offset) for offset in estimate.offsets),
        status=Status(estimate.status),
        message=printable(str(estimate.message), LONGEST_MESSAGE),
        cost=Cost(int(estimate.cost.evaluations), int(estimate.cost.iterations)),
        traces={printable(str(name), LONGEST_NAME): np.array(trace, float) for name, trace in estimate.traces.items()},
    )


def _plain_distributions(estimate: Estimate) -> Estimate:
    """Return the distributions and the weight of an estimate or alternative, in plain numbers."""
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
        raise ValueError(f"a reconstruction must have shape {(n_dof, times.size)}, not {values.shape}")
    return Sampled(times, values)


def _plain_distribution(distribution: Distribution | None) -> Distribution | None:
    if distribution is None:
        return None
    names = tuple(str(name) for name in distribution.names)
    n = len(names)
    if isinstance(distribution, Draws):
        return Draws(names, _shaped(distribution.samples, (None, n)))
    if not isinstance(distribution, Normal):
        raise TypeError(f"a distribution must be a Normal or Draws, not {type(distribution).__name__}")
    covariance = None if distribution.covariance is None else _shaped(distribution.covariance, (n, n))
    dof = None if distribution.dof is None else float(distribution.dof)
    return Normal(names, _shaped(distribution.mean, (n,)), covariance, bool(distribution.log), dof)


def _shaped(values: Any, shape: Sequence[int | None]) -> np.ndarray:
    array = np.array(values, float)
    if array.ndim != len(shape) or any(want not in (None, n) for want, n in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(f"an array must have shape ({wanted}), not {array.shape}")
    return array


class _PlainUnpickler(pickle.Unpickler):
    """Unpickles numbers, texts, numpy arrays and estimates only, nothing that runs code of a method."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in REBUILT:
            return REBUILT[module, name]
        if module.partition(".")[0] == "numpy" and name in NUMPY:
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"{module}.{name} is not plain")


def pack(content: Any) -> bytes:
    """Serialise plain content."""
    return pickle.dumps(content, protocol=pickle.HIGHEST_PROTOCOL)


def unpack(content: bytes) -> Any:
    """Deserialise the result of :func:`pack`; raises UnpicklingError for anything that is not plain."""
    return _PlainUnpickler(io.BytesIO(content)).load()
