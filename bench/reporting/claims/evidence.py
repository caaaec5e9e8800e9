"""What claims rest on: the tidy tables, the tables of studies, and the stored cells."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.reporting.frame import Result, experiment_frame
from bench.store.store import Store

PRIMARY = ("k_over_m_error_pct", "c_over_m_error_pct", "rmse")
"""The errors by which free vibration of one mass is judged."""


class Evidence:
    """The files of a folder of results and the cells of a store; a question that finds nothing is an error."""

    def __init__(self, folder: Path, store: Store) -> None:
        self.folder, self.store = folder, store
        self._tables: dict[str, pd.DataFrame] = {}
        self._cells: dict[str, list[Result]] = {}

    def table(self, name: str) -> pd.DataFrame:
        """``results/<name>.csv`` without the lines of cells that were not run; raises InputError without it."""
        if name not in self._tables:
            path = self.folder / f"{name}.csv"
            if not path.is_file():
                raise InputError("results", path, "there is no such table; python -m bench tables writes the tables")
            data = pd.read_csv(path)
            self._tables[name] = data[data.metric != "not run"] if "metric" in data else data
        return self._tables[name]

    def rows(self, name: str, **wanted: Any) -> pd.DataFrame:
        """The lines of a table with these values, one or several a column.

        Raises InputError where one of the values is in no line: what was never measured cannot be claimed.
        """
        found = self.table(name)
        for column, values in wanted.items():
            found = found[found[column].isin(_several(values))]
        for column, values in wanted.items():
            missing = [value for value in _several(values) if not (found[column] == value).any()]
            if missing:
                raise InputError("claim", name, f"no line has {column} = {', '.join(map(str, missing))}")
        return found

    def excess(self, name: str, **wanted: Any) -> pd.Series:
        """Of the same lines the excess over the bound, as far as there is one."""
        return self.rows(name, **wanted)["excess"].dropna()

    def value(self, name: str, column: str, **wanted: Any) -> float:
        """The one value of a column that the lines have; raises InputError where they have several."""
        values = self.rows(name, **wanted)[column].dropna().unique()
        if len(values) != 1:
            raise InputError("claim", name, f"{len(values)} values of {column}, not one")
        return float(values[0])

    def cells(self, experiment: str, **wanted: Any) -> list[Result]:
        """The cells of an experiment with these facts of a result; raises InputError unless all are stored."""
        found = [
            one
            for one in self._of(experiment)
            if all(getattr(one, fact) in _several(values) for fact, values in wanted.items())
        ]
        missing = sum(one.stored is None for one in found)
        if missing or not found:
            raise InputError("claim", experiment, f"{missing or 'all'} of the cells with {wanted} are not stored")
        return found

    def stored(self, experiment: str) -> list[Result]:
        """The cells of an experiment that are stored: for what is said of these and no others."""
        return [one for one in self._of(experiment) if one.stored is not None]

    def _of(self, experiment: str) -> list[Result]:
        if experiment not in self._cells:
            unique = {result.identity: result for result in experiment_frame(experiment, self.store)}
            self._cells[experiment] = list(unique.values())
        return self._cells[experiment]

    def seconds(self, experiment: str, **wanted: Any) -> float:
        """Processor time of a fit (s): median over such cells of the median over their fits."""
        return float(np.median([np.nanmedian(one.cpu_s) for one in self.cells(experiment, **wanted)]))

    def study(self, file: str, section: str = "") -> pd.DataFrame:
        """The first Markdown table of a study's page below a heading; every entry is text."""
        path = self.folder / file
        if not path.is_file():
            raise InputError("results", path, "there is no such page; its study writes it")
        lines = path.read_text(encoding="utf-8").partition(f"## {section}\n" if section else "\n")[2].splitlines()
        first = next((i for i, line in enumerate(lines) if line.startswith("|")), None)
        if first is None:
            raise InputError("results", path, f"no table below {section!r}")
        last = next((i for i in range(first, len(lines)) if not lines[i].startswith("|")), len(lines))
        split = csv.reader((line.strip()[1:-1] for line in lines[first:last]), delimiter="|", quoting=csv.QUOTE_NONE)
        head, _, *rest = [[entry.strip() for entry in line] for line in split]
        width = len(head)
        return pd.DataFrame([(line + [""] * width)[:width] for line in rest], columns=head)

    @cached_property
    def atlas(self) -> pd.DataFrame:
        """``results/atlas.csv.gz``, a line a point and method; raises InputError without it."""
        return self._atlas("atlas.csv.gz", "")

    @cached_property
    def atlas_forced(self) -> pd.DataFrame:
        """``results/atlas_forced.csv.gz``, the same of tests with a measured force."""
        return self._atlas("atlas_forced.csv.gz", " test=forced")

    def _atlas(self, name: str, test: str) -> pd.DataFrame:
        path = self.folder / name
        if not path.is_file():
            raise InputError("results", path, f"there is no such atlas; python -m bench -m experiment=atlas{test}")
        return pd.read_csv(path)

    @cached_property
    def archived(self) -> int:
        """Cells of the published archive, each once."""
        path = self.folder / "archive" / "cells.parquet"
        return pd.read_parquet(path, columns=["identity"]).identity.nunique() if path.is_file() else 0

    @cached_property
    def archive_size(self) -> float:
        """Of the published archive (bytes)."""
        return float(sum(path.stat().st_size for path in (self.folder / "archive").rglob("*.parquet")))


def _several(values: Any) -> tuple[Any, ...]:
    """A tuple of one or of several."""
    return tuple(values) if isinstance(values, Iterable) and not isinstance(values, str) else (values,)
