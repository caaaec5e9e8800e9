"""The log-posterior as a JAX function for gradient-based samplers, compiled once per layout.

It equals :class:`methods.sampling.posterior.Posterior`, in natural units, with the same equation of motion
(:func:`bench.state_rate`, :func:`bench.rk4_scan`).

- **Linear systems**: state and force over an interval in which the force is linear satisfy a constant-coefficient
  system (C. F. Van Loan, IEEE Trans. Automatic Control 23:395, 1978). Its matrix exponential, by scaling, a Taylor
  polynomial of degree 8 and squaring, is the exact state transition for any step.
- **Others**: Runge-Kutta steps of order four, of at most ``STEP`` radians of the fastest rate at the mode.

The compiled code depends on the :class:`DensityLayout` only; all numbers are arguments, so that the replicates of a
cell share it. JAX is imported inside functions, to keep the import of this module fast.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench import System, acceleration, array_ops, rk4_scan, state_rate
from methods.kalman.joint import Nodes, fastest_rate, node_times
from methods.sampling.posterior import NOISE_SD, Posterior

STEP = 0.3
"""Integration step in radians of the fastest rate, with a relative frequency error of at most 7e-5."""
RATE_RATIO = 1.5
"""Rates are rounded up to a power of this, so that similar problems share the steps."""
REACH = 4.0
"""Factor by which the rate may exceed that at the mode before the matrix exponential loses accuracy."""
TAYLOR = 8

Data = dict[str, Any]
"""All numbers of a problem as a tree of arrays."""


@dataclass(frozen=True)
class DensityLayout:
    """The hashable structure on which the compiled code depends.

    ``rigs``: the system of each record with its added mass. ``known``: whether the initial state of each record is
    known. ``channels``: record, measured quantity, DOF, and index of the offset, -1 for none. ``squarings``: number of
    squarings of the matrix exponential.
    """

    system: System
    free: tuple[str, ...]
    rigs: tuple[System, ...]
    known: tuple[bool, ...]
    channels: tuple[tuple[int, str, int, int], ...]
    forced: bool
    squarings: int


def prepare(posterior: Posterior) -> tuple[DensityLayout, Data]:
    """Return layout and numbers of a problem, with steps for the fastest rate at the posterior's mode."""
    model, k = posterior.model, len(posterior.model.free)
    system, records = model.system, model.problem.records
    logs = posterior.mode[:k]
    speed = RATE_RATIO ** np.ceil(np.log(fastest_rate(model, logs)) / np.log(RATE_RATIO))
    # a linear system requires steps at the samples of a force only
    nodes = Nodes.of(model, np.inf if system.linear else STEP / max(speed, 1e-9))
    tables = [_table(nodes, first, last) for first, last in itertools.pairwise(nodes.bounds)]
    longest = max(float(np.max(table["gaps"])) for table in tables)
    squarings = max(0, int(np.ceil(np.log2(2.0 * REACH * speed * longest)))) if system.linear else 0
    order = {channel: i for i, channel in enumerate(model.offset_channels)}
    channels = tuple((r, c.measures, c.dof, order.get(i, -1)) for i, (r, c) in enumerate(model.channels))
    known = tuple(record.initial_state is not None for record in records)
    rigs = tuple(record.rig(system) for record in records)
    layout = DensityLayout(system, model.free, rigs, known, channels, bool(np.any(nodes.pushes)), squarings)
    times = node_times(model)
    data: Data = {
        "tables": tables,
        "starts": model.initial_states,
        "node_of": [np.searchsorted(times[r], c.times) for r, c in model.channels],
        "values": [c.values for _, c in model.channels],
        "centre": posterior.centre[0],
        "sds": posterior.sds[0],
        "noise_centre": posterior.noise_centre[0],
    }
    return layout, data


def _table(nodes: Nodes, first: int, last: int) -> dict[str, np.ndarray]:
    """Return the steps of one record: lengths (J,), forces (J, 3, n_dof), number of steps before a node (K,)."""
    reached = nodes.reached[first:last]
    steps = slice(reached[0], reached[-1])
    h = nodes.lengths[steps]
    gaps, which = np.unique(np.round(h, 11), return_inverse=True)
    rows = {"h": h, "push": nodes.pushes[steps], "reached": reached - reached[0], "gaps": gaps, "which": which}
    return rows | {"forces": nodes.forces[first:last]}


