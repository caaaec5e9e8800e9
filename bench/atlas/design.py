"""Where the atlas is sampled: a scrambled Sobol sequence over a box, and regular grids over two of its axes."""

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
    """The first ``number`` points of the sequence over the box of a kind of test."""
    from scipy.stats import qmc  # slow to import

    if number < 1 or number & (number - 1):
        raise InputError("atlas.points", number, "a power of two, at which the sequence is balanced")
    shares = qmc.Sobol(len(kind.AXES) + 1, scramble=True, rng=np.random.default_rng(seed)).random(number)
    values = {axis.name: axis.at(shares[:, i]) for i, axis in enumerate(kind.AXES)}
    return [
        made(kind, {name: column[i] for name, column in values.items()}, kind.CHOICE.at(shares[i, -1]))
        for i in range(number)
    ]


@dataclass(frozen=True)
class Slice:
    """A grid over two axes, the other numbers of the test fixed."""

    name: str
    fixed: Point
    across: str
    up: str
    size: tuple[int, int]

    def axes(self) -> tuple[Axis, Axis]:
        """The two axes; raises InputError for a name that is none."""
        by_name = {axis.name: axis for axis in self.fixed.AXES}
        for name in (self.across, self.up):
            if name not in by_name:
                raise InputError("atlas.slices", name, f"one of {', '.join(by_name)}")
        return by_name[self.across], by_name[self.up]

    def points(self) -> list[Point]:
        """The grid, row by row from below."""
        across, up = self.axes()
        columns, rows = (axis.at(np.linspace(0.0, 1.0, n)) for axis, n in zip((across, up), self.size, strict=True))
        return [self._at({across.name: x, up.name: y}) for y, x in itertools.product(rows, columns)]

    def _at(self, values: Mapping[str, float]) -> Point:
        kind = type(self.fixed)
        stated = {axis.name: getattr(self.fixed, axis.name) for axis in kind.AXES}
        return made(kind, {**stated, **values}, getattr(self.fixed, kind.CHOICE.name))


def made(kind: type[Point], values: Mapping[str, Any], chosen: Any) -> Point:
    """A test of a kind from its numbers and its choice."""
    numbers: dict[str, Any] = {name: float(value) for name, value in values.items()}
    numbers["samples"] = round(numbers["samples"])
    return kind(**numbers, **{kind.CHOICE.name: chosen})


def blocks(points: Sequence[Point], size: int) -> list[list[Point]]:
    """The points in groups of ``size``, which are computed and kept together."""
    return [list(points[i : i + size]) for i in range(0, len(points), size)]
