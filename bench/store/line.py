"""A cell in one line, as the collected view and the published archive have it."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

import numpy as np
import pyarrow as pa

from bench.store.stored import StoredCell

PLAIN = {
    "identity": pa.string(), "mtime_ns": pa.int64(), "size": pa.int64(), "problem": pa.string(),
    "method": pa.string(), "label": pa.string(), "kind": pa.string(), "system": pa.string(), "snr_db": pa.float64(),
    "initial_state": pa.string(), "disturbance": pa.string(), "replicates": pa.int64(), "seed": pa.int64(),
    "n_ok": pa.int64(), "statuses": pa.string(), "version": pa.string(), "wall_s": pa.float64(),
    "cpu_s": pa.float64(), "peak_memory_mb": pa.float64(), "started": pa.string(), "commit": pa.string(),
    "data": pa.string(), "metrics": pa.string(),
}  # fmt: skip
STATISTICS = ("mean", "median", "ci_low", "ci_high", "bound", "excess")
LISTS = {name: pa.list_(pa.float64()) for name in STATISTICS}
SCHEMA = pa.schema({**PLAIN, **LISTS})


def described(cell: StoredCell) -> dict[str, Any]:
    """What the view says of a cell."""
    what, come = cell.cell, cell.provenance
    disturbance = what.get("data", {}).get("disturbance") or {}
    cpu = [row.cpu_s for row in cell.rows if np.isfinite(row.cpu_s)]
    memory = [row.peak_memory_mb for row in cell.rows if np.isfinite(row.peak_memory_mb)]
    return {
        **{name: what.get(name) for name in ("method", "label", "system", "snr_db", "initial_state", "seed")},
        "disturbance": str(disturbance.get("kind", "none")),
        "replicates": len(cell.rows),
        "n_ok": cell.n_ok,
        "statuses": json.dumps(Counter(row.status.value for row in cell.rows)),
        "version": cell.version.get("digest", ""),
        "wall_s": cell.wall_s,
        "cpu_s": float(np.sum(cpu)) if cpu else None,
        "peak_memory_mb": max(memory, default=None),
        "started": come.get("started"),
        "commit": come.get("commit"),
        "data": come.get("data"),
        "kind": what.get("data", {}).get("system"),
        "metrics": " ".join(cell.summary),
        **{name: [summary.get(name) for summary in cell.summary.values()] for name in STATISTICS},
    }
