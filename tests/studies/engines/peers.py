"""The table of other people's engines beside ours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from statistics import median

from tests.studies.common import tracked
from tests.studies.engines.children import MEMORY_MB, answered, measured
from tests.studies.engines.rivals import RIVALS, SOLVED, STARTS
from tests.studies.engines.rows import SEED, Row

SETS, REPEATS, TOGETHER = 10, 2, 100


@dataclass(frozen=True)
class Peer:
    """One line: median seconds a fit, how many of how many data sets ended at our minimum; or why there is none."""

    name: str
    title: str
    start: str
    seconds: float = math.nan
    solved: int = 0
    sets: int = 0
    failure: str = ""


def compare(limit_s: float, python: str) -> list[Peer]:
    """Ours, one data set at a time and many together, with the search for their starts; then those of a Python."""
    found = []
    for together in (1, TOGETHER):
        row = Row("", "", ("system=sdof",), "shooting", {}, together)
        outcome = measured(row.task(limit_s))
        title = f"`method=shooting`, {f'{together} together' if together > 1 else 'alone'}"
        found.append(Peer(f"shooting {together}", title, "its own", outcome.best, failure=outcome.failure))
    for name, start in tracked(list(product(RIVALS, STARTS)), "other engine"):
        found.append(peer(name, RIVALS[name][1], start, limit_s, python))
    return found


def peer(name: str, title: str, start: str, limit_s: float, python: str) -> Peer:
    """One engine from one kind of start, in a child of its own."""
    task = {
        "rival": name, "start": start, "seed": SEED, "sets": SETS, "repeats": REPEATS, "limit_s": limit_s,
        "memory_mb": MEMORY_MB,
    }  # fmt: skip
    said = answered(["-m", "tests.studies.engines.rivals"], task, python=python)
    if isinstance(said, str):
        return Peer(name, title, start, failure=said)
    if "missing" in said:
        return Peer(name, title, start, failure="not installed")
    solved = sum(off < SOLVED for off in said["off"])
    return Peer(name, title, start, median(said["seconds"]), solved, len(said["off"]))
