"""Joint estimation of state and parameters by Kalman filters: what the extended and the unscented filter share.

**Joint state.** Displacements, velocities and hidden states, then the log-parameters, then the offsets of sensors:
constants that the measurements of the motion tell of, once the equation of motion carries the state from sample to
sample (R. E. Kopp, R. J. Orford, AIAA J. 1:2300, 1963). The equation is the system's residual and nothing else
(:func:`bench.rk4_step`), so any system, known force and irregular times are served alike. Several records are one
chain: between two of them the motion starts anew and the constants carry over.

**Filter and smoother.** Transition and measurement are replaced by affine maps with an error covariance, by the rule
that makes the filter: see :mod:`methods.kalman.ekf` and :mod:`methods.kalman.ukf`. Then the Kalman filter is exact:
prediction, innovation, update in Joseph's form, which keeps a covariance positive. The smoother is the modified
Bryson-Frazier one (G. J. Bierman, Int. J. Control 18:65, 1973): it inverts innovation covariances only, so a start
that is known exactly, a singular covariance, does no harm.

**Iteration.** With 25 samples one pass ends far from where it began, and its first updates were made at wrong
parameters. So the record is passed again, each time from the original belief, with the maps taken about the smoothed
trajectory of the pass before: the iterated extended Kalman smoother (B. M. Bell, SIAM J. Optimization 4:626, 1994),
which without process noise is a Gauss-Newton method for the most probable parameters, or its counterpart with sigma
points (A. F. Garcia-Fernandez, L. Svensson, S. Sarkka, IEEE Trans. Automatic Control 62:2056, 2017). Nothing is counted
twice, as it would be if a pass began at the end of the one before. ``passes=1`` is the plain filter.

**Noise.** Not told. The first pass is run at each of ``LEVELS`` and the one kept under which the innovations are most
likely. From then on each channel's variance is its residual sum of squares over N less the part of them that was
fitted, ``sum H P H' / R``: the fixed point of the EM step of R. H. Shumway, D. S. Stoffer (J. Time Series Analysis
3:253, 1982). Parameters are constants, so their process noise, ``drift``, is zero unless it is asked for.

**First belief.** Log-parameters: the prior. Without one: the best of :mod:`methods.starts.candidates`,
and ``open_sd`` about it; where nothing tells the scale the gauge mass is 1 and the answer is the groups. A start that
is not told: rest, with a standard deviation of ``START`` times the largest displacement (times the fastest rate for
velocities).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from bench import SIGMA_FLOOR, Cost, Estimate, InputError, NoEstimate, OutputError, Problem, estimate_at
from methods.kalman.joint import Chain, Joint, first_belief

LEVELS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Standard deviations of the noise tried in the first pass, over the root mean square of each channel."""
POOR = 0.5
"""A response that leaves more than this part of the mean square of the data is said to be poor."""


