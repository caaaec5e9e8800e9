"""The residual vector of an inverse PINN and its linearisation.

Each row is divided by its standard deviation, so that half the squared norm is minus the log posterior:

data      response minus measurement, over the channel's noise
physics   the equation of motion at the collocation points over the gauge mass (an acceleration), over its standard
          deviation; likewise the error of each hidden state's rate, times the frequency in the data
initial   response minus known initial state, over a small part of the noise (absent where the ansatz has it exactly);
          hidden states start at zero
prior     log-parameters minus their nominal values, over the prior's standard deviations

Without division by the gauge mass, m x'' + c x' + k x would vanish when all parameters tend to zero.

Every tensor has a leading axis over fits, B: the problems of one batch have the same system, channels and numbers of
samples.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from bench import Problem, array_ops
from methods.network.ansatz import Adjoints, Ansatz, MixedAnsatz, Tape
from methods.pinn.block import Block, Spread

TERMS = ("data", "physics", "initial", "prior")
CHUNK = 2**24
"""Largest number of entries of J in memory while normal equations are accumulated."""

torch_ops = array_ops(torch, lambda *entries: torch.broadcast_tensors(*map(torch.as_tensor, entries)))
"""The torch functions available to equations of motion."""


@dataclass
class State:
    """The residual vectors at a point z (B, n_z), with intermediate results for their linearisation.

    ``outputs``: responses with their derivatives, one tensor per record; ``rows`` (B, n_rows); ``terms`` (B, 4):
    squared norm of each term.
    """

    z: Tensor
    tapes: list[Tape]
    outputs: list[Tensor]
    rows: Tensor
    terms: Tensor

    @property
    def loss(self) -> np.ndarray:
        """Return half the squared norm of each vector, (B,)."""
        return np.asarray(0.5 * self.terms.sum(1).cpu())


@dataclass
class Linear:
    """The linearisation at a state.

    ``seeds``, one (B, 3, n_rows, n_paths) per record: slopes of the rows by the ansatz and its derivatives.
    ``adjoints``, one per record: slopes by the layers of the ansatz. ``columns`` (B, n_rows, n_unknowns): slopes by the
    free log-parameters, then by the offsets.
    """

    seeds: list[Tensor]
    adjoints: list[Adjoints]
    columns: Tensor


AnsatzMaker = Callable[[int, Block], Ansatz]
"""A function that returns the ansatz of a record, given its index and its block."""


class Residuals:
    """The residual vectors of problems (in natural units) as a function of ``z``: coefficients, then other unknowns.

    The other unknowns are the logarithms of the ``free`` parameters, then the offset of each channel that has one.
    Parameters that are not free have the values ``log_fixed`` (B, n_parameters). ``omega`` (B,): frequencies of the
    data. ``exact``: build a known initial state into the response (:func:`methods.pinn.block.exact_start`). ``shift``
    (B, n_rows): multipliers of an augmented Lagrangian, added to the rows.
    """

    shift: Tensor | None = None

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
        self.fixed = False
        self.log_fixed = torch.as_tensor(np.array(log_fixed), device=self.device)
        self.prior: tuple[Tensor, Tensor] | None = None
        if first.prior is not None:
            normals = [(p.prior.log_mean[self.free], p.prior.log_sds[self.free]) for p in problems if p.prior]
            means, sds = (torch.as_tensor(np.array(part), device=self.device) for part in zip(*normals, strict=True))
            self.prior = means, sds
        channels = [channel for record in first.records for channel in record.channels]
        self.n_channels = len(channels)
        self.kinds = self._kinds()
        self.n_rows = self.kinds.size
        offsets = np.flatnonzero([channel.offset for channel in channels])
        self.n_offsets = offsets.size
        self.offset_rows = torch.as_tensor((self.kinds[:, None] == offsets).astype(float), device=self.device)
        term = np.array([*[0] * self.n_channels, 1, 1, 2, 2, 3])[self.kinds]
        self.term_rows = torch.as_tensor(np.eye(len(TERMS))[term], device=self.device)

    def _kinds(self) -> np.ndarray:
        """Return the kind of each row: its channel, then physics, hidden states, initial x and v, prior."""
        kinds, first = [], 0
        for block in self.blocks:
            paths = np.repeat(np.arange(block.n_paths) >= block.n_dof, block.collocation)
            others = [paths.astype(int), 2 + np.array(block.start_stream, int)]
            kinds += [first + block.channel, *(self.n_channels + kind for kind in others)]
            first += int(block.channel[-1]) + 1
        return np.concatenate([*kinds, np.full(len(self.free) if self.prior else 0, self.n_channels + 4)])

    @property
    def n_fits(self) -> int:
        return int(self.log_fixed.shape[0])

    @property
    def n_coefficients(self) -> int:
        return sum(a.count for a in self.ansatzes)

    @property
    def n_unknowns(self) -> int:
        return len(self.free) + self.n_offsets

    @property
    def n_z(self) -> int:
        return self.n_coefficients + self.n_unknowns

    def take(self, who: np.ndarray) -> Residuals:
        """Return the residual vectors of the fits with indices ``who`` (k,)."""
        if who.size == self.n_fits:
            return self
        index = torch.as_tensor(who, device=self.device)
        other = copy.copy(self)
        other.blocks = [block.take(index) for block in self.blocks]
        other.ansatzes = [ansatz.take(index) for ansatz in self.ansatzes]
        other.log_fixed = self.log_fixed[index]
        other.prior = None if self.prior is None else (self.prior[0][index], self.prior[1][index])
        other.shift = None if self.shift is None else self.shift[index]
        return other

    def hold(self) -> Residuals:
        """Return the same vectors with fixed parameters."""
        other = copy.copy(self)
        other.fixed = True
        return other

    def heads(self, z: Tensor) -> tuple[Residuals, Tensor]:
        """Return the residual vectors as a function of output layers and other unknowns, and these at z."""
        other = copy.copy(self)
        parts, rest = self.split_flat(z)
        pairs = [a.head(part) for a, part in zip(self.ansatzes, parts, strict=True)]
        other.ansatzes = [basis for basis, _ in pairs]
        return other, torch.cat([*[head for _, head in pairs], rest], 1)

    def with_heads(self, z: Tensor, short: Tensor) -> Tensor:
        """Return z with output layers and other unknowns replaced by the vector ``short`` of :meth:`heads`."""
        parts, _ = self.split_flat(z)
        sizes = [a.head(part)[0].count for a, part in zip(self.ansatzes, parts, strict=True)]
        *heads, rest = short.split([*sizes, self.n_unknowns], 1)
        whole = [a.with_head(p, o) for a, p, o in zip(self.ansatzes, parts, heads, strict=True)]
        return torch.cat([*whole, rest], 1)

    def mixed(self, z: Tensor, deviations: Tensor) -> tuple[Residuals, Tensor]:
        """Return the residual vectors for coefficients with which J has orthonormal columns at z, and these.

        Random features are so similar that the singular values of J span twelve decades, and damped steps along the
        small ones take hundreds of iterations. Splines are unchanged.
        """
        other = copy.copy(self)
        parts, rest = self.split_flat(z)
        state = self.evaluate(z, deviations)
        records = zip(self.blocks, self.ansatzes, state.tapes, self.linearise(state, deviations).adjoints, strict=True)
        other.ansatzes = [
            a if a.local else MixedAnsatz.of(a, a.jacobian(tape, adjoints, block.points))
            for block, a, tape, adjoints in records
        ]
        return other, torch.cat([*[a.mixed(part) for a, part in zip(other.ansatzes, parts, strict=True)], rest], 1)

    def unmixed(self, z: Tensor) -> Tensor:
        """Return z with the coefficients before :meth:`mixed`."""
        parts, rest = self.split_flat(z)
        return torch.cat([*[a.unmixed(part) for a, part in zip(self.ansatzes, parts, strict=True)], rest], 1)

    def split_flat(self, z: Tensor) -> tuple[list[Tensor], Tensor]:
        """Return the coefficients of each record's ansatz, and the other unknowns."""
        *parts, rest = z.split([*[a.count for a in self.ansatzes], self.n_unknowns], 1)
        return parts, rest

    def split(self, z: Tensor) -> tuple[list[Tensor], Tensor, Tensor]:
        """Return the coefficients of each record's ansatz, all log-parameters (B, n_parameters), offsets."""
        parts, rest = self.split_flat(z)
        logs = self.log_fixed.clone()
        logs[:, self.free] = rest[:, : len(self.free)]
        return parts, logs, rest[:, len(self.free) :]

    def deviations(self, spread: Spread) -> Tensor:
        """Return the standard deviation of every row, (B, n_rows)."""
        others = np.stack([spread.physics, spread.hidden, spread.displacement, spread.velocity], 1)
        by_kind = np.concatenate([spread.channels, others], 1)
        n = self.n_rows if self.prior is None else self.n_rows - len(self.free)
        deviations = torch.as_tensor(by_kind[:, self.kinds[:n]], device=self.device)
        return deviations if self.prior is None else torch.cat([deviations, self.prior[1]], 1)

    def evaluate(self, z: Tensor, deviations: Tensor) -> State:
        """Compute the residual vectors at z, and the squared norm of each term."""
        parts, logs, offsets = self.split(z)
        tapes = [ansatz.forward(part) for ansatz, part in zip(self.ansatzes, parts, strict=True)]
        outputs = [block.response(tape.output) for block, tape in zip(self.blocks, tapes, strict=True)]
        rows = self.rows(outputs, logs, offsets) / deviations
        return State(z, tapes, outputs, rows, (rows * rows) @ self.term_rows)

    def rows(self, outputs: Sequence[Tensor], logs: Tensor, offsets: Tensor) -> Tensor:
        """Compute the unscaled residual vectors from responses and their derivatives."""
        p = {name: value[:, None] for name, value in zip(self.system.names, logs.exp().unbind(1), strict=True)}
        parts = []
        for block, out in zip(self.blocks, outputs, strict=True):
            parts.append((out[:, :, block.data_points] * block.pick).sum((1, 3)) - block.values)
            parts += self._equations(block, p, out[:, :, : block.collocation])
            parts.append(out[:, block.start_stream, 0, block.start_path] - block.start)
        if self.prior is not None:
            parts.append(logs[:, self.free] - self.prior[0])
        rows = torch.cat(parts, 1)
        rows = rows + offsets @ self.offset_rows.T if self.n_offsets else rows
        return rows if self.shift is None else rows + self.shift

    def plain(self, state: State, deviations: Tensor) -> Tensor:
        """Return the rows of a state in natural units, without the multipliers."""
        rows = state.rows * deviations
        return rows if self.shift is None else rows - self.shift

    def _equations(self, block: Block, p: Mapping[str, Tensor], streams: Tensor) -> list[Tensor]:
        """Compute the equations of motion over the gauge mass, then those of the hidden states' rates, (B, m) each."""
        n, rig = block.n_dof, block.rig
        paths, rates, accelerations = (list(streams[:, s].unbind(-1)) for s in range(3))
        x, v, a, z = paths[:n], rates[:n], accelerations[:n], paths[n:]
        motion = [r / p[self.system.gauge] for r in rig.residual(p, x, v, a, block.force, z, torch_ops)]
        wanted = rig.hidden_rates(p, x, v, block.force, z, torch_ops)
        return motion + [block.omega * (rate - target) for rate, target in zip(rates[n:], wanted, strict=True)]

    def linearise(self, state: State, deviations: Tensor) -> Linear:
        """Linearise the vectors at a state."""
        parts, _, _ = self.split(state.z)
        seeds, columns = self._slopes(state, deviations)
        records = zip(self.blocks, self.ansatzes, parts, state.tapes, seeds, strict=True)
        adjoints = [ansatz.adjoint(part, tape, seed, block.points) for block, ansatz, part, tape, seed in records]
        return Linear(seeds, adjoints, columns)

    def gradient(self, z: Tensor, deviations: Tensor) -> tuple[State, Tensor]:
        """Compute the state at z and the gradient of its loss, (B, n_z), by one adjoint pass."""
        state = self.evaluate(z, deviations)
        parts, _, _ = self.split(z)
        seeds, columns = self._slopes(state, deviations)
        gradients, first = [], 0
        for block, ansatz, part, tape, seed in zip(self.blocks, self.ansatzes, parts, state.tapes, seeds, strict=True):
            weighted = seed * state.rows[:, None, first : first + block.n_rows, None]
            by_point = torch.zeros_like(tape.output).index_add_(2, block.points, weighted)
            gradients.append(ansatz.pull_back(tape, ansatz.adjoint(part, tape, by_point), None))
            first += block.n_rows
        return state, torch.cat([*gradients, (state.rows[:, None] @ columns)[:, 0]], 1)

    def _slopes(self, state: State, deviations: Tensor) -> tuple[list[Tensor], Tensor]:
        """Compute seeds and columns of :class:`Linear`."""
        logs, n_free = self.split(state.z)[1], len(self.free)
        columns = torch.zeros(self.n_fits, self.n_rows, self.n_unknowns, dtype=torch.float64, device=self.device)
        all_seeds, first = [], 0
        for block, output in zip(self.blocks, state.outputs, strict=True):
            rows = slice(first, first + block.n_rows)
            data, physics, initial = block.slices.values()
            by_streams, by_logs = self._physics_slopes(block, output, logs)
            columns[:, rows][:, physics, :n_free] = by_logs[..., self.free]
            seeds = torch.zeros(self.n_fits, 3, block.n_rows, block.n_paths, dtype=torch.float64, device=self.device)
            seeds[:, :, data], seeds[:, :, physics] = block.pick, by_streams
            for row, (stream, path) in enumerate(zip(block.start_stream, block.start_path, strict=True), initial.start):
                seeds[:, stream, row, path] = 1.0
            all_seeds.append(block.response_adjoint(seeds, block.points) / deviations[:, None, rows, None])
            first += block.n_rows
        if self.prior is not None:
            columns[:, first:, :n_free] = torch.eye(n_free, dtype=torch.float64, device=self.device)
        columns[:, :, n_free:] = self.offset_rows
        if self.fixed:
            columns[:, :, :n_free] = 0.0
        return all_seeds, columns / deviations[..., None]

    def _physics_slopes(self, block: Block, output: Tensor, logs: Tensor) -> tuple[Tensor, Tensor]:
        """Differentiate the equations of motion.

        Each equation depends on one point, so one reverse pass over the sum of its values gives the slopes at all.

        Returns:
            Slopes by the response and its derivatives, (B, 3, n_rows, n_paths), and by the log-parameters,
            (B, n_rows, n_parameters).
        """
        streams = output[:, :, : block.collocation].detach().clone().requires_grad_(True)
        point_logs = logs.detach()[:, None].expand(-1, block.collocation, -1).clone().requires_grad_(True)
        with torch.enable_grad():
            p = dict(zip(self.system.names, point_logs.exp().unbind(-1), strict=True))
            totals = [equation.sum() for equation in self._equations(block, p, streams)]
            inputs = streams, point_logs
            slopes = [torch.autograd.grad(t, inputs, retain_graph=True, materialize_grads=True) for t in totals]
        by_streams, by_logs = zip(*slopes, strict=True)
        return torch.cat(by_streams, 2), torch.cat(by_logs, 1)

    def gram(self, state: State, linear: Linear) -> Tensor:
        """Compute ``J Jᵀ``, (B, n_rows, n_rows)."""
        total, first = linear.columns @ linear.columns.mT, 0
        for block, ansatz, tape, adjoint in zip(self.blocks, self.ansatzes, state.tapes, linear.adjoints, strict=True):
            rows = slice(first, first + block.n_rows)
            total[:, rows, rows] += ansatz.gram(tape, adjoint, block.points)
            first += block.n_rows
        return total

    def pull_back(self, state: State, linear: Linear, dual: Tensor) -> Tensor:
        """Compute ``Jᵀ dual``, (B, n_z), for ``dual`` (B, n_rows)."""
        parts, first = [], 0
        for block, ansatz, tape, adjoint in zip(self.blocks, self.ansatzes, state.tapes, linear.adjoints, strict=True):
            parts.append(ansatz.pull_back(tape, adjoint, block.points, dual[:, first : first + block.n_rows]))
            first += block.n_rows
        return torch.cat([*parts, (dual[:, None] @ linear.columns)[:, 0]], 1)

    def jacobian_parts(self, state: State, linear: Linear) -> Iterator[tuple[slice, Tensor]]:
        """Yield J in blocks of rows (B, n, n_z), with their slices; the rows of the prior come last."""
        step = max(1, CHUNK // (self.n_fits * self.n_z))
        start, column = 0, 0
        for block, ansatz, tape, adjoint in zip(self.blocks, self.ansatzes, state.tapes, linear.adjoints, strict=True):
            for first in range(0, block.n_rows, step):
                rows = slice(first, min(first + step, block.n_rows))
                place = slice(start + rows.start, start + rows.stop)
                j = ansatz.jacobian(tape, adjoint, block.points, rows)
                j = pad(j, (column, self.n_z - column - ansatz.count))
                j[..., self.n_coefficients :] = linear.columns[:, place]
                yield place, j
            start += block.n_rows
            column += ansatz.count
        yield slice(start, self.n_rows), pad(linear.columns[:, start:], (self.n_coefficients, 0))
