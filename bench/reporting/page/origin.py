"""Provenance of stored cells: their commits, stale and missing cells; failed fits."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench.config.experiment import Experiment
from bench.contract.estimate import Status
from bench.errors import InputError, shortened
from bench.reporting.frame import Result, table_experiments
from bench.reporting.page.words import decibels
from bench.store.stored_cell import StoredCell
from bench.store.version import described_version

LONGEST = 300
"""Largest number of characters of a message that are shown; a longer one is shortened in the middle."""
Lines = list[dict[str, Any]]
"""Lines of a table: values by heading."""


def cells_of(results: Sequence[Result]) -> pd.DataFrame:
    """Return one line per cell: fits, processor time (h), provenance, and the version that has changed since."""
    return pd.DataFrame([_facts(result.stored) for result in results if result.stored])


def _facts(cell: StoredCell) -> dict[str, Any]:
    facts = cell.provenance
    return {
        "identity": cell.identity,
        "fits": len(cell.columns),
        "hours": float(np.nansum(cell.columns.numbers("cpu_s"))) / 3600.0,
        "commit": str(facts.get("commit") or "not recorded") + (" with changes" if facts.get("dirty") else ""),
        "started": str(facts.get("started") or "")[:16].replace("T", " "),
        "changed": changed(cell),
    }


def changed(cell: StoredCell) -> str:
    """Return which version has changed since a cell was computed; empty if none has."""
    try:
        return described_version(cell.cell).changed_since(cell.version)
    except InputError:
        return "not installed here"


def counted(cells: pd.DataFrame, column: str) -> Lines:
    """Count cells and fits by the values of a column, the most frequent first; empty values are left out."""
    groups = cells[cells[column] != ""].groupby(column, as_index=False)
    groups = groups.agg(cells=("fits", "size"), fits=("fits", "sum"))
    return groups.sort_values(["cells", column], ascending=[False, True]).to_dict("records")


def experiments(cells: pd.DataFrame) -> Lines:
    """Count the cells of each experiment with a stored cell, and those that are missing or stale."""
    stale, lines = dict(zip(cells.identity, cells.changed != "", strict=True)), []
    for name in table_experiments():
        with suppress(InputError):  # a method of it is not installed here
            described = {cell.identity for cell in Experiment(name).cells()}
            stored = described & stale.keys()
            missing, outdated = len(described - stored), sum(stale[identity] for identity in stored)
            counts = {"cells": len(described), "missing": missing, "stale": outdated}
            lines += [{"experiment": name, **counts}] if stored else []
    return lines


def commits_here(cells: pd.DataFrame) -> int | None:
    """Count the commits that the repository of this checkout contains; None without a repository."""
    named = sorted({commit.split()[0] for commit in cells.commit if commit != "not recorded"})
    with suppress(OSError):
        command = ["git", "cat-file", "--batch-check"]
        here = Path(__file__).parent
        done = subprocess.run(command, input="\n".join(named), text=True, capture_output=True, cwd=here)
        if not done.returncode:
            return sum(line.split()[1] == "commit" for line in done.stdout.splitlines())
    return None


def failed_fits(results: Sequence[Result]) -> Lines:
    """Count failed fits by method, scenario and message; data that a method does not support are no failure."""
    lines = [
        {
            "method": result.title,
            "status": status.value,
            "message": shortened(message, LONGEST),
            "scenario": _where(result),
        }
        for result in results
        for status, message in zip(result.statuses, result.messages, strict=True)
        if status not in (Status.OK, Status.UNSUPPORTED)
    ]
    if not lines:
        return []
    by = ["method", "status", "scenario", "message"]
    counts = pd.DataFrame(lines).groupby(by, as_index=False).size().rename(columns={"size": "fits"})
    return counts.sort_values(["fits", *by], ascending=[False, *[True] * len(by)]).to_dict("records")


def _where(result: Result) -> str:
    kind = f", {result.disturbance.replace('_', ' ')}" if result.disturbance else ""
    return f"{result.system}, {decibels(result.snr_db)} dB{kind}"
