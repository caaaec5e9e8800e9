"""State of stored cells: those of an earlier version, and failed fits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from bench.contract.estimate import Status
from bench.errors import InputError, shortened
from bench.reporting.frame import Result
from bench.reporting.page.words import decibels
from bench.store.stored_cell import StoredCell
from bench.store.version import settings_version

LONGEST = 300
"""Largest number of characters of a message that are shown; a longer one is shortened in the middle."""
Lines = list[dict[str, Any]]
"""Lines of a table: values by heading."""


def cells_of(results: Sequence[Result]) -> pd.DataFrame:
    """Return one line per cell: fits, processor time (h), start, and the version that has changed since."""
    return pd.DataFrame([_facts(result.stored) for result in results if result.stored])


def _facts(cell: StoredCell) -> dict[str, Any]:
    return {
        "fits": len(cell.columns),
        "hours": float(np.nansum(cell.columns.numbers("cpu_s"))) / 3600.0,
        "started": str(cell.provenance.get("started") or "")[:16].replace("T", " "),
        "changed": changed(cell),
    }


def changed(cell: StoredCell) -> str:
    """Return which version has changed since a cell was computed; empty if none has."""
    method, system = str(cell.cell.get("method")), str((cell.cell.get("data") or {}).get("system"))
    try:
        return settings_version(method, system, cell.cell.get("settings", {})).changed_since(cell.version)
    except InputError:
        return "not installed here"


def stale(cells: pd.DataFrame) -> Lines:
    """Count cells and fits by the version that has changed, the most frequent first."""
    groups = (
        cells[cells.changed != ""].groupby("changed", as_index=False).agg(cells=("fits", "size"), fits=("fits", "sum"))
    )
    return groups.sort_values(["cells", "changed"], ascending=[False, True]).to_dict("records")


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
