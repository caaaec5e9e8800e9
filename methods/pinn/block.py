"""The rows of one record in the residual vector: evaluation points and standard deviations.

Every tensor has a leading axis over fits, B (see :mod:`methods.pinn.residuals`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench import Problem, Record, System
from methods.network.ansatz import Local
from methods.starts.forced_motion import forced_dofs
from methods.starts.waves import ORDER


def structure(problem: Problem) -> tuple[object, ...]:
    """Return the properties that problems of one batch must share."""
    records = tuple(
        (
            tuple((c.n, c.measures, c.dof, c.offset) for c in r.channels),
            r.initial_state is not None,
            forced_dofs(r.forces),
        )
        for r in problem.records
    )
    rigs = tuple(record.rig(problem.system) for record in problem.records)
    return rigs, records, problem.prior is not None, problem.forced


@dataclass(frozen=True)
class Spread:
    """Standard deviations of the rows of each fit, in natural units.

    Of the channels of all records, (B, n_channels); of the equations of motion and of the hidden states
    (accelerations), and of the known initial displacement and velocity, (B,) each.
    """

    channels: np.ndarray
    physics: np.ndarray
    hidden: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray


class Block:
    """One record of every fit: its ``rig``, evaluation points of the response, and the point of each row."""

    def __init__(
        self,
        records: Sequence[Record],
        system: System,
        collocation: int,
        device: torch.device,
        omega: np.ndarray,
        exact: bool,
    ) -> None:
        def tensor(values: object) -> Tensor:
            return torch.as_tensor(np.array(values), device=device)

        first = records[0]
        self.rig = first.rig(system)
        self.n_dof, self.n_data, self.collocation = system.n_dof, first.n, collocation
        self.n_paths = system.n_dof + system.n_hidden
        self.omega = tensor(omega)[:, None]
        self.duration = np.array([r.duration for r in records])
        grids = [np.linspace(0.0, r.duration, collocation) for r in records]
        self.times = np.stack(
            [np.concatenate([grid, *[c.times for c in r.channels]]) for grid, r in zip(grids, records, strict=True)]
        )
        self.values = tensor([np.concatenate([c.values for c in r.channels]) for r in records])
        forces = [r.force(grid, system.n_dof) for r, grid in zip(records, grids, strict=True)]
        self.force = [tensor([force[dof] for force in forces]) for dof in range(system.n_dof)]
        stream = np.concatenate([np.full(c.n, ORDER[c.measures]) for c in first.channels])
        dof = np.concatenate([np.full(c.n, c.dof) for c in first.channels])
        self.channel = np.concatenate([np.full(c.n, i) for i, c in enumerate(first.channels)])
        self.data_points = collocation + torch.arange(self.n_data, device=device)
        self.pick = tensor(np.eye(3)[:, stream, None] * np.eye(self.n_paths)[dof])  # (3, n_data, n_paths), 0 and 1
        known = None
        if first.initial_state is not None:
            states = [r.initial_state for r in records if r.initial_state is not None]
            known = np.stack([np.stack([s.displacement, s.velocity]) for s in states])
        self.lift = self.shape = None
        # rows of the initial state: displacements, then velocities, then the hidden states, which are zero
        n_known = 2 * self.n_dof if known is not None and not exact else 0
        n_start = n_known + system.n_hidden
        self.start = torch.zeros(len(records), n_start, dtype=torch.float64, device=device)
        if known is not None and n_known:
            self.start[:, :n_known] = tensor(known).flatten(1)
        self.start_stream = [i // self.n_dof for i in range(n_known)] + [0] * system.n_hidden
        self.start_path = [i % self.n_dof for i in range(n_known)] + list(range(self.n_dof, self.n_paths))
        if known is not None and exact:
            lift, shape = exact_start(self.times, known, omega)
            self.lift, self.shape = tensor(lift), tensor(shape)
        # rows: data, physics of each path, initial state; time 0 is the first collocation point
        physics = torch.arange(collocation, device=device).repeat(self.n_paths)
        self.points = torch.cat([self.data_points, physics, torch.zeros(n_start, dtype=torch.long, device=device)])
        self.n_rows = self.points.shape[0]
        self.slices = {
            "data": slice(0, self.n_data),
            "physics": slice(self.n_data, self.n_data + physics.shape[0]),
            "initial": slice(self.n_rows - n_start, self.n_rows),
        }

    def response(self, output: Tensor) -> Tensor:
        """Return the derivatives of the response from those of the trainable function."""
        if self.lift is None or self.shape is None:
            return output
        return self.lift + torch.einsum("bnst,btno->bsno", self.shape, output)

    def response_adjoint(self, seeds: Tensor, points: Tensor | None = None) -> Tensor:
        """Transform adjoint seeds of the response to those of the trainable function."""
        if self.shape is None:
            return seeds
        shape = self.shape if points is None else self.shape[:, points]
        return torch.einsum("bkst,bsko->btko", shape, seeds)

    def local_ansatz(
        self, functions: Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]], count: int
    ) -> Local:
        """Return an ansatz linear in ``count`` functions of local support.

        ``functions`` evaluates those that are non-zero, for times and a duration: values and derivatives
        (3, n, n_local), and the index of the first one, (n,).
        """
        pairs = [functions(times, float(duration)) for times, duration in zip(self.times, self.duration, strict=True)]
        values, first = (torch.as_tensor(np.stack(p), device=self.values.device) for p in zip(*pairs, strict=True))
        return Local(values, first, count, self.n_paths)

    def take(self, who: Tensor) -> Block:
        other = copy.copy(self)
        which = np.asarray(who.cpu())
        other.times, other.duration = self.times[which], self.duration[which]
        other.values, other.force = self.values[who], [f[who] for f in self.force]
        other.start, other.omega = self.start[who], self.omega[who]
        if self.lift is not None and self.shape is not None:
            other.lift, other.shape = self.lift[who], self.shape[who]
        return other


def exact_start(times: np.ndarray, known: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Build a known initial state into an ansatz: ``x(t) = (x0 + v0 t) g + (1 - g) n(t)``.

    ``g = exp(-(omega t)²)`` and n is the trainable function. Returns the derivatives 0 to 2 of the first term,
    (B, 3, n_points, n_dof), and the matrices that map those of n to those of the second term, (B, n_points, 3, 3).
    """
    t, w2 = times, omega[:, None] ** 2
    g = np.exp(-w2 * t**2)
    g1, g2 = -2.0 * w2 * t * g, (4.0 * w2**2 * t**2 - 2.0 * w2) * g
    x0, v0 = known[:, 0, None, :], known[:, 1, None, :]
    line = x0 + v0 * t[..., None]
    g_, g1_, g2_ = (part[..., None] for part in (g, g1, g2))
    lift = np.stack([line * g_, v0 * g_ + line * g1_, 2.0 * v0 * g1_ + line * g2_], 1)
    zero = np.zeros_like(g)
    shape = np.stack([1.0 - g, zero, zero, -g1, 1.0 - g, zero, -g2, -2.0 * g1, 1.0 - g], -1)
    return lift, shape.reshape(*g.shape, 3, 3)
