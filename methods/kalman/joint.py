"""State and parameters as one: the joint model of the Kalman filters, and the nodes through which it moves.

The joint state is displacements, velocities and hidden states, then the log-parameters, then the offsets of sensors.
Its motion is the system's residual and nothing else (:func:`bench.rk4_step`). A :class:`Chain` holds the nodes, each
time 0 and each time of a sample, record after record, and the integration steps between them as one rectangular table,
so that many nodes are passed at once. Everything is in natural units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench import (
    LOG_LIMIT,
    InitialState,
    NoEstimate,
    OutputError,
    Record,
    System,
    acceleration,
    fastest_rates,
    nan_ops,
    rk4_step,
    step_counts,
)
from methods.kalman.starts import first_candidate

START = 3.0
"""Standard deviation of an untold start, in largest displacements of the data (and fastest rates)."""
DIFFERENCE = 1e-5
"""Step of the differences from which the fastest rate follows, over the size of the data."""
MAX_STEPS = 3000
"""Steps between two samples beyond which a motion counts as too fast to follow."""


OfRig = Callable[[System, np.ndarray, np.ndarray], np.ndarray]
"""A rig, joint states (L, S, d) and the nodes (L,) or (1,) they belong to, to values (L, S, ...)."""


@dataclass(frozen=True, eq=False)
class Joint:
    """The joint state ``[x, v, z, log-parameters, offsets]`` and the belief in it before any sample.

    ``logs`` and ``log_sds`` (k,): log-parameters at first; ``log_walk`` (k,): variance that they gain a unit of time.
    ``speed``: the rate (radians a unit of time) by which a velocity that is not told is thought to be larger than a
    displacement.
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

    @cached_property
    def constants(self) -> np.ndarray:
        """Where the constants stand in the joint state: log-parameters, then offsets."""
        return np.arange(self.states, self.size)

    def parameters(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters of joint states (..., d), each of shape (...)."""
        logs = points[..., self.states : self.states + len(self.model.free)]
        return self.model.parameters(np.clip(logs, -LOG_LIMIT, LOG_LIMIT))

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
        """The model's vector at smoothed means (K, d): constants at the end, and the starts that were not told.

        The last mean is the filter's own; those before it, where constants are the same, are known less exactly.
        """
        k, n = len(self.model.free), self.model.system.n_dof
        starts = [means[chain.first_of[i], : 2 * n] for i in self.model.unknown_starts]
        constants = means[-1, self.constants]
        return np.concatenate([np.clip(constants[:k], -LOG_LIMIT, LOG_LIMIT), *starts, constants[k:]])


def first_belief(model: OutputError, theta: np.ndarray, drift: float, open_sd: float) -> Joint:
    """The belief before any sample: the prior, or ``open_sd`` about the first of the candidates.

    ``theta``: the best start, whose fastest rate says how fast an untold start may be. ``drift``: standard deviation
    of the random walk of a log-parameter over a unit of time, the longest record.
    """
    k = len(model.free)
    if model.prior is not None:
        logs, sds = model.prior.log_mean, model.prior.log_sds
    else:
        nominal = first_candidate(model)
        logs, sds = np.log([nominal[name] for name in model.free]), np.full(k, open_sd)
    return Joint(model, logs, sds, np.full(k, drift**2), fastest_rate(model, theta[:k]))


def fastest_rate(model: OutputError, logs: np.ndarray) -> float:
    """Largest rate (radians a unit of time) of the equation of motion linearised at rest and at the data's size.

    Raises NoEstimate where it is not finite.
    """
    p, n, hidden = model.parameters(logs), model.system.n_dof, model.system.n_hidden

    def fastest(displacement: float, velocity: float) -> float:
        # hidden states are taken to be of a displacement's size
        state = np.repeat([displacement, velocity, displacement], [n, n, hidden])
        return float(np.max(fastest_rates(model.system, p, state, DIFFERENCE)))

    at_rest = fastest(0.0, 0.0)
    size = amplitude(model, at_rest)
    rate = fastest(size, size * at_rest)
    if not np.isfinite(rate):
        raise NoEstimate(
            "the parameters left the range in which the motion is finite; give a prior nearer to the system"
        )
    return rate


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


@dataclass(frozen=True, eq=False)
class Chain:
    """The nodes, record after record: each time 0 and each time of a sample, and the steps that lead to them.

    ``values`` (K, C): what each channel gave at a node, NaN where nothing; ``forces`` (K, n_dof) there.
    ``steps`` (K, J): integration steps from the node before, none above ``longest``, padded with steps of no length;
    ``pushes`` (K, J, 3, n_dof): forces at the start, middle and end of each. ``first_of``: the first node of each
    record.
    """

    joint: Joint
    values: np.ndarray
    forces: np.ndarray
    steps: np.ndarray
    pushes: np.ndarray
    first_of: tuple[int, ...]
    longest: float

    @staticmethod
    def of(joint: Joint, longest: float) -> Chain:
        """With steps of at most ``longest``; raises NoEstimate where that takes too many."""
        model = joint.model
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
        return Chain(joint, np.concatenate(values), np.concatenate(forces), steps, pushes, tuple(first_of), longest)

    @property
    def nodes(self) -> int:
        return len(self.values)

    def measured(self, node: int) -> np.ndarray:
        """The numbers of the channels that gave a value at a node."""
        return np.flatnonzero(np.isfinite(self.values[node]))

    @cached_property
    def _rigs(self) -> tuple[tuple[System, ...], np.ndarray]:
        """The rigs that moved, and which of them each node belongs to, (K,)."""
        moved = [record.rig(self.joint.model.system) for record in self.joint.model.problem.records]
        rigs = tuple(dict.fromkeys(moved))
        lengths = np.diff([*self.first_of, self.nodes])
        return rigs, np.repeat([rigs.index(rig) for rig in moved], lengths)

    def _by_rig(self, of: OfRig, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """``of`` for each rig at its own nodes; they differ where masses were added in some records."""
        rigs, number = self._rigs
        mine = number[nodes]
        if np.all(mine == mine[0]):
            return of(rigs[mine[0]], points, nodes)
        parts = [(mine == i, rig) for i, rig in enumerate(rigs) if np.any(mine == i)]
        found = [(which, of(rig, points[which], nodes[which])) for which, rig in parts]
        whole = np.empty((len(nodes), *found[0][1].shape[1:]))
        for which, own in found:
            whole[which] = own
        return whole

    def advance(self, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Joint states (L, S, d) carried to the nodes (L,) or (1,) from the ones before them."""
        return self._by_rig(self._advanced, points, nodes)

    def _advanced(self, system: System, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        joint = self.joint
        p = joint.parameters(points)
        state = [points[..., i] for i in range(joint.states)]
        steps, pushes = self.steps[nodes], self.pushes[nodes]
        for j in range(int(np.max(np.count_nonzero(steps, axis=1)))):
            f = [[pushes[:, j, part, i, None] for i in range(system.n_dof)] for part in range(3)]
            state = rk4_step(system, p, state, steps[:, j, None], (f[0], f[1], f[2]), nan_ops)
        return np.concatenate([np.stack(state, axis=-1), points[..., joint.states :]], axis=-1)

    def trajectories(self, thetas: np.ndarray) -> np.ndarray:
        """The joint states (B, K, d) that the model's vectors (B, size) give at all nodes."""
        joint, model = self.joint, self.joint.model
        k, offsets = len(model.free), len(model.offset_channels)
        constants = np.concatenate([thetas[:, :k], thetas[:, thetas.shape[1] - offsets :]], axis=1)
        path = np.empty((len(thetas), self.nodes, joint.size))
        first = dict(zip(self.first_of, model.starts(thetas), strict=True))
        for node in range(self.nodes):
            if node not in first:
                path[:, node] = self.advance(path[None, :, node - 1], np.array([node]))[0]
                continue
            start = first[node]
            x, v = (start.displacement, start.velocity) if isinstance(start, InitialState) else start
            at_rest = np.zeros((len(thetas), model.system.n_hidden))
            moving = np.broadcast_to(np.concatenate([x, v]).T, (len(thetas), 2 * model.system.n_dof))
            path[:, node] = np.concatenate([moving, at_rest, constants], axis=1)
        return path

    def observe(self, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """What every channel would give, (L, S, C), at joint states (L, S, d) of the nodes (L,) or (1,)."""
        return self._by_rig(self._observed, points, nodes)

    def _observed(self, system: System, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        joint = self.joint
        n, x = system.n_dof, [points[..., i] for i in range(joint.states)]
        seen = {"displacement": x[:n], "velocity": x[n : 2 * n]}
        if any(c.measures == "acceleration" for _, c in joint.model.channels):
            f = [self.forces[nodes, i][:, None] for i in range(n)]
            p = joint.parameters(points)
            seen["acceleration"] = list(acceleration(system, p, x[:n], x[n : 2 * n], f, x[2 * n :], nan_ops))
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
    counts = step_counts(grid, longest)
    if counts.sum() > MAX_STEPS + grid.size:
        raise NoEstimate("the motion came out far faster than the samples can show; give a prior nearer to the system")
    h = np.repeat(np.diff(grid) / counts, counts)
    at = start + np.concatenate([[0.0], np.cumsum(h)[:-1]])
    if any(force.degree > 1 for force in record.forces):
        return h, _curved(record, n, at, h)
    # inside a step a force is linear, so its ends follow from two inner points, whatever happens at the ends
    near, far = (np.stack(record.force(at + part * h, n), axis=1) for part in (0.25, 0.75))
    return h, np.stack([1.5 * near - 0.5 * far, 0.5 * (near + far), 1.5 * far - 0.5 * near], axis=1)


def _curved(record: Record, n: int, at: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Forces (J, 3, n_dof) at the start, middle and end of steps in which they are cubic, from four inner points."""
    inner = np.array([0.125, 0.375, 0.625, 0.875])
    seen = np.stack([np.stack(record.force(at + part * h, n), axis=1) for part in inner], axis=1)
    weights = np.vander([0.0, 0.5, 1.0], 4) @ np.linalg.inv(np.vander(inner, 4))
    return np.asarray(np.einsum("pi,jin->jpn", weights, seen))
