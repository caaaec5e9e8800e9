"""One pass of filter and smoother over the nodes of a problem, about given trajectories, several of them at once.

Transition and measurement are made affine about the trajectories by the rule of the method
(:mod:`methods.kalman.core`); a start of another record is a transition too. The smoother subtracts what the data tell
from what was believed before, so where the data tell much more than that its covariances lose digits; those of
constants are taken at the last node, where they are the filter's.

Arrays have a leading axis B, the trajectories that the maps are taken about; K nodes, joint states of size d, C
channels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from operator import itemgetter
from typing import Any

import numpy as np

from bench import SIGMA_FLOOR
from methods.kalman.core import Affine, Rule, Update, apply, backward, predict, update
from methods.kalman.joint import Joint, Nodes

LONG = 4000
"""Nodes from which on a recursion is compiled: that costs half a second, and saves 0.1 ms a node."""
BLOCK = 8192
"""Beliefs about which maps are taken at once: their points fit into memory, and nearly into the cache."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Smoothed means (B, K, d) and covariances (B, K, d, d), and the measurement maps that they were found with."""

    means: np.ndarray
    covariances: np.ndarray
    observed: Affine

    @property
    def finite(self) -> np.ndarray:
        """Which of the filters stayed finite, (B,)."""
        return np.all(np.isfinite(self.means), axis=(1, 2)) & np.all(np.isfinite(self.covariances), axis=(1, 2, 3))


def filtered(
    joint: Joint, nodes: Nodes, rule: Rule, sigma: np.ndarray, means: np.ndarray, covariances: np.ndarray
) -> Smoothed:
    """One pass forth and back at noise ``sigma`` (B, C), always from the belief before any sample.

    The affine maps are taken about ``means`` (B, K, d) and ``covariances`` (B, K, d, d).
    """
    before = np.maximum(np.arange(nodes.number) - 1, 0)
    transitions = _mapped(rule, nodes.advance, means[:, before], covariances[:, before])
    constants = joint.constants[: joint.log_walk.size]
    transitions.error[:, :, constants, constants] += joint.log_walk * nodes.durations[:, None, None]
    keep = np.diag((np.arange(joint.size) >= joint.states).astype(float))
    for record, first in zip(joint.model.problem.records, nodes.first_of, strict=True):  # a new motion, old constants
        mean, variances = joint.start(record)
        padding = np.zeros(joint.size - joint.states)
        transitions.slopes[first], transitions.constants[first] = keep, np.concatenate([mean, padding])
        transitions.error[first] = np.diag(np.concatenate([variances, padding]))
    observed = _mapped(rule, nodes.observe, means, covariances)
    variances = np.diagonal(observed.error, axis1=2, axis2=3) + sigma**2
    here = np.isfinite(nodes.values)
    inputs = (transitions, observed.slopes, observed.constants, variances, np.where(here, nodes.values, 0.0), here)
    mean, covariance = joint.first()
    belief = np.tile(mean, (len(sigma), 1)), np.tile(covariance, (len(sigma), 1, 1))
    updates = scan(_forth, belief, inputs)[1]
    nothing = np.zeros_like(belief[0]), np.zeros_like(belief[1])
    smoothed = scan(_back, nothing, (transitions.slopes, observed.slopes, updates), reverse=True)[1]
    ordered = [part.swapaxes(0, 1) for part in (*smoothed, *observed)]
    return Smoothed(ordered[0], ordered[1], Affine(*ordered[2:]))


def _forth(belief: Any, node: Any) -> tuple[Any, Update]:
    """From the belief after one node to that after the next."""
    transition, *measured = node
    updated = update(*predict(transition, *belief), *measured)
    return (updated.mean, updated.covariance), updated


