"""A cell: one scenario, one method with its settings, so many replicates of a seed; known by what it computes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bench.scenario import Scenario

FORMAT = 1
"""Raised when scores change their meaning, so that older rows are not taken for new ones."""


@dataclass(frozen=True)
class Cell:
    """``settings`` are all settings of the method, defaults included; ``label`` is what tables call the variant.

    ``timeout_s`` limits one replicate.
    """

    scenario: Scenario
    method: str
    settings: Mapping[str, Any]
    replicates: int
    seed: int
    label: str
    timeout_s: float = 600.0

    def description(self) -> dict[str, Any]:
        """What is computed, by name: this and nothing else decides the identity."""
        return {
            "format": FORMAT,
            "method": self.method,
            "settings": dict(self.settings),
            "replicates": self.replicates,
            "seed": self.seed,
            "timeout_s": float(self.timeout_s),
            "data": self.scenario.data_identity(),
            "told": self.scenario.told_identity(),
            "dense": self.scenario.dense,
            "forecast": float(self.scenario.forecast),
        }

    @property
    def identity(self) -> str:
        """Hash of the description: not of labels, machine or place."""
        text = json.dumps(self.description(), sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:20]
