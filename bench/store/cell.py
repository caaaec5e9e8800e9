"""A cell: one scenario, one method with its settings, so many replicates of a seed; known by what it computes.

The identity is that of the question: it names the cell's file. A setting at its default has no part in it, so that a
method which gets a new setting keeps its cells. What answers the question is the cell's version
(:mod:`bench.store.version`): a stored answer of another version is stale.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from bench.entrants.registry import default_settings
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.scenario.scenario import Scenario
from bench.store.shape import DESCRIPTION, fits
from bench.store.stored import StoredCell
from bench.store.version import Version, settings_version

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
        """Return what is computed, by name."""
        return {
            "format": FORMAT,
            "method": self.method,
            "settings": dict(self.settings),
            "replicates": self.replicates,
            "seed": self.seed,
            **_stated(self.scenario),
        }

    def stated(self) -> dict[str, Any]:
        """Return the description with the labels of the cell and of its system: all that :meth:`restored` needs."""
        return {**self.description(), "label": self.label, "system": self.scenario.label}

    @classmethod
    def restored(cls, stated: Mapping[str, Any], identity: str, force_file: Path | None = None) -> Cell:
        """Return the cell of a description; raises InputError where this version would give it another identity.

        A force that was read from a file is stated by the digest of its numbers; ``force_file`` is where they are.
        """
        reason = "this version describes its configuration differently; run it anew"
        if not fits(stated, DESCRIPTION):
            raise InputError("cell", identity, reason)
        force = stated.get("data", {}).get("force") or {}
        if "file" in force:  # never a path that a description names
            if force_file is None or not force_file.is_file():
                raise InputError("cell", identity, f"the file of its force is not there ({force_file or 'not kept'})")
            stated = {**stated, "data": {**stated["data"], "force": {**force, "file": str(force_file)}}}
        try:
            scenario = Scenario.from_dict(stated, label=stated["system"])
            settings = {**default_settings(stated["method"]), **stated["settings"]}  # what it has got since: defaults
            cell = cls(scenario, stated["method"], settings, stated["replicates"], stated["seed"], stated["label"])
            own = cell.identity
        except InputError:
            raise
        except Exception as error:  # whatever a description makes of a scenario that no version has written
            raise InputError("cell", identity, f"{reason} ({one_line(error)})") from None
        if own != identity:
            raise InputError("cell", identity, reason)
        return cell

    @property
    def version(self) -> Version:
        """Return the version that would compute the cell now."""
        return settings_version(self.method, self.scenario.system, self.settings)

    @cached_property
    def identity(self) -> str:
        """Hash the description, settings at their defaults apart: not labels, limits, machine or place."""
        return self._hash(self.description())

    @cached_property
    def question(self) -> str:
        """Hash the same but for the number of replicates: cells that differ in it alone begin with the same data."""
        return self._hash({**self.description(), "replicates": None})

    def _hash(self, description: dict[str, Any]) -> str:
        usual = default_settings(self.method)
        own = {name: value for name, value in self.settings.items() if name not in usual or usual[name] != value}
        text = json.dumps({**description, "settings": own}, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    @cached_property
    def bound_identity(self) -> str:
        """Hash what the bound depends on, which many cells share."""
        from bench.store.bounds import bound_identity  # loads scipy, which a mere look at cells does without

        return bound_identity(self)


def stored_as_cell(stored: StoredCell) -> Cell:
    """Return the cell whose description is stored; raises InputError where this version describes it differently."""
    return Cell.restored(stored.cell, stored.identity)


def _stated(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario as JSON holds it, computed once: the cells of all methods have the same one."""
    known = vars(scenario)
    if "_stated" not in known:
        known["_stated"] = scenario.to_dict()
    return dict(known["_stated"])
