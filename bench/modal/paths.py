"""Fits of the modal track: a method on a replicate of a scenario, stored as JSON."""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from bench.entrants.modal import GROUP, load_modal, make_modal
from bench.modal.scenario import ModalScenario
from bench.store.results import read_result, write_result

STORED = 1
"""Version of the stored format."""
LIMIT_S = 600.0
"""Time limit of a fit (s)."""


@dataclass(frozen=True, eq=False)
class TrackFit:
    """Task of the engine: a method on a replicate; the number of modes is not given to the method."""

    scenario: ModalScenario
    method: str
    replicate: int
    seed: int = 0
    size: int = 1
    limit_s: float = LIMIT_S

    @cached_property
    def key(self) -> str:
        """Digest of scenario, method, versions, seed and replicate."""
        versions = [STORED, load_modal(self.method).version]
        parts = [versions, self.scenario.identity, self.method, self.seed, self.replicate]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:20]

    @property
    def kind(self) -> tuple[str, str]:
        """The method and the scenario."""
        return self.method, self.scenario.label

    @property
    def used(self) -> set[tuple[str, str]]:
        """The method."""
        return {(GROUP, self.method)}

    def read(self, folder: Path) -> dict[str, Any] | None:
        """Return the stored fit; None if there is none."""
        content = read_result(folder, self.key)
        return None if content is None else dict(json.loads(content))

    def stored(self, folder: Path) -> bool:
        """Return whether the fit is stored."""
        return self.read(folder) is not None

    def compute(self, folder: Path) -> None:
        """Identify the modes and store them; raises InputError if the folder is not writable."""
        problem, _ = self.scenario.draw(self.seed, self.replicate)
        method, start = make_modal(self.method), time.perf_counter()
        estimate = method.identify_modes(problem)
        wall_s = time.perf_counter() - start
        modes = [
            [float(x) for x in (m.frequency, m.damping_ratio, m.frequency_sd, m.damping_ratio_sd)]
            for m in estimate.modes
        ]
        stored = {
            "status": estimate.status.value, "message": estimate.message, "degrees": float(estimate.degrees),
            "modes": modes, "wall_s": wall_s,
        }  # fmt: skip
        write_result(folder, self.key, json.dumps(stored).encode())
