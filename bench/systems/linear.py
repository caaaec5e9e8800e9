"""Linear systems: a single mass, chains of masses, and arbitrary symmetric matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from bench.errors import InputError
from bench.systems.contract import (
    DAMPING,
    MASS,
    STIFFNESS,
    Array,
    Dimension,
    Kind,
    Parameter,
    Quantity,
    System,
    over_gauge,
)

GROUP_UNITS: dict[Kind, str] = {"mass": "-", "damping": "1/s", "stiffness": "1/s²", "other": "-"}
"""Units of ratios to a mass, by kind of parameter."""


SDOF_PARAMETERS = (
    Parameter("m", "kg", "mass", MASS),
    Parameter("c", "N·s/m", "damping", DAMPING),
    Parameter("k", "N/m", "stiffness", STIFFNESS),
)
SDOF_GROUPS = (
    Quantity("k_over_m", "1/s²", {"k": 1.0, "m": -1.0}),
    Quantity("c_over_m", "1/s", {"c": 1.0, "m": -1.0}),
)
SDOF_MODAL = (
    Quantity("natural_frequency", "Hz", {"k": 0.5, "m": -0.5}, 0.5 / math.pi),
    Quantity("damping_ratio", "-", {"c": 1.0, "k": -0.5, "m": -0.5}, 0.5),
)
"""Created once, since scoring uses them in every replicate."""


@dataclass(frozen=True)
class SDOF(System):
    """Single degree of freedom, ``m x'' + c x' + k x = f(t)`` (the paper's equations 1 and A1).

    Free vibration determines only k/m and c/m: scaling (m, c, k) by a constant leaves the response unchanged.
    """

    name: ClassVar[str] = "sdof"
    linear: ClassVar[bool] = True

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return SDOF_PARAMETERS

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * x[0] - f[0]]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return SDOF_GROUPS

    @property
    def modal(self) -> tuple[Quantity, ...]:
        """``f_n = sqrt(k/m) / 2π`` and ``ζ = c / (2 sqrt(k m))``."""
        return SDOF_MODAL


@dataclass(frozen=True)
class Chain(System):
    """Chain of ``n`` masses, each connected to the previous mass (the first to the ground) by a spring and a damper.

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
        return over_gauge(self.parameters, "m1", GROUP_UNITS)


@dataclass(frozen=True)
class RayleighChain(System):
    """Chain of ``n`` masses with proportional damping, ``C = alpha M + beta K`` (Inman, section 4.5).

    The damping force is ``alpha m_i v_i`` on each mass and ``beta k_i`` times the rate of elongation in each link, so
    that the residual is not affine in the parameters. ``alpha`` (1/s) and ``beta`` (s) are identifiable.
    """

    n: int = 2
    name: ClassVar[str] = "rayleigh_chain"
    linear: ClassVar[bool] = True
    affine_in_parameters: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.n < 1:
            raise InputError("system.n", self.n, "a chain needs at least one mass")

    @property
    def n_dof(self) -> int:
        return self.n

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            *self._undamped,
            Parameter("alpha", "1/s", "damping", Dimension(0, 0, -1)),
            Parameter("beta", "s", "damping", Dimension(0, 0, 1)),
        )

    @property
    def _undamped(self) -> tuple[Parameter, ...]:
        numbers = range(1, self.n + 1)
        return (
            *(Parameter(f"m{i}", "kg", "mass", MASS) for i in numbers),
            *(Parameter(f"k{i}", "N/m", "stiffness", STIFFNESS) for i in numbers),
        )

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        s = [x[i] + p["beta"] * v[i] for i in range(self.n)]
        link = [p[f"k{i + 1}"] * (s[i] - s[i - 1] if i else s[i]) for i in range(self.n)]
        return [
            p[f"m{i + 1}"] * (a[i] + p["alpha"] * v[i]) + link[i] - (link[i + 1] if i + 1 < self.n else 0.0) - f[i]
            for i in range(self.n)
        ]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return (
            *over_gauge(self._undamped, "m1", GROUP_UNITS),
            Quantity("alpha", "1/s", {"alpha": 1.0}),
            Quantity("beta", "s", {"beta": 1.0}),
        )


