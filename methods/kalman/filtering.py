"""The Kalman filter and smoother of the joint state, about given trajectories, for several of them at once.

Transition and measurement are replaced by affine maps with an error covariance, by the rule that makes the filter: see
:mod:`methods.kalman.ekf` and :mod:`methods.kalman.ukf`. Then the Kalman filter is exact: prediction, innovation, update
in Joseph's form, which keeps a covariance positive. The smoother is the modified Bryson-Frazier one (G. J. Bierman,
Int. J. Control 18:65, 1973): it inverts innovation covariances only, so a start that is known exactly, a singular
covariance, does no harm. It subtracts what the data tell from what was believed before, so where the data tell much
more than that its covariances lose digits; those of constants are taken at the last node, where they are the filter's.

Arrays have a leading axis B, the trajectories that the maps are taken about; K nodes, joint states of size d, C
channels.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from bench import SIGMA_FLOOR
from methods.kalman.joint import Chain, Joint

Map = Callable[[np.ndarray], np.ndarray]
"""Points (L, S, d) to values (L, S, m)."""
Affine = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Slopes (..., m, d), constants (..., m) and error covariance (..., m, m)."""
Rule = Callable[[Map, np.ndarray, np.ndarray], Affine]
"""How a map becomes affine about beliefs: means (L, d) and covariances (L, d, d)."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Smoothed means (B, K, d) and covariances (B, K, d, d), and the measurement maps that they were found with.

    ``sigma`` (B, C): the noise assumed; ``likelihood`` (B,): log-likelihood of the innovations, up to a constant; minus
    infinity where the filter did not stay finite.
    """

    means: np.ndarray
    covariances: np.ndarray
    observed: Affine
    sigma: np.ndarray
    likelihood: np.ndarray


@dataclass(frozen=True, eq=False)
class _Node:
    """What the smoother needs of a node; leading axis B."""

    transition: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    slopes: np.ndarray
    gain: np.ndarray
    precision: np.ndarray
    innovation: np.ndarray


def filtered(
    joint: Joint, chain: Chain, rule: Rule, sigma: np.ndarray, means: np.ndarray, covariances: np.ndarray
) -> Smoothed:
    """One pass forth and back at noise ``sigma`` (B, C), always from the belief before any sample.

    The affine maps are taken about ``means`` (B, K, d) and ``covariances`` (B, K, d, d).
    """
    count, every = len(sigma), np.arange(chain.nodes)
    before = np.maximum(every - 1, 0)
    transitions = _mapped(rule, chain.advance, np.tile(every, count), means[:, before], covariances[:, before])
    observed = _mapped(rule, chain.observe, np.tile(every, count), means, covariances)
    m, cov = joint.first()
    mean, covariance = np.tile(m, (count, 1)), np.tile(cov, (count, 1, 1))
    nodes, likelihood = list[_Node](), np.zeros(count)
    for k in range(chain.nodes):
        a = np.tile(np.eye(joint.size), (count, 1, 1))
        if k in chain.first_of[1:]:
            a, mean, covariance = _restart(joint, chain.first_of.index(k), mean, covariance)
        elif k:
            a, shift, error = (part[:, k] for part in transitions)
            mean = (a @ mean[..., None])[..., 0] + shift
            covariance = a @ covariance @ a.swapaxes(1, 2) + error
            walk = joint.log_walk * float(chain.steps[k].sum())
            constants = joint.constants[: walk.size]
            covariance[:, constants, constants] += walk
        h = (observed[0][:, k], observed[1][:, k], observed[2][:, k])
        node, gained = _update(h, chain.values[k], chain.measured(k), sigma, a, mean, covariance)
        mean, covariance, likelihood = node.mean, node.covariance, likelihood + gained
        nodes.append(node)
    smoothed = _smoothed(nodes)
    finite = np.isfinite(likelihood) & np.all(np.isfinite(smoothed[0]), axis=(1, 2))
    return Smoothed(*smoothed, observed, sigma, np.where(finite, likelihood, -np.inf))


def _mapped(
    rule: Rule,
    function: Callable[..., np.ndarray],
    nodes: np.ndarray,
    means: np.ndarray,
    covariances: np.ndarray,
) -> Affine:
    """The affine maps about all beliefs, (B, K, ...)."""
    b, k, d = means.shape
    found = rule(partial(function, nodes=nodes), means.reshape(-1, d), covariances.reshape(-1, d, d))
    slopes, constants, error = (part.reshape(b, k, *part.shape[1:]) for part in found)
    return slopes, constants, error


