"""A cell: one scenario, one method with its settings, a number of replicates, and a seed.

The identity of a cell is a hash of its configuration, and names its file. Settings at their defaults are not part of
the hash, so that adding a setting to a method does not change the identity of existing cells. The version of the code
(:mod:`bench.store.version`) is not part of it either: a cell stored by another version is stale.
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
from bench.store.stored_cell import StoredCell
from bench.store.version import Version, described_version

FORMAT = 2
"""Part of the identity. Raise it when the meaning of scores changes, so that older rows are not used."""


@dataclass(frozen=True)
class Cell:
    """The configuration of a cell.

    ``settings`` are all settings of the method, defaults included; ``label`` names the variant of the method in tables.
    """

    scenario: Scenario
    method: str
    settings: Mapping[str, Any]
    replicates: int
    seed: int
    label: str

    def description(self) -> dict[str, Any]:
        """Return the configuration that determines the identity, as plain values."""
        return {
            "format": FORMAT,
            "method": self.method,
            "settings": dict(self.settings),
            "replicates": self.replicates,
            "seed": self.seed,
            **scenario_description(self.scenario),
        }

    def full_description(self) -> dict[str, Any]:
        """Return the description with the labels of cell and system, for :meth:`from_description`."""
        return {**self.description(), "label": self.label, "system": self.scenario.label}

    @classmethod
    def from_description(cls, stated: Mapping[str, Any], identity: str, force_file: Path | None = None) -> Cell:
        """Return the cell of a stored description.

        Args:
            stated: The description, see :meth:`full_description`.
            identity: The stored identity.
            force_file: File of the force's samples, of which a description has only the digest.

        Raises:
            InputError: The description is invalid, or has another identity in this version.
        """
        reason = "this version describes its configuration differently; run it again"
        if not fits(stated, DESCRIPTION):
            raise InputError("cell", identity, reason)
        force = stated.get("data", {}).get("force") or {}
        if "file" in force:  # a path in a description is never opened
            if force_file is None or not force_file.is_file():
                raise InputError("cell", identity, f"the file of its force is missing ({force_file or 'not stored'})")
            stated = {**stated, "data": {**stated["data"], "force": {**force, "file": str(force_file)}}}
        try:
            scenario = Scenario.from_dict(stated, label=stated["system"])
            settings = {**default_settings(stated["method"]), **stated["settings"]}  # later settings at their defaults
            cell = cls(scenario, stated["method"], settings, stated["replicates"], stated["seed"], stated["label"])
            matching = cell.identity == identity
        except InputError:
            raise
        except Exception as error:  # an invalid description can cause any exception
            raise InputError("cell", identity, f"{reason} ({one_line(error)})") from None
        if not matching:
            raise InputError("cell", identity, reason)
        return cell

    @property
    def version(self) -> Version:
        """The version of the code that would compute the cell now."""
        return described_version(self.description())

    @cached_property
    def identity(self) -> str:
        """Hash of the description, without settings at their defaults; labels, limits and machine have no influence."""
        return self._hash(self.description())

    @cached_property
    def question(self) -> str:
        """Hash without the number of replicates: cells with the same hash begin with the same data."""
        return self._hash({**self.description(), "replicates": None})

    def _hash(self, description: dict[str, Any]) -> str:
        defaults = default_settings(self.method)
        changed = {k: value for k, value in self.settings.items() if k not in defaults or defaults[k] != value}
        text = json.dumps({**description, "settings": changed}, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    @cached_property
    def bound_identity(self) -> str:
        """Hash of everything that the bound depends on; many cells share a bound."""
        from bench.store.bounds import bound_identity  # imports scipy, which reading cells does not need

        return bound_identity(self)


def stored_as_cell(stored: StoredCell) -> Cell:
    """Return the cell of a stored description; raises InputError if its identity differs in this version."""
    return Cell.from_description(stored.cell, stored.identity)


def scenario_description(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario as plain values, cached in it, since the cells of all methods share the scenario."""
    cache = vars(scenario)
    if "_description" not in cache:
        cache["_description"] = scenario.to_dict()
    return dict(cache["_description"])
