"""Nonlinear systems of one degree of freedom."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from bench.errors import InputError
from bench.systems.contract import FORCE, LENGTH, MEASURED, STIFFNESS, Dimension, Parameter, Quantity, System
from bench.systems.linear import SDOF

TINY = 1e-30
"""Added to the base of a fractional power, whose derivative at zero would be 0 times infinity; too small to matter."""


@dataclass(frozen=True)
class Duffing(System):
    """Duffing oscillator with hardening spring, ``m x'' + c x' + k x + k3 x³ = f(t)``."""

    name: ClassVar[str] = "duffing"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*SDOF().parameters, Parameter("k3", "N/m³", "stiffness", Dimension(1, -2, -2)))

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return [p["m"] * a[0] + p["c"] * v[0] + (p["k"] + p["k3"] * x[0] * x[0]) * x[0] - f[0]]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return (*SDOF().groups, Quantity("k3_over_m", "1/(m²·s²)", {"k3": 1.0, "m": -1.0}))


@dataclass(frozen=True)
class QuadraticDamping(System):
    """Linear and quadratic damping, ``m x'' + c x' + c2 |x'| x' + k x = f(t)``, as by fluid drag."""

    name: ClassVar[str] = "quadratic_damping"
    smooth: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*SDOF().parameters, Parameter("c2", "N·s²/m²", "damping", Dimension(1, -1, 0)))

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return [p["m"] * a[0] + p["c"] * v[0] + p["c2"] * ops.abs(v[0]) * v[0] + p["k"] * x[0] - f[0]]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return (*SDOF().groups, Quantity("c2_over_m", "1/m", {"c2": 1.0, "m": -1.0}))


@dataclass(frozen=True)
class Coulomb(System):
    """Dry friction and viscous damping, ``m x'' + c x' + mu tanh(x'/v_s) + k x = f(t)``.

    ``mu`` is the friction force (N). The smoothing velocity ``v_s`` (``smoothing_velocity``, m/s) is an option, not a
    parameter: the friction is Coulomb's ``mu sign(x')`` at speeds well above it and viscous (``mu / v_s``) well below
    it, so there is no sticking.
    """

    smoothing_velocity: float = 0.01
    name: ClassVar[str] = "coulomb"
    smooth: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not 0 < self.smoothing_velocity < float("inf"):
            raise InputError("system.options.smoothing_velocity", self.smoothing_velocity, "a positive velocity (m/s)")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*SDOF().parameters, Parameter("mu", "N", "damping", FORCE))

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        friction = p["mu"] * ops.tanh(v[0] / self.smoothing_velocity)
        return [p["m"] * a[0] + p["c"] * v[0] + friction + p["k"] * x[0] - f[0]]

    def rescaled(self, scale: Callable[[Dimension], float]) -> Self:
        return replace(self, smoothing_velocity=self.smoothing_velocity / scale(MEASURED["velocity"]))

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return (*SDOF().groups, Quantity("mu_over_m", "m/s²", {"mu": 1.0, "m": -1.0}))


@dataclass(frozen=True)
class VanDerPol(System):
    """Self-excited vibration with a limit cycle, ``m x'' - c x' + c3 x² x' + k x = f(t)``.

    Van der Pol's equation ``y'' - mu (1 - y²) y' + y = 0`` in physical dimensions, with ``y = x √(c3/c)``, time in
    ``√(m/k)`` and ``mu = c / √(m k)`` (Nayfeh and Mook, Nonlinear Oscillations, section 3.1.6). ``c`` supplies energy,
    ``c3`` (N·s/m³) dissipates it; for small mu the amplitude of the limit cycle is ``2 √(c/c3)``.
    """

    name: ClassVar[str] = "van_der_pol"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*SDOF().parameters, Parameter("c3", "N·s/m³", "damping", Dimension(1, -2, -1)))

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return [p["m"] * a[0] + (p["c3"] * x[0] * x[0] - p["c"]) * v[0] + p["k"] * x[0] - f[0]]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return (*SDOF().groups, Quantity("c3_over_m", "1/(m²·s)", {"c3": 1.0, "m": -1.0}))


@dataclass(frozen=True)
class Pendulum(System):
    """Pendulum in terms of the arc length ``x = l θ`` (m), ``m x'' + c x' + k l sin(x/l) = f(t)``.

    This is ``m l² θ'' + c l² θ' + m g l sin θ = f l`` divided by ``l``, with ``k = m g / l`` the stiffness at small
    amplitudes. Gravity is not given, so m cannot be computed from the weight ``k l``: free vibration determines k/m
    (which is g/l), c/m, and, from the longer period at large amplitudes, the length ``l``. Not affine in ``l``.
    """

    name: ClassVar[str] = "pendulum"
    affine_in_parameters: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*SDOF().parameters, Parameter("l", "m", "other", LENGTH))

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * p["l"] * ops.sin(x[0] / p["l"]) - f[0]]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return (*SDOF().groups, Quantity("l", "m", {"l": 1.0}))


@dataclass(frozen=True)
class BoucWen(System):
    """Hysteresis by a hidden displacement z, ``m x'' + c x' + k x + kz z = f(t)`` (Bouc 1967, Wen 1976).

    ``z' = x' - beta |x'| |z|^(n-1) z - gamma x' |z|^n``: with Wen's stiffness and post-yield ratio ``k = a k0`` and
    ``kz = (1 - a) k0``, and A = 1, since Wen's parameters are redundant (Ma et al., J. Eng. Mech. 130:610, 2004). The
    initial value of z (m) is 0. The ``exponent`` n is an option. ``beta`` and ``gamma`` have dimension ``length^-n``;
    they occur in the rate of z only and are identifiable. For small motion the stiffness is ``k + kz``.
    """

    exponent: float = 1.0
    name: ClassVar[str] = "bouc_wen"
    smooth: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not 1.0 <= self.exponent < float("inf"):
            raise InputError(
                "system.options.exponent", self.exponent, "1 or more: below, the rate of z is not Lipschitz"
            )

    @property
    def n_hidden(self) -> int:
        return 1

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        unit, dimension = f"1/m^{self.exponent:g}", Dimension(0, -self.exponent, 0)
        return (
            *SDOF().parameters,
            Parameter("kz", "N/m", "stiffness", STIFFNESS),
            Parameter("beta", unit, "other", dimension),
            Parameter("gamma", unit, "other", dimension),
        )

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * x[0] + p["kz"] * z[0] - f[0]]

    def hidden_rates(self, p, x, v, f, z, ops):  # type: ignore[no-untyped-def]
        # a whole exponent as an integer, which every library can raise to
        n = int(self.exponent) if self.exponent == int(self.exponent) else self.exponent
        size = ops.abs(z[0])
        if n != int(n):
            size = size + TINY
        # |z|^(n-1) is left out at n = 1, where its slope at z = 0 would be 0 times infinity
        bent, power = (z[0] * size ** (n - 1), size**n) if n != 1 else (z[0], size)
        return [v[0] - p["beta"] * ops.abs(v[0]) * bent - p["gamma"] * v[0] * power]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        unit = f"1/m^{self.exponent:g}"
        return (
            *SDOF().groups,
            Quantity("kz_over_m", "1/s²", {"kz": 1.0, "m": -1.0}),
            Quantity("beta", unit, {"beta": 1.0}),
            Quantity("gamma", unit, {"gamma": 1.0}),
        )
