"""The page of the measured track: the totals, what is right in which set, and each set with its siblings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.reporting.grid import Grid, rendered, style
from bench.reporting.tables.track_table import (
    CERTIFIED,
    FREE_RUN,
    Track,
    TrackPanel,
    certified_rows,
    free_runs,
    known_values,
    method_rows,
    origin,
    overview,
    summary,
)
from bench.reporting.track.figures import coverage, forest


@dataclass(frozen=True)
class TrackSection:
    """One set with one system: texts, a picture (maybe none) and captioned tables."""

    key: str
    title: str
    origin: str
    known: str
    picture: str
    grids: tuple[tuple[str, Grid], ...]


def page(track: Track, command: str) -> str:
    """The page as HTML, which needs no other file and no network."""
    sentences = [line.removeprefix("- ") for line in summary(track).splitlines()]
    return rendered(
        "track/track.html.j2",
        style=style(),
        sentences=sentences,
        overview=_grid(overview(track)),
        coverage=coverage(track),
        sections=[_section(panel, track) for panel in track.panels],
        command=command,
    )


def _section(panel: TrackPanel, track: Track) -> TrackSection:
    known = known_values(panel) if panel.of.known else ""
    key = f"{panel.name}-{panel.system}".replace("+", "-")
    title = f"{panel.name}, {panel.system}"
    if panel.absent:
        return TrackSection(key, title, f"{origin(panel)} {panel.absent}.", known, "", ())
    grids = [("Methods, over all siblings", _grid(method_rows(panel)))]
    if panel.name == CERTIFIED:
        grids.append(("Against the certified values", _grid(certified_rows(panel))))
    if (free := free_runs(panel, track.free_runs)) is not None:
        grids.append((FREE_RUN.removesuffix(":"), _grid(free)))
    return TrackSection(key, title, origin(panel), known, forest(panel), tuple(grids))


def _grid(table: tuple[Sequence[Sequence[str]], Sequence[str]]) -> Grid:
    rows, headers = table
    return Grid(tuple(headers), tuple(tuple(row) for row in rows))
