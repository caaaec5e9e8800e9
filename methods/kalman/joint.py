"""The joint model of state and parameters for the Kalman filters, and its time grid.

The joint state is displacements, velocities and hidden states, then the log-parameters, then the offsets of sensors.
It is integrated from the system's equation of motion (:func:`bench.rk4_step`). :class:`Nodes` are the times at which
the state is estimated, and the integration steps between them. All quantities are in natural units
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
"""Standard deviation of an unknown initial state over the largest displacement (and fastest rate)."""
DIFFERENCE = 1e-5
"""Step of the finite differences for the fastest rate, over the size of the data."""
MAX_STEPS = 3000
"""Largest number of integration steps between two samples."""
MOST_STEPS = 5_000_000
"""Largest number of integration steps over a record."""
LONG = 1000
"""Largest number of times of a record with one node each."""
NODES = 250
"""Approximate number of nodes of longer records."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """The nodes of all records in sequence, each with the samples from it to the next node.

    The times of a record are 0 and those of its samples; there is a node at each, or at every n-th of a long record.
    T times, J integration steps, K nodes with at most n times each, C channels.

    ``values`` (T, C): measured values, NaN where missing. ``forces`` (T, n_dof). ``lengths`` (J,): integration steps,
    none above ``longest``. ``pushes`` (J, 3, n_dof): forces at the start, middle and end of each step. ``reached``
    (T,): number of steps before each time. ``bounds`` (records + 1,): index of the first time of each record, and T.
    ``samples`` (K, n): indices of a node's times, the last one repeated. ``there`` (K, n): False for repetitions.
    ``ends`` (K,): number of steps before the end of each node. ``records`` (K,): record of each node.
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
        """Place the nodes, with steps of at most ``longest``; raises NoEstimate where too many are needed."""
        n, values, forces = model.system.n_dof, list[np.ndarray](), list[np.ndarray]()
        paths, reached = list[Steps](), list[np.ndarray]()
        for i, (record, times) in enumerate(zip(model.problem.records, node_times(model), strict=True)):
            rows = np.full((times.size, len(model.channels)), np.nan)
            for j, (of_record, channel) in enumerate(model.channels):
                if of_record == i:
                    rows[np.searchsorted(times, channel.times), j] = channel.values
            values.append(rows)
            forces.append(np.stack(record.force(times, n), axis=1))
            grid = np.unique(np.concatenate([times, *[f.times[f.times <= times[-1]] for f in record.forces]]))
            counts = step_counts(grid, longest)
            upto = np.concatenate([[0], np.cumsum(counts)])[np.searchsorted(grid, times)]
            if np.max(np.diff(upto), initial=0) > MAX_STEPS + grid.size or upto[-1] > MOST_STEPS:
                raise NoEstimate(
                    "the estimated motion is far faster than the samples resolve; give a prior closer to the system"
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
        """Return the duration of each node, (K,)."""
        upto = np.concatenate([[0.0], np.cumsum(self.lengths)])
        return np.asarray(upto[self.ends] - upto[self.reached[self.samples[:, 0]]])

    @property
    def firsts(self) -> np.ndarray:
        """Return the index of the first node of each record."""
        return np.searchsorted(self.records, np.arange(self.records[-1] + 1))


@dataclass(frozen=True, eq=False)
class Joint:
    """The joint state ``[x, v, z, log-parameters, offsets]`` and its prior.

    ``logs`` and ``log_sds`` (k,): prior mean and standard deviation of log-parameters. ``log_walk``: variance of their
    random walk per unit of time. ``speed``: ratio of initial velocity and displacement in the prior (radians per unit
    of time).
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
        """Return the slice of the log-parameters, which the offsets follow."""
        return slice(self.states, self.states + len(self.model.free))

    def parameters(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Return the parameters of joint states (..., d), each of shape (...)."""
        return self.model.parameters(np.clip(points[..., self.log_places], -LOG_LIMIT, LOG_LIMIT))

    def start(self, record: Record) -> tuple[np.ndarray, np.ndarray]:
        """Return prior mean and variances of the motion ``[x, v, z]`` at time 0 of a record; hidden states are zero."""
        n, mean, variance = self.model.system.n_dof, np.zeros(self.states), np.zeros(self.states)
        if record.initial_state is not None:
            mean[:n], mean[n : 2 * n] = record.initial_state.displacement, record.initial_state.velocity
        else:
            sd = START * amplitude(self.model, self.speed)
            variance[:n], variance[n : 2 * n] = sd**2, (sd * self.speed) ** 2
        return mean, variance

    def first(self) -> tuple[np.ndarray, np.ndarray]:
        """Return prior mean and covariance of the joint state at the first record."""
        mean, variance = self.start(self.model.problem.records[0])
        offsets = np.array([self.model.rms[i] for i in self.model.offset_channels])
        all_variances = np.concatenate([variance, self.log_sds**2, (START * offsets) ** 2])
        return np.concatenate([mean, self.logs, np.zeros(offsets.size)]), np.diag(all_variances)

    def theta(self, means: np.ndarray, nodes: Nodes) -> np.ndarray:
        """Return the model's vectors (B, size) for smoothed means (B, K, d): final constants and initial states.

        The constants are taken at the last node, where rounding errors of the smoother are absent.
        """
        n, places = self.model.system.n_dof, self.log_places
        starts = [means[:, nodes.firsts[i], : 2 * n] for i in self.model.unknown_starts]
        logs, offsets = means[:, -1, places], means[:, -1, places.stop :]
        return np.concatenate([np.clip(logs, -LOG_LIMIT, LOG_LIMIT), *starts, offsets], axis=1)

    def trajectories(self, thetas: np.ndarray, nodes: Nodes) -> np.ndarray:
        """Return the joint states (B, K, d) at the nodes for the model's vectors (B, size)."""
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
        """Integrate joint states (L, S, d) from nodes ``which`` (L,) to their ends.

        Returns:
            Predicted measurements at the times of the node, then the joint state at its end, (L, S, n C + d).
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
            length = np.where(j < steps, nodes.lengths[step], 0.0)[:, None]  # a zero step leaves the state unchanged
            start, middle, end = ([nodes.pushes[step, k, i, None] for i in range(rig.n_dof)] for k in range(3))
            state = rk4_step(rig, p, state, length, (start, middle, end), numpy_ops)
        readings = self.observe(path, p, points, nodes.forces[nodes.samples[which]], rig)
        return np.concatenate([readings, np.stack(state, axis=-1), points[..., self.states :]], axis=-1)

    def observe(
        self, path: np.ndarray, p: dict[str, np.ndarray], points: np.ndarray, forces: np.ndarray, rig: System
    ) -> np.ndarray:
        """Return predicted measurements (L, S, n C) along motions (states, L, S, n) under forces (L, n, n_dof)."""
        n, first_offset, offsets = rig.n_dof, self.log_places.stop, self.model.offset_channels
        shown = {"displacement": path[:n], "velocity": path[n : 2 * n]}
        if any(c.measures == "acceleration" for _, c in self.model.channels):
            push = [forces[:, None, :, i] for i in range(n)]
            each = {name: value[..., None] for name, value in p.items()}
            motion = list(path[:n]), list(path[n : 2 * n])
            shown["acceleration"] = np.stack(acceleration(rig, each, *motion, push, list(path[2 * n :]), numpy_ops))
        rows = [
            shown[c.measures][c.dof] + (points[..., first_offset + offsets.index(i), None] if i in offsets else 0.0)
            for i, (_, c) in enumerate(self.model.channels)
        ]
        return np.stack(rows, axis=-1).reshape(*path.shape[1:3], -1)

    def nodes_by_rig(self, nodes: Nodes) -> Iterator[tuple[System, np.ndarray]]:
        """Yield each rig and its nodes; rigs differ where masses were added in some records."""
        moved = [record.rig(self.model.system) for record in self.model.problem.records]
        for rig in dict.fromkeys(moved):
            yield rig, np.flatnonzero([moved[i] == rig for i in nodes.records])


def node_times(model: OutputError) -> list[np.ndarray]:
    """Return the times of each record: 0 and those of its samples."""
    return [np.unique(np.concatenate([[0.0], *[c.times for c in record.channels]])) for record in model.problem.records]


def fastest_rate(model: OutputError, logs: np.ndarray) -> float:
    """Return the largest rate (radians per unit of time) of the motion linearised at rest and at the data's size.

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
        raise NoEstimate("the motion is not finite at the estimated parameters; give a prior closer to the system")
    return rate


def amplitude(model: OutputError, rate: float) -> float:
    """Return the largest measured displacement, else velocity over the rate or acceleration over its square."""
    order = {"displacement": 0, "velocity": 1, "acceleration": 2}
    least = min(order[c.measures] for _, c in model.channels)
    sizes = [
        float(np.max(np.abs(c.values - c.offset * np.median(c.values)))) / max(rate, 1.0) ** least
        for _, c in model.channels
        if order[c.measures] == least and c.n
    ]
    return max(sizes, default=0.0) or 1.0
