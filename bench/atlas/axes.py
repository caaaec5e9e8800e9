"""Axes of an atlas: the quantities that describe a test, with their ranges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Spacing = Literal["logarithmic", "linear"]


@dataclass(frozen=True)
class Axis:
    """A number that describes a test, with its range."""

    name: str
    low: float
    high: float
    spacing: Spacing = "linear"

    def value(self, share: np.ndarray) -> np.ndarray:
        """Return the values at shares (0 to 1) of the range."""
        if self.spacing == "logarithmic":
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)


@dataclass(frozen=True)
class AxisValues:
    """A categorical property of a test, whose ``values`` are equally frequent."""

    name: str
    values: tuple[Any, ...]

    def value(self, share: float) -> Any:
        """Return the value at a share from 0 to 1."""
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
