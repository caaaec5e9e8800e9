"""What the atlas costs: time of the fits that were made, and from it that of those that are left."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.atlas.run import Block, read_block


@dataclass(frozen=True)
class Progress:
    """How far the blocks of a label are, their fits, and the seconds of one core that a fit takes (NaN: none yet)."""

    label: str
    done: int
    blocks: int
    fits_done: int
    fits: int
    fit_s: float


def progress(tasks: Sequence[Block], folder: Path) -> list[Progress]:
    """A line a label, from the statistics of finished blocks: median time of a fit at a point, times its fits."""
    found = []
    for label in dict.fromkeys(task.label for task in tasks):
        own = [task for task in tasks if task.label == label]
        kept = [(task, statistics) for task in own if (statistics := read_block(folder, task)) is not None]
        fits = sum(task.size for task, _ in kept)
        seconds = sum(one.seconds * one.fits for _, statistics in kept for one in statistics)
        rate = seconds / fits if fits else math.nan
        found.append(Progress(label, len(kept), len(own), fits, sum(task.size for task in own), rate))
    return found


def hours(tasks: Sequence[Block], fit_s: dict[str, float], workers: int) -> float:
    """Hours that so many workers take, each block by the one that is free first, in the order of the tasks."""
    free = [0.0] * workers
    for task in tasks:
        heapq.heappush(free, heapq.heappop(free) + task.size * fit_s[task.label])
    return max(free) / 3600.0
