"""Structural identifiability from noise-free data, by the exact rank of Taylor coefficients.

The coefficients of the Taylor series of the measured displacements at time 0 are all that perfect data hold. Their
Jacobian by the log-parameters (and by the initial state, where it is unknown) is computed exactly at random rational
points; its row space is what the data determine. It is the observability rank condition (Hermann and Krener, IEEE
Trans. Automatic Control 22:728, 1977) with the parameters as constant states, evaluated at a point instead of
symbolically, as in Sedoglavic, J. Symbolic Computation 33:735, 2002; as many derivatives as there are states and
parameters suffice. The verdict is local: one of finitely many solutions counts as identified.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.dynamics.mechanics import state_rate
from bench.errors import InputError
from bench.information.series import LARGEST, Series, rational, series_ops
from bench.scenario.scenario import Scenario
from bench.systems import Quantity, System

SETTLED = 2
"""Random points are drawn until so many in a row add nothing to what is lost, and determined, at any of them.

A direction that is lost at all of them is a scaling; a product of powers is determined if it is orthogonal to all that
is lost at any."""


@dataclass(frozen=True)
class Structure:
    """The structural verdict on the parameters ``names``.

    ``rank``: how many independent functions of the parameters perfect data determine. ``scalings``: integer directions
    of the log-parameters along which the response never changes. ``groups``: a basis of the products of powers that are
    determined; where ``len(groups) < rank``, so are functions that are no products of powers. ``at_start``: whether the
    verdict holds for the scenario's own initial state, as opposed to a generic one.
    """

    names: tuple[str, ...]
    rank: int
    scalings: tuple[tuple[int, ...], ...]
    groups: tuple[Quantity, ...]
    at_start: bool = False

    def identifiable(self, quantity: Quantity) -> bool:
        """Return whether a product of powers is determined: its exponents are combinations of those of the groups."""
        rows = np.array([group.vector(self.names) for group in self.groups]).reshape(-1, len(self.names))
        w = np.array(quantity.vector(self.names))
        return int(np.linalg.matrix_rank(np.vstack([rows, w]))) == len(self.groups)

    def sentences(self) -> list[str]:
        """Describe the result in words."""
        n, bent = len(self.names), len(self.names) - self.rank - len(self.scalings)
        if self.rank == n:
            return [f"all {n} parameters are identifiable: {', '.join(self.names)}"]
        lines = [f"{self.rank} independent functions of the {n} parameters are identifiable"]
        lines += [_scaling_sentence(self.names, direction) for direction in self.scalings]
        if bent:
            ways = "one more way" if bent == 1 else f"{bent} more ways"
            lines.append(f"the parameters can change in {ways} together that no fixed powers describe")
        if self.groups:
            lines.append(f"identifiable: {', '.join(map(readable, self.groups))}, and any product of their powers")
        if len(self.groups) < self.rank:
            lines.append(f"and {self.rank - len(self.groups)} more functions that are no products of powers (sums)")
        return lines


def _scaling_sentence(names: Sequence[str], direction: Sequence[int]) -> str:
    moved = [(name, power) for name, power in zip(names, direction, strict=True) if power]
    listed = ", ".join(name if power == 1 else f"{name} (to the power {power})" for name, power in moved)
    if len(moved) == 1:
        return f"{moved[0][0]} does not change the response at all"
    return f"{listed} may all be multiplied by one constant: the response stays the same"


def readable(quantity: Quantity) -> str:
    """Format a product of powers, e.g. ``k1*k2/(m1*m2)``."""

    def factors(sign: int) -> list[str]:
        powers = [(name, sign * power) for name, power in quantity.exponents.items() if sign * power > 0]
        return [name if power == 1 else f"{name}^{power:g}" for name, power in powers]

    above, below = "*".join(factors(1)) or "1", factors(-1)
    under = below[0] if len(below) == 1 else f"({'*'.join(below)})"
    return f"{above}/{under}" if below else above


def structure_of(scenario: Scenario, measured: Sequence[int] | None = None) -> Structure:
    """Reach the verdict for a scenario: at its own initial state where that is known, else at generic ones.

    Raises InputError for a DOF that it does not have.
    """
    if scenario.added_mass is not None:
        remedy = "the exact verdict is for one record; leave the added mass out"
        raise InputError("system.added_mass", list(scenario.added_mass), remedy)
    forced = () if scenario.force is None else (scenario.force.dof,)
    start = scenario.initial if scenario.initial_state == "known" else None
    measured = scenario.measured_dofs if measured is None else measured
    return structure(scenario.make_system(), measured, scenario.initial_state, forced, start)


def structure(
    system: System,
    measured: Sequence[int] | None = None,
    initial_state: Literal["known", "unknown"] = "known",
    forced: Sequence[int] = (),
    start: tuple[Sequence[float], Sequence[float]] | None = None,
) -> Structure:
    """Find what perfect displacements of the ``measured`` DOFs (all by default) determine of the parameters.

    ``forced``: the DOFs on which a known force with generic derivatives acts. ``start``: displacement and velocity at
    time 0 where they are known; generic values by default, and where the response has no Taylor series at ``start``.
    Hidden states start from zero. Raises InputError for a DOF that the system does not have.
    """
    measured = range(system.n_dof) if measured is None else measured
    check_dofs(system, measured)
    n = len(system.names)
    lost: list[list[Any]] = []  # spans what is lost at any of the points
    determined: list[list[Any]] = []  # spans what is determined at any of them
    rank, settled = -1, 0
    for seed in itertools.count():
        try:
            rows = _jacobian(system, measured, initial_state, forced, start, random.Random(seed))
        except ZeroDivisionError:
            if start is None:
                raise
            return structure(system, measured, initial_state, forced, None)
        lost_here = [row[:n] for row in _null(rows, len(rows[0]))]
        determined_here = _null(lost_here, n)
        if len(determined_here) > rank:  # what came before were special points
            rank, settled, lost, determined = len(determined_here), 0, [], []
        if len(determined_here) == rank:
            dimensions = len(lost), len(determined)
            lost, determined = _basis([*lost, *lost_here], n), _basis([*determined, *determined_here], n)
            settled = settled + 1 if dimensions == (len(lost), len(determined)) else 0
        if rank == n or settled == SETTLED:
            break
    groups = tuple(_quantity(system, _integers(row)) for row in _null(lost, n))
    scalings = []
    for direction in map(_integers, _null(determined, n)):
        sign = 1 if next(filter(None, direction)) > 0 else -1
        scalings.append(tuple(sign * entry for entry in direction))
    return Structure(system.names, rank, tuple(scalings), groups, start is not None)


def check_dofs(system: System, measured: Sequence[int]) -> None:
    """Raise InputError unless ``measured`` names DOFs of the system, each once."""
    if not measured or len(set(measured)) != len(measured) or not set(measured) <= set(range(system.n_dof)):
        known = ", ".join(map(str, range(system.n_dof)))
        raise InputError("measured", list(measured), f"a list of DOFs, each once; {system.name} has {known}")


def _jacobian(
    system: System,
    measured: Sequence[int],
    initial_state: str,
    forced: Sequence[int],
    start: tuple[Sequence[float], Sequence[float]] | None,
    rng: random.Random,
) -> list[list[Any]]:
    """Derive the measured Taylor coefficients exactly, by log-parameters and then by the unknown initial state."""
    n, names = system.n_dof, system.names
    free = len(names) + (2 * n if initial_state == "unknown" else 0)
    order = 2 * n + system.n_hidden + max(len(names), 2 * n + system.n_hidden)

    def draw() -> Any:
        return rational(rng.randint(1, LARGEST))

    values = [draw() for _ in names]
    # d/d(log p) = p d/dp
    p = {
        name: Series.constant(value, free, i, value) for i, (name, value) in enumerate(zip(names, values, strict=True))
    }
    given = [draw() for _ in range(2 * n)] if start is None else [rational(float(v)) for part in start for v in part]
    first = [*given, *[rational(0)] * system.n_hidden]
    unknown = [len(names) + i if initial_state == "unknown" and i < 2 * n else None for i in range(len(first))]
    state = [Series.constant(value, free, which) for value, which in zip(first, unknown, strict=True)]
    push = {dof: [draw() for _ in range(order)] for dof in forced}
    ops = series_ops(rng)
    for k in range(order):
        f = [_known(push[i][: k + 1], free) if i in push else 0 for i in range(n)]
        rates = [rate.c for rate in state_rate(system, p, state, f, ops)]
        state = [_extended(s, rate, k) for s, rate in zip(state, rates, strict=True)]
    return [list(row[1:]) for dof in measured for row in state[dof].c]


def _known(values: Sequence[Any], free: int) -> Series:
    c = np.full((len(values), 1 + free), rational(0), dtype=object)
    c[:, 0] = values
    return Series(c)


def _extended(state: Series, rate: np.ndarray, k: int) -> Series:
    """Add one coefficient: ``s[k+1] = s'[k] / (k+1)``; a rate that is constant in time has none after the first."""
    new = rate[k] / rational(k + 1) if k < len(rate) else np.full(state.c.shape[1], rational(0), dtype=object)
    return Series(np.concatenate([state.c, new[None]]))


