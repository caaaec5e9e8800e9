"""State and parameters as one: the joint model of the Kalman filters, and the nodes through which it moves.

The joint state is displacements, velocities and hidden states, then the log-parameters, then the offsets of sensors.
Its motion is the system's residual and nothing else (:func:`bench.rk4_step`). :class:`Nodes` are the times at which
the state is estimated, and the integration steps between them. Everything is in natural units
(:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

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
    numpy_ops,
    rk4_step,
    simulate,
    step_counts,
)

START = 3.0
"""Standard deviation of an unknown initial state, in largest displacements of the data (and fastest rates)."""
DIFFERENCE = 1e-5
"""Step of the differences from which the fastest rate follows, over the size of the data."""
MAX_STEPS = 3000
"""Steps between two samples beyond which a motion counts as too fast to follow,"""
MOST_STEPS = 5_000_000
"""and steps over a record."""
LONG = 1000
"""Times of a record above which a node has the samples of several,"""
NODES = 250
"""so that the record has about as many nodes."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """The nodes of all records, one record behind the other, each with the samples from it to the next.

    The times are, record by record, 0 and those of its samples; a node stands at each, or at every so many of a long
    record. T times, J integration steps, K nodes with n times each at most, C channels.

    ``values`` (T, C): what each channel gave, NaN where nothing; ``forces`` (T, n_dof). ``lengths`` (J,): steps,
    none above ``longest``; ``pushes`` (J, 3, n_dof): forces at the start, middle and end of each; ``reached`` (T,): how
    many of them lead to a time. ``bounds`` (records + 1,): the first time of each record, and T. ``samples`` (K, n):
    the times of a node, the last one repeated; ``there`` (K, n): which count; ``ends`` (K,): steps that lead to the
    end of a node; ``records`` (K,): its record.
    """

    values: np.ndarray
    forces: np.ndarray
    lengths: np.ndarray
    pushes: np.ndarray
    reached: np.ndarray
    bounds: np.ndarray
    samples: np.ndarray
    there: np.ndarray
    ends: np.ndarray
    records: np.ndarray
    longest: float

    @staticmethod
    def of(model: OutputError, longest: float) -> Nodes:
        """Place the nodes, with steps of at most ``longest``; raises NoEstimate where that takes too many."""
        n, values, forces = model.system.n_dof, list[np.ndarray](), list[np.ndarray]()
        paths, reached = list[Steps](), list[np.ndarray]()
        for i, (record, times) in enumerate(zip(model.problem.records, node_times(model), strict=True)):
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
        bounds = np.cumsum([0, *map(len, values)])
        most = int(np.max(np.diff(bounds)))
        each = most // NODES if most > LONG else 1
        firsts = [np.arange(first, last, each) for first, last in itertools.pairwise(bounds)]
        records = np.repeat(np.arange(len(firsts)), [len(part) for part in firsts])
        wanted = np.concatenate(firsts)[:, None] + np.arange(each + 1)
        samples = np.minimum(wanted, bounds[records + 1][:, None] - 1)
        steps = np.concatenate(reached)
        return Nodes(
            np.concatenate(values),
            np.concatenate(forces),
            np.concatenate([path.lengths for path in paths]),
            np.concatenate([path.forces for path in paths]),
            steps,
            bounds,
            samples[:, :-1],
            (samples == wanted)[:, :-1],
            steps[samples[:, -1]],
            records,
            longest,
        )

    @property
    def readings(self) -> np.ndarray:
        """Return the values of each channel at the times of each node, (K, n C); NaN where there is none."""
        return np.where(self.there[..., None], self.values[self.samples], np.nan).reshape(len(self.samples), -1)

    @property
    def durations(self) -> np.ndarray:
        """The time from each node to its end, (K,)."""
        upto = np.concatenate([[0.0], np.cumsum(self.lengths)])
        return np.asarray(upto[self.ends] - upto[self.reached[self.samples[:, 0]]])

    @property
    def firsts(self) -> np.ndarray:
        """The first node of each record."""
        return np.searchsorted(self.records, np.arange(self.records[-1] + 1))


@dataclass(frozen=True, eq=False)
class Joint:
    """The joint state ``[x, v, z, log-parameters, offsets]`` and the distribution in it before any sample.

    ``logs`` and ``log_sds`` (k,): log-parameters at first; ``log_walk``: variance that they gain a unit of time.
    ``speed``: the rate (radians a unit of time) by which an unknown velocity is thought to be larger than a
    displacement.
    """

    model: OutputError
    logs: np.ndarray
    log_sds: np.ndarray
    log_walk: float
    speed: float

    @property
    def states(self) -> int:
        return 2 * self.model.system.n_dof + self.model.system.n_hidden

    @property
    def size(self) -> int:
        return self.states + len(self.model.free) + len(self.model.offset_channels)

    @property
    def log_places(self) -> slice:
        """Where the log-parameters stand; the offsets come behind them."""
        return slice(self.states, self.states + len(self.model.free))

    def parameters(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters of joint states (..., d), each of shape (...)."""
        return self.model.parameters(np.clip(points[..., self.log_places], -LOG_LIMIT, LOG_LIMIT))

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
        """The model's vectors (B, size) at smoothed means (B, K, d): constants at the end, and unknown initial states.

        The last mean is the filter's own; those before it, where constants are the same, are known less exactly.
        """
        n, at = self.model.system.n_dof, self.log_places
        starts = [means[:, nodes.firsts[i], : 2 * n] for i in self.model.unknown_starts]
        logs, offsets = means[:, -1, at], means[:, -1, at.stop :]
        return np.concatenate([np.clip(logs, -LOG_LIMIT, LOG_LIMIT), *starts, offsets], axis=1)

    def trajectories(self, thetas: np.ndarray, nodes: Nodes) -> np.ndarray:
        """The joint states (B, K, d) that the model's vectors (B, size) give at the nodes."""
        model, parts, p = self.model, list[np.ndarray](), self.model.parameters(thetas)
        k, offsets = len(model.free), len(model.offset_channels)
        constants = np.concatenate([thetas[:, :k], thetas[:, thetas.shape[1] - offsets :]], axis=1)
        times = np.concatenate(node_times(model))
        for i, (record, start) in enumerate(zip(model.problem.records, model.starts(thetas), strict=True)):
            wanted = times[nodes.samples[nodes.records == i, 0]]
            motion = simulate(record.rig(model.system), p, start, wanted, record.forces)
            parts.append(np.concatenate([motion.displacement, motion.velocity, motion.hidden]))
        path = np.moveaxis(np.concatenate(parts, axis=-1), 0, -1)
        rest = np.broadcast_to(constants[:, None], (*path.shape[:2], constants.shape[1]))
        return np.concatenate([path, rest], axis=-1)

    def follow(self, points: np.ndarray, nodes: Nodes, which: np.ndarray, rig: System) -> np.ndarray:
        """Carry joint states (L, S, d) from nodes (L,) to their ends, at which another node may stand.

        Returns:
            What the channels give at the times of the node, then the joint state at its end, (L, S, n C + d).
        """
        p, first = self.parameters(points), nodes.reached[nodes.samples[which, 0]]
        state, steps = [points[..., i] for i in range(self.states)], nodes.ends[which] - first
        due = nodes.reached[nodes.samples[which]] - first[:, None]
        path = np.empty((self.states, *points.shape[:2], due.shape[1]))
        wanted, most = set(due.ravel().tolist()), int(np.max(steps, initial=0))
        for j in range(most + 1):
            if j in wanted:
                place, sample = np.nonzero(due == j)
                path[:, place, :, sample] = np.moveaxis(np.array(state)[:, place], 0, 1)
            if j == most:
                break
            step = np.minimum(first + j, nodes.lengths.size - 1)
            length = np.where(j < steps, nodes.lengths[step], 0.0)[:, None]  # no length: nothing moves any more
            start, middle, end = ([nodes.pushes[step, k, i, None] for i in range(rig.n_dof)] for k in range(3))
            state = rk4_step(rig, p, state, length, (start, middle, end), numpy_ops)
        readings = self.observe(path, p, points, nodes.forces[nodes.samples[which]], rig)
        return np.concatenate([readings, np.stack(state, axis=-1), points[..., self.states :]], axis=-1)

    def observe(
        self, path: np.ndarray, p: dict[str, np.ndarray], points: np.ndarray, forces: np.ndarray, rig: System
    ) -> np.ndarray:
        """Return readings (L, S, n C) of all channels along motions (states, L, S, n) under forces (L, n, n_dof)."""
        n, at, offsets = rig.n_dof, self.log_places.stop, self.model.offset_channels
        shown = {"displacement": path[:n], "velocity": path[n : 2 * n]}
        if any(c.measures == "acceleration" for _, c in self.model.channels):
            push = [forces[:, None, :, i] for i in range(n)]
            each = {name: value[..., None] for name, value in p.items()}
            motion = list(path[:n]), list(path[n : 2 * n])
            shown["acceleration"] = np.stack(acceleration(rig, each, *motion, push, list(path[2 * n :]), numpy_ops))
        rows = [
            shown[c.measures][c.dof] + (points[..., at + offsets.index(i), None] if i in offsets else 0.0)
            for i, (_, c) in enumerate(self.model.channels)
        ]
        return np.stack(rows, axis=-1).reshape(*path.shape[1:3], -1)

    def nodes_by_rig(self, nodes: Nodes) -> Iterator[tuple[System, np.ndarray]]:
        """Each rig that moved, and its nodes: rigs differ where masses were added in some records."""
        moved = [record.rig(self.model.system) for record in self.model.problem.records]
        for rig in dict.fromkeys(moved):
            yield rig, np.flatnonzero([moved[i] == rig for i in nodes.records])


def node_times(model: OutputError) -> list[np.ndarray]:
    """The times of each record: 0 and those of its samples."""
    return [np.unique(np.concatenate([[0.0], *[c.times for c in record.channels]])) for record in model.problem.records]


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
