"""Where the atlas is sampled: a scrambled Sobol sequence over a box, and regular grids over two of its axes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench.atlas.point import Point
from bench.errors import InputError

Spacing = Literal["logarithmic", "linear"]


@dataclass(frozen=True)
class Axis:
    """A number of a test, between two limits."""

    name: str
    low: float
    high: float
    spacing: Spacing = "linear"

    def at(self, share: np.ndarray) -> np.ndarray:
        """The values at shares (0 to 1) of the way from the lower to the upper limit."""
        if self.spacing == "logarithmic":
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)


AXES = (
    Axis("samples", 8, 500, "logarithmic"),
    Axis("cycles", 0.3, 100.0, "logarithmic"),
    Axis("damping_ratio", 5e-4, 1.2, "logarithmic"),
    Axis("snr_db", -5.0, 60.0),
    Axis("phase", 0.0, math.pi),
)
"""The box. A start that is turned by half a cycle is the same motion upside down."""


def sobol(number: int, seed: int) -> list[Point]:
    """The first ``number`` points of the sequence over :data:`AXES` and a known or unknown start."""
    from scipy.stats import qmc  # slow to import

    if number < 1 or number & (number - 1):
        raise InputError("atlas.points", number, "a power of two, at which the sequence is balanced")
    shares = qmc.Sobol(len(AXES) + 1, scramble=True, rng=np.random.default_rng(seed)).random(number)
    values = {axis.name: axis.at(shares[:, i]) for i, axis in enumerate(AXES)}
    return [
        _point({name: column[i] for name, column in values.items()}, bool(shares[i, -1] < 0.5)) for i in range(number)
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
        by_name = {axis.name: axis for axis in AXES}
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
        stated = {axis.name: getattr(self.fixed, axis.name) for axis in AXES}
        return _point({**stated, **values}, self.fixed.start_known)


def _point(values: Mapping[str, float], known: bool) -> Point:
    numbers = {name: float(value) for name, value in values.items() if name != "samples"}
    return Point(samples=round(float(values["samples"])), start_known=known, **numbers)


def blocks(points: Sequence[Point], size: int) -> list[list[Point]]:
    """The points in groups of ``size``, which are computed and kept together."""
    return [list(points[i : i + size]) for i in range(0, len(points), size)]
