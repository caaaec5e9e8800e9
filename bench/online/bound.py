"""The posterior Cramér-Rao bound along a stream: the least error that a tracker can have of the log-parameters.

Motion, ambient force and log-parameters are one state with a prior and process noise; their bound is the inverse of the
information matrix that the recursion of P. Tichavský, C. H. Muravchik, A. Nehorai (IEEE Trans. Signal Processing
46:1386, 1998) carries from sample to sample. Its transition is singular where a force is held (the noise has fewer
dimensions than the motion), so it is written as the equivalent Riccati recursion, which inverts innovations only: time
update ``F P F' + Q``, measurement update ``P - P H' (H P H' + R)^-1 H P``, with F and H the derivatives at the truth.
Their expectation is over the streams: the variances are averaged over replicates.

The process noise of the log-parameters is that of a walk whose mean-square increments are those of the true course,
instant by instant: for a step, nothing but at its instant. So it is the bound of who knows when something may change
and by how much about, but not by how much: a tracker has to find out both. Levels of noise and of an ambient force, and
what it keeps of itself, are taken as known. No prior of the parameters, and a motion at first that nobody tells.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from bench.contract.online import Layout
from bench.dynamics.discrete_model import DiscreteModel
from bench.online.scenario import OnlineScenario, Stream

OPEN_LOG_SD = 3.0
"""Standard deviation of a log-parameter at first: a factor of 20."""
OPEN_MOTION = 10.0
"""Standard deviation of displacement and velocity at first, over their root mean squares."""


def bound_variances(scenario: OnlineScenario, stream: Stream) -> dict[str, np.ndarray]:
    """The bound on the variance of the logarithm of each quantity of the layout after each sample, each (n,)."""
    covariances = _covariances(scenario, stream)
    free = stream.layout.free
    weights = {quantity.name: np.array(quantity.vector(free)) for quantity in stream.layout.quantities}
    return {name: np.einsum("i,kij,j->k", w, covariances, w) for name, w in weights.items()}


def _covariances(scenario: OnlineScenario, stream: Stream) -> np.ndarray:
    """Covariances of the log-parameters after each sample, (n, n_free, n_free)."""
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
    kept = np.array([force.kept for force in scenario.forces if not force.told])
    level = np.array([force.amplitude for force in scenario.forces if not force.told]) * np.mean(scale)
    walk[:, model.ambient] = level**2 * (1.0 - kept**2)
    first = np.zeros(model.size)
    size = np.sqrt(np.mean(truth.motion**2, axis=0))
    first[: model.n_motion] = (OPEN_MOTION * np.maximum(size, 1e-12 * size.max())) ** 2
    first[model.ambient] = level**2
    first[model.logs] = OPEN_LOG_SD**2
    transitions, slopes = (np.asarray(part) for part in _slopes(layout)(joints, truth.told, kept))
    found = riccati(transitions, slopes, walk, np.diag(first), np.diag(truth.sigma**2))
    return found[:, model.logs, model.logs]


def _exponents(layout: Layout) -> np.ndarray:
    """Return the power of the gauge that makes each free parameter a ratio; 1 for those that scale with the mass.

    Raises ValueError for a system with a parameter that is not proportional to a mass.
    """
    groups = {name: group.exponents for group in layout.system.groups for name in group.exponents}
    if any(groups.get(name, {}).get(name) != 1.0 for name in layout.free):
        raise ValueError(f"{layout.system.name}: not every parameter stands in a group")
    return np.array([float(layout.system.gauge in groups[name]) for name in layout.free])


def riccati(
    transitions: np.ndarray, slopes: np.ndarray, walk: np.ndarray, first: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Covariances after each sample of a linear model, (n, d, d).

    Args:
        transitions: from each sample to the next, (n, d, d).
        slopes: of what is measured, (n, c, d).
        walk: variances of the process noise behind each sample, (n, d).
        first: covariance before the first sample, (d, d).
        noise: covariance of the measurements, (c, c).
    """
    covariance, found = first, np.empty((len(walk), *first.shape))
    for k, (f, h) in enumerate(zip(transitions, slopes, strict=True)):
        cross = covariance @ h.T
        gain = np.linalg.solve(h @ cross + noise, cross.T).T
        left = np.eye(len(first)) - gain @ h
        found[k] = left @ covariance @ left.T + gain @ noise @ gain.T
        covariance = f @ found[k] @ f.T + np.diag(walk[k])
    return found


@lru_cache(maxsize=32)
def _slopes(layout: Layout) -> Any:
    """(joint states, told forces, memory) -> transitions and slopes of what is measured, at every sample."""
    import jax

    jax.config.update("jax_enable_x64", True)
    model = DiscreteModel(layout)
    advance, observe = jax.jacfwd(model.advance), jax.jacfwd(model.observe)

    def both(joint: Any, force: Any, kept: Any) -> tuple[Any, Any]:
        return advance(joint, force, layout.interval, kept), observe(joint, force)

    return jax.jit(jax.vmap(both, in_axes=(0, 0, None)))
