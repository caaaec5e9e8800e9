"""A vibrating system: one residual, its parameters, and the groups that free vibration can tell.

A system is written once, as the residual of its equation of motion, in plain operators on sequences of
degree-of-freedom (DOF) components. numpy, jax, torch, casadi and sympy all run that same line; everything
else (regression columns, mass matrix, acceleration, simulation, sensitivities) is derived from it in
:mod:`bench.mechanics`, :mod:`bench.simulate` and :mod:`bench.bound`.

No true value stands here: a system knows names, units and dimensions, never numbers.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

from bench.errors import InputError

Kind = Literal["mass", "damping", "stiffness", "other"]
"""What a parameter is; a prior's width is stated by kind."""

Array = Any
"""A component in whatever library runs the residual: numpy, jax, torch, casadi or sympy."""

Components = Sequence[Array]
"""One entry per DOF (or per hidden state); entries may be scalars, arrays or symbols."""


class Ops(Protocol):
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
    linear: ClassVar[bool] = False
    """Affine in displacement, velocity and acceleration, with coefficients that do not depend on time."""
    affine_in_parameters: ClassVar[bool] = True
    """The residual is affine in the parameters, so it has regression columns."""

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

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def gauge(self) -> str:
        """The parameter that the groups are ratios to: the first mass."""
        return next(p.name for p in self.parameters if p.kind == "mass")

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Everything that is scored: parameters, groups and modal quantities."""
        own = tuple(Quantity(p.name, p.unit, {p.name: 1.0}) for p in self.parameters)
        return own + self.groups + self.modal

    def quantity(self, name: str) -> Quantity:
        """The scored quantity of that name."""
        return next(q for q in self.quantities if q.name == name)

    def dimension(self, quantity: Quantity) -> Dimension:
        """Mass, length and time exponents of a quantity of this system."""
        total = Dimension()
        for parameter in self.parameters:
            total = total + parameter.dimension * quantity.exponents.get(parameter.name, 0.0)
        return total


def _over_gauge(parameters: Sequence[Parameter], gauge: str, units: Mapping[Kind, str]) -> tuple[Quantity, ...]:
    """Every parameter but the gauge, divided by it."""
    return tuple(
        Quantity(f"{p.name}_over_{gauge}", units[p.kind], {p.name: 1.0, gauge: -1.0})
        for p in parameters
        if p.name != gauge
    )


MASS, DAMPING, STIFFNESS = Dimension(1, 0, 0), Dimension(1, 0, -1), Dimension(1, 0, -2)


@dataclass(frozen=True)
class SDOF(System):
    """Single degree of freedom, ``m x'' + c x' + k x = f(t)`` (the paper's equations 1 and A1).

    Free vibration tells only k/m and c/m: (m, c, k) times any constant gives the same response.
    """

    name: ClassVar[str] = "sdof"
    linear: ClassVar[bool] = True

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("m", "kg", "mass", MASS),
            Parameter("c", "N·s/m", "damping", DAMPING),
            Parameter("k", "N/m", "stiffness", STIFFNESS),
        )

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * x[0] - f[0]]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return (
            Quantity("k_over_m", "1/s²", {"k": 1.0, "m": -1.0}),
            Quantity("c_over_m", "1/s", {"c": 1.0, "m": -1.0}),
        )

    @property
    def modal(self) -> tuple[Quantity, ...]:
        """``f_n = sqrt(k/m) / 2π`` and ``ζ = c / (2 sqrt(k m))``."""
        return (
            Quantity("natural_frequency", "Hz", {"k": 0.5, "m": -0.5}, 0.5 / math.pi),
            Quantity("damping_ratio", "-", {"c": 1.0, "k": -0.5, "m": -0.5}, 0.5),
        )


@dataclass(frozen=True)
class Chain(System):
    """A chain of ``n`` masses, each tied to the one before (the first to the ground) by a spring and a damper.

    ``m_i a_i + (force of link i) - (force of link i+1) = f_i`` with link force
    ``c_i (v_i - v_{i-1}) + k_i (x_i - x_{i-1})`` and ``x_0 = 0``.
    """

    n: int = 2
    name: ClassVar[str] = "chain"
    linear: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.n < 1:
            raise InputError("system.n", self.n, "a chain needs at least one mass")

    @property
    def n_dof(self) -> int:
        return self.n

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        numbers = range(1, self.n + 1)
        return (
            *(Parameter(f"m{i}", "kg", "mass", MASS) for i in numbers),
            *(Parameter(f"c{i}", "N·s/m", "damping", DAMPING) for i in numbers),
            *(Parameter(f"k{i}", "N/m", "stiffness", STIFFNESS) for i in numbers),
        )

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        link = [
            p[f"c{i + 1}"] * (v[i] - v[i - 1] if i else v[i]) + p[f"k{i + 1}"] * (x[i] - x[i - 1] if i else x[i])
            for i in range(self.n)
        ]
        return [
            p[f"m{i + 1}"] * a[i] + link[i] - (link[i + 1] if i + 1 < self.n else 0.0) - f[i] for i in range(self.n)
        ]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return _over_gauge(self.parameters, "m1", {"mass": "-", "damping": "1/s", "stiffness": "1/s²", "other": "-"})


@dataclass(frozen=True)
class Duffing(System):
    """Duffing oscillator with hardening spring, ``m x'' + c x' + k x + k3 x³ = f(t)``."""

    name: ClassVar[str] = "duffing"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*SDOF().parameters, Parameter("k3", "N/m³", "stiffness", Dimension(1, -2, -2)))

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * x[0] + p["k3"] * x[0] ** 3 - f[0]]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return (*SDOF().groups, Quantity("k3_over_m", "1/(m²·s²)", {"k3": 1.0, "m": -1.0}))


SYSTEMS: dict[str, type[System]] = {cls.name: cls for cls in (SDOF, Chain, Duffing)}
"""Systems by the name that a configuration gives them."""


def make_system(name: str, options: Mapping[str, Any]) -> System:
    """The system called ``name`` with its structural options (the number of masses, say)."""
    if name not in SYSTEMS:
        raise InputError("system", name, f"known systems: {', '.join(sorted(SYSTEMS))}")
    try:
        return SYSTEMS[name](**options)
    except TypeError as error:
        raise InputError("system.options", dict(options), str(error)) from None
