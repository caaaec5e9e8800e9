"""A system under check, at random parameters and motions."""

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
"""About what parameters of each kind are, in SI units."""


@dataclass(frozen=True)
class Motion:
    """Displacement, velocity, acceleration, force and hidden states, an array (n,) or a number a component."""

    x: Sequence[Any]
    v: Sequence[Any]
    a: Sequence[Any]
    f: Sequence[Any]
    z: Sequence[Any]

    @property
    def parts(self) -> tuple[Sequence[Any], ...]:
        """In the order of the fields."""
        return self.x, self.v, self.a, self.f, self.z

    def changed(self, by: Callable[[Any], Any]) -> Motion:
        """The motion with every component changed."""
        return Motion(*([by(component) for component in part] for part in self.parts))

    def at(self, i: int) -> Motion:
        """The plain numbers of one instant."""
        return self.changed(lambda component: float(component[i]))


@dataclass(frozen=True, eq=False)
class Specimen:
    """A system as it is registered: its name and options, and the instance."""

    name: str
    options: Mapping[str, Any]
    system: System

    @cached_property
    def parameters(self) -> dict[str, float]:
        """Of every kind about what is usual, all different."""
        return {p.name: TYPICAL[p.kind] * 1.1**i for i, p in enumerate(self.system.parameters)}

    @cached_property
    def motion(self) -> Motion:
        rng = np.random.default_rng(7)
        n, hidden = self.system.n_dof, self.system.n_hidden
        return Motion(*([rng.standard_normal(POINTS) for _ in range(size)] for size in (n, n, n, n, hidden)))

    def residual(self, p: Mapping[str, Any], m: Motion, ops: Ops = numpy_ops) -> list[Any]:
        """The residual, one entry a DOF; raises Refusal for another number of them."""
        rows = self.system.residual(p, m.x, m.v, m.a, m.f, m.z, ops)
        if not isinstance(rows, list | tuple) or len(rows) != self.system.n_dof:
            said = len(rows) if isinstance(rows, list | tuple) else f"a {type(rows).__name__}"
            raise Refusal(f"residual returned {said} for {self.system.n_dof} DOF")
        return list(rows)

    def numbers(self, p: Mapping[str, Any], m: Motion, ops: Ops = numpy_ops) -> np.ndarray:
        """The residual and the rates of the hidden states as numbers, shape (n_dof + n_hidden, n)."""
        rates = self.system.hidden_rates(p, m.x, m.v, m.f, m.z, ops)
        if len(rates) != self.system.n_hidden:
            raise Refusal(f"hidden_rates returned {len(rates)} for n_hidden = {self.system.n_hidden}")
        rows = [*self.residual(p, m, ops), *rates]
        return np.array([np.broadcast_to(np.asarray(row, float), np.shape(m.x[0])) for row in rows])
