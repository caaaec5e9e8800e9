"""Where the stored cells come from, what of them is stale or missing, and what failed."""

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
from bench.errors import InputError
from bench.reporting.frame import Result, table_experiments
from bench.reporting.page.words import decibels
from bench.store.stored import StoredCell
from bench.store.version import settings_version

LONGEST = 200
"""Letters of a message that are shown."""
Lines = list[dict[str, Any]]
"""Of a table: values by heading."""


def cells_of(results: Sequence[Result]) -> pd.DataFrame:
    """A line a cell: fits, processor time (h), where and when it was computed, and which version has changed since."""
    return pd.DataFrame([_facts(result.stored) for result in results if result.stored])


def _facts(cell: StoredCell) -> dict[str, Any]:
    facts = cell.provenance
    packages = facts.get("packages") or {}
    machine = (facts.get("processor"), facts.get("cores"), facts.get("system"), facts.get("python"))
    return {
        "identity": cell.identity,
        "fits": len(cell.columns),
        "hours": float(np.nansum(cell.columns.numbers("cpu_s"))) / 3600.0,
        "commit": str(facts.get("commit") or "not recorded") + (" with changes" if facts.get("dirty") else ""),
        "machine": ", ".join(str(part) for part in machine if part) or "not recorded",
        "packages": ", ".join(f"{name} {version}" for name, version in sorted(packages.items())) or "not recorded",
        "started": str(facts.get("started") or "")[:16].replace("T", " "),
        "changed": changed(cell),
    }


def changed(cell: StoredCell) -> str:
    """Which version has changed since a cell was computed; nothing where none has."""
    method, system = str(cell.cell.get("method")), str((cell.cell.get("data") or {}).get("system"))
    try:
        return settings_version(method, system, cell.cell.get("settings", {})).changed_since(cell.version)
    except InputError:
        return "not installed here"


def counted(cells: pd.DataFrame, column: str) -> Lines:
    """The values of a column with their cells and fits, the most frequent first; empty ones are left out."""
    groups = cells[cells[column] != ""].groupby(column, as_index=False)
    groups = groups.agg(cells=("fits", "size"), fits=("fits", "sum"))
    return groups.sort_values(["cells", column], ascending=[False, True]).to_dict("records")


def experiments(cells: pd.DataFrame) -> Lines:
    """Of each experiment of which a cell is stored: its cells, and how many are missing or stale."""
    stale, lines = dict(zip(cells.identity, cells.changed != "", strict=True)), []
    for name in table_experiments():
        with suppress(InputError):  # a method of it is not installed here
            own = {cell.identity for cell in Experiment(name).cells()}
            there = own & stale.keys()
            counts = {"cells": len(own), "missing": len(own - there), "stale": sum(stale[one] for one in there)}
            lines += [{"experiment": name, **counts}] if there else []
    return lines


def commits_here(cells: pd.DataFrame) -> int | None:
    """How many of the commits the repository of this checkout holds; None where there is none."""
    named = sorted({commit.split()[0] for commit in cells.commit if commit != "not recorded"})
    with suppress(OSError):
        command = ["git", "cat-file", "--batch-check"]
        here = Path(__file__).parent
        done = subprocess.run(command, input="\n".join(named), text=True, capture_output=True, cwd=here)
        if not done.returncode:
            return sum(line.split()[1] == "commit" for line in done.stdout.splitlines())
    return None


def not_ok(results: Sequence[Result], unsupported: bool) -> Lines:
    """What failed, or what was not tried since a method cannot take such data: how often, and with what message."""
    lines = [
        {"method": result.title, "status": status.value, "message": message[:LONGEST], "scenario": _where(result)}
        for result in results
        for status, message in zip(result.statuses, result.messages, strict=True)
        if status is not Status.OK and (status is Status.UNSUPPORTED) == unsupported
    ]
    if not lines:
        return []
    by = ["method", "message"] if unsupported else ["method", "status", "scenario", "message"]
    counts = pd.DataFrame(lines).groupby(by, as_index=False).size().rename(columns={"size": "fits"})
    return counts.sort_values(["fits", *by], ascending=[False, *[True] * len(by)]).to_dict("records")


def _where(result: Result) -> str:
    kind = f", {result.disturbance.replace('_', ' ')}" if result.disturbance else ""
    return f"{result.system}, {decibels(result.snr_db)} dB{kind}"
