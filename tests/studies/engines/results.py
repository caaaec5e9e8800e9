"""Measuring rows and curves, by the code of this checkout and of an earlier one in turn, and what came out in words."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.studies.engines.children import ROOT, Outcome, measured
from tests.studies.engines.rows import Curve, Row

LARGE = 1.1
"""An exponent above which growth is called more than linear."""


@dataclass(frozen=True)
class Result:
    """A row with what was measured; ``before`` is None where no earlier checkout is named."""

    row: Row
    now: Outcome
    before: Outcome | None
    limit_s: float = math.nan

    @property
    def held(self) -> bool | None:
        """Decide whether it takes no more time and memory than its goals; None where it has none."""
        if math.isnan(self.row.goal_s):
            return None
        small = math.isnan(self.row.goal_mb) or self.now.peak_mb <= self.row.goal_mb
        return not self.now.failure and not self.now.failed and self.now.best <= self.row.goal_s and small

    @property
    def ratio(self) -> float:
        """Time before over time now; where the earlier code came to no end within its limit, nan."""
        return self.before.best / self.now.best if self.before else math.nan

    @property
    def ratio_text(self) -> str:
        """The ratio as the table shows it: its least value where only the earlier code came to no end."""
        if self.before and self.before.late and not self.now.failure:
            return f"> {self.limit_s / (self.now.best * self.row.together):.3g} ×"
        return "-" if math.isnan(self.ratio) else f"{self.ratio:.3g} ×"


def measure(row: Row, limit_s: float, before: Path | None) -> Result:
    """A row's children, those of the earlier checkout and of this one in turn."""
    folders, found = [folder for folder in (before, ROOT) if folder], dict[Path, Outcome]()
    modules = {folder: () if row.warm else measured(row.task(limit_s), folder).modules for folder in folders}
    for _ in range(row.rounds):
        for folder in folders:
            if folder in found and found[folder].failure:
                continue
            new = measured({**row.task(limit_s), "modules": modules[folder]}, folder)
            found[folder] = found[folder].with_more(new) if folder in found else new
    return Result(row, found[ROOT], found[before] if before else None, limit_s=limit_s)


def difference(now: Outcome, before: Outcome) -> float:
    """The largest difference of an estimate's logarithm between both, in standard errors of the earlier one.

    Of the data sets that both have an estimate of; nan where there is none, or no standard error.
    """
    found = []
    for new, old in zip(now.answers, before.answers, strict=True):
        for name in new["values"].keys() & old["values"].keys():
            found.append(abs(new["values"][name] - old["values"][name]) / old["errors"][name])
    return float(np.max(found)) if found else math.nan


def same_answers(result: Result) -> str:
    """Return, as the table has it, how far the answers of both checkouts differ."""
    now, before = result.now, result.before
    if before is None or now.failure or before.failure:
        return "-"
    if now.data != before.data:
        return "other data"
    statuses = sum(a["status"] != b["status"] for a, b in zip(now.answers, before.answers, strict=True))
    off = difference(now, before)
    text = "-" if math.isnan(off) else "equal" if off == 0.0 else f"{off:.1g}"
    return f"{text}; {statuses} other statuses" if statuses else text


# ------------------------------------------------------------------------------------------------ growth


@dataclass(frozen=True)
class Growth:
    """A curve with the time of all fits of a child together, by size; ``failure``: what ended it, at which size."""

    curve: Curve
    sizes: tuple[int, ...]
    seconds: tuple[float, ...]
    failure: str = ""

    @property
    def exponent(self) -> float:
        """Return the exponent of the power law over the upper half."""
        return exponent(self.sizes, self.seconds)


def exponent(sizes: Iterable[float], seconds: Iterable[float]) -> float:
    """The slope of the logarithm of time over that of size, by least squares over the upper half of the points.

    The middle one of an odd number counts with the upper half; nan for fewer than two points.
    """
    x, y = np.log(list(sizes)), np.log(list(seconds))
    upper = slice(x.size // 2 if x.size > 2 else 0, None)
    if x.size < 2:
        return math.nan
    return float(np.polyfit(x[upper], y[upper], 1)[0])


def grow(curve: Curve, limit_s: float) -> Growth:
    """Measure a curve from small to large, up to the first size without an answer."""
    sizes, seconds, failure = list[int](), list[float](), ""
    for size in curve.sizes:
        found = measured(curve.row(size).task(limit_s))
        if found.failure or found.failed:
            failure = f"{found.failure or found.answers[0]['message']} at {size}"
            break
        sizes.append(size)
        seconds.append(found.best * curve.row(size).together)
    return Growth(curve, tuple(sizes), tuple(seconds), failure)
