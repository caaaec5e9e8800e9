"""Pictures that are maps: what failed where."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import altair as alt
import pandas as pd

from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.reporting.figures.gallery import Gallery, Nothing, Picture
from bench.reporting.frame import Result
from bench.reporting.pictures.style import layered, table
from bench.reporting.rounding import readable

LETTERS = {
    Status.DIVERGED: "d", Status.NONFINITE: "n", Status.TIMEOUT: "t", Status.KILLED: "k", Status.OOM: "o",
    Status.CRASHED: "c", Status.INVALID: "i",
}  # fmt: skip
ABSENT = {Status.UNSUPPORTED: "–", Status.MISSING_DEPENDENCY: "p"}
"""Not failures of a fit: the method says that it cannot, or its package is not there."""
MOST = 60
"""Rows shown at most: those with most failures."""
Scene = tuple[str, str]
"""A system and what disturbs it: a row, at its noise level and start with most failures of each method."""


@dataclass(frozen=True)
class Share:
    """Of the replicates of a method: how many of those tried failed, the status of most, and why not tried, if so."""

    failed: float
    status: Status | None
    absent: Status | None

    @property
    def text(self) -> str:
        """What stands in the map: a number (%) and the status, or why there is none."""
        if self.status is None:
            return ABSENT[self.absent] if self.absent else ""
        return (
            f"{100 * self.failed:.0f}\n{LETTERS[self.status]}" if self.failed >= 0.01 else f"<1\n{LETTERS[self.status]}"
        )


def share(cell: Result) -> Share:
    """The share of a cell."""
    counted = Counter(cell.statuses)
    absent = max((s for s in ABSENT if counted[s]), key=lambda s: counted[s], default=None)
    failed = {status: counted[status] for status in LETTERS if counted[status]}
    total = sum(failed.values()) / cell.n if cell.n else 0.0
    return Share(total, max(failed, key=lambda s: failed[s], default=None), absent)


def worst(cells: Sequence[Result]) -> dict[tuple[Scene, str], Share]:
    """By row and method, the share of the cell with most failures; not tried only if no cell of it was."""
    found: dict[tuple[Scene, str], Share] = {}
    for cell in cells:
        at, own = ((cell.system, cell.disturbance), cell.label), share(cell)
        kept = found.get(at)
        if kept is None or (own.failed, own.absent is None) > (kept.failed, kept.absent is None):
            found[at] = own
    return found


def draw_failures(gallery: Gallery) -> Picture:
    """A heat map, a row a system and a column a method, of those rows and columns in which something failed."""
    found = worst(gallery.cells)
    bad = Counter[Scene]()
    for (scene, _), own in found.items():
        bad[scene] += round(1e6 * own.failed)
    rows = sorted(sorted((scene for scene in bad if bad[scene]), key=lambda scene: -bad[scene])[:MOST])
    if not rows:
        raise Nothing("no replicate of any cell failed")
    failing = {label for (scene, label), own in found.items() if scene in rows and own.failed}
    columns = [label for label in gallery.looks if label in failing]
    shown = [(row, label, found.get((row, label))) for row in rows for label in columns]
    frame = pd.DataFrame(
        [
            (_name(row), gallery.name(label), 100.0 * own.failed if own else 0.0, own.text if own else "·")
            for row, label, own in shown
        ],
        columns=["test", "method", "failed", "shown"],
    )
    chart = alt.Chart(table(frame)).encode(
        alt.X("method:N").sort([gallery.name(label) for label in columns]).title(None)
        .axis(orient="top", labelAngle=-90, ticks=False, domain=False, grid=True, bandPosition=0),
        alt.Y("test:N").sort([_name(row) for row in rows]).title(None)
        .axis(ticks=False, domain=False, grid=True, bandPosition=0),
        tooltip=["test", "method", "failed", "shown"],
    )  # fmt: skip
    heat = alt.Color("failed:Q").scale(domain=[0, 100], range=["#fee8c8", "#e34a33"]).legend(None)
    failed = chart.transform_filter("datum.failed > 0")
    dark = failed.mark_text(lineBreak="\n", lineHeight=7.5, dy=-3.5, color="#1a1a1a")
    text = chart.transform_filter("datum.failed == 0").mark_text()
    layers = layered(
        chart.data, failed.mark_rect().encode(heat), dark.encode(text="shown:N"), text.encode(text="shown:N")
    )
    scenes = {scene for scene, _ in found}
    fitted = {label for (scene, label), own in found.items() if scene in rows and own.absent is None}
    never = [gallery.name(label) for label in gallery.looks if label in fitted - set(columns) - set(REFERENCES)]
    used = {own.status for *_, own in shown if own}
    letters = ", ".join(f"{letter} {status}" for status, letter in LETTERS.items() if status in used)
    drawn = layers.properties(width=300, height=alt.Step(18))
    return Picture(drawn, _caption(gallery.cells, len(rows), len(scenes), never, letters))


def _caption(cells: Sequence[Result], rows: int, scenes: int, never: Sequence[str], letters: str) -> str:
    tried = sum(cell.n - sum(cell.statuses.count(status) for status in ABSENT) for cell in cells)
    failed = sum(cell.statuses.count(status) for cell in cells for status in LETTERS)
    without = f" No fit of these failed there: {'; '.join(never)}." if never else ""
    return (
        f"Fits failed in {rows} of {scenes} kinds of test. In a row, a system with what disturbs its record, the "
        "share (%) of the replicates that were tried and failed, at the noise level and start where it is largest, "
        f"with the letter of the most frequent status ({letters}). A stroke: the method says that it cannot do this "
        "('unsupported'), p: a package is missing; neither is a failure of a fit. A point: not run. Kinds of test "
        f"and methods without any failure are left out.{without} Of all {tried} replicates that were tried {failed} "
        "failed. A failure counts as an infinite error in medians, ranks and profiles."
    )


def _name(scene: Scene) -> str:
    """A row's name: the system, and what disturbs it."""
    system, disturbance = scene
    return readable(system) + (f", {readable(disturbance)}" if disturbance else "")