def _restart(
    joint: Joint, record: int, mean: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Transition, mean and covariance at the start of another record: a new motion, the same constants."""
    keep = np.diag((np.arange(joint.size) >= joint.states).astype(float))
    start, variance = joint.start(joint.model.problem.records[record])
    padding = np.zeros(joint.size - joint.states)
    mean = mean @ keep + np.concatenate([start, padding])
    covariance = keep @ covariance @ keep + np.diag(np.concatenate([variance, padding]))
    return np.broadcast_to(keep, covariance.shape), mean, covariance


def _inverses(matrices: np.ndarray) -> np.ndarray:
    """NaN where there is none: a trajectory on which the filter is lost must not stop the others."""
    if matrices.shape[-1] == 1:
        return np.asarray(1.0 / matrices)
    found = np.full_like(matrices, np.nan)
    for i, matrix in enumerate(matrices):
        if np.all(np.isfinite(matrix)):
            with contextlib.suppress(np.linalg.LinAlgError):
                found[i] = np.linalg.inv(matrix)
    return found


def _update(
    h: Affine,
    values: np.ndarray,
    measured: np.ndarray,
    sigma: np.ndarray,
    transition: np.ndarray,
    mean: np.ndarray,
    covariance: np.ndarray,
) -> tuple[_Node, np.ndarray]:
    """The node after its samples, and the log-likelihood (B,) of their innovations."""
    d, slopes = mean.shape[1], h[0][:, measured]
    error = h[2][:, measured[:, None], measured] + np.eye(measured.size) * sigma[:, measured, None] ** 2
    innovation = values[measured] - (slopes @ mean[..., None])[..., 0] - h[1][:, measured]
    cross = covariance @ slopes.swapaxes(1, 2)
    total = slopes @ cross + error
    precision = _inverses(total)
    gain = cross @ precision
    mean = mean + (gain @ innovation[..., None])[..., 0]
    left = np.eye(d) - gain @ slopes
    covariance = left @ covariance @ left.swapaxes(1, 2) + gain @ error @ gain.swapaxes(1, 2)
    covariance = 0.5 * (covariance + covariance.swapaxes(1, 2))
    log_det = np.linalg.slogdet(np.where(np.isfinite(total), total, 1.0))[1]
    gained = -0.5 * (np.einsum("bi,bij,bj->b", innovation, precision, innovation) + log_det)
    return _Node(transition, mean, covariance, slopes, gain, precision, innovation), gained


def _smoothed(nodes: list[_Node]) -> tuple[np.ndarray, np.ndarray]:
    """Means (B, K, d) and covariances (B, K, d, d) given all samples, by the adjoint vector and matrix of Bierman."""
    count, d = nodes[0].mean.shape
    adjoint, weight = np.zeros((count, d, 1)), np.zeros((count, d, d))
    means, covariances = np.empty((count, len(nodes), d)), np.empty((count, len(nodes), d, d))
    for k in range(len(nodes) - 1, -1, -1):
        node = nodes[k]
        p = node.covariance
        means[:, k] = node.mean - (p @ adjoint)[..., 0]
        covariances[:, k] = p - p @ weight @ p
        towards = node.slopes.swapaxes(1, 2) @ node.precision
        left = (np.eye(d) - node.gain @ node.slopes).swapaxes(1, 2)
        adjoint = left @ adjoint - towards @ node.innovation[..., None]
        weight = left @ weight @ left.swapaxes(1, 2) + towards @ node.slopes
        back = node.transition.swapaxes(1, 2)
        adjoint, weight = back @ adjoint, back @ weight @ node.transition
    return means, 0.5 * (covariances + covariances.swapaxes(2, 3))


def noise(joint: Joint, chain: Chain, found: Smoothed) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviation of the noise by channel (B, C), and the degrees of freedom that the data spent (B,)."""
    slopes, constants, error = found.observed
    left = chain.values - np.einsum("bkcd,bkd->bkc", slopes, found.means) - constants
    fitted = np.einsum("bkci,bkij,bkcj->bkc", slopes, found.covariances, slopes) + np.diagonal(error, axis1=2, axis2=3)
    here = np.isfinite(chain.values)
    counts = np.maximum(here.sum(axis=0), 1)
    used = np.clip(np.sum(np.where(here, fitted, 0.0), axis=1) / found.sigma**2, 0.0, counts - 0.5)
    rss = np.sum(np.where(here, left, 0.0) ** 2, axis=1)
    return np.maximum(np.sqrt(rss / (counts - used)), SIGMA_FLOOR * joint.model.rms), used.sum(axis=1)
