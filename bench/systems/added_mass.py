"""A system that carries known masses, for the record of a rig to which one was added."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from bench.systems.contract import MASS, Dimension, Parameter, Quantity, System


@dataclass(frozen=True)
class LoadedSystem(System):
    """``system`` with ``added`` (kg, one a DOF): ``added_i a_i`` joins the residual of DOF i, whatever the system is.

    A known mass gives free vibration its scale: two records, with and without it, tell every parameter.
    """

    system: System
    added: tuple[float, ...]
    name: ClassVar[str] = "loaded"

    def __post_init__(self) -> None:
        for declared in ("linear", "affine_in_parameters", "smooth"):
            object.__setattr__(self, declared, getattr(self.system, declared))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.system.parameters

    @property
    def n_dof(self) -> int:
        return self.system.n_dof

    @property
    def n_hidden(self) -> int:
        return self.system.n_hidden

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        own = self.system.residual(p, x, v, a, f, z, ops)
        return [r + mass * a_i for r, mass, a_i in zip(own, self.added, a, strict=True)]

    def hidden_rates(self, p, x, v, f, z, ops):  # type: ignore[no-untyped-def]
        return self.system.hidden_rates(p, x, v, f, z, ops)

    def rescaled(self, scale: Callable[[Dimension], float]) -> Self:
        added = tuple(mass / scale(MASS) for mass in self.added)
        return replace(self, system=self.system.rescaled(scale), added=added)

    @property
    def groups(self) -> tuple[Quantity, ...]:
        """Those of the system; with the added mass told, its parameters are identifiable too."""
        return self.system.groups