def _back(adjoint: Any, node: Any) -> tuple[Any, Any]:
    """From what the nodes behind tell of one to what it and they tell of the one before; its smoothed belief."""
    (vector, weight), (transition, slopes, updated) = adjoint, node
    covariance = updated.covariance
    smoothed = updated.mean - apply(covariance, vector), covariance - covariance @ weight @ covariance
    vector, weight = backward(vector, weight, slopes, updated)
    back = transition.swapaxes(-1, -2)
    return (apply(back, vector), back @ weight @ transition), smoothed


def _mapped(rule: Rule, function: Callable[..., np.ndarray], means: np.ndarray, covariances: np.ndarray) -> Affine:
    """The affine maps about all beliefs (B, K, ...), node by node: (K, B, ...)."""
    count, number, d = means.shape
    nodes = np.repeat(np.arange(number), count)
    flat = means.swapaxes(0, 1).reshape(-1, d), covariances.swapaxes(0, 1).reshape(-1, d, d)
    blocks = [slice(first, first + BLOCK) for first in range(0, nodes.size, BLOCK)]
    parts = [rule(partial(function, nodes=nodes[block]), flat[0][block], flat[1][block]) for block in blocks]
    slopes, constants, error = map(np.concatenate, zip(*parts, strict=True))
    return Affine(*(part.reshape(number, count, *part.shape[1:]) for part in (slopes, constants, error)))


# --------------------------------------------------------------------------------------------------------- recursion


def scan(step: Callable[[Any, Any], tuple[Any, Any]], state: Any, inputs: Any, reverse: bool = False) -> Any:
    """Run a recursion over the leading axis of trees of arrays: its last state, and all outputs.

    A short one in numpy; a long one compiled by jax.
    """
    number = len(_leaves(inputs)[0])
    if number >= LONG:
        state, outputs = _compiled(step, reverse)(state, inputs)
        return _rebuilt(state, np.asarray), _rebuilt(outputs, np.asarray)
    rows: list[Any] = [None] * number
    for i in reversed(range(number)) if reverse else range(number):
        state, rows[i] = step(state, _rebuilt(inputs, itemgetter(i)))
    leaves = iter([np.stack(parts) for parts in zip(*map(_leaves, rows), strict=True)])
    return state, _rebuilt(rows[0], lambda _: next(leaves))


@lru_cache(maxsize=8)
def _compiled(step: Callable[[Any, Any], tuple[Any, Any]], reverse: bool) -> Callable[[Any, Any], Any]:
    import jax

    jax.config.update("jax_enable_x64", True)
    return jax.jit(lambda state, inputs: jax.lax.scan(step, state, inputs, reverse=reverse))  # type: ignore[no-any-return]


def _leaves(tree: Any) -> list[Any]:
    """The arrays of nested tuples, in order."""
    return [leaf for part in tree for leaf in _leaves(part)] if isinstance(tree, tuple) else [tree]


def _rebuilt(tree: Any, function: Callable[[Any], Any]) -> Any:
    """Nested tuples with each array replaced."""
    if not isinstance(tree, tuple):
        return function(tree)
    parts = [_rebuilt(part, function) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)


# ------------------------------------------------------------------------------------------------------------- noise


def noise(joint: Joint, nodes: Nodes, sigma: np.ndarray, passed: Smoothed) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviation of the noise by channel (B, C), and the degrees of freedom that the data spent (B,).

    ``sigma`` (B, C): the noise that the pass assumed.
    """
    slopes, constants, error = passed.observed
    left = nodes.values - apply(slopes, passed.means) - constants
    fitted = np.sum((slopes @ passed.covariances) * slopes, axis=-1) + np.diagonal(error, axis1=2, axis2=3)
    here = np.isfinite(nodes.values)
    counts = np.maximum(here.sum(axis=0), 1)
    used = np.clip(np.sum(np.where(here, fitted, 0.0), axis=1) / sigma**2, 0.0, counts - 0.5)
    rss = np.sum(np.where(here, left, 0.0) ** 2, axis=1)
    return np.maximum(np.sqrt(rss / (counts - used)), SIGMA_FLOOR * joint.model.rms), used.sum(axis=1)
