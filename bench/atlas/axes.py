"""The numbers of a test over which an atlas is spread, each between two limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

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


@dataclass(frozen=True)
class AxisValues:
    """What a test has one of: ``values`` of equal share."""

    name: str
    values: tuple[Any, ...]

    def at(self, share: float) -> Any:
        """The value at a share from 0 to 1."""
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