def _matrix(rows: list[list[Any]], n: int) -> Any:
    from sympy import QQ
    from sympy.polys.matrices import DomainMatrix

    return DomainMatrix(rows, (len(rows), n), QQ).to_sparse() if rows else DomainMatrix.zeros((1, n), QQ)


def _basis(rows: list[list[Any]], n: int) -> list[list[Any]]:
    """Return an exact basis of what rows of length ``n`` span: their reduced row echelon form."""
    reduced, pivots = _matrix(rows, n).rref()
    return reduced.to_dense().to_list()[: len(pivots)]


def _null(rows: list[list[Any]], n: int) -> list[list[Any]]:
    """Return an exact basis of the null space of rows of length ``n``; without rows, everything."""
    return _matrix(rows, n).nullspace().to_dense().to_list()


def _integers(row: Sequence[Any]) -> tuple[int, ...]:
    """Return the shortest integer vector along a rational one."""
    common = math.lcm(*(int(entry.denominator) for entry in row))
    whole = [int(entry.numerator) * (common // int(entry.denominator)) for entry in row]
    return tuple(entry // (math.gcd(*whole) or 1) for entry in whole)


def _quantity(system: System, powers: Sequence[int]) -> Quantity:
    """Return a product of powers, named as in the system if the system defines it."""
    exponents = {name: float(power) for name, power in zip(system.names, powers, strict=True) if power}
    for known in system.quantities:
        if known.coefficient == 1.0 and dict(known.exponents) == exponents:
            return known
    product = Quantity("", "", exponents)
    dimension = system.dimension(product)
    bases = (("kg", dimension.mass), ("m", dimension.length), ("s", dimension.time))
    unit = "·".join(base if power == 1 else f"{base}^{power:g}" for base, power in bases if power)
    return Quantity(readable(product), unit or "-", exponents)
