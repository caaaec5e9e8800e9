"""A cell: one scenario, one method with its settings, so many replicates of a seed; known by what it computes.

The identity is that of the question: it names the cell's file. A setting at its default has no part in it, so that a
method which gets a new setting keeps its cells. What answers the question, the code with its defaults and the packages,
is the cell's version (:mod:`bench.store.version`): a stored answer of another version is stale.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bench.entrants.registry import default_settings
from bench.errors import InputError
from bench.scenario.scenario import Scenario
from bench.store.stored import StoredCell
from bench.store.version import Version, cell_version

FORMAT = 2
"""Raised when scores change their meaning, so that older rows are not taken for new ones."""


@dataclass(frozen=True)
class Cell:
    """``settings`` are all settings of the method, defaults included; ``label`` is what tables call the variant."""

    scenario: Scenario
    method: str
    settings: Mapping[str, Any]
    replicates: int
    seed: int
    label: str

    def description(self) -> dict[str, Any]:
        """What is computed, by name."""
        return {
            "format": FORMAT,
            "method": self.method,
            "settings": dict(self.settings),
            "replicates": self.replicates,
            "seed": self.seed,
            **_stated(self.scenario),
        }

    @property
    def version(self) -> Version:
        """What would compute the cell now."""
        disturbance = self.scenario.disturbance
        return cell_version(self.method, self.scenario.system, disturbance.kind if disturbance else "none")

    @cached_property
    def identity(self) -> str:
        """Hash of the description, settings at their defaults apart: not of labels, limits, machine or place."""
        return self._hash(self.description())

    @cached_property
    def question(self) -> str:
        """The same without the number of replicates: cells that differ in it alone have the same data sets first."""
        return self._hash({**self.description(), "replicates": None})

    def _hash(self, description: dict[str, Any]) -> str:
        usual = default_settings(self.method)
        own = {name: value for name, value in self.settings.items() if name not in usual or usual[name] != value}
        text = json.dumps({**description, "settings": own}, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    @cached_property
    def bound_identity(self) -> str:
        """Hash of what the bound depends on, which many cells share."""
        from bench.store.bounds import bound_identity  # loads scipy, which a mere look at cells does without

        return bound_identity(self)


def stored_as_cell(stored: StoredCell) -> Cell:
    """The cell whose description is stored; raises InputError where this version describes it differently."""
    what = stored.cell
    scenario = Scenario.from_dict(what, label=what["system"])
    settings = {**default_settings(what["method"]), **what["settings"]}  # what it has got since is at its default
    cell = Cell(scenario, what["method"], settings, what["replicates"], what["seed"], what["label"])
    if cell.identity != stored.identity:
        raise InputError("cell", stored.identity, "this version describes its configuration differently; run it anew")
    return cell


def _stated(scenario: Scenario) -> dict[str, Any]:
    """The scenario as JSON holds it, worked out once: the cells of all methods have the same one."""
    known = vars(scenario)
    if "_stated" not in known:
        known["_stated"] = scenario.to_dict()
    return dict(known["_stated"])
