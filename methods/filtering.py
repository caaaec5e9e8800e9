"""Joint estimation of state and parameters by Kalman filters: what the extended and the unscented filter share.

**Joint state.** Displacements, velocities and hidden states, then the log-parameters, then the offsets of sensors:
constants that the measurements of the motion tell of, once the equation of motion carries the state from sample to
sample (R. E. Kopp, R. J. Orford, AIAA J. 1:2300, 1963). The equation is the system's residual and nothing else
(:func:`bench.rk4_step`), so any system, known force and irregular times are served alike. Several records are one
chain: between two of them the motion starts anew and the constants carry over.

**Filter and smoother.** Transition and measurement are replaced by affine maps with an error covariance, by the rule
that makes the filter: see :mod:`methods.ekf` and :mod:`methods.ukf`. Then the Kalman filter is exact: prediction,
innovation, update in Joseph's form, which keeps a covariance positive. The smoother is the modified Bryson-Frazier one
(G. J. Bierman, Automatica 9:503, 1973): it inverts innovation covariances only, so a start that is known exactly, a
singular covariance, does no harm.

**Iteration.** With 25 samples one pass ends far from where it began, and its first updates were made at wrong
parameters. So the record is passed again, each time from the original belief, with the maps taken about the smoothed
trajectory of the pass before: the iterated extended Kalman smoother (B. M. Bell, SIAM J. Optimization 4:626, 1994),
which without process noise is a Gauss-Newton method for the most probable parameters, or its counterpart with sigma
points (A. F. Garcia-Fernandez, L. Svensson, S. Sarkka, IEEE Trans. Signal Processing 65:1437, 2017). Nothing is counted
twice, as it would be if a pass began at the end of the one before. ``passes=1`` is the plain filter.

**Noise.** Not told. The first pass is run at each of ``LEVELS`` and the one kept under which the innovations are most
likely. From then on each channel's variance is its residual sum of squares over N less the part of them that was
fitted, ``sum H P H' / R``: the fixed point of the EM step of R. H. Shumway, D. S. Stoffer (J. Time Series Analysis
3:253, 1982). Parameters are constants, so their process noise, ``drift``, is zero unless it is asked for.

**First belief.** Log-parameters: the prior. Without one: the best start of the scan of :mod:`methods.spectral`, and
``open_sd`` about it; in free vibration the gauge mass is then 1 and the answer is the groups. A start that is not told:
rest, with a standard deviation of ``START`` times the largest displacement (times the fastest rate for velocities).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from bench import (
    Cost,
    Estimate,
    InputError,
    Ops,
    Problem,
    Record,
    Serves,
    Status,
    acceleration,
    numpy_ops,
    rk4_step,
    state_rate,
)
from methods.spectral import LOG_LIMIT, SIGMA_FLOOR, OutputError, candidates, estimate_at, silent

LEVELS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Standard deviations of the noise tried in the first pass, over the root mean square of each channel."""
START = 3.0
"""Standard deviation of an untold start, in largest displacements of the data (and fastest rates)."""
STEP = 0.15
"""Integration step in radians of the fastest rate: the natural frequency is then off by 4 parts in a million."""
MAX_STEPS = 400
"""Steps between two samples beyond which a motion counts as too fast to follow."""
POOR = 0.5
"""A response that leaves more than this part of the mean square of the data is said to be poor."""

SERVES = Serves(
    measures=("displacement", "velocity", "acceleration"),
    several_records=True,
    several_channels=True,
    offsets=True,
    max_dof=None,
    hidden_states=True,
)


def _solve(matrix: Sequence[Sequence[Any]], rhs: Sequence[Any]) -> Sequence[Any]:
    """As that of ``numpy_ops``, but NaN at singular matrices: a point that ran away must not stop the others."""
    try:
        return numpy_ops.solve(matrix, rhs)
    except np.linalg.LinAlgError:
        n = len(rhs)
        entries = np.broadcast_arrays(*[entry for row in matrix for entry in row], *rhs)
        stacked = np.stack(entries[: n * n], -1).reshape(*entries[0].shape, n, n)
        good = np.abs(np.linalg.det(stacked)) > 0
        rows = [[np.where(good, entries[i * n + j], float(i == j)) for j in range(n)] for i in range(n)]
        return numpy_ops.solve(rows, [np.where(good, entry, np.nan) for entry in entries[n * n :]])


