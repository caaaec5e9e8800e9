"""Stored cells as if they had run, made from closed forms and a seed: no method, no simulation."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.config.experiment import Experiment
from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import method_names
from bench.information.fisher import Bound
from bench.reporting.frame import table_experiments
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.scoring.traces import MOMENTS
from bench.store.cell_file import FORMAT
from bench.store.seal import sealed
from bench.store.store import Store
from bench.store.stored_cell import StoredCell
from bench.store.version import cell_version

VERSION = {"method": 1, "system": 1, "scoring": 1}
TRUTH = {"m": 1.0, "c": 0.4, "k": 8.0}
NOISE = 0.05
SD_K, SD_C, CORRELATION = 0.005, 0.035, 0.2
"""Of the logarithms of k/m and c/m: what the bound is said to be, and the spread of a method on it."""
BOUND = Bound(
    ("m", "c", "k"),
    {
        "k_over_m": SD_K,
        "c_over_m": SD_C,
        "damping_ratio": float(np.sqrt(SD_C**2 + SD_K**2 / 4 - CORRELATION * SD_K * SD_C)),
    },
    {},
    {},
    0.0107,
    0.01,
    (),
)


def displacement(times: np.ndarray, k: float = 8.0, c: float = 0.4) -> np.ndarray:
    """The free response of a unit mass released from 1 m at rest (underdamped), by its closed form."""
    w = np.sqrt(k - c**2 / 4)
    return np.exp(-c * times / 2) * (np.cos(w * times) + c / (2 * w) * np.sin(w * times))


def described(
    label: str, snr: float = 20.0, told: str = "known", seed: int = 0, n: int = 30, **data: Any
) -> dict[str, Any]:
    """What a stored cell says of itself."""
    physics = {
        "system": "sdof", "options": {}, "parameters": TRUTH, "initial": [[1.0], [0.0]], "snr_db": snr,
        "duration": 10.0, "samples": 25, "force": None, **data,
    }  # fmt: skip
    prior = {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5, "wrong": False}
    return {
        "format": 2, "method": label, "settings": {}, "replicates": n, "seed": seed, "data": physics,
        "told": {"initial_state": told, "prior": prior}, "dense": 200, "forecast": 10.0, "label": label,
        "system": "sdof", "snr_db": snr, "initial_state": told, "sigma": [NOISE],
    }  # fmt: skip


def scored(label: str, n: int, spread: float = 1.0, bias: float = 0.0) -> list[Row]:
    """Replicates whose errors of k/m and c/m are normal, so many times the bound wide; intervals as wide as that."""
    rng = np.random.default_rng(int.from_bytes(hashlib.sha256(label.encode()).digest()[:4], "big"))
    rows = []
    for i in range(n):
        z = rng.standard_normal(2)
        logs = spread * np.array([SD_K * z[0], SD_C * (CORRELATION * z[0] + np.sqrt(1 - CORRELATION**2) * z[1])])
        k, c = np.exp(logs + np.array([bias, 0.0]))
        ratios = {"k_over_m_ratio": k, "c_over_m_ratio": c, "m_ratio": 1.0, "k_ratio": k, "c_ratio": c}
        levels = {
            f"{name}_pit": 0.5 + 0.5 * np.tanh(0.8 * u) for name, u in zip(("k_over_m", "c_over_m"), z, strict=True)
        }
        errors = {f"{name}_error_pct": 100 * abs(ratios[f"{name}_ratio"] - 1) for name in ("k_over_m", "c_over_m")}
        rmse = 0.0107 * spread * float(np.abs(rng.standard_normal())) + abs(bias)
        rows.append(Row(i, Status.OK, scores={**ratios, **levels, **errors, "rmse": rmse}, cpu_s=0.01 * (1 + i % 3)))
    return rows


def recorded(rows: Sequence[Row], reconstructs: bool, trained: bool) -> dict[str, np.ndarray]:
    """The arrays of replicate 0."""
    times, dense = np.linspace(0, 10, 25), np.linspace(0, 10, 200)
    noise = NOISE * np.random.default_rng(0).standard_normal(25)
    arrays = {
        "sample_times": times, "sample_values": displacement(times) + noise, "sample_dof": np.zeros(25, int),
        "dense_times": dense, "true_displacement": displacement(dense)[None],
    }  # fmt: skip
    if reconstructs:
        found = rows[0].scores
        own = displacement(dense, 8.0 * found["k_over_m_ratio"], 0.4 * found["c_over_m_ratio"])
        arrays |= {"displacement": own[None], "displacement_sd": np.full((1, 200), 0.01)}
    if trained:
        steps = np.arange(1.0, 31.0)
        arrays |= {"trace_evaluations": steps, "trace_loss": 1e4 / steps**2, "trace_mean_square_data": 1.0 / steps}
        arrays |= {"trace_start_objectives": np.array([-70.0, -70.0, 3.0])}
    return arrays


BODY = ("summary", "rows", "tracebacks")
"""What the second line of a cell's file holds."""


