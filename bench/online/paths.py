"""The paths of the online track: a tracker over a stream, kept as one file of arrays."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bench.entrants.online import make_online
from bench.entrants.registry import load_method
from bench.isolation.machine import compiled_single_threaded
from bench.online.follow import Followed, follow
from bench.online.scenario import OnlineScenario
from bench.store.results import read_result, write_result
from bench.store.version import bound_version

LIMIT_S = 86400.0
"""Limit of a path (s): a window of a slow batch method takes hours."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """All replicates of a scenario by a method; ``label`` is the method's name in the table, or its variant's."""

    scenario: OnlineScenario
    method: str
    settings: dict[str, Any]
    replicates: int
    seed: int = 0
    label: str = ""

    @cached_property
    def versions(self) -> list[int]:
        """Return the versions of the method, of a batch method that it repeats, of the system and the scoring."""
        method = make_online(self.method, self.settings)
        batch = getattr(method, "batch", None)
        repeated = [load_method(batch).version] if isinstance(batch, str) else []
        return [method.version, *repeated, *bound_version(self.scenario.system)]

    def paths(self) -> list[OnlinePath]:
        """Return the path of each replicate."""
        return [OnlinePath(self, i) for i in range(self.replicates)]


@dataclass(frozen=True, eq=False)
class OnlinePath:
    """A task of the engine: a replicate of a tracking."""

    of: Tracking
    replicate: int
    size: int = 1
    limit_s: float = LIMIT_S

    @cached_property
    def key(self) -> str:
        """Return a digest of scenario, method with settings, versions, seed and replicate."""
        of = self.of
        parts = [of.versions, of.scenario.identity, of.method, of.settings, of.seed, self.replicate]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]

    @property
    def kind(self) -> tuple[str, str]:
        """Return the labels of method and scenario."""
        return self.of.label or self.of.method, self.of.scenario.label

    def stored(self, folder: Path) -> bool:
        """Return whether the path is stored whole."""
        return read_result(folder, self.key) is not None

    def compute(self, folder: Path) -> None:
        """Follow the stream and store the path; raises InputError where the folder cannot be written."""
        path = follow(
            make_online(self.of.method, self.of.settings), self.of.scenario.stream(self.of.seed, self.replicate)
        )
        content = io.BytesIO()
        np.savez_compressed(content, **asdict(path))
        write_result(folder, self.key, content.getvalue())


def read_paths(folder: Path, of: Tracking) -> dict[int, Followed]:
    """Return the stored paths of a tracking, by replicate."""
    stored = {}
    for path in of.paths():
        if (content := read_result(folder, path.key)) is not None:
            with np.load(io.BytesIO(content), allow_pickle=False) as kept:
                arrays = {name: kept[name] if kept[name].ndim else kept[name].item() for name in kept.files}
            stored[path.replicate] = Followed(**arrays)
    return stored


def in_order(trackings: Sequence[Tracking]) -> list[OnlinePath]:
    """Return the paths of trackings, stream by stream: methods share what they compile for one.

    What is compiled from now on uses one thread, since paths share the cores.
    """
    compiled_single_threaded()
    places = {scenario: i for i, scenario in enumerate(dict.fromkeys(of.scenario.identity for of in trackings))}
    return sorted(
        (path for of in trackings for path in of.paths()),
        key=lambda path: (places[path.of.scenario.identity], path.replicate),
    )