Map = Callable[[np.ndarray], np.ndarray]
"""Points (L, S, d) to values (L, S, m)."""
Affine = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Slopes (L, m, d), constants (L, m) and error covariance (L, m, m)."""
Rule = Callable[[Map, np.ndarray, np.ndarray], Affine]
"""How a map becomes affine about beliefs: means (L, d) and covariances (L, d, d)."""


@dataclass(frozen=True)
class Settings:
    """At most ``passes``, until the log-parameters move by less than ``tolerance`` of their standard deviations.

    ``drift``: standard deviation of the random walk of each log-parameter over the longest record. ``open_sd``: that
    of a log-parameter at first, where there is no prior.
    """

    passes: int
    tolerance: float
    drift: float
    open_sd: float

    def __post_init__(self) -> None:
        if self.passes < 1:
            raise InputError("method.passes", self.passes, "at least 1")
        if not (np.isfinite(self.drift) and self.drift >= 0):
            raise InputError("method.drift", self.drift, "a standard deviation, 0 for constant parameters")
        for name in ("tolerance", "open_sd"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"method.{name}", getattr(self, name), "a positive number")


def estimate(problem: Problem, rule: Rule, settings: Settings) -> Estimate:
    """Estimate parameters (or groups) by passes of the filter that ``rule`` makes; a problem in natural units."""
    model = OutputError(problem)
    joint = first_belief(model, settings.drift, settings.open_sd)
    chain = Chain.of(joint, float(np.exp(0.5 * joint.spread)))
    found = filtered(joint, chain, rule, np.array(LEVELS)[:, None] * model.rms)
    evaluations, settled = len(LEVELS), False
    for _done in range(1, settings.passes):
        theta = joint.theta(found.means, chain)
        sigma, _ = noise(joint, chain, found)
        chain = Chain.of(joint.at(theta), 1.0)
        last, found = found, filtered(joint, chain, rule, sigma[None], found)
        evaluations += 1
        shift, sd = found.means[0] - last.means[0], np.sqrt(np.diagonal(found.covariances[0]))
        moved = np.abs(shift[joint.constants]) / np.maximum(sd[joint.constants], 1e-12)
        settled = bool(np.max(moved) < settings.tolerance)
        if settled:
            break
    cost = Cost(evaluations * (2 * joint.size + 1), evaluations - len(LEVELS) + 1)
    sigma, used = noise(joint, chain, found)
    theta, k = joint.theta(found.means, chain), len(model.free)
    constants = joint.constants[:k]
    covariance = found.covariances[0][np.ix_(constants, constants)]
    settled = settled or settings.passes == 1
    left = float(np.mean(((model.data - model.predict(theta)) / model.rms[model.channel_of]) ** 2))
    if not (settled or left < POOR):
        lost = f"the filter lost the motion: its passes do not settle, and its response leaves {left:.0%} of the data"
        raise NoEstimate(lost, cost=cost)
    said = [] if left < POOR else [f"the response leaves {left:.0%} of the data's mean square: motion lost, or noise"]
    said += [] if settled else ["the passes had not settled: raise passes"]
    return estimate_at(model, theta, covariance, used, cost, "; ".join(said))


# ------------------------------------------------------------------------------------------ filter and smoother


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Smoothed means (K, d) and covariances (K, d, d), and the measurement maps that they were found with.

    ``sigma`` (C,): the noise assumed; ``likelihood``: log-likelihood of the innovations, up to a constant.
    """

    means: np.ndarray
    covariances: np.ndarray
    observed: Affine
    sigma: np.ndarray
    likelihood: float


@dataclass(frozen=True, eq=False)
class _Node:
    """What the smoother needs of a node; leading axis: the noise levels."""

    transition: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    slopes: np.ndarray
    gain: np.ndarray
    precision: np.ndarray
    innovation: np.ndarray


def filtered(joint: Joint, chain: Chain, rule: Rule, sigma: np.ndarray, around: Smoothed | None = None) -> Smoothed:
    """One pass forth and back at noise levels ``sigma`` (B, C), of which the most likely is kept.

    The affine maps are taken about the filter's own beliefs, or about those of an earlier pass, ``around``. Raises
    NoEstimate where the filter does not stay finite.
    """
    every, maps = np.arange(chain.nodes), None
    if around is not None:
        shifted = np.maximum(every - 1, 0)
        beliefs = around.means[shifted], around.covariances[shifted]
        maps = (
            rule(partial(chain.advance, nodes=every), *beliefs),
            rule(partial(chain.observe, nodes=every), around.means, around.covariances),
        )
    m, cov = joint.first()
    mean, covariance = np.tile(m, (len(sigma), 1)), np.tile(cov, (len(sigma), 1, 1))
    nodes, seen, likelihood = [], [], np.zeros(len(sigma))
    for k in range(chain.nodes):
        here = np.array([k])
        a = np.tile(np.eye(joint.size), (len(sigma), 1, 1))
        if k in chain.first_of[1:]:
            a, mean, covariance = _restart(joint, chain.first_of.index(k), mean, covariance)
        elif k:
            f = _at(maps[0], k) if maps else rule(partial(chain.advance, nodes=here), mean, covariance)
            a = np.broadcast_to(f[0], a.shape)
            mean = (a @ mean[..., None])[..., 0] + f[1]
            covariance = a @ covariance @ a.swapaxes(1, 2) + f[2]
            walk = joint.log_walk * float(chain.steps[k].sum())
            constants = joint.constants[: walk.size]
            covariance[:, constants, constants] += walk
        h = _at(maps[1], k) if maps else rule(partial(chain.observe, nodes=here), mean, covariance)
        seen.append(h)
        node, gained = _update(h, chain.values[k], chain.measured(k), sigma, a, mean, covariance)
        mean, covariance, likelihood = node.mean, node.covariance, likelihood + gained
        nodes.append(node)
    likelihood = np.where(np.isfinite(likelihood), likelihood, -np.inf)
    best = int(np.argmax(likelihood))
    if likelihood[best] == -np.inf:
        raise NoEstimate("the filter lost the motion: its state did not stay finite; give a prior nearer to the system")
    means, covariances = _smoothed(nodes, best)
    observed = tuple(
        np.stack([np.broadcast_to(h[i], (len(sigma), *h[i].shape[1:]))[best] for h in seen]) for i in range(3)
    )
    return Smoothed(means, covariances, (observed[0], observed[1], observed[2]), sigma[best], float(likelihood[best]))


