"""A system with known additional masses, for records of a structure to which masses were attached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from bench.systems.contract import MASS, Dimension, Parameter, Quantity, System


@dataclass(frozen=True)
class LoadedSystem(System):
    """``system`` with additional masses ``added`` (kg, one per DOF); ``added_i a_i`` is added to the residual of DOF i.

    A known mass determines the scale in free vibration: from two records, with and without it, every parameter is
    identifiable.
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
        residual = self.system.residual(p, x, v, a, f, z, ops)
        return [r + mass * a_i for r, mass, a_i in zip(residual, self.added, a, strict=True)]

    def hidden_rates(self, p, x, v, f, z, ops):  # type: ignore[no-untyped-def]
        return self.system.hidden_rates(p, x, v, f, z, ops)

    def rescaled(self, scale: Callable[[Dimension], float]) -> Self:
        added = tuple(mass / scale(MASS) for mass in self.added)
        return replace(self, system=self.system.rescaled(scale), added=added)

    @property
    def groups(self) -> tuple[Quantity, ...]:
        """Groups of the system without the added masses."""
        return self.system.groups
