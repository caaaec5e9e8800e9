"""Names that stand beside a panel, each as near the height of what it names as the others let it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.reporting.figures.style import MM, SMALL

LINE = 1.3 * SMALL / 72.0 / MM
"""Height of a line of text (mm)."""
GAP = 1.2
"""Between two names (mm)."""


@dataclass(frozen=True)
class Name:
    """A text of one or more lines, and where what it names is on the panel, in parts of its width and height."""

    text: str
    x: float
    y: float
    colour: str = "0.35"

    @property
    def height(self) -> float:
        """Of the text and the gap to the next (mm)."""
        return LINE * (self.text.count("\n") + 1) + GAP


def height_of(names: Sequence[Name]) -> float:
    """What a column of names needs (mm)."""
    return sum(name.height for name in names)


def name_beside(axis: Any, names: Sequence[Name], height: float) -> None:
    """Write names right of a panel of a height (mm), each with a line to the place of what it names."""
    sizes = np.array([name.height for name in names]) / height
    for name, at in zip(names, spread(np.array([name.y for name in names]), sizes), strict=True):
        x, y = (name.x, 1.0, 1.05), (name.y, at, at)
        axis.plot(x, y, color=name.colour, lw=0.5, zorder=3, transform=axis.transAxes, clip_on=False)
        axis.text(1.06, at, name.text, fontsize=SMALL, va="center", transform=axis.transAxes, linespacing=1.0)


def spread(wanted: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Centres (n,) of labels of these sizes (n,) on a line from 0 to 1: near those wanted (n,), none on another.

    Least squares in the order of what is wanted; labels that do not fit all hang over the upper end.
    """
    from scipy.optimize import isotonic_regression

    order = np.argsort(wanted, kind="stable")
    below = np.cumsum(sizes[order]) - 0.5 * sizes[order]
    free = isotonic_regression(wanted[order] - below).x
    placed = np.clip(free, 0.0, max(0.0, 1.0 - float(sizes.sum()))) + below
    centres = np.empty_like(placed)
    centres[order] = placed
    return centres