OPS = cast(Ops, SimpleNamespace(**{**vars(numpy_ops), "solve": _solve}))

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


def identify(problem: Problem, rule: Rule, settings: Settings) -> Estimate:
    """The smoothed belief about the parameters (or groups), by passes of the filter that ``rule`` makes."""
    units = problem.natural_units()
    scaled = problem.expressed_in(units)
    if silent(scaled):
        sentence = "no sensor shows any motion; check the wiring or choose another record"
        return Estimate.failed(problem.system, Status.DIVERGED, sentence)
    with np.errstate(all="ignore"):
        estimate = _passes(OutputError(scaled), rule, settings)
    return replace(estimate, offsets=problem.offsets_from(units, estimate.offsets)).expressed_in(units.inverse)


def _passes(model: OutputError, rule: Rule, settings: Settings) -> Estimate:
    joint = first_belief(model, settings)
    try:
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
    except _Lost as reason:
        return Estimate.failed(model.system, Status.DIVERGED, str(reason))
    cost = Cost(evaluations * (2 * joint.size + 1), evaluations - len(LEVELS) + 1)
    sigma, used = noise(joint, chain, found)
    theta, k = joint.theta(found.means, chain), len(model.free)
    constants = joint.constants[:k]
    covariance = found.covariances[0][np.ix_(constants, constants)]
    settled = settled or settings.passes == 1
    left = float(np.mean(((model.data - model.predict(theta)) / model.rms[model.channel_of]) ** 2))
    if not (settled or left < POOR):
        sentence = (
            f"the filter lost the motion: its passes do not settle, and its response leaves {left:.0%} of the data"
        )
        return Estimate.failed(model.system, Status.DIVERGED, sentence, cost)
    said = [] if left < POOR else [f"the response leaves {left:.0%} of the data's mean square: motion lost, or noise"]
    said += [] if settled else ["the passes had not settled: raise passes"]
    return estimate_at(model, theta, covariance, used, cost, "; ".join(said))


class _Lost(ArithmeticError):
    """The filter lost the motion; the message is the sentence of the Estimate."""


# ---------------------------------------------------------------------------------------------- the joint model


