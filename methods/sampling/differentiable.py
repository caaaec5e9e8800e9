"""The posterior of a problem as a jax function, compiled once for all problems of one layout: for gradient samplers.

It is :class:`methods.sampling.posterior.Posterior`, term by term, in jax and differentiable: of the one residual
(:func:`bench.state_rate`, :func:`bench.rk4_scan`), in natural units.

- **Linear systems**: state and force over an interval in which the force is linear obey one constant-coefficient system
  (C. F. Van Loan, IEEE Trans. Automatic Control 23:395, 1978). Its matrix exponential, by scaling, a Taylor polynomial
  of degree 8 and squaring, carries the state from node to node: exact to rounding, at any step.
- **Others**: Runge-Kutta steps of order four, of at most ``STEP`` radians of the fastest rate at the mode.

What decides the compiled code is a :class:`DensityLayout`; all numbers are arguments, so the replicates of a cell share
it. jax is imported in functions: this module costs nothing where it is not used.
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
"""Integration step in radians of the fastest rate: the natural frequency is then off by at most 7 parts in 100,000."""
RATE_RATIO = 1.5
"""Rates are rounded up to a power of this, so that problems that are alike take the same steps."""
REACH = 4.0
"""How much faster than at the mode the motion may become before the matrix exponential loses digits."""
TAYLOR = 8

Data = dict[str, Any]
"""All numbers of a problem, as arrays: a tree that jax takes as an argument."""


@dataclass(frozen=True)
class DensityLayout:
    """What decides the compiled code: the system, what is estimated, which records and sensors; hashable.

    ``rigs`` by record: the system that moved, with what was added to it. ``known`` by record: whether its initial state
    is. ``channels``: record, what is measured, DOF, and which of the offsets is added, -1 for none. ``squarings`` of
    the matrix exponential.
    """

    system: System
    free: tuple[str, ...]
    rigs: tuple[System, ...]
    known: tuple[bool, ...]
    channels: tuple[tuple[int, str, int, int], ...]
    forced: bool
    squarings: int


def prepare(posterior: Posterior) -> tuple[DensityLayout, Data]:
    """Layout and numbers of a problem, its steps sized by the fastest rate at the posterior's mode."""
    model, k = posterior.model, len(posterior.model.free)
    system, records = model.system, model.problem.records
    logs = posterior.mode[:k]
    speed = RATE_RATIO ** np.ceil(np.log(fastest_rate(model, logs)) / np.log(RATE_RATIO))
    # a linear system needs steps at the samples of a force only
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
    """Steps of one record: lengths (J,), forces (J, 3, n_dof), the step after which a node is reached (K,)."""
    reached = nodes.reached[first:last]
    steps = slice(reached[0], reached[-1])
    h = nodes.lengths[steps]
    gaps, which = np.unique(np.round(h, 11), return_inverse=True)
    rows = {"h": h, "push": nodes.pushes[steps], "reached": reached - reached[0], "gaps": gaps, "which": which}
    return rows | {"forces": nodes.forces[first:last]}


def log_density(layout: DensityLayout, data: Data, phi: Any) -> Any:
    """The log-posterior of ``phi = [theta, log sigma by channel]``, up to a constant; -inf where it is not finite."""
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
        left = (data["values"][i] - readings[data["node_of"][i]] - shift) * jnp.exp(-log_sigma[i])
        value -= 0.5 * jnp.sum(left**2) + data["values"][i].size * log_sigma[i]
    return jnp.where(jnp.isfinite(value), value, -jnp.inf)


def _measured(system: System, p: Mapping[str, Any], path: Any, forces: Any, measures: str, dof: int) -> Any:
    """What an ideal sensor gives at every node, (K,), from the states there (K, d)."""
    import jax.numpy as jnp

    n = system.n_dof
    if measures != "acceleration":
        return path[:, dof if measures == "displacement" else n + dof]
    x, v, z = (list(part.T) for part in (path[:, :n], path[:, n : 2 * n], path[:, 2 * n :]))
    return acceleration(system, p, x, v, list(forces.T), z, array_ops(jnp))[dof]


def _path(layout: DensityLayout, system: System, p: Mapping[str, Any], start: Any, table: Mapping[str, Any]) -> Any:
    """States ``[x, v, z]`` at the nodes of a record, (K, d)."""
    import jax
    import jax.numpy as jnp

    first = jnp.concatenate([jnp.asarray(start), jnp.zeros(system.n_hidden)])
    if not system.linear:
        return rk4_scan(system, p, first, table["h"], table["push"])[table["reached"]]
    carriers = _carriers(layout, system, p, table["gaps"])

    def exact(state: Any, inputs: tuple[Any, Any, Any]) -> tuple[Any, Any]:
        h, push, which = inputs
        whole = jnp.concatenate([state, push[0], (push[2] - push[0]) / h]) if layout.forced else state
        new = carriers[which] @ whole
        return new, new

    _, path = jax.lax.scan(exact, first, (table["h"], table["push"], table["which"]))
    return jnp.concatenate([first[None], path])[table["reached"]]


def _carriers(layout: DensityLayout, system: System, p: Mapping[str, Any], gaps: Any) -> Any:
    """The upper rows of the matrix exponentials that carry ``[x, v]`` (and force and its slope) over each gap."""
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