def _at(maps: Affine, node: int) -> Affine:
    return maps[0][node : node + 1], maps[1][node : node + 1], maps[2][node : node + 1]


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


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """NaN where there is none: a level of the noise at which the filter is lost must not stop the others."""
    if np.all(np.isfinite(matrix)):
        try:
            return np.linalg.inv(matrix)
        except np.linalg.LinAlgError:
            pass
    return np.full_like(matrix, np.nan)


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
    levels, d = mean.shape
    slopes = np.broadcast_to(h[0][:, measured], (levels, measured.size, d))
    error = h[2][:, measured[:, None], measured] + np.eye(measured.size) * sigma[:, measured, None] ** 2
    innovation = values[measured] - (slopes @ mean[..., None])[..., 0] - h[1][:, measured]
    cross = covariance @ slopes.swapaxes(1, 2)
    total = slopes @ cross + error
    precision = np.stack([_inverse(t) for t in total])
    gain = cross @ precision
    mean = mean + (gain @ innovation[..., None])[..., 0]
    left = np.eye(d) - gain @ slopes
    covariance = left @ covariance @ left.swapaxes(1, 2) + gain @ error @ gain.swapaxes(1, 2)
    covariance = 0.5 * (covariance + covariance.swapaxes(1, 2))
    log_det = np.linalg.slogdet(np.where(np.isfinite(total), total, 1.0))[1]
    gained = -0.5 * (np.einsum("bi,bij,bj->b", innovation, precision, innovation) + log_det)
    return _Node(transition, mean, covariance, slopes, gain, precision, innovation), gained


def _smoothed(nodes: list[_Node], level: int) -> tuple[np.ndarray, np.ndarray]:
    """Means (K, d) and covariances (K, d, d) given all samples, by the adjoint vector and matrix of Bierman (1973)."""
    d = nodes[0].mean.shape[1]
    adjoint, weight = np.zeros(d), np.zeros((d, d))
    means, covariances = np.empty((len(nodes), d)), np.empty((len(nodes), d, d))
    for k in range(len(nodes) - 1, -1, -1):
        node = nodes[k]
        p = node.covariance[level]
        means[k] = node.mean[level] - p @ adjoint
        covariances[k] = p - p @ weight @ p
        h, precision = node.slopes[level], node.precision[level]
        left = np.eye(d) - node.gain[level] @ h
        adjoint = left.T @ adjoint - h.T @ precision @ node.innovation[level]
        weight = left.T @ weight @ left + h.T @ precision @ h
        a = node.transition[level]
        adjoint, weight = a.T @ adjoint, a.T @ weight @ a
    return means, 0.5 * (covariances + covariances.swapaxes(1, 2))


def noise(joint: Joint, chain: Chain, found: Smoothed) -> tuple[np.ndarray, float]:
    """Standard deviation of the noise by channel (C,), and the degrees of freedom that the data spent."""
    slopes, constants, error = found.observed
    left = chain.values - np.einsum("kcd,kd->kc", slopes, found.means) - constants
    fitted = np.einsum("kci,kij,kcj->kc", slopes, found.covariances, slopes) + np.diagonal(error, axis1=1, axis2=2)
    here = np.isfinite(chain.values)
    counts = np.maximum(here.sum(axis=0), 1)
    used = np.clip(np.sum(np.where(here, fitted, 0.0), axis=0) / found.sigma**2, 0.0, counts - 0.5)
    rss = np.sum(np.where(here, left, 0.0) ** 2, axis=0)
    return np.maximum(np.sqrt(rss / (counts - used)), SIGMA_FLOOR * joint.model.rms), float(used.sum())
