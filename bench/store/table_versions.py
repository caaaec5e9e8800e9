"""Versions of the code behind tables that are not made of cells: the tracks and the atlas.

Next to these tables stands ``versions.csv``, with a line per table and registered method or system that it was computed
with. A table is stale if one of these versions has changed, as a stored cell is (:mod:`bench.store.version`).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from bench.entry_points import entry_points_of
from bench.files import read_regular

FILE = "versions.csv"
TABLES = ("table10.csv", "table11.csv", "table12.csv", "atlas*.csv.gz")
"""Files of these tables in a folder of results."""


class TableVersion(NamedTuple):
    """The version of a class that a table was computed with, by the group and name of its entry point."""

    table: str
    group: str
    name: str
    version: str

    @property
    def changed(self) -> str:
        """The difference from today's version in one line; empty if there is none."""
        today = version_text(self.group, self.name)
        return f"{self.name} version {self.version}, today {today or 'not installed'}" * (today != self.version)


def version_text(group: str, name: str) -> str:
    """Return the version of a registered class, with those of its parts; empty if it is not installed."""
    point = entry_points_of(group).get(name)
    if point is None:
        return ""
    loaded = point.load()
    parts = sorted(getattr(loaded, "parts", {}).items())
    return "; ".join([str(loaded.version), *(f"{part} {number}" for part, number in parts)])


def read_versions(folder: Path) -> list[TableVersion]:
    """Return the lines of a folder's file; none if there is no such file."""
    try:
        text = read_regular(folder / FILE).decode()
    except OSError:
        return []
    return [TableVersion(*line) for line in csv.reader(text.splitlines()[1:]) if len(line) == len(TableVersion._fields)]


def tables_without_versions(folder: Path, versions: Iterable[TableVersion]) -> list[str]:
    """Return the names of a folder's tables without a line among ``versions``: they were computed before the file."""
    tables = {path.name.partition(".")[0] for pattern in TABLES for path in folder.glob(pattern)}
    return sorted(tables - {line.table for line in versions})


def with_table(folder: Path, table: str, used: Iterable[tuple[str, str]]) -> str:
    """Return the text of the file with today's versions of a table, which is computed with ``used``: group, name."""
    kept = [line for line in read_versions(folder) if line.table != table]
    lines = [*kept, *(TableVersion(table, *entry, version_text(*entry)) for entry in set(used))]
    content = io.StringIO()
    csv.writer(content, lineterminator="\n").writerows([TableVersion._fields, *sorted(lines)])
    return content.getvalue()
