"""A vibrating system: one residual, its parameters, and the groups that free vibration can tell.

A system is written once, as the residual of its equation of motion, in plain operators on sequences of
degree-of-freedom (DOF) components. numpy, jax, torch, casadi and sympy all run that same line; everything
else (regression columns, mass matrix, acceleration, simulation, sensitivities) is derived from it in
:mod:`bench.dynamics.mechanics`, :mod:`bench.dynamics.simulate` and :mod:`bench.information.fisher`.

No true value stands here: a system knows names, units and dimensions, never numbers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Literal, Self

Kind = Literal["mass", "damping", "stiffness", "other"]
"""What a parameter is; a prior's width is stated by kind."""

Array = Any
"""A component in whatever library runs the residual: numpy, jax, torch, casadi or sympy."""

Components = Sequence[Array]
"""One entry per DOF (or per hidden state); entries may be scalars, arrays or symbols."""


@dataclass(frozen=True)
class Ops:
    """The functions beyond plain operators that a residual may call, for the library at hand."""

    sin: Callable[[Array], Array]
    cos: Callable[[Array], Array]
    tanh: Callable[[Array], Array]
    exp: Callable[[Array], Array]
    abs: Callable[[Array], Array]
    where: Callable[[Array, Array, Array], Array]
    solve: Callable[[Sequence[Sequence[Array]], Components], Components]
    """``solve(matrix_rows, right_hand_side)``: the components of the solution of a linear system."""


@dataclass(frozen=True)
class Dimension:
    """Exponents of mass, length and time, e.g. ``Dimension(1, 0, -2)`` for a stiffness in N/m."""

    mass: float = 0.0
    length: float = 0.0
    time: float = 0.0

    def __add__(self, other: Dimension) -> Dimension:
        return Dimension(self.mass + other.mass, self.length + other.length, self.time + other.time)

    def __mul__(self, power: float) -> Dimension:
        return Dimension(self.mass * power, self.length * power, self.time * power)


LENGTH = Dimension(0, 1, 0)
FORCE = Dimension(1, 1, -2)
MEASURED = {"displacement": LENGTH, "velocity": Dimension(0, 1, -1), "acceleration": Dimension(0, 1, -2)}


@dataclass(frozen=True)
class Parameter:
    """A physical parameter: its name, SI unit, kind and dimension. All are positive, hence have a logarithm."""

    name: str
    unit: str
    kind: Kind
    dimension: Dimension


@dataclass(frozen=True)
class Quantity:
    """A product of powers of parameters, ``coefficient * prod(p ** exponent)``; linear in their logarithms.

    Parameters themselves, identifiable groups (k/m, c/m), natural frequency and damping ratio are all of this
    form, so a bound or a covariance in log-parameters carries over to them exactly.
    """

    name: str
    unit: str
    exponents: Mapping[str, float]
    coefficient: float = 1.0

    def value(self, parameters: Mapping[str, Any]) -> Any:
        """The quantity at the parameters (floats or arrays of one shape)."""
        result: Any = self.coefficient
        for name, power in self.exponents.items():
            result = result * parameters[name] ** power
        return result

    def vector(self, names: Sequence[str]) -> list[float]:
        """The exponents in the order of ``names``: the gradient of log(quantity) by the log-parameters."""
        return [float(self.exponents.get(name, 0.0)) for name in names]


class System(ABC):
    """One residual and what it declares. Subclasses are frozen dataclasses without true values."""

    name: ClassVar[str]
    version: ClassVar[int] = 1
    """Raised where a change of the equations alters results: stored cells of another version are stale."""
    linear: ClassVar[bool] = False
    """Affine in displacement, velocity and acceleration, with coefficients that do not depend on time."""
    affine_in_parameters: ClassVar[bool] = True
    """The residual is affine in the parameters, so it has regression columns."""

    smooth: ClassVar[bool] = True
    """Nothing in the equations bends suddenly, as a modulus or dry friction does; else integrated with more care."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters, in the order used by every vector and matrix over them."""

    @property
    def n_dof(self) -> int:
        return 1

    @property
    def n_hidden(self) -> int:
        """Number of hidden first-order states z (Bouc-Wen has one)."""
        return 0

    @abstractmethod
    def residual(
        self,
        p: Mapping[str, Array],
        x: Components,
        v: Components,
        a: Components,
        f: Components,
        z: Components,
        ops: Ops,
    ) -> list[Array]:
        """The equation of motion as ``r = 0``, one entry a DOF, affine in the accelerations ``a``.

        ``x``, ``v``, ``a`` are displacement (m), velocity and acceleration by DOF, ``f`` the known force (N) on
        each DOF (zero where none acts), ``z`` the hidden states.
        """

    def hidden_rates(
        self, p: Mapping[str, Array], x: Components, v: Components, f: Components, z: Components, ops: Ops
    ) -> list[Array]:
        """The time derivatives of the hidden states, one entry each."""
        return []

    @property
    @abstractmethod
    def groups(self) -> tuple[Quantity, ...]:
        """The identifiable groups in free vibration; checked in the tests against the Fisher information."""

    @property
    def modal(self) -> tuple[Quantity, ...]:
        """Natural frequency, damping ratio, where they are products of powers."""
        return ()

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def gauge(self) -> str:
        """The parameter that the groups are ratios to: the first mass."""
        return next(p.name for p in self.parameters if p.kind == "mass")

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Everything that is scored, each once: parameters, groups (a parameter may be one) and modal quantities."""
        own = tuple(Quantity(p.name, p.unit, {p.name: 1.0}) for p in self.parameters)
        names = {q.name for q in own}
        return own + tuple(group for group in self.groups if group.name not in names) + self.modal

    def rescaled(self, scale: Callable[[Dimension], float]) -> Self:
        """The same system in other units, of which ``scale`` says the size; itself unless an option has a dimension."""
        return self

    @property
    def dimensions(self) -> Mapping[str, Dimension]:
        """The dimension of each scored quantity."""
        return _dimensions(self)

    def quantity(self, name: str) -> Quantity:
        """The scored quantity of that name."""
        return next(q for q in self.quantities if q.name == name)

    def dimension(self, quantity: Quantity) -> Dimension:
        """Mass, length and time exponents of a quantity of this system."""
        total = Dimension()
        for parameter in self.parameters:
            total = total + parameter.dimension * quantity.exponents.get(parameter.name, 0.0)
        return total


@lru_cache(maxsize=64)
def _dimensions(system: System) -> Mapping[str, Dimension]:
    """Those of :attr:`System.dimensions`, once for all equal systems."""
    return {quantity.name: system.dimension(quantity) for quantity in system.quantities}


def over_gauge(parameters: Sequence[Parameter], gauge: str, units: Mapping[Kind, str]) -> tuple[Quantity, ...]:
    """Every parameter but the gauge, divided by it, with the unit of its kind."""
    return tuple(
        Quantity(f"{p.name}_over_{gauge}", units[p.kind], {p.name: 1.0, gauge: -1.0})
        for p in parameters
        if p.name != gauge
    )


MASS, DAMPING, STIFFNESS = Dimension(1, 0, 0), Dimension(1, 0, -1), Dimension(1, 0, -2)
