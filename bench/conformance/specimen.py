"""A system under check, at typical parameters and random motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bench.conformance.check import Refusal
from bench.dynamics.ops import numpy_ops
from bench.systems import Kind, Ops, System

POINTS = 5
TYPICAL: Mapping[Kind, float] = {"mass": 1.0, "damping": 0.2, "stiffness": 8.0, "other": 0.5}
"""Typical parameters of each kind (SI units)."""


@dataclass(frozen=True)
class Motion:
    """Displacement, velocity, acceleration, force and hidden states, an array (n,) or a number per component."""

    x: Sequence[Any]
    v: Sequence[Any]
    a: Sequence[Any]
    f: Sequence[Any]
    z: Sequence[Any]

    @property
    def parts(self) -> tuple[Sequence[Any], ...]:
        """The fields in their order."""
        return self.x, self.v, self.a, self.f, self.z

    def changed(self, by: Callable[[Any], Any]) -> Motion:
        """Return the motion with every component changed."""
        return Motion(*([by(component) for component in part] for part in self.parts))

    def at(self, i: int) -> Motion:
        """Return the plain numbers of one instant."""
        return self.changed(lambda component: float(component[i]))


@dataclass(frozen=True, eq=False)
class Specimen:
    """A system as it is registered: its name and options, and the instance."""

    name: str
    options: Mapping[str, Any]
    system: System

    @cached_property
    def parameters(self) -> dict[str, float]:
        """Typical parameters, no two of a kind alike."""
        return {p.name: TYPICAL[p.kind] * 1.1**i for i, p in enumerate(self.system.parameters)}

    @cached_property
    def motion(self) -> Motion:
        """Random motion at ``POINTS`` instants."""
        rng = np.random.default_rng(7)
        n, hidden = self.system.n_dof, self.system.n_hidden
        return Motion(*([rng.standard_normal(POINTS) for _ in range(size)] for size in (n, n, n, n, hidden)))

    def rows(self, p: Mapping[str, Any], m: Motion, ops: Ops = numpy_ops) -> list[Any]:
        """Return the residual and the rates of the hidden states; raises Refusal for a wrong number of them."""
        residual = self.system.residual(p, m.x, m.v, m.a, m.f, m.z, ops)
        if not isinstance(residual, list | tuple) or len(residual) != self.system.n_dof:
            count = len(residual) if isinstance(residual, list | tuple) else f"a {type(residual).__name__}"
            raise Refusal(f"residual returned {count} for {self.system.n_dof} DOF")
        rates = self.system.hidden_rates(p, m.x, m.v, m.f, m.z, ops)
        if len(rates) != self.system.n_hidden:
            raise Refusal(f"hidden_rates returned {len(rates)} for n_hidden = {self.system.n_hidden}")
        return [*residual, *rates]

    def numbers(self, p: Mapping[str, Any], m: Motion, ops: Ops = numpy_ops) -> np.ndarray:
        """Return :meth:`rows` as numbers, shape (n_dof + n_hidden, n)."""
        return np.array([np.broadcast_to(np.asarray(row, float), np.shape(m.x[0])) for row in self.rows(p, m, ops)])
