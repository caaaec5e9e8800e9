"""Definition of a vibrating system: its residual, its parameters, and the groups identifiable in free vibration.

A system is written once, as the residual of its equation of motion, in plain operators on sequences of
degree-of-freedom (DOF) components. NumPy, JAX, PyTorch, CasADi and SymPy all evaluate this code; regression columns,
mass matrix, acceleration, simulation and sensitivities are derived from it in :mod:`bench.dynamics.mechanics`,
:mod:`bench.dynamics.simulate` and :mod:`bench.information.fisher`.

A system declares names, units and dimensions of its parameters, never their values.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Literal, Self

Kind = Literal["mass", "damping", "stiffness", "other"]
"""Kind of a parameter; the width of a prior is set per kind."""

Array = Any
"""A component in the library that evaluates the residual: NumPy, JAX, PyTorch, CasADi or SymPy."""

Components = Sequence[Array]
"""One entry per DOF (or per hidden state); entries are scalars, arrays or symbols."""


@dataclass(frozen=True)
class Ops:
    """Functions of one library that a residual may call besides plain operators.

    Attributes:
        sin: Sine of an array.
        cos: Cosine of an array.
        tanh: Hyperbolic tangent of an array.
        exp: Exponential of an array.
        abs: Absolute value of an array.
        where: ``where(condition, a, b)`` selects elements of ``a`` where the condition is true, else of ``b``.
        solve: ``solve(matrix_rows, right_hand_side)`` returns the components of the solution of a linear system.
    """

    sin: Callable[[Array], Array]
    cos: Callable[[Array], Array]
    tanh: Callable[[Array], Array]
    exp: Callable[[Array], Array]
    abs: Callable[[Array], Array]
    where: Callable[[Array, Array, Array], Array]
    solve: Callable[[Sequence[Sequence[Array]], Components], Components]


@dataclass(frozen=True)
class Dimension:
    """Exponents of mass, length and time, e.g. ``Dimension(1, 0, -2)`` for a stiffness in N/m.

    Attributes:
        mass: Exponent of mass.
        length: Exponent of length.
        time: Exponent of time.
    """

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
    """A physical parameter. Parameters are positive, so that they can be estimated in logarithms.

    Attributes:
        name: Name, as ``k``.
        unit: SI unit, as ``N/m``.
        kind: Kind, which sets the width of its prior.
        dimension: Exponents of mass, length and time.
    """

    name: str
    unit: str
    kind: Kind
    dimension: Dimension


@dataclass(frozen=True)
class Quantity:
    """A product of powers of parameters, ``coefficient * prod(p ** exponent)``.

    Parameters, identifiable groups (k/m, c/m), natural frequency and damping ratio have this form. The logarithm of a
    quantity is linear in the log-parameters, so bounds and covariances of log-parameters transform to it exactly.

    Attributes:
        name: Name, as ``k_over_m``.
        unit: SI unit.
        exponents: Exponent by parameter name; parameters that are not named have exponent 0.
        coefficient: Positive constant factor.
    """

    name: str
    unit: str
    exponents: Mapping[str, float]
    coefficient: float = 1.0

    def value(self, parameters: Mapping[str, Any]) -> Any:
        """Evaluate the quantity at parameters given by name (floats, or arrays of one shape)."""
        result: Any = self.coefficient
        for name, power in self.exponents.items():
            result = result * parameters[name] ** power
        return result

    def vector(self, names: Sequence[str]) -> list[float]:
        """Return the exponents in the order of ``names``: the gradient of log(quantity) by the log-parameters."""
        return [float(self.exponents.get(name, 0.0)) for name in names]


class System(ABC):
    """Base class of systems: a residual and its properties. Subclasses are frozen dataclasses."""

    name: ClassVar[str]
    """Name in the configuration."""
    version: ClassVar[int] = 1
    """Version of the equations; stored cells of another version are stale. Raise it when a change alters results."""
    linear: ClassVar[bool] = False
    """The residual is affine in displacement, velocity and acceleration, with constant coefficients."""
    affine_in_parameters: ClassVar[bool] = True
    """The residual is affine in the parameters, so that regression columns exist."""
    smooth: ClassVar[bool] = True
    """The equations are differentiable. If not (absolute value, dry friction), smaller integration steps are taken."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters, in the order of every vector and matrix over them."""

    @property
    def n_dof(self) -> int:
        """Number of degrees of freedom."""
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
        """Evaluate the residual ``r`` of the equation of motion ``r = 0``, which is affine in the accelerations.

        Args:
            p: Parameters by name (SI units).
            x: Displacement (m) of each DOF.
            v: Velocity (m/s) of each DOF.
            a: Acceleration (m/s²) of each DOF.
            f: Known force (N) on each DOF; zero where none acts.
            z: Hidden states.
            ops: Functions of the library in which the other arguments are given.

        Returns:
            One entry per DOF (N).
        """

    def hidden_rates(
        self, p: Mapping[str, Array], x: Components, v: Components, f: Components, z: Components, ops: Ops
    ) -> list[Array]:
        """Evaluate the time derivatives of the hidden states.

        Args:
            p: Parameters by name (SI units).
            x: Displacement (m) of each DOF.
            v: Velocity (m/s) of each DOF.
            f: Known force (N) on each DOF.
            z: Hidden states.
            ops: Functions of the library in which the other arguments are given.

        Returns:
            One entry per hidden state (its unit per second).
        """
        return []

    @property
    @abstractmethod
    def groups(self) -> tuple[Quantity, ...]:
        """Groups that are identifiable in free vibration; the tests compare them with the Fisher information."""

    @property
    def modal(self) -> tuple[Quantity, ...]:
        """Natural frequency and damping ratio, where they are products of powers of parameters."""
        return ()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def gauge(self) -> str:
        """Parameter by which the groups are divided: the first mass."""
        return next(p.name for p in self.parameters if p.kind == "mass")

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Scored quantities, without duplicates: parameters, groups (a parameter may be a group), modal quantities."""
        parameters = tuple(Quantity(p.name, p.unit, {p.name: 1.0}) for p in self.parameters)
        names = {q.name for q in parameters}
        return parameters + tuple(group for group in self.groups if group.name not in names) + self.modal

    def rescaled(self, scale: Callable[[Dimension], float]) -> Self:
        """Convert options to other units, given the size of the unit of each dimension."""
        return self

    @property
    def dimensions(self) -> Mapping[str, Dimension]:
        """Dimension of each scored quantity, by name."""
        return _dimensions(self)

    def quantity(self, name: str) -> Quantity:
        """Return the scored quantity of this name."""
        return next(q for q in self.quantities if q.name == name)

    def dimension(self, quantity: Quantity) -> Dimension:
        """Return the exponents of mass, length and time of a quantity of this system."""
        total = Dimension()
        for parameter in self.parameters:
            total = total + parameter.dimension * quantity.exponents.get(parameter.name, 0.0)
        return total


@lru_cache(maxsize=64)
def _dimensions(system: System) -> Mapping[str, Dimension]:
    """Compute :attr:`System.dimensions`; equal systems share the result."""
    return {quantity.name: system.dimension(quantity) for quantity in system.quantities}


def over_gauge(parameters: Sequence[Parameter], gauge: str, units: Mapping[Kind, str]) -> tuple[Quantity, ...]:
    """Return the ratio of every other parameter to the gauge.

    Args:
        parameters: All parameters.
        gauge: Name of the parameter to divide by.
        units: Unit of the ratio, by kind of parameter.

    Returns:
        One quantity per parameter other than the gauge.
    """
    return tuple(
        Quantity(f"{p.name}_over_{gauge}", units[p.kind], {p.name: 1.0, gauge: -1.0})
        for p in parameters
        if p.name != gauge
    )


MASS, DAMPING, STIFFNESS = Dimension(1, 0, 0), Dimension(1, 0, -1), Dimension(1, 0, -2)
