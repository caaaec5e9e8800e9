"""Advice from what other commands wrote beside the site: the atlas, the measured track, and the online track."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from bench.atlas.model import TOLD
from bench.entrants.online import online_card
from bench.errors import InputError
from bench.reporting.atlas import RARE
from bench.reporting.labels import title
from bench.reporting.page.situations import SituationRecord, ordered

GROUPS = ("k_over_m", "c_over_m")
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


def atlas_records(folder: Path) -> tuple[dict[str, SituationRecord], int]:
    """By label, what each method does over the atlas of free decays where the data tell k/m and c/m; its points."""
    needed = {"method", "aliased", "fits", "seconds"}
    needed |= {f"{name}{end}" for name in GROUPS for end in ("_core", "_gross")} | {f"bound_{name}" for name in GROUPS}
    data = read_csv(folder / "atlas.csv.gz", needed)
    if data is None:
        return {}, 0
    told = [data[(data[f"bound_{name}"] <= TOLD) & ~data["aliased"].astype(bool)] for name in GROUPS]
    points = int(max(told[0]["method"].value_counts(), default=0))
    return {str(label): _over_points(str(label), told) for label in dict.fromkeys(data["method"])}, points


def _over_points(label: str, told: list[pd.DataFrame]) -> SituationRecord:
    """A method's lines of each quantity pooled; gross errors are counted by the quantity that has more."""
    own = [(frame[frame["method"] == label], name) for frame, name in zip(told, GROUPS, strict=True)]
    core = pd.concat([frame[f"{name}_core"] for frame, name in own]).dropna()
    counted = [
        (int((frame["fits"] * frame[f"{name}_gross"]).round().sum()), int(frame["fits"].sum())) for frame, name in own
    ]
    wrong, fits = max(counted, key=lambda pair: pair[0] / pair[1] if pair[1] else -1.0)
    return SituationRecord(
        label, label, float(core.median()) if len(core) else math.nan, float(core.max()) if len(core) else math.nan,
        wrong, fits, float(own[0][0]["seconds"].median()),
    )  # fmt: skip


def unsteady(atlas: Mapping[str, SituationRecord]) -> frozenset[str]:
    """The methods that ran on the whole atlas and have gross errors on more of it than counts as rare."""
    most = max((one.fits for one in atlas.values()), default=0)
    return frozenset(label for label, one in atlas.items() if one.risk > RARE and one.fits == most)


def atlas_order(
    atlas: Mapping[str, SituationRecord],
) -> tuple[tuple[SituationRecord, ...], tuple[SituationRecord, ...]]:
    """Those that are advised over the atlas, and those that are fragile there; in neither: methods on a part of it."""
    most = max((one.fits for one in atlas.values()), default=0)
    whole = {label: one for label, one in atlas.items() if one.fits == most}
    least = min((one.risk for one in whole.values()), default=0.0)
    compared = {label: replace(one, p_gross=0.0, extra=one.risk - least) for label, one in whole.items()}
    found = ordered(compared, frozenset(compared), frozenset())
    return found.advised, found.fragile


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
