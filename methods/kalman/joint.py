"""State and parameters as one: the joint model of the Kalman filters, and the nodes through which it moves.

The joint state is displacements, velocities and hidden states, then the log-parameters, then the offsets of sensors.
Its motion is the system's residual and nothing else (:func:`bench.rk4_step`). The :class:`Nodes` are each time 0 and
each time of a sample, record after record, with the integration steps between them. Everything is in natural units
(:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench import (
    LOG_LIMIT,
    NoEstimate,
    OutputError,
    Record,
    Steps,
    System,
    acceleration,
    fastest_rates,
    nan_ops,
    rk4_step,
    simulate,
    step_counts,
)
from methods.kalman.starts import first_candidate

START = 3.0
"""Standard deviation of an untold start, in largest displacements of the data (and fastest rates)."""
DIFFERENCE = 1e-5
"""Step of the differences from which the fastest rate follows, over the size of the data."""
MAX_STEPS = 3000
"""Steps between two samples beyond which a motion counts as too fast to follow,"""
MOST_STEPS = 5_000_000
"""and steps over a record."""


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

    def theta(self, means: np.ndarray, nodes: Nodes) -> np.ndarray:
        """The model's vector at smoothed means (K, d): constants at the end, and the starts that were not told.

        The last mean is the filter's own; those before it, where constants are the same, are known less exactly.
        """
        k, n = len(self.model.free), self.model.system.n_dof
        starts = [means[nodes.first_of[i], : 2 * n] for i in self.model.unknown_starts]
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
class Nodes:
    """The nodes, record after record: each time 0 and each time of a sample, and the steps that lead to them.

    ``values`` (K, C): what each channel gave at a node, NaN where nothing; ``forces`` (K, n_dof) there.
    ``lengths`` (J,): all integration steps, none above ``longest``; ``pushes`` (J, 3, n_dof): forces at the start,
    middle and end of each; ``reached`` (K,): how many of them lead to a node. ``first_of``: the first node of each
    record.
    """

    joint: Joint
    values: np.ndarray
    forces: np.ndarray
    lengths: np.ndarray
    pushes: np.ndarray
    reached: np.ndarray
    first_of: tuple[int, ...]
    longest: float

    @staticmethod
    def of(joint: Joint, longest: float) -> Nodes:
        """With steps of at most ``longest``; raises NoEstimate where that takes too many."""
        model = joint.model
        n, values, forces, first_of = model.system.n_dof, list[np.ndarray](), list[np.ndarray](), list[int]()
        paths, reached = list[Steps](), list[np.ndarray]()
        for i, (record, times) in enumerate(zip(model.problem.records, _node_times(model), strict=True)):
            first_of.append(sum(map(len, values)))
            rows = np.full((times.size, len(model.channels)), np.nan)
            for j, (of, channel) in enumerate(model.channels):
                if of == i:
                    rows[np.searchsorted(times, channel.times), j] = channel.values
            values.append(rows)
            forces.append(np.stack(record.force(times, n), axis=1))
            grid = np.unique(np.concatenate([times, *[f.times[f.times <= times[-1]] for f in record.forces]]))
            counts = step_counts(grid, longest)
            upto = np.concatenate([[0], np.cumsum(counts)])[np.searchsorted(grid, times)]
            if np.max(np.diff(upto), initial=0) > MAX_STEPS + grid.size or upto[-1] > MOST_STEPS:
                raise NoEstimate(
                    "the motion came out far faster than the samples can show; give a prior nearer to the system"
                )
            reached.append(upto + sum(path.lengths.size for path in paths))
            paths.append(Steps.over(grid, counts, record.forces, n))
        lengths = np.concatenate([path.lengths for path in paths])
        pushes = np.concatenate([path.forces for path in paths])
        tables = np.concatenate(values), np.concatenate(forces), lengths, pushes, np.concatenate(reached)
        return Nodes(joint, *tables, tuple(first_of), longest)

    @property
    def number(self) -> int:
        return len(self.values)

    @cached_property
    def counts(self) -> np.ndarray:
        """How many steps lead to each node from the one before, (K,)."""
        return np.diff(self.reached, prepend=0)

    @cached_property
    def durations(self) -> np.ndarray:
        """The time from the node before to each, (K,); 0 where a record starts."""
        return np.diff(np.concatenate([[0.0], np.cumsum(self.lengths)])[self.reached], prepend=0.0)

    @cached_property
    def _rigs(self) -> tuple[tuple[System, ...], np.ndarray]:
        """The rigs that moved, and which of them each node belongs to, (K,)."""
        moved = [record.rig(self.joint.model.system) for record in self.joint.model.problem.records]
        rigs = tuple(dict.fromkeys(moved))
        lengths = np.diff([*self.first_of, self.number])
        return rigs, np.repeat([rigs.index(rig) for rig in moved], lengths)

    def _by_rig(self, of: OfRig, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """``of`` for each rig at its own nodes; they differ where masses were added in some records."""
        rigs, number = self._rigs
        mine = number[nodes]
        if np.all(mine == mine[0]):
            return of(rigs[mine[0]], points, nodes)
        parts = [(mine == i, rig) for i, rig in enumerate(rigs) if np.any(mine == i)]
        by_rig = [(which, of(rig, points[which], nodes[which])) for which, rig in parts]
        whole = np.empty((len(nodes), *by_rig[0][1].shape[1:]))
        for which, values in by_rig:
            whole[which] = values
        return whole

    def advance(self, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Joint states (L, S, d) carried to the nodes (L,) from the ones before them."""
        return self._by_rig(self._advanced, points, nodes)

    def _advanced(self, system: System, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        joint = self.joint
        p = joint.parameters(points)
        state = [points[..., i] for i in range(joint.states)]
        counts = self.counts[nodes]
        for j in range(int(np.max(counts, initial=0))):
            step = np.minimum(self.reached[nodes] - counts + j, self.lengths.size - 1)
            length = np.where(j < counts, self.lengths[step], 0.0)[:, None]  # no length: nothing moves any more
            f = [[self.pushes[step, part, i, None] for i in range(system.n_dof)] for part in range(3)]
            state = rk4_step(system, p, state, length, (f[0], f[1], f[2]), nan_ops)
        return np.concatenate([np.stack(state, axis=-1), points[..., joint.states :]], axis=-1)

    def trajectories(self, thetas: np.ndarray) -> np.ndarray:
        """The joint states (B, K, d) that the model's vectors (B, size) give at all nodes."""
        model = self.joint.model
        k, offsets = len(model.free), len(model.offset_channels)
        constants = np.concatenate([thetas[:, :k], thetas[:, thetas.shape[1] - offsets :]], axis=1)
        p, parts = model.parameters(thetas), list[np.ndarray]()
        for record, start, times in zip(model.problem.records, model.starts(thetas), _node_times(model), strict=True):
            motion = simulate(record.rig(model.system), p, start, times, record.forces)
            parts.append(np.concatenate([motion.displacement, motion.velocity, motion.hidden]))
        path = np.moveaxis(np.concatenate(parts, axis=-1), 0, -1)
        rest = np.broadcast_to(constants[:, None], (*path.shape[:2], constants.shape[1]))
        return np.concatenate([path, rest], axis=-1)

    def observe(self, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """What every channel would give, (L, S, C), at joint states (L, S, d) of the nodes (L,)."""
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


def _node_times(model: OutputError) -> list[np.ndarray]:
    """The times of each record's nodes: 0 and those of its samples."""
    return [np.unique(np.concatenate([[0.0], *[c.times for c in record.channels]])) for record in model.problem.records]
