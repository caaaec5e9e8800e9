"""Systems that the benchmark does not have, for what its own do not exercise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bench.systems import MASS, SDOF, STIFFNESS, Parameter, Quantity, System


@dataclass(frozen=True)
class Coupled(System):
    """Two masses with an off-diagonal inertia term; its mass matrix depends on the motion (a cart and its arm).

    ``(m1 + m2) a1 + m2 cos(x2) a2 + k x1 = f1`` and, doubled so that the matrix is not symmetric,
    ``m2 cos(x2) a1 + m2 a2 + k sin(x2) = f2``.
    """

    name: ClassVar[str] = "coupled"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("m1", "kg", "mass", MASS),
            Parameter("m2", "kg", "mass", MASS),
            Parameter("k", "N/m", "stiffness", STIFFNESS),
        )

    @property
    def n_dof(self) -> int:
        return 2

    def residual(self, p, x, v, a, f, z, ops):
        tie = p["m2"] * ops.cos(x[1])
        return [
            (p["m1"] + p["m2"]) * a[0] + tie * a[1] + p["k"] * x[0] - f[0],
            2.0 * (tie * a[0] + p["m2"] * a[1] + p["k"] * ops.sin(x[1]) - f[1]),
        ]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return ()


@dataclass(frozen=True)
class BoucWen(System):
    """``m x'' + c x' + k z = f`` with a hidden state, ``z' = v - 0.5 |v| z``: hysteresis of the simplest kind."""

    name: ClassVar[str] = "bouc_wen"
    smooth: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return SDOF().parameters

    @property
    def n_hidden(self) -> int:
        return 1

    def residual(self, p, x, v, a, f, z, ops):
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * z[0] - f[0]]

    def hidden_rates(self, p, x, v, f, z, ops):
        return [v[0] - 0.5 * ops.abs(v[0]) * z[0]]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return SDOF().groups


@dataclass(frozen=True)
class Exponential(SDOF):
    """Not affine in its parameters, and it says so."""

    name: ClassVar[str] = "exponential"
    affine_in_parameters: ClassVar[bool] = False