@dataclass(frozen=True, eq=False)
class Joint:
    """The joint state ``[x, v, z, log-parameters, offsets]`` and the belief in it before any sample.

    ``logs`` and ``log_sds`` (k,): log-parameters at first; ``log_walk`` (k,): variance that they gain a unit of time.
    ``speed``: the fastest rate (radians a unit of time) at them.
    """

    model: OutputError
    logs: np.ndarray
    log_sds: np.ndarray
    log_walk: np.ndarray
    speed: float

    @property
    def states(self) -> int:
        return 2 * self.model.system.n_dof + self.model.system.n_hidden

    @property
    def size(self) -> int:
        return self.states + len(self.model.free) + len(self.model.offset_channels)

    @property
    def spread(self) -> float:
        """Width of the belief about the fastest stiffness: how much faster the motion may come out."""
        return float(np.max(self.log_sds, initial=0.0))

    @cached_property
    def constants(self) -> np.ndarray:
        """Where the constants stand in the joint state: log-parameters, then offsets."""
        return np.arange(self.states, self.size)

    def parameters(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters of joint states (..., d), each of shape (...)."""
        logs = points[..., self.states : self.states + len(self.model.free)]
        return self.model.parameters(np.clip(logs, -LOG_LIMIT, LOG_LIMIT))

    def at(self, theta: np.ndarray) -> Joint:
        """The same, with its rate taken at ``theta``; raises _Lost where that is not finite."""
        logs = theta[: self.logs.size]
        return replace(self, speed=fastest_rate(self.model, logs))

    def start(self, record: Record) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variances of the motion ``[x, v, z]`` at time 0 of a record; hidden states start at zero."""
        n, mean, variance = self.model.system.n_dof, np.zeros(self.states), np.zeros(self.states)
        if record.initial_state is not None:
            mean[:n], mean[n : 2 * n] = record.initial_state.displacement, record.initial_state.velocity
        else:
            sd = START * amplitude(self.model, self.speed)
            variance[:n], variance[n : 2 * n] = sd**2, (sd * self.speed) ** 2
        return mean, variance

    def first(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance before the first sample of the first record."""
        mean, variance = self.start(self.model.problem.records[0])
        offsets = np.array([self.model.rms[i] for i in self.model.offset_channels])
        all_variances = np.concatenate([variance, self.log_sds**2, (START * offsets) ** 2])
        return np.concatenate([mean, self.logs, np.zeros(offsets.size)]), np.diag(all_variances)

    def theta(self, means: np.ndarray, chain: Chain) -> np.ndarray:
        """The model's vector at smoothed means (K, d): constants and the starts that were not told."""
        k, n = len(self.model.free), self.model.system.n_dof
        starts = [means[chain.first_of[i], : 2 * n] for i in self.model.unknown_starts]
        constants = means[0, self.constants]
        return np.concatenate([np.clip(constants[:k], -LOG_LIMIT, LOG_LIMIT), *starts, constants[k:]])


def first_belief(model: OutputError, settings: Settings) -> Joint:
    """The belief before any sample: the prior, or the best start of the data's scan."""
    k = len(model.free)
    if model.prior is not None:
        logs, sds = model.prior.log_mean, model.prior.log_sds
    else:
        starts = [model.vector(p) for p in candidates(model, 3)]
        logs, sds = min(starts, key=model.profile)[:k], np.full(k, settings.open_sd)
    return Joint(model, logs, sds, np.full(k, settings.drift**2), fastest_rate(model, logs))


def fastest_rate(model: OutputError, logs: np.ndarray) -> float:
    """Largest rate (radians a unit of time) of the equation of motion linearised at rest and at the data's size.

    Raises _Lost where it is not finite.
    """
    slow = _rate(model, logs, 0.0, 0.0)
    size = amplitude(model, slow)
    return max(slow, _rate(model, logs, size, size * slow))


def amplitude(model: OutputError, rate: float) -> float:
    """The largest displacement that the sensors show, velocities over the rate and accelerations over its square."""
    order = {"displacement": 0, "velocity": 1, "acceleration": 2}
    least = min(order[c.measures] for _, c in model.channels)
    sizes = [
        float(np.max(np.abs(c.values - c.offset * np.median(c.values)))) / max(rate, 1.0) ** least
        for _, c in model.channels
        if order[c.measures] == least and c.n
    ]
    return max(sizes, default=0.0) or 1.0


def _rate(model: OutputError, logs: np.ndarray, displacement: float, velocity: float) -> float:
    """The largest rate about one state; hidden states are taken to be of a displacement's size."""
    system = model.system
    p = {name: float(value) for name, value in model.parameters(logs).items()}
    n, d = system.n_dof, 2 * system.n_dof + system.n_hidden
    level = np.array([displacement] * n + [velocity] * n + [displacement] * system.n_hidden)
    # as many states as there are coordinates, each moved in one of them, to both sides
    state = level[:, None] + 1e-5 * np.concatenate([np.eye(d), -np.eye(d)], axis=1)
    rates = state_rate(system, p, list(state), [0.0] * n, OPS)
    rows = np.stack([np.broadcast_to(rate, (2 * d,)) for rate in rates])
    slopes = (rows[:, :d] - rows[:, d:]) / 2e-5
    if not np.all(np.isfinite(slopes)):
        raise _Lost("the parameters left the range in which the motion is finite; give a prior nearer to the system")
    return float(np.max(np.abs(np.linalg.eigvals(slopes))))


@dataclass(frozen=True, eq=False)
class Chain:
    """The nodes, record after record: each time 0 and each time of a sample, and the steps that lead to them.

    ``values`` (K, C): what each channel gave at a node, NaN where nothing; ``forces`` (K, n_dof) there.
    ``steps`` (K, J): integration steps from the node before, padded with steps of no length; ``pushes``
    (K, J, 3, n_dof): forces at the start, middle and end of each. ``first_of``: the first node of each record.
    """

    joint: Joint
    values: np.ndarray
    forces: np.ndarray
    steps: np.ndarray
    pushes: np.ndarray
    first_of: tuple[int, ...]

    @staticmethod
    def of(joint: Joint, margin: float) -> Chain:
        """With steps that resolve ``margin`` times the fastest rate; raises _Lost where that takes too many."""
        model, longest = joint.model, STEP / max(margin * joint.speed, 1e-9)
        n, values, forces, first_of = model.system.n_dof, [], [], []
        pieces: list[tuple[np.ndarray, np.ndarray]] = []
        for i, record in enumerate(model.problem.records):
            times = np.unique(np.concatenate([[0.0], *[c.times for c in record.channels]]))
            first_of.append(len(pieces))
            rows = np.full((times.size, len(model.channels)), np.nan)
            for j, (of, channel) in enumerate(model.channels):
                if of == i:
                    rows[np.searchsorted(times, channel.times), j] = channel.values
            values.append(rows)
            forces.append(np.stack(record.force(times, n), axis=1))
            pieces.append((np.zeros(0), np.zeros((0, 3, n))))
            pieces += [_steps(record, n, a, b, longest) for a, b in itertools.pairwise(times)]
        most = max(len(h) for h, _ in pieces)
        steps, pushes = np.zeros((len(pieces), most)), np.zeros((len(pieces), most, 3, n))
        for row, (h, push) in enumerate(pieces):
            steps[row, : h.size], pushes[row, : h.size] = h, push
        return Chain(joint, np.concatenate(values), np.concatenate(forces), steps, pushes, tuple(first_of))

    @property
    def nodes(self) -> int:
        return len(self.values)

    def measured(self, node: int) -> np.ndarray:
        """The numbers of the channels that gave a value at a node."""
        return np.flatnonzero(np.isfinite(self.values[node]))

    def advance(self, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Joint states (L, S, d) carried to the nodes (L,) or (1,) from the ones before them."""
        joint, system = self.joint, self.joint.model.system
        p = joint.parameters(points)
        state = [points[..., i] for i in range(joint.states)]
        steps, pushes = self.steps[nodes], self.pushes[nodes]
        for j in range(int(np.max(np.count_nonzero(steps, axis=1)))):
            f = [[pushes[:, j, part, i, None] for i in range(system.n_dof)] for part in range(3)]
            state = rk4_step(system, p, state, steps[:, j, None], (f[0], f[1], f[2]), OPS)
        return np.concatenate([np.stack(state, axis=-1), points[..., joint.states :]], axis=-1)

    def observe(self, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """What every channel would give, (L, S, C), at joint states (L, S, d) of the nodes (L,) or (1,)."""
        joint, system = self.joint, self.joint.model.system
        n, x = system.n_dof, [points[..., i] for i in range(joint.states)]
        seen = {"displacement": x[:n], "velocity": x[n : 2 * n]}
        if any(c.measures == "acceleration" for _, c in joint.model.channels):
            f = [self.forces[nodes, i][:, None] for i in range(n)]
            p = joint.parameters(points)
            seen["acceleration"] = list(acceleration(system, p, x[:n], x[n : 2 * n], f, x[2 * n :], OPS))
        offsets = dict(zip(joint.model.offset_channels, joint.constants[len(joint.model.free) :], strict=True))
        rows = [
            seen[c.measures][c.dof] + (points[..., offsets[i]] if i in offsets else 0.0)
            for i, (_, c) in enumerate(joint.model.channels)
        ]
        return np.stack(rows, axis=-1)


def _steps(record: Record, n: int, start: float, end: float, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Steps (J,) from a time to another, none across a sample of a force, and forces (J, 3, n_dof) along each."""
    knots = [f.times[(f.times > start) & (f.times < end)] for f in record.forces]
    grid = np.unique(np.concatenate([[start, end], *knots]))
    counts = np.maximum(1, np.ceil(np.diff(grid) / longest)).astype(int)
    if counts.sum() > MAX_STEPS + grid.size:
        raise _Lost("the motion came out far faster than the samples can show; give a prior nearer to the system")
    h = np.repeat(np.diff(grid) / counts, counts)
    at = start + np.concatenate([[0.0], np.cumsum(h)[:-1]])
    # inside a step a force is linear, so its ends follow from two inner points, whatever happens at the ends
    near, far = (np.stack(record.force(at + part * h, n), axis=1) for part in (0.25, 0.75))
    return h, np.stack([1.5 * near - 0.5 * far, 0.5 * (near + far), 1.5 * far - 0.5 * near], axis=1)


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
    _Lost where the filter does not stay finite.
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
        raise _Lost("the filter lost the motion: its state did not stay finite; give a prior nearer to the system")
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
    if not np.all(np.isfinite(total)):
        # a level that is lost must not stop the others
        lost = ~np.all(np.isfinite(total), axis=(1, 2))
        total = np.where(lost[:, None, None], np.nan, total)
    precision = np.stack([np.linalg.inv(t) if np.all(np.isfinite(t)) else np.full_like(t, np.nan) for t in total])
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
