"""Tasks of the online track: the path of a tracker over a stream, stored as one file of arrays."""

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

from bench import scoring
from bench.contract.online import OnlineIdentifier
from bench.entrants.online import GROUP as TRACKERS
from bench.entrants.online import make_online
from bench.entrants.registry import GROUP as METHODS
from bench.isolation.machine import compiled_single_threaded
from bench.online.follow import Followed, follow
from bench.online.scenario import OnlineScenario
from bench.store.results import read_result, write_result
from bench.store.table_versions import version_text
from bench.systems import GROUP as SYSTEMS

LIMIT_S = 86400.0
"""Time limit of a path (s); a slow batch method on moving windows takes hours."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """All replicates of a scenario for a method; ``label`` names the variant of the method in the table."""

    scenario: OnlineScenario
    method: str
    settings: dict[str, Any]
    replicates: int
    seed: int = 0
    label: str = ""

    @cached_property
    def identifier(self) -> OnlineIdentifier:
        """The method with its settings."""
        return make_online(self.method, self.settings)

    @cached_property
    def used(self) -> set[tuple[str, str]]:
        """The tracker, or the batch method in its windows, and the system: groups and names of entry points."""
        batch = getattr(self.identifier, "batch", None)
        return {(TRACKERS, self.method) if batch is None else (METHODS, batch), (SYSTEMS, self.scenario.system)}

    @cached_property
    def versions(self) -> list[Any]:
        """The versions of the method, of all that is used, and of the scoring."""
        return [self.identifier.version, *(version_text(*entry) for entry in sorted(self.used)), scoring.VERSION]

    def paths(self) -> list[OnlinePath]:
        """Return the path of each replicate."""
        return [OnlinePath(self, i) for i in range(self.replicates)]


@dataclass(frozen=True, eq=False)
class OnlinePath:
    """A task of the engine: one replicate of a tracking."""

    tracking: Tracking
    replicate: int
    size: int = 1
    limit_s: float = LIMIT_S

    @cached_property
    def key(self) -> str:
        """Digest of scenario, method with settings, versions, seed and replicate."""
        t = self.tracking
        parts = [t.versions, t.scenario.identity, t.method, t.settings, t.seed, self.replicate]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]

    @property
    def kind(self) -> tuple[str, str]:
        """The labels of method and scenario."""
        return self.tracking.label or self.tracking.method, self.tracking.scenario.label

    @property
    def used(self) -> set[tuple[str, str]]:
        """The entry points that its tracking uses."""
        return self.tracking.used

    def stored(self, folder: Path) -> bool:
        """Return whether a complete path is stored."""
        return read_result(folder, self.key) is not None

    def compute(self, folder: Path) -> None:
        """Apply the tracker to the stream and store the path; raises InputError if the folder cannot be written."""
        t = self.tracking
        path = follow(make_online(t.method, t.settings), t.scenario.stream(t.seed, self.replicate))
        content = io.BytesIO()
        np.savez_compressed(content, **asdict(path))
        write_result(folder, self.key, content.getvalue())


def read_paths(folder: Path, tracking: Tracking) -> dict[int, Followed]:
    """Return the stored paths of a tracking by replicate."""
    stored = {}
    for path in tracking.paths():
        if (content := read_result(folder, path.key)) is not None:
            with np.load(io.BytesIO(content), allow_pickle=False) as file:
                arrays = {name: file[name] if file[name].ndim else file[name].item() for name in file.files}
            stored[path.replicate] = Followed(**arrays)
    return stored


def in_order(trackings: Sequence[Tracking]) -> list[OnlinePath]:
    """Return the paths of trackings ordered by stream, since methods share compiled code for a stream.

    Code that is compiled later uses one thread, since parallelism is over paths.
    """
    compiled_single_threaded()
    order = {identity: i for i, identity in enumerate(dict.fromkeys(t.scenario.identity for t in trackings))}
    return sorted(
        (path for tracking in trackings for path in tracking.paths()),
        key=lambda path: (order[path.tracking.scenario.identity], path.replicate),
    )