Entry = tuple[int, int, int]
"""Row, column (row <= column, from 1) and sign of an entry of a symmetric matrix."""


@dataclass(frozen=True)
class Matrices(System):
    """``M x'' + C x' + K x = f`` with symmetric matrices of a given pattern of non-zero entries.

    ``mass``, ``damping`` and ``stiffness`` list the non-zero entries, each once, as ``[row, column]`` or
    ``[row, column, sign]``, counted from 1; the symmetric entry is implied. The parameters ``m11, m12, ...`` are
    the magnitudes of the entries. Parameters are positive, so the sign of an entry (negative for the stiffness between
    two masses) is part of the pattern.

    Free vibration from one general initial state determines the ratios to ``m11`` if the damping is not proportional
    or the mass matrix is diagonal: ``T M, T C, T K`` has the same response, and if ``inv(M) C`` commutes with
    ``inv(M) K``, some matrices T other than multiples of the identity keep a full M symmetric.
    """

    mass: tuple[Entry, ...] = ((1, 1, 1),)
    damping: tuple[Entry, ...] = ((1, 1, 1),)
    stiffness: tuple[Entry, ...] = ((1, 1, 1),)
    name: ClassVar[str] = "matrices"
    linear: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for field in ("mass", "damping", "stiffness"):
            object.__setattr__(self, field, _entries(f"system.options.{field}", getattr(self, field)))
        used = {i for part in (self.mass, self.damping, self.stiffness) for i, j, _ in part for i in (i, j)}
        diagonal = {i for i, j, sign in self.mass if i == j and sign > 0}
        if used != set(range(1, len(used) + 1)) or diagonal != used or len(used) > 9:
            raise InputError("system.options.mass", list(self.mass), "each DOF, 1 to at most 9, needs a mass [i, i]")
        if not _connected(used, [(i, j) for part in (self.mass, self.damping, self.stiffness) for i, j, _ in part]):
            raise InputError("system.options", "pattern", "it consists of uncoupled systems; identify them separately")

    @property
    def n_dof(self) -> int:
        return max(i for i, _, _ in self.mass)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            *(Parameter(f"m{i}{j}", "kg", "mass", MASS) for i, j, _ in self.mass),
            *(Parameter(f"c{i}{j}", "N·s/m", "damping", DAMPING) for i, j, _ in self.damping),
            *(Parameter(f"k{i}{j}", "N/m", "stiffness", STIFFNESS) for i, j, _ in self.stiffness),
        )

    @property
    def gauge(self) -> str:
        return "m11"

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        rows: list[Array] = [-f[i] for i in range(self.n_dof)]
        for letter, entries, motion in (("m", self.mass, a), ("c", self.damping, v), ("k", self.stiffness, x)):
            for i, j, sign in entries:
                value = sign * p[f"{letter}{i}{j}"]
                rows[i - 1] = rows[i - 1] + value * motion[j - 1]
                if i != j:
                    rows[j - 1] = rows[j - 1] + value * motion[i - 1]
        return rows

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return over_gauge(self.parameters, "m11", GROUP_UNITS)


def _entries(field: str, given: Sequence[Sequence[int]]) -> tuple[Entry, ...]:
    """Return the entries with their signs, sorted. Raises InputError for invalid and repeated entries."""
    entries = []
    for entry in given:
        values = (*entry, 1) if len(entry) == 2 else tuple(entry)
        if (
            len(values) != 3
            or min(values[:2]) < 1
            or values[2] not in (-1, 1)
            or (values[0] == values[1] and values[2] < 0)
        ):
            raise InputError(
                field, list(entry), "[row, column] or [row, column, sign], counted from 1; no negative diagonal"
            )
        entries.append((min(values[:2]), max(values[:2]), values[2]))
    if len({entry[:2] for entry in entries}) < len(entries):
        raise InputError(field, list(map(list, given)), "an entry is repeated (the matrix is symmetric)")
    return tuple(sorted(entries))


def _connected(dofs: set[int], pairs: Sequence[tuple[int, int]]) -> bool:
    reached = {1}
    for _ in dofs:
        reached |= {i for pair in pairs if set(pair) & reached for i in pair}
    return reached == dofs
