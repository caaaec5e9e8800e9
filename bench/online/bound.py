"""The posterior Cramér-Rao bound along a stream: the smallest error of a tracker's estimates of the log-parameters.

Motion, ambient force and log-parameters form one state with a prior and process noise. Their bound is the inverse of
the information matrix of the recursion by P. Tichavský, C. H. Muravchik, A. Nehorai (IEEE Trans. Signal Processing
46:1386, 1998). With forces that are constant over an interval its transition is singular, since the noise has fewer
dimensions than the motion. It is therefore written as the equivalent Riccati recursion, which inverts innovations only:
time update ``F P F' + Q``, measurement update ``P - P H' (H P H' + R)^-1 H P``, with the derivatives F and H at the
true values. The expectation over streams is the average of the variances over replicates.

The process noise of the log-parameters is a random walk whose mean-square increments at every instant are those of the
true course; for a step they are zero except at the step. The bound is thus that of an observer who knows when a change
may occur and its approximate size; a tracker has to estimate both. The levels of noise and ambient force, and the
memory of the ambient force, are assumed known. There is no prior of the parameters, and the initial state is unknown.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from bench.contract.online import Layout
from bench.dynamics.discrete_model import DiscreteModel
from bench.online.scenario import OnlineScenario, Stream

OPEN_LOG_SD = 3.0
"""Initial standard deviation of a log-parameter (a factor of 20)."""
OPEN_MOTION = 10.0
"""Initial standard deviation of displacement and velocity over their root mean squares."""


def bound_variances(scenario: OnlineScenario, stream: Stream) -> dict[str, np.ndarray]:
    """Return the bound on the variance of the logarithm of each quantity after each sample, each (n,)."""
    covariances = _covariances(scenario, stream)
    free = stream.layout.free
    weights = {quantity.name: np.array(quantity.vector(free)) for quantity in stream.layout.quantities}
    return {name: np.einsum("i,kij,j->k", w, covariances, w) for name, w in weights.items()}


def _covariances(scenario: OnlineScenario, stream: Stream) -> np.ndarray:
    """Return the covariances of the log-parameters after each sample, (n, n_free, n_free)."""
    layout, truth = stream.layout, stream.truth
    model = DiscreteModel(layout)
    n = len(stream.times)
    logs = np.log(np.stack([truth.parameters[name] for name in layout.free], axis=1))
    if not layout.scale_known:
        logs = logs - _exponents(layout) * np.log(truth.parameters[layout.system.gauge])[:, None]
    scale = 1.0 if layout.scale_known else 1.0 / truth.parameters[layout.system.gauge][:, None]
    joints = np.zeros((n, model.size))
    joints[:, : model.n_motion], joints[:, model.logs] = truth.motion, logs
    joints[:, model.ambient] = truth.ambient * scale
    walk = np.zeros((n, model.size))
    increments = scenario.increment_variances()
    names = list(layout.system.names)
    walk[:, model.logs] = increments[:, [names.index(name) for name in layout.free]]
    if not layout.scale_known:
        walk[:, model.logs] += increments[:, [names.index(layout.system.gauge)]]
    kept = np.array([force.autocorrelation for force in scenario.forces if not force.told])
    level = np.array([force.amplitude for force in scenario.forces if not force.told]) * np.mean(scale)
    walk[:, model.ambient] = level**2 * (1.0 - kept**2)
    first = np.zeros(model.size)
    size = np.sqrt(np.mean(truth.motion**2, axis=0))
    first[: model.n_motion] = (OPEN_MOTION * np.maximum(size, 1e-12 * size.max())) ** 2
    first[model.ambient] = level**2
    first[model.logs] = OPEN_LOG_SD**2
    transitions, slopes = (np.asarray(part) for part in _slopes(layout)(joints, truth.known, kept))
    covariances = riccati(transitions, slopes, walk, np.diag(first), np.diag(truth.sigma**2))
    return covariances[:, model.logs, model.logs]


def _exponents(layout: Layout) -> np.ndarray:
    """Return the exponent of the gauge in each free parameter: 1 for parameters that scale with the mass, otherwise 0.

    Raises:
        ValueError: A parameter belongs to no group.
    """
    groups = {name: group.exponents for group in layout.system.groups for name in group.exponents}
    if any(groups.get(name, {}).get(name) != 1.0 for name in layout.free):
        raise ValueError(f"{layout.system.name}: not every parameter stands in a group")
    return np.array([float(layout.system.gauge in groups[name]) for name in layout.free])


def riccati(
    transitions: np.ndarray, slopes: np.ndarray, walk: np.ndarray, first: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Return the covariances of a linear model after each sample, (n, d, d).

    Args:
        transitions: Transition matrices from each sample to the next, (n, d, d).
        slopes: Measurement matrices, (n, c, d).
        walk: Variances of the process noise after each sample, (n, d).
        first: Covariance before the first sample, (d, d).
        noise: Covariance of the measurement noise, (c, c).
    """
    covariance, covariances = first, np.empty((len(walk), *first.shape))
    for k, (f, h) in enumerate(zip(transitions, slopes, strict=True)):
        cross = covariance @ h.T
        gain = np.linalg.solve(h @ cross + noise, cross.T).T
        left = np.eye(len(first)) - gain @ h
        covariances[k] = left @ covariance @ left.T + gain @ noise @ gain.T
        covariance = f @ covariances[k] @ f.T + np.diag(walk[k])
    return covariances


@lru_cache(maxsize=32)
def _slopes(layout: Layout) -> Any:
    """Return a function of states, known forces and memory: transition and measurement matrices at every sample."""
    import jax

    jax.config.update("jax_enable_x64", True)
    model = DiscreteModel(layout)
    advance, observe = jax.jacfwd(model.advance), jax.jacfwd(model.observe)

    def both(joint: Any, force: Any, kept: Any) -> tuple[Any, Any]:
        return advance(joint, force, layout.interval, kept), observe(joint, force)

    return jax.jit(jax.vmap(both, in_axes=(0, 0, None)))
