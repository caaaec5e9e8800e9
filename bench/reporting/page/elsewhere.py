"""Advice from what other commands wrote beside the site: the measured track, and the online track."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from bench.entrants.online import online_card
from bench.errors import InputError
from bench.reporting.labels import title

MOST_LEFT_OUT = 0.1
"""A method that misses more than this share of the online track's lines is not compared with the others there."""


@dataclass(frozen=True)
class RecordSummary:
    """A method on real records: ``believed`` of ``fits`` were answers that its own checks do not withdraw."""

    label: str
    believed: int
    fits: int
    held_out: float
    seconds: float


@dataclass(frozen=True)
class TrackerSummary:
    """A tracker: median and worst error over the bound along the path, coverage (%), microseconds a sample."""

    title: str
    excess: float
    worst: float
    coverage: float
    micros: float
    ok: int
    records: int


def read_csv(path: Path, needed: set[str]) -> pd.DataFrame | None:
    """A CSV of this benchmark with at least these columns; None where there is none that can be read."""
    try:
        found = pd.read_csv(path)
    except (OSError, ValueError):
        return None
    return found if needed <= set(found.columns) and len(found) else None


def measured(folder: Path) -> list[RecordSummary]:
    """Every method of the measured track, the one with most answers that stand first."""
    data = read_csv(
        folder / "table11.csv", {"set", "system", "method", "sibling", "status", "trust", "held_out", "wall_s"}
    )
    if data is None:
        return []
    fits = data.drop_duplicates(["set", "system", "method", "sibling"])
    stands = (fits["status"] == "ok") & (fits["trust"] != "do not trust")
    found = []
    for label in dict.fromkeys(fits["method"]):
        own = fits[fits["method"] == label]
        good = own[stands.loc[own.index]]
        held = float(good["held_out"].median()) if len(good) else math.nan
        found.append(RecordSummary(str(label), len(good), len(own), held, float(own["wall_s"].median())))
    return sorted(found, key=lambda one: (-one.believed, one.seconds, one.label))


def followed(folder: Path) -> list[TrackerSummary]:
    """The trackers of the online track, the least error over the bound first; those of a few scenarios are left out."""
    needed = {"scenario", "method", "quantity", "excess", "coverage_pct", "ok", "replicates", "micros_median"}
    data = read_csv(folder / "table10.csv", needed)
    if data is None:
        return []
    data = data[data["quantity"].notna() & (data["method"] != "bound")]
    lines = data.groupby("method")["excess"].count()
    enough = lines[lines >= (1 - MOST_LEFT_OUT) * lines.max()].index
    found = []
    for label in dict.fromkeys(data["method"]):
        own = data[data["method"] == label]
        if label in enough:
            each = own.drop_duplicates("scenario")
            found.append(
                TrackerSummary(
                    tracker_title(str(label)), float(own["excess"].median()), float(own["excess"].max()),
                    float(own["coverage_pct"].median()), float(own["micros_median"].median()),
                    int(each["ok"].sum()), int(each["replicates"].sum()),
                )
            )  # fmt: skip
    return sorted(found, key=lambda one: (one.excess, one.title))


def tracker_title(label: str) -> str:
    """A tracker's name for people, where it is registered."""
    try:
        return online_card(label).title or title(label)
    except InputError:
        return label.replace("_", " ")
