"""The residual vector of an inverse PINN, and what every optimiser needs of it. One object, whoever minimises it.

The vector holds, each row divided by its standard deviation, so that half its squared length is minus the log
posterior:

data      response minus measurement, over the channel's noise
physics   the system's residual at the collocation points, divided by the gauge mass (an acceleration), over ``slack``;
          likewise the rate of each hidden state less what it should be, times the frequency in the data
initial   response minus told state at time 0, over a small part of the noise (absent where the ansatz has it exactly);
          hidden states start at zero
prior     log-parameters minus their nominal values, over the prior's standard deviations

Dividing the equation of motion by the gauge mass matters: m x'' + c x' + k x itself becomes small when all parameters
shrink together, and an optimiser that is offered this bargain takes it.

Every tensor has a leading axis over fits, B: the problems of one batch have the same system, the same channels and as
many samples, and nothing else in common.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench import Problem, array_ops
from methods.network.ansatz import Adjoints, Ansatz, MixedAnsatz, Tape
from methods.pinn.block import Block, Spread

TERMS = ("data", "physics", "initial", "prior")
CHUNK = 2**24
"""Entries of J formed at a time where the normal equations are built from its columns."""


torch_ops = array_ops(torch, lambda *entries: torch.broadcast_tensors(*map(torch.as_tensor, entries)))
"""The torch functions a residual may call."""


@dataclass
class State:
    """The residual vectors at a point z (B, n_z), with what their linearisation needs.

    ``outputs`` are the responses' streams record by record, ``rows`` (B, n_rows), ``terms`` (B, 4) squared lengths.
    """

    z: Tensor
    tapes: list[Tape]
    outputs: list[Tensor]
    rows: Tensor
    terms: Tensor

    @property
    def loss(self) -> np.ndarray:
        """Half the squared length of each vector, (B,)."""
        return np.asarray(0.5 * self.terms.sum(1).cpu())


@dataclass
class Linear:
    """The linearisation at a state: adjoints of each record's ansatz, and the columns of the other unknowns.

    ``columns`` has shape (B, n_rows, n_unknowns): free log-parameters, then offsets.
    """

    adjoints: list[Adjoints]
    columns: Tensor


AnsatzMaker = Callable[[int, Block], Ansatz]
"""Makes the ansatz of a record, given its number and its block."""


class Residuals:
    """The residual vectors of problems (in natural units) as a function of ``z``: coefficients, then other unknowns.

    The other unknowns are the logarithms of the ``free`` parameters, then one offset for each channel that has one;
    the parameters that are not free keep their value in ``log_fixed`` (B, n_parameters). ``omega`` (B,) are the
    frequencies of the data; ``exact`` asks for the told start by construction
    (:func:`methods.pinn.block.exact_start`).
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        make_ansatz: AnsatzMaker,
        collocation: int,
        free: Sequence[str],
        log_fixed: np.ndarray,
        omega: np.ndarray,
        device: str = "cpu",
        exact: bool = False,
    ) -> None:
        self.device = torch.device(device)
        first = problems[0]
        self.system = first.system
        self.blocks = [
            Block([p.records[i] for p in problems], self.system, collocation, self.device, omega, exact)
            for i in range(len(first.records))
        ]
        self.ansatzes = [make_ansatz(i, block) for i, block in enumerate(self.blocks)]
        self.free = [self.system.names.index(name) for name in free]
        self.log_fixed = torch.as_tensor(np.array(log_fixed), device=self.device)
        self.gauge = self.system.gauge
        self.offsets = [(i, j) for i, r in enumerate(first.records) for j, c in enumerate(r.channels) if c.offset]
        self.n_unknowns = len(self.free) + len(self.offsets)
        self.prior: tuple[Tensor, Tensor] | None = None
        if first.prior is not None:
            beliefs = [(p.prior.log_mean[self.free], p.prior.log_sds[self.free]) for p in problems if p.prior]
            means, sds = (torch.as_tensor(np.array(part), device=self.device) for part in zip(*beliefs, strict=True))
            self.prior = means, sds
        self.n_rows = sum(b.n_rows for b in self.blocks) + (len(self.free) if self.prior else 0)
        self._offset_rows = self._offset_columns()
        self.term_rows = self._term_columns()

    @property
    def n_fits(self) -> int:
        return int(self.log_fixed.shape[0])

    @property
    def n_coefficients(self) -> int:
        return sum(a.count for a in self.ansatzes)

    @property
    def n_z(self) -> int:
        return self.n_coefficients + self.n_unknowns

    def take(self, who: np.ndarray) -> Residuals:
        """The residual vectors of some of the fits, (k,) indices."""
        if who.size == self.n_fits:
            return self
        index = torch.as_tensor(who, device=self.device)
        other = copy.copy(self)
        other.blocks = [block.take(index) for block in self.blocks]
        other.ansatzes = [ansatz.take(index) for ansatz in self.ansatzes]
        other.log_fixed = self.log_fixed[index]
        other.prior = None if self.prior is None else (self.prior[0][index], self.prior[1][index])
        return other

    def heads(self, z: Tensor) -> tuple[Residuals, Tensor]:
        """The same vectors as a function of the last layers and the other unknowns alone, and these at z."""
        other = copy.copy(self)
        parts, rest = self.split_flat(z)
        pairs = [a.head(part) for a, part in zip(self.ansatzes, parts, strict=True)]
        other.ansatzes = [basis for basis, _ in pairs]
        return other, torch.cat([*[own for _, own in pairs], rest], 1)

    def mixed(self, z: Tensor, deviations: Tensor) -> tuple[Residuals, Tensor]:
        """Return the same vectors as a function of coefficients by which J has orthonormal columns at z, and these.

        Random features are so much alike that J has singular values over twelve decades, and a damped step moves
        along the small ones only after hundreds of iterations. Splines are left as they are.
        """
        other = copy.copy(self)
        parts, rest = self.split_flat(z)
        state = self.evaluate(z, deviations)
        linear = self.linearise(state, deviations)
        ansatzes = zip(self.blocks, self.ansatzes, state.tapes, linear.adjoints, strict=True)
        other.ansatzes = [
            a if a.local else MixedAnsatz.of(a, a.jacobian(tape, adjoints, block.points))
            for block, a, tape, adjoints in ansatzes
        ]
        return other, torch.cat([*[a.mixed(part) for a, part in zip(other.ansatzes, parts, strict=True)], rest], 1)

    def unmixed(self, z: Tensor) -> Tensor:
        """Return the coefficients before :meth:`mixed`, and the other unknowns."""
        parts, rest = self.split_flat(z)
        return torch.cat([*[a.unmixed(part) for a, part in zip(self.ansatzes, parts, strict=True)], rest], 1)

    def with_heads(self, z: Tensor, short: Tensor) -> Tensor:
        """z with its last layers and other unknowns as in the vector ``short`` of :meth:`heads`."""
        parts, _ = self.split_flat(z)
        sizes = [a.head(part)[0].count for a, part in zip(self.ansatzes, parts, strict=True)]
        *own, rest = short.split([*sizes, self.n_unknowns], 1)
        whole = [a.with_head(p, o) for a, p, o in zip(self.ansatzes, parts, own, strict=True)]
        return torch.cat([*whole, rest], 1)

    def held(self, z: Tensor) -> tuple[Residuals, Tensor]:
        """The same vectors, without the prior, as a function of coefficients and offsets alone, and these at z."""
        other = copy.copy(self)
        parts, logs, offsets = self.split(z)
        other.log_fixed, other.free, other.prior = logs, [], None
        other.n_unknowns, other.n_rows = len(self.offsets), sum(block.n_rows for block in self.blocks)
        other._offset_rows, other.term_rows = other._offset_columns(), other._term_columns()
        return other, torch.cat([*parts, offsets], 1)

    def with_responses(self, z: Tensor, short: Tensor) -> Tensor:
        """z with its coefficients and offsets as in the vector ``short`` of :meth:`held`."""
        n = self.n_coefficients
        return torch.cat([short[:, :n], z[:, n : n + len(self.free)], short[:, n:]], 1)

    def split_flat(self, z: Tensor) -> tuple[list[Tensor], Tensor]:
        """Coefficients of each record's ansatz, and the other unknowns."""
        *parts, rest = z.split([*[a.count for a in self.ansatzes], self.n_unknowns], 1)
        return parts, rest

    def split(self, z: Tensor) -> tuple[list[Tensor], Tensor, Tensor]:
        """Coefficients of each record's ansatz, all log-parameters (B, n_parameters), offsets."""
        parts, rest = self.split_flat(z)
        logs = self.log_fixed.clone()
        logs[:, self.free] = rest[:, : len(self.free)]
        return parts, logs, rest[:, len(self.free) :]

    def deviations(self, spread: Spread) -> Tensor:
        """The standard deviation of every row, (B, n_rows)."""
        parts, at = [], 0
        for block in self.blocks:
            part = np.empty((self.n_fits, block.n_rows))
            n_channels = int(block.channel[-1]) + 1
            part[:, block.slices["data"]] = spread.channels[:, at : at + n_channels][:, block.channel]
            physics = np.stack([spread.physics] * block.n_dof + [spread.hidden] * (block.n_paths - block.n_dof), 1)
            part[:, block.slices["physics"]] = np.repeat(physics, block.collocation, axis=1)
            own = np.stack([spread.displacement, spread.velocity], 1)
            part[:, block.slices["initial"]] = own[:, block.start_stream]
            parts.append(part)
            at += n_channels
        deviations = torch.as_tensor(np.concatenate(parts, 1), device=self.device)
        return deviations if self.prior is None else torch.cat([deviations, self.prior[1]], 1)

    def evaluate(self, z: Tensor, deviations: Tensor) -> State:
        """The residual vectors at z, and their squared lengths term by term."""
        parts, logs, offsets = self.split(z)
        tapes = [ansatz.forward(part) for ansatz, part in zip(self.ansatzes, parts, strict=True)]
        outputs = [block.response(tape.output) for block, tape in zip(self.blocks, tapes, strict=True)]
        rows = self._rows(outputs, self._physics(outputs, logs), logs, offsets) / deviations
        return State(z, tapes, outputs, rows, self._terms(rows))

    def _physics(self, outputs: Sequence[Tensor], logs: Tensor) -> list[Tensor]:
        """The equations, record by record and path by path, (B, n_paths * collocation) each."""
        p = {name: value[:, None] for name, value in zip(self.system.names, logs.exp().unbind(1), strict=True)}
        return [
            torch.cat(self._equations(block, p, out[:, :, : block.collocation]), 1)
            for block, out in zip(self.blocks, outputs, strict=True)
        ]

    def _equations(self, block: Block, p: Mapping[str, Tensor], streams: Tensor) -> list[Tensor]:
        """The equations of motion over the gauge mass, then those of the hidden states' rates, (B, m) each."""
        n, rig = block.n_dof, block.rig
        paths, rates, accelerations = (list(streams[:, s].unbind(-1)) for s in range(3))
        x, v, a, z = paths[:n], rates[:n], accelerations[:n], paths[n:]
        motion = [r / p[self.gauge] for r in rig.residual(p, x, v, a, block.force, z, torch_ops)]
        wanted = rig.hidden_rates(p, x, v, block.force, z, torch_ops)
        return motion + [block.omega * (rate - own) for rate, own in zip(rates[n:], wanted, strict=True)]

    def _rows(self, outputs: Sequence[Tensor], physics: Sequence[Tensor], logs: Tensor, offsets: Tensor) -> Tensor:
        """The residual vectors, not yet scaled."""
        parts = []
        for block, out, own in zip(self.blocks, outputs, physics, strict=True):
            measured = (out[:, :, block.data_points] * block.pick).sum((1, 3))
            parts += [measured - block.values, own]
            parts.append(out[:, block.start_stream, 0, block.start_path] - block.start)
        if self.prior is not None:
            parts.append(logs[:, self.free] - self.prior[0])
        rows = torch.cat(parts, 1)
        return rows + offsets @ self._offset_rows.T if self.offsets else rows

    def _terms(self, rows: Tensor) -> Tensor:
        return (rows * rows) @ self.term_rows

    def _term_columns(self) -> Tensor:
        """Which row belongs to which term, (n_rows, 4), 0 and 1."""
        columns, at = np.zeros((self.n_rows, len(TERMS))), 0
        for block in self.blocks:
            for name, part in block.slices.items():
                columns[at + part.start : at + part.stop, TERMS.index(name)] = 1.0
            at += block.n_rows
        columns[at:, TERMS.index("prior")] = 1.0
        return torch.as_tensor(columns, device=self.device)

    def _offset_columns(self) -> Tensor:
        """Which data row has which channel's offset, (n_rows, n_offsets), 0 and 1."""
        columns, at = np.zeros((self.n_rows, len(self.offsets))), 0
        for i, block in enumerate(self.blocks):
            for k, (record, channel) in enumerate(self.offsets):
                if record == i:
                    columns[at + np.flatnonzero(block.channel == channel), k] = 1.0
            at += block.n_rows
        return torch.as_tensor(columns, device=self.device)

    def _physics_slopes(self, block: Block, output: Tensor, logs: Tensor) -> tuple[Tensor, Tensor]:
        """Derivatives of the scaled equations by the streams, (B, 3, n_paths, m, n_paths), and by the log-parameters,
        (B, n_paths, m, n_parameters).

        The residual acts point by point, so one reverse pass over the sum of its values gives the slopes at every
        point.
        """
        m = block.collocation
        streams = output[:, :, :m].detach().clone().requires_grad_(True)
        spread_logs = logs.detach()[:, None].expand(-1, m, -1).clone().requires_grad_(True)
        by_streams, by_logs = [], []
        with torch.enable_grad():
            p = dict(zip(self.system.names, spread_logs.exp().unbind(-1), strict=True))
            for equation in self._equations(block, p, streams):
                slopes = torch.autograd.grad(
                    equation.sum(), (streams, spread_logs), retain_graph=True, allow_unused=True, materialize_grads=True
                )
                by_streams.append(slopes[0])
                by_logs.append(slopes[1])
        return torch.stack(by_streams, 2), torch.stack(by_logs, 1)

    def linearise(self, state: State, deviations: Tensor) -> Linear:
        """Adjoints and explicit columns at a state."""
        parts, logs, _ = self.split(state.z)
        n_free = len(self.free)
        columns = torch.zeros(self.n_fits, self.n_rows, self.n_unknowns, dtype=torch.float64, device=self.device)
        adjoints, at = [], 0
        for k, (block, ansatz, tape) in enumerate(zip(self.blocks, self.ansatzes, state.tapes, strict=True)):
            own_deviations = deviations[:, at : at + block.n_rows]
            seeds, by_logs = self._seeds(block, state.outputs[k], logs)
            seeds /= own_deviations[:, None, :, None]
            physics = slice(at + block.slices["physics"].start, at + block.slices["physics"].stop)
            columns[:, physics, :n_free] = by_logs[..., self.free].flatten(1, 2)
            adjoints.append(ansatz.adjoint(parts[k], tape, seeds, block.points))
            at += block.n_rows
        if self.prior is not None:
            columns[:, at:, :n_free] = torch.eye(n_free, dtype=torch.float64, device=self.device)
        columns[:, :, n_free:] = self._offset_rows
        return Linear(adjoints, columns / deviations[..., None])

    def _seeds(self, block: Block, output: Tensor, logs: Tensor) -> tuple[Tensor, Tensor]:
        """Slopes of a record's rows by the ansatz' streams at their points, (B, 3, n_rows, n_paths), not yet scaled."""
        by_streams, by_logs = self._physics_slopes(block, output, logs)
        seeds = torch.zeros(self.n_fits, 3, block.n_rows, block.n_paths, dtype=torch.float64, device=self.device)
        seeds[:, :, block.slices["data"]] = block.pick
        seeds[:, :, block.slices["physics"]] = by_streams.flatten(2, 3)
        for row, (stream, path) in enumerate(zip(block.start_stream, block.start_path, strict=True)):
            seeds[:, stream, block.slices["initial"].start + row, path] = 1.0
        return block.response_adjoint(seeds, block.points), by_logs

    def gram(self, state: State, linear: Linear, unknowns: bool = True) -> Tensor:
        """``J Jᵀ``, (B, n_rows, n_rows); over the coefficients alone where ``unknowns`` is False."""
        total = linear.columns @ linear.columns.mT
        if not unknowns:
            total.zero_()
        at = 0
        for block, ansatz, tape, own in zip(self.blocks, self.ansatzes, state.tapes, linear.adjoints, strict=True):
            end = at + block.n_rows
            total[:, at:end, at:end] += ansatz.gram(tape, own, block.points)
            at = end
        return total

    def pull_back(self, state: State, linear: Linear, dual: Tensor) -> Tensor:
        """``Jᵀ dual``, vectors like z, for ``dual`` (B, n_rows)."""
        parts, at = [], 0
        for block, ansatz, tape, own in zip(self.blocks, self.ansatzes, state.tapes, linear.adjoints, strict=True):
            parts.append(ansatz.pull_back(tape, own, block.points, dual[:, at : at + block.n_rows]))
            at += block.n_rows
        return torch.cat([*parts, (dual[:, None] @ linear.columns)[:, 0]], 1)

    def jacobian_parts(self, state: State, linear: Linear) -> Iterator[tuple[slice, Tensor]]:
        """J itself, (B, n, n_z) at a time, with the rows that each part holds; the rows of the prior come last.

        One part is held at a time, so that J never stands in memory whole.
        """
        step = max(1, CHUNK // (self.n_fits * self.n_z))
        at, column = 0, 0
        for block, ansatz, tape, own in zip(self.blocks, self.ansatzes, state.tapes, linear.adjoints, strict=True):
            for first in range(0, block.n_rows, step):
                rows = slice(first, min(first + step, block.n_rows))
                place = slice(at + rows.start, at + rows.stop)
                part = self._empty_rows(rows.stop - rows.start)
                part[..., column : column + ansatz.count] = ansatz.jacobian(tape, own, block.points, rows)
                part[..., self.n_coefficients :] = linear.columns[:, place]
                yield place, part
            at += block.n_rows
            column += ansatz.count
        part = self._empty_rows(self.n_rows - at)
        part[..., self.n_coefficients :] = linear.columns[:, at:]
        yield slice(at, self.n_rows), part

    def normal_equations(self, state: State, linear: Linear) -> tuple[Tensor, Tensor, Tensor]:
        """``JᵀJ`` (B, n_z, n_z), ``Jᵀ r`` (B, n_z) and the largest squared row of J (B,)."""
        matrix = self.log_fixed.new_zeros(self.n_fits, self.n_z, self.n_z)
        gradient, size = torch.zeros_like(state.z), self.log_fixed.new_zeros(self.n_fits)
        for rows, j in self.jacobian_parts(state, linear):
            matrix += j.mT @ j
            gradient += (state.rows[:, None, rows] @ j)[:, 0]
            if j.shape[1]:
                size = torch.maximum(size, (j * j).sum(2).amax(1))
        return matrix, gradient, size

    def _empty_rows(self, n: int) -> Tensor:
        return torch.zeros(self.n_fits, n, self.n_z, dtype=torch.float64, device=self.device)

    def gradient(self, z: Tensor, deviations: Tensor) -> tuple[State, Tensor]:
        """The state at z and the gradient of its loss, vectors like z, by one adjoint pass over the points."""
        parts, logs, offsets = self.split(z)
        tapes = [ansatz.forward(part) for ansatz, part in zip(self.ansatzes, parts, strict=True)]
        outputs = [block.response(tape.output) for block, tape in zip(self.blocks, tapes, strict=True)]
        leaves = [output.detach().requires_grad_(True) for output in outputs]
        free_logs = logs.detach().requires_grad_(True)
        with torch.enable_grad():
            physics = self._physics(leaves, free_logs)
        rows = self._rows(outputs, [own.detach() for own in physics], logs, offsets) / deviations
        pulled = rows / deviations
        own_pulled, at = [], 0
        for block in self.blocks:
            own_pulled.append(pulled[:, at : at + block.n_rows])
            at += block.n_rows
        by_physics = [own[:, block.slices["physics"]] for own, block in zip(own_pulled, self.blocks, strict=True)]
        *seeds, by_logs = torch.autograd.grad(physics, [*leaves, free_logs], by_physics)
        gradients = []
        for k, (block, ansatz, tape) in enumerate(zip(self.blocks, self.ansatzes, tapes, strict=True)):
            own = own_pulled[k]
            seeds[k][:, :, block.data_points] = own[:, None, : block.n_data, None] * block.pick
            seeds[k][:, block.start_stream, 0, block.start_path] += own[:, block.slices["initial"]]
            adjoints = ansatz.adjoint(parts[k], tape, block.response_adjoint(seeds[k]))
            gradients.append(ansatz.pull_back(tape, adjoints, None))
        by_unknowns = by_logs[:, self.free]
        if self.prior is not None:
            by_unknowns = by_unknowns + pulled[:, at:]
        gradients += [by_unknowns, pulled @ self._offset_rows]
        return State(z, tapes, outputs, rows, self._terms(rows)), torch.cat(gradients, 1)