def content(path: Path) -> dict[str, Any]:
    """Return what a cell's file holds, the last line under ``npz``."""
    head, body, npz = path.read_text(encoding="utf-8").split("\n")
    return {**json.loads(head), **json.loads(body), "npz": npz}


def resealed(content: Mapping[str, Any]) -> bytes:
    """Return the file of a cell with this content, which a test has taken from another and changed."""
    body = json.dumps({key: content[key] for key in BODY if key in content}) + "\n" + str(content.get("npz", ""))
    head = {key: value for key, value in content.items() if key not in ("format", "sha256", "npz", *BODY)}
    sealed_head = sealed(FORMAT, json.dumps({**head, "body": hashlib.sha256(body.encode()).hexdigest()}))
    return sealed_head + b"\n" + body.encode()


def version_today(method: str) -> dict[str, int]:
    """Return the version of a method's cells; :data:`VERSION` of one that is not registered."""
    known = method in {*method_names(), *REFERENCES}
    return cell_version(method, "sdof").as_json() if known else dict(VERSION)


def save(
    store: Store,
    cell: Mapping[str, Any],
    rows: Sequence[Row],
    arrays: Mapping[str, np.ndarray] | None = None,
    bound: Bound = BOUND,
    tracebacks: str = "",
) -> StoredCell:
    """Store a cell under the hash of what it says of itself."""
    identity = hashlib.sha256(json.dumps(dict(cell), sort_keys=True).encode()).hexdigest()[:20]
    summary = summarise(rows, bound)
    kept = dict(arrays or {})
    version = version_today(cell["method"])
    stored = StoredCell(identity, dict(cell), tuple(rows), summary, {}, {}, 1.0, {}, version, kept, tracebacks)
    store.save(stored)
    return stored


def fill(
    store: Store, labels: Sequence[str], snrs: Sequence[float] = (20.0,), told: Sequence[str] = ("known",), n: int = 30
) -> None:
    """Cells of several methods on the reference system, each method wider than the one before it."""
    for i, label in enumerate(labels):
        for snr in snrs:
            for start in told:
                rows = scored(f"{label} {snr} {start}", n, spread=1.0 + 0.3 * i)
                if i % 3 == 0:  # those of recorded searches
                    rows = [replace(row, scores={**row.scores, "starts": 3.0, "starts_at_best": 2.0}) for row in rows]
                arrays = recorded(rows, reconstructs=i % 3 != 2, trained=i % 3 == 0)
                save(store, described(label, snr, start, n=n), rows, arrays)


def trained(n: int, off: Callable[[float], float], seconds: float = 5.0, **others: float) -> list[Row]:
    """Trainings that arrive at the given time (s) and end at twice that: ``off(t)`` is the error of k/m (%) at t.

    ``others`` are further scores; one that is NaN is left out.
    """
    told = {f"k_over_m_off_pct_at_{moment:g}s": off(min(moment, 2.0 * seconds)) for moment in MOMENTS}
    at_end = off(2.0 * seconds)
    scores = {
        "k_over_m_error_pct": at_end, "c_over_m_error_pct": 100 * SD_C, "k_over_m_coverage_95": 1.0, "rmse": 0.0107,
        "training_s": 2.0 * seconds, "loss_over_minimum": 1.0, "certificate": 1e-6, "arrival_s": seconds,
        "k_over_m_off_pct_at_minimum": at_end, "c_over_m_off_pct_at_minimum": 100 * SD_C, **told, **others,
    }  # fmt: skip
    known = {name: value for name, value in scores.items() if not np.isnan(value)}
    return [Row(i, Status.OK, scores=known, cpu_s=3.0 * seconds, peak_memory_mb=50.0) for i in range(n)]


def _falling(last: float, seconds: float) -> float:
    """An error (%) that falls to its last."""
    return last + 50.0 / (1.0 + 100.0 * seconds**2)


def fill_family(store: Store) -> list[StoredCell]:
    """Every cell at 20 dB with the start known of the experiment that has a family, each row slower than the last."""
    name = next(name for name in table_experiments() if Experiment(name).table.get("form") == "family")
    kept = []
    cells = [cell for cell in Experiment(name).cells() if cell.scenario.snr_db == 20]
    for i, cell in enumerate(cell for cell in cells if cell.scenario.initial_state == "known"):
        rows = trained(3, partial(_falling, 0.5 + 0.01 * i), 0.02 * 1.15**i)
        summary = summarise(rows, BOUND)
        what = {**cell.description(), "label": cell.label, "snr_db": 20.0, "initial_state": "known"}
        kept.append(StoredCell(cell.identity, what, tuple(rows), summary, {}, {}, 1.0))
        store.save(kept[-1])
    return kept
