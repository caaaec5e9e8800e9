"""Sampling of the atlas: a scrambled Sobol sequence over all axes, and regular grids over two of them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.atlas.axes import Axis
from bench.atlas.point import Point
from bench.errors import InputError


def sobol(kind: type[Point], number: int, seed: int) -> list[Point]:
    """Return the first ``number`` points of a scrambled Sobol sequence over the axes of a kind of test.

    Raises:
        InputError: ``number`` is not a power of two, for which the sequence is balanced.
    """
    from scipy.stats import qmc  # slow to import

    if number < 1 or number & (number - 1):
        raise InputError("atlas.points", number, "must be a power of two, for which the sequence is balanced")
    shares = qmc.Sobol(len(kind.AXES) + 1, scramble=True, rng=np.random.default_rng(seed)).random(number)
    values = {axis.name: axis.value(shares[:, i]) for i, axis in enumerate(kind.AXES)}
    return [
        make_point(kind, {name: column[i] for name, column in values.items()}, kind.CHOICE.value(shares[i, -1]))
        for i in range(number)
    ]


@dataclass(frozen=True)
class Slice:
    """A grid over two axes, horizontal (``across``) and vertical (``up``); the other numbers of the test are fixed."""

    name: str
    fixed: Point
    across: str
    up: str
    size: tuple[int, int]

    def axes(self) -> tuple[Axis, Axis]:
        """Return the two axes; raises InputError for an unknown name."""
        by_name = {axis.name: axis for axis in self.fixed.AXES}
        for name in (self.across, self.up):
            if name not in by_name:
                raise InputError("atlas.slices", name, f"use one of {', '.join(by_name)}")
        return by_name[self.across], by_name[self.up]

    def points(self) -> list[Point]:
        """Return the points of the grid, row by row from the bottom."""
        across, up = self.axes()
        columns, rows = (axis.value(np.linspace(0.0, 1.0, n)) for axis, n in zip((across, up), self.size, strict=True))
        return [self._point({across.name: x, up.name: y}) for y, x in itertools.product(rows, columns)]

    def _point(self, values: Mapping[str, float]) -> Point:
        kind = type(self.fixed)
        fixed = {axis.name: getattr(self.fixed, axis.name) for axis in kind.AXES}
        return make_point(kind, {**fixed, **values}, getattr(self.fixed, kind.CHOICE.name))


def make_point(kind: type[Point], values: Mapping[str, Any], choice: Any) -> Point:
    """Return a test of a kind from the values of its axes and of its categorical property."""
    numbers: dict[str, Any] = {name: float(value) for name, value in values.items()}
    numbers["samples"] = round(numbers["samples"])
    return kind(**numbers, **{kind.CHOICE.name: choice})


def blocks(points: Sequence[Point], size: int) -> list[list[Point]]:
    """Divide points into groups of ``size``, which are computed and stored together."""
    return [list(points[i : i + size]) for i in range(0, len(points), size)]
