"""The residual vector of an inverse PINN, and what every optimiser needs of it. One object, whoever minimises it.

The vector holds, each row divided by its standard deviation, so that half its squared length is minus the log
posterior:

data      network minus measurement, over the channel's noise
physics   the system's residual at the collocation points, divided by the gauge mass (an acceleration), over ``slack``
initial   network minus told state at time 0, over a small part of the noise
prior     log-parameters minus their nominal values, over the prior's standard deviations

Dividing the equation of motion by the gauge mass matters: m x'' + c x' + k x itself becomes small when all parameters
shrink together, and an optimiser that is offered this bargain takes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import cast

import numpy as np
import torch
from torch import Tensor

from bench import Ops, Problem, Record, System
from methods.pinn import network

STREAM = {"displacement": 0, "velocity": 1, "acceleration": 2}
TERMS = ("data", "physics", "initial", "prior")


def _solve(matrix: Sequence[Sequence[Tensor]], rhs: Sequence[Tensor]) -> list[Tensor]:
    n = len(rhs)
    entries = torch.broadcast_tensors(*[torch.as_tensor(e) for row in matrix for e in row], *rhs)
    stacked = torch.stack(entries[: n * n], -1).unflatten(-1, (n, n))
    return list(torch.linalg.solve(stacked, torch.stack(entries[n * n :], -1)).unbind(-1))


torch_ops = cast(
    Ops,
    SimpleNamespace(
        sin=torch.sin, cos=torch.cos, tanh=torch.tanh, exp=torch.exp, abs=torch.abs, where=torch.where, solve=_solve
    ),
)
"""The torch functions a residual may call."""


@dataclass(frozen=True)
class Spread:
    """Standard deviations of the rows: one a channel (record by record), of the physics, and of the told start.

    ``physics`` is an acceleration, ``displacement`` and ``velocity`` are those of the told start; natural units.
    """

    channels: tuple[float, ...]
    physics: float
    displacement: float
    velocity: float


class Block:
    """One record and its network: the points it is evaluated at, and which row looks at which point."""

    def __init__(self, record: Record, system: System, collocation: int, device: torch.device) -> None:
        def tensor(values: np.ndarray) -> Tensor:
            return torch.as_tensor(np.array(values), device=device)

        self.duration = record.duration
        self.rate = 2.0 / self.duration
        self.n_dof = system.n_dof
        self.n_data = record.n
        self.collocation = collocation
        grid = np.linspace(0.0, self.duration, collocation)
        times = np.concatenate([grid, *[c.times for c in record.channels]])
        self.tau = tensor(2.0 * times / self.duration - 1.0)
        self.values = tensor(np.concatenate([c.values for c in record.channels]))
        self.force = [tensor(f) for f in record.force(grid, system.n_dof)]
        self.stream = tensor(np.concatenate([np.full(c.n, STREAM[c.measures]) for c in record.channels]))
        self.dof = tensor(np.concatenate([np.full(c.n, c.dof) for c in record.channels]))
        self.channel = np.concatenate([np.full(c.n, i) for i, c in enumerate(record.channels)])
        self.data_points = collocation + torch.arange(self.n_data, device=device)
        self.start = None
        if record.initial_state is not None:
            self.start = tensor(np.stack([record.initial_state.displacement, record.initial_state.velocity]))
        n_start = 0 if self.start is None else 2 * self.n_dof
        # rows: data, physics (DOF by DOF), start (displacements, then velocities); time 0 is the first collocation
        # point
        physics = torch.arange(collocation, device=device).repeat(self.n_dof)
        self.points = torch.cat([self.data_points, physics, torch.zeros(n_start, dtype=torch.long, device=device)])
        self.n_rows = self.points.shape[0]
        self.slices = {
            "data": slice(0, self.n_data),
            "physics": slice(self.n_data, self.n_data + physics.shape[0]),
            "initial": slice(self.n_rows - n_start, self.n_rows),
        }


@dataclass
class State:
    """The residual vector at a point z, with what its linearisation needs."""

    z: Tensor
    tapes: list[network.Tape]
    rows: Tensor
    terms: dict[str, float]

    @property
    def loss(self) -> float:
        return 0.5 * float(self.rows @ self.rows)


@dataclass
class Linear:
    """The linearisation at a state: adjoints of each record's network, and the columns of the other unknowns.

    ``columns`` has shape (n_rows, n_unknowns): free log-parameters, then offsets.
    """

    adjoints: list[list[Tensor]]
    columns: Tensor


class Residuals:
    """The residual vector of a problem (in natural units) as a function of ``z``: all weights, then the other unknowns.

    The other unknowns are the logarithms of the ``free`` parameters, then one offset for each channel that has one;
    the parameters that are not free keep their value in ``log_fixed``.
    """

    def __init__(
        self,
        problem: Problem,
        widths: Sequence[int],
        collocation: int,
        free: Sequence[str],
        log_fixed: np.ndarray,
        device: str,
    ) -> None:
        self.device = torch.device(device)
        self.problem, self.system, self.widths = problem, problem.system, tuple(widths)
        self.blocks = [Block(r, problem.system, collocation, self.device) for r in problem.records]
        self.n_weights = network.count(widths)
        self.free = [problem.system.names.index(name) for name in free]
        self.log_fixed = torch.as_tensor(np.array(log_fixed), device=self.device)
        self.gauge = problem.system.names.index(problem.system.gauge)
        channels = [(i, j) for i, r in enumerate(problem.records) for j, c in enumerate(r.channels) if c.offset]
        self.offsets = channels
        self.n_unknowns = len(self.free) + len(channels)
        self.n_rows = sum(b.n_rows for b in self.blocks)
        self.prior = None
        if problem.prior is not None:
            self.prior = [
                torch.as_tensor(v[self.free], device=self.device)
                for v in (problem.prior.log_mean, problem.prior.log_sds)
            ]
            self.n_rows += len(self.free)
        self._offset_rows = self._offset_columns()

    def _offset_columns(self) -> Tensor:
        columns = torch.zeros(self.n_rows, len(self.offsets), dtype=torch.float64, device=self.device)
        at = 0
        for i, block in enumerate(self.blocks):
            for k, (record, channel) in enumerate(self.offsets):
                if record == i:
                    columns[at + torch.as_tensor(np.flatnonzero(block.channel == channel), device=self.device), k] = 1.0
            at += block.n_rows
        return columns

    def split(self, z: Tensor) -> tuple[list[network.Layers], Tensor, Tensor]:
        """Layers of each record's network, all log-parameters (n_parameters,), offsets."""
        n = self.n_weights
        layers = [network.unflat(z[i * n : (i + 1) * n], self.widths) for i in range(len(self.blocks))]
        rest = z[len(self.blocks) * n :]
        logs = self.log_fixed.clone()
        logs[self.free] = rest[: len(self.free)]
        return layers, logs, rest[len(self.free) :]

    def deviations(self, spread: Spread) -> Tensor:
        """The standard deviation of every row, (n_rows,)."""
        parts, at = [], 0
        for block, record in zip(self.blocks, self.problem.records, strict=True):
            part = np.empty(block.n_rows)
            part[block.slices["data"]] = np.array(spread.channels[at : at + len(record.channels)])[block.channel]
            part[block.slices["physics"]] = spread.physics
            if block.start is not None:
                part[block.slices["initial"]] = np.repeat([spread.displacement, spread.velocity], block.n_dof)
            parts.append(part)
            at += len(record.channels)
        deviations = torch.as_tensor(np.concatenate(parts), device=self.device)
        return deviations if self.prior is None else torch.cat([deviations, self.prior[1]])

    def evaluate(self, z: Tensor, deviations: Tensor) -> State:
        """The residual vector at z, and its squared length term by term."""
        layers, logs, offsets = self.split(z)
        tapes = [network.forward(own, block.tau, block.rate) for own, block in zip(layers, self.blocks, strict=True)]
        rows = self._rows([tape.output for tape in tapes], logs, offsets) / deviations
        return State(z, tapes, rows, self._terms(rows))

    def _rows(self, outputs: Sequence[Tensor], logs: Tensor, offsets: Tensor) -> Tensor:
        """The residual vector, not yet scaled, by the streams of every network and the other unknowns."""
        parts = []
        p = dict(zip(self.system.names, logs.exp().unbind(), strict=True))
        for block, out in zip(self.blocks, outputs, strict=True):
            m = block.collocation
            x, v, a = (list(out[s, :m].unbind(-1)) for s in range(3))
            equations = self.system.residual(p, x, v, a, block.force, [], torch_ops)
            parts.append(out[block.stream, block.data_points, block.dof] - block.values)
            parts += [equation / p[self.system.gauge] for equation in equations]
            if block.start is not None:
                parts.append((out[:2, 0] - block.start).reshape(-1))
        if self.prior is not None:
            parts.append(logs[self.free] - self.prior[0])
        rows = torch.cat(parts)
        return rows + self._offset_rows @ offsets if self.offsets else rows

    def _terms(self, rows: Tensor) -> dict[str, float]:
        squares = (rows * rows).cpu().numpy()
        terms, at = dict.fromkeys(TERMS, 0.0), 0
        for block in self.blocks:
            for name, part in block.slices.items():
                terms[name] += float(squares[at + part.start : at + part.stop].sum())
            at += block.n_rows
        terms["prior"] = float(squares[at:].sum())
        return terms

    def _physics_slopes(self, block: Block, tape: network.Tape, logs: Tensor) -> tuple[Tensor, Tensor]:
        """Derivatives of the scaled equations by the streams, (n_dof, 3, m, n_dof), and by the log-parameters,
        (n_dof, m, n_parameters).

        The residual acts point by point, so one reverse pass over the sum of its values gives the slopes at every
        point.
        """
        m = block.collocation
        streams = tape.output[:, :m].detach().clone().requires_grad_(True)
        spread_logs = logs.detach().expand(m, -1).clone().requires_grad_(True)
        by_streams, by_logs = [], []
        with torch.enable_grad():
            p = dict(zip(self.system.names, spread_logs.exp().unbind(-1), strict=True))
            x, v, a = (list(streams[s].unbind(-1)) for s in range(3))
            for equation in self.system.residual(p, x, v, a, block.force, [], torch_ops):
                total = (equation / p[self.system.gauge]).sum()
                slopes = torch.autograd.grad(total, (streams, spread_logs), retain_graph=True)
                by_streams.append(slopes[0])
                by_logs.append(slopes[1])
        return torch.stack(by_streams), torch.stack(by_logs)

    def linearise(self, state: State, deviations: Tensor, output_only: bool = False) -> Linear:
        """Adjoints (of the last layer only, if so asked) and explicit columns at a state."""
        layers, logs, _ = self.split(state.z)
        columns = torch.zeros(self.n_rows, self.n_unknowns, dtype=torch.float64, device=self.device)
        adjoints, at = [], 0
        for block, own, tape in zip(self.blocks, layers, state.tapes, strict=True):
            own_deviations = deviations[at : at + block.n_rows]
            seeds, by_logs = self.seeds(block, tape, logs)
            seeds /= own_deviations[:, None]
            physics = slice(at + block.slices["physics"].start, at + block.slices["physics"].stop)
            columns[physics, : len(self.free)] = by_logs[..., self.free].reshape(-1, len(self.free))
            adjoints.append([seeds] if output_only else network.adjoint(own, tape, seeds, block.points))
            at += block.n_rows
        if self.prior is not None:
            columns[at:, : len(self.free)] = torch.eye(len(self.free), dtype=torch.float64, device=self.device)
        columns[:, len(self.free) :] = self._offset_rows
        return Linear(adjoints, columns / deviations[:, None])

    def seeds(self, block: Block, tape: network.Tape, logs: Tensor) -> tuple[Tensor, Tensor]:
        """Slopes of a record's rows by the network's streams at their points, (3, n_rows, n_dof), not yet scaled."""
        by_streams, by_logs = self._physics_slopes(block, tape, logs)
        seeds = torch.zeros(3, block.n_rows, block.n_dof, dtype=torch.float64, device=self.device)
        rows = torch.arange(block.n_data, device=self.device)
        seeds[block.stream, rows, block.dof] = 1.0
        seeds[:, block.slices["physics"]] = by_streams.transpose(0, 1).reshape(3, -1, block.n_dof)
        if block.start is not None:
            eye = torch.eye(block.n_dof, dtype=torch.float64, device=self.device)
            first = block.slices["initial"].start
            seeds[0, first : first + block.n_dof] = eye
            seeds[1, first + block.n_dof :] = eye
        return seeds, by_logs

    def gram(self, state: State, linear: Linear, unknown_scale: float, output_only: bool = False) -> Tensor:
        """``J S² Jᵀ``, (n_rows, n_rows), where S multiplies the unknowns beside the weights by ``unknown_scale``."""
        scaled = linear.columns * unknown_scale
        total = scaled @ scaled.T
        at = 0
        for block, tape, adjoints in zip(self.blocks, state.tapes, linear.adjoints, strict=True):
            end = at + block.n_rows
            if output_only:
                tape = network.Tape(tape.inputs[-1:], [], tape.output)
            total[at:end, at:end] += network.gram(tape, adjoints, block.points)
            at = end
        return total

    def pull_back(
        self, state: State, linear: Linear, dual: Tensor, unknown_scale: float, output_only: bool = False
    ) -> Tensor:
        """``S² Jᵀ dual`` as a vector like z."""
        parts, at = [], 0
        for block, tape, adjoints in zip(self.blocks, state.tapes, linear.adjoints, strict=True):
            own = dual[at : at + block.n_rows]
            if output_only:
                short = network.Tape(tape.inputs[-1:], [], tape.output)
                tail = network.pull_back(short, adjoints, block.points, own)
                parts += [torch.zeros(self.n_weights - tail.shape[0], dtype=torch.float64, device=self.device), tail]
            else:
                parts.append(network.pull_back(tape, adjoints, block.points, own))
            at += block.n_rows
        return torch.cat([*parts, unknown_scale**2 * (linear.columns.T @ dual)])

    def gradient(self, z: Tensor, deviations: Tensor) -> tuple[State, Tensor]:
        """The state at z and the gradient of its loss, a vector like z, by one adjoint pass over the points."""
        layers, logs, offsets = self.split(z)
        tapes = [network.forward(own, block.tau, block.rate) for own, block in zip(layers, self.blocks, strict=True)]
        leaves = [part.detach().requires_grad_(True) for part in (*[tape.output for tape in tapes], logs, offsets)]
        with torch.enable_grad():
            rows = self._rows(leaves[:-2], leaves[-2], leaves[-1]) / deviations
            slopes = torch.autograd.grad(0.5 * (rows @ rows), leaves, allow_unused=True, materialize_grads=True)
        parts = [
            network.pull_back(tape, network.adjoint(own, tape, seeds), None)
            for own, tape, seeds in zip(layers, tapes, slopes[:-2], strict=True)
        ]
        rows = rows.detach()
        return State(z, tapes, rows, self._terms(rows)), torch.cat([*parts, slopes[-2][self.free], slopes[-1]])

    def jacobian(self, state: State, deviations: Tensor) -> Tensor:
        """J explicitly, (n_rows, n_z); for checks and small problems."""
        linear = self.linearise(state, deviations)
        result = torch.zeros(self.n_rows, state.z.shape[0], dtype=torch.float64, device=self.device)
        at = 0
        for i, (block, tape, adjoints) in enumerate(zip(self.blocks, state.tapes, linear.adjoints, strict=True)):
            own = slice(i * self.n_weights, (i + 1) * self.n_weights)
            result[at : at + block.n_rows, own] = network.jacobian(tape, adjoints, block.points)
            at += block.n_rows
        result[:, len(self.blocks) * self.n_weights :] = linear.columns
        return result