def log_density(layout: DensityLayout, data: Data, phi: Any) -> Any:
    """Return the log-posterior of ``phi = [theta, log sigma of each channel]`` up to a constant; -inf if not finite."""
    import jax.numpy as jnp

    k, n2 = len(layout.free), 2 * layout.system.n_dof
    offsets = phi[k + n2 * layout.known.count(False) :]
    logs, log_sigma = phi[:k], phi[len(phi) - len(layout.channels) :]
    value = -0.5 * jnp.sum(((logs - data["centre"]) / data["sds"]) ** 2)
    value -= 0.5 * jnp.sum(((log_sigma - data["noise_centre"]) / NOISE_SD) ** 2)
    p = {name: jnp.exp(phi[layout.free.index(name)]) if name in layout.free else 1.0 for name in layout.system.names}
    paths, column = [], k
    for r, (rig, known, table) in enumerate(zip(layout.rigs, layout.known, data["tables"], strict=True)):
        paths.append(_path(layout, rig, p, data["starts"][r] if known else phi[column : column + n2], table))
        column += 0 if known else n2
    for i, (r, measures, dof, offset) in enumerate(layout.channels):
        readings = _measured(layout.rigs[r], p, paths[r], data["tables"][r]["forces"], measures, dof)
        shift = offsets[offset] if offset >= 0 else 0.0
        residual = (data["values"][i] - readings[data["node_of"][i]] - shift) * jnp.exp(-log_sigma[i])
        value -= 0.5 * jnp.sum(residual**2) + data["values"][i].size * log_sigma[i]
    return jnp.where(jnp.isfinite(value), value, -jnp.inf)


def _measured(system: System, p: Mapping[str, Any], path: Any, forces: Any, measures: str, dof: int) -> Any:
    """Return the noise-free measurement at every node, (K,), from the states there (K, d)."""
    import jax.numpy as jnp

    n = system.n_dof
    if measures != "acceleration":
        return path[:, dof if measures == "displacement" else n + dof]
    x, v, z = (list(part.T) for part in (path[:, :n], path[:, n : 2 * n], path[:, 2 * n :]))
    return acceleration(system, p, x, v, list(forces.T), z, array_ops(jnp))[dof]


def _path(layout: DensityLayout, system: System, p: Mapping[str, Any], start: Any, table: Mapping[str, Any]) -> Any:
    """Compute the states ``[x, v, z]`` at the nodes of a record, (K, d)."""
    import jax
    import jax.numpy as jnp

    first = jnp.concatenate([jnp.asarray(start), jnp.zeros(system.n_hidden)])
    if not system.linear:
        return rk4_scan(system, p, first, table["h"], table["push"])[table["reached"]]
    transitions = _transitions(layout, system, p, table["gaps"])

    def exact(state: Any, inputs: tuple[Any, Any, Any]) -> tuple[Any, Any]:
        h, push, which = inputs
        whole = jnp.concatenate([state, push[0], (push[2] - push[0]) / h]) if layout.forced else state
        new = transitions[which] @ whole
        return new, new

    _, path = jax.lax.scan(exact, first, (table["h"], table["push"], table["which"]))
    return jnp.concatenate([first[None], path])[table["reached"]]


def _transitions(layout: DensityLayout, system: System, p: Mapping[str, Any], gaps: Any) -> Any:
    """Return the rows for ``[x, v]`` of the matrix exponentials over each interval, by state, force and slope."""
    import jax
    import jax.numpy as jnp

    n, ops = system.n_dof, array_ops(jnp)
    unit = np.eye(3 * n if layout.forced else 2 * n)
    # a linear residual: the rate at unit states and unit forces is the matrix, column by column
    columns = [state_rate(system, p, list(row[: 2 * n]), list(row[2 * n :]) or [0.0] * n, ops) for row in unit]
    matrix = jnp.stack([jnp.stack([jnp.asarray(entry, float) for entry in column]) for column in columns], axis=1)
    if layout.forced:
        matrix = jnp.zeros((4 * n, 4 * n)).at[: 2 * n, : 3 * n].set(matrix)
        matrix = matrix.at[2 * n : 3 * n, 3 * n :].set(jnp.eye(n))

    def exponential(gap: Any) -> Any:
        x, identity = matrix * (gap / 2**layout.squarings), jnp.eye(len(matrix))
        e = identity
        for order in range(TAYLOR, 0, -1):
            e = identity + x @ e / order
        for _ in range(layout.squarings):
            e = e @ e
        return e[: 2 * n]

    return jax.vmap(exponential)(gaps)
