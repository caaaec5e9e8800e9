"""One pass of filter and smoother over the nodes of a problem, linearised about several trajectories at once.

The map of a node (measurements, and state at its end) is linearised about each trajectory by the rule of the method
(:mod:`methods.kalman.core`); the change to another record is a transition too. The many rows of a node with several
times are replaced by their triangular factor, which has the same normal equations (G. J. Bierman, Factorization Methods
for Discrete Sequential Estimation, 1977). The smoother subtracts information from the prior covariance, which loses
digits where the data are much more informative than the prior; constants are therefore taken from the last node, where
the filter's covariance holds.

Arrays have a leading axis B, the trajectories of linearisation; K nodes, joint states of size d, C channels, n times
per node.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from bench import SIGMA_FLOOR, System
from methods.kalman.core import Affine, Rule, Update, apply, backward, error, predict, update
from methods.kalman.joint import Joint, Nodes

ENTRIES = 2**23
"""Largest number of array entries of motions in memory: 64 MB."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Smoothed means (B, K, d) and covariances (B, K, d, d), and the noise estimated from the residuals.

    ``sigma`` (B, C): standard deviation of the noise; ``used`` (B,): degrees of freedom used by the data.
    """

    means: np.ndarray
    covariances: np.ndarray
    sigma: np.ndarray
    used: np.ndarray


def smooth(joint: Joint, nodes: Nodes, rule: Rule, sigma: np.ndarray, about: np.ndarray, width: np.ndarray) -> Smoothed:
    """Filter and smooth at noise ``sigma`` (B, C) from the prior.

    The maps are linearised about the means ``about`` (B, K, d) and the covariances ``width`` (B, K, d, d).
    """
    values = nodes.readings
    whole, c = _linearised(joint, nodes, rule, about, width), values.shape[1]
    observed = Affine(whole.slopes[:, :, :c], whole.constants[:, :, :c], whole.scatter[..., :c])
    transitions = Affine(whole.slopes[:, :, c:], whole.constants[:, :, c:], whole.scatter[..., c:])
    walk = np.zeros((len(values), joint.size))
    walk[:, joint.log_places] = joint.log_walk * nodes.durations[:, None]
    for record, first in zip(joint.model.problem.records[1:], nodes.firsts[1:], strict=True):
        mean, variances = joint.start(record)  # a new motion, old constants
        transitions.slopes[first - 1] = np.diag((np.arange(joint.size) >= joint.states).astype(float))
        transitions.constants[first - 1], transitions.scatter[first - 1] = 0.0, 0.0
        transitions.constants[first - 1, :, : joint.states] = mean
        walk[first - 1], walk[first - 1, : joint.states] = 0.0, variances
    errors = np.sum(observed.scatter**2, axis=-2)
    noise = np.tile(sigma**2, c // sigma.shape[1])
    measured = _measurements(observed, errors + noise, values)
    mean, covariance = joint.first()
    distribution = np.tile(mean, (len(sigma), 1)), np.tile(covariance, (len(sigma), 1, 1))
    updates, moves = list[Update](), (transitions.slopes, transitions.constants, error(transitions, walk[:, None]))
    for row, move in zip(zip(*measured, strict=True), zip(*moves, strict=True), strict=True):
        updates.append(update(*distribution, *row))
        distribution = predict(*move, *updates[-1][:2])
    means, covariances = _smoothed(updates, transitions.slopes, measured[0])
    here = np.isfinite(values)[:, None]
    left = np.where(here, values[:, None] - apply(observed.slopes, means) - observed.constants, 0.0)
    fitted = np.where(here, np.sum((observed.slopes @ covariances) * observed.slopes, axis=-1) + errors, 0.0)
    counts = np.maximum(joint.model.counts, 1)
    used = np.clip(_by_channel(fitted, sigma) / sigma**2, 0.0, counts - 0.5)
    new = np.sqrt(_by_channel(left**2, sigma) / (counts - used))
    floor = SIGMA_FLOOR * joint.model.rms
    return Smoothed(means.swapaxes(0, 1), covariances.swapaxes(0, 1), np.maximum(new, floor), used.sum(axis=1))


def _linearised(joint: Joint, nodes: Nodes, rule: Rule, means: np.ndarray, covariances: np.ndarray) -> Affine:
    """Return the affine maps of all nodes about all trajectories, (K, B, ...); computed in blocks."""
    count, number, d = means.shape
    maps: list[np.ndarray] = []
    for rig, places in joint.nodes_by_rig(nodes):
        size = max(1, ENTRIES // (count * joint.states * (2 * d + 1) * nodes.samples.shape[1]))
        for block in np.array_split(places, -(-places.size // size)):
            follow = partial(_followed, joint=joint, nodes=nodes, which=np.tile(block, count), rig=rig)
            affine = rule(follow, means[:, block].reshape(-1, d), covariances[:, block].reshape(-1, d, d))
            parts = [part.reshape(count, block.size, *part.shape[1:]).swapaxes(0, 1) for part in affine]
            maps = maps or [np.empty((number, *part.shape[1:])) for part in parts]
            for whole, part in zip(maps, parts, strict=True):
                whole[block] = part
    return Affine(*maps)


def _followed(points: np.ndarray, joint: Joint, nodes: Nodes, which: np.ndarray, rig: System) -> np.ndarray:
    return joint.follow(points, nodes, which, rig)


def _measurements(observed: Affine, variances: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the measurements for :func:`methods.kalman.core.update`, with no more rows than unknowns."""
    here, d = np.isfinite(values), observed.slopes.shape[-1]
    values = np.where(here, values, 0.0)[:, None]
    if values.shape[-1] <= d:
        used = np.broadcast_to(here[:, None], variances.shape)
        return observed.slopes, observed.constants, variances, np.broadcast_to(values, variances.shape), used
    rows = np.concatenate([observed.slopes, (values - observed.constants)[..., None]], axis=-1)
    rows = np.where(here[:, None, :, None], rows / np.sqrt(variances)[..., None], 0.0)
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))[..., :d, :]
    nothing = np.zeros(triangle.shape[:-1])
    return triangle[..., :d], nothing, nothing + 1.0, triangle[..., d], nothing == 0.0


def _smoothed(updates: list[Update], transitions: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return smoothed means (K, B, d) and covariances (K, B, d, d), computed from the last node back."""
    means, covariances = (np.stack([updated[i] for updated in updates]) for i in range(2))
    vector, weight = np.zeros_like(means[0]), np.zeros_like(covariances[0])
    for k in reversed(range(len(updates))):
        means[k] -= apply(covariances[k], vector)
        covariances[k] -= covariances[k] @ weight @ covariances[k]
        vector, weight = backward(vector, weight, slopes[k], updates[k])
        if k:
            back = transitions[k - 1].swapaxes(-1, -2)
            vector, weight = apply(back, vector), back @ weight @ transitions[k - 1]
    return means, covariances


def _by_channel(rows: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return the sums of numbers (K, B, n C) over all nodes and their times, (B, C)."""
    return np.asarray(rows.reshape(len(rows), *sigma.shape[:1], -1, sigma.shape[1]).sum(axis=(0, 2)))
