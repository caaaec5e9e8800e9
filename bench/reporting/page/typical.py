"""Of every system the scenario that stands for it where there is no room for all."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bench.reporting.page.reading import Panel

SNR_DB = 20.0
"""Of the first screen."""


def typical(panels: Sequence[Panel]) -> list[int]:
    """The place in ``panels`` of one scenario with methods a system, in their order.

    Undisturbed before disturbed, then nearest to 20 dB, start unknown, most methods.
    """

    def rank(i: int) -> tuple[bool, float, bool, int, int]:
        panel, facts = panels[i], panels[i].facts
        return not panel.plain, _far(facts.snr_db), facts.initial_state != "unknown", -len(panel.methods), i

    found: dict[str, int] = {}
    for i in sorted((i for i, panel in enumerate(panels) if panel.methods), key=rank):
        found.setdefault(panels[i].facts.system, i)
    return sorted(found.values())


def _far(snr_db: float) -> float:
    return math.inf if math.isnan(snr_db) else abs(snr_db - SNR_DB)
