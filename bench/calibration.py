"""``python -m bench.calibration``: whether stated uncertainties hold, as results/calibration.md and .csv.

From the stored rows of ``experiment=calibration`` alone: for every method, noise and start, how often the intervals
of k/m and c/m held the truth, how its normal scores are spread, and the share of the displacement inside the band.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tabulate import tabulate

from bench.cli import read_folders
from bench.errors import InputError
from bench.levels import calibration
from bench.store import Store, StoredCell
from bench.tables import TITLES, entries

EXPERIMENT = "calibration"
SYMBOLS = {"k_over_m": "k/m", "c_over_m": "c/m"}
FEWEST = 20
"""Replicates below which nothing is judged."""
LEGEND = """Of each interval of 95 %: the share of replicates in which it held the truth, with its own 95 % interval
(Wilson's). z is the truth's normal score under the belief: of mean 0 and standard deviation 1 if the belief is
calibrated; a standard deviation of 2 means intervals half as wide as they should be. The verdict is by three tests
(mean of z, its variance, uniformity of the levels) at 5 % after Holm's adjustment. Band: the share of the record, 1,000
points in each replicate, where the true displacement lies in the method's own 95 % band. A dash: the method states no
uncertainty."""


def lines(found: Sequence[Any]) -> pd.DataFrame:
    """One line a method, noise, start and quantity."""
    rows: list[dict[str, Any]] = []
    for entry in found:
        if entry.stored is None:
            continue
        scenario = entry.cell.scenario
        for name in SYMBOLS:
            head = {
                "method": entry.cell.label, "initial_state": scenario.told, "snr_db": scenario.snr_db, "quantity": name
            }  # fmt: skip
            rows.append({**head, **_judged(entry.stored, name)})
    return pd.DataFrame(rows)


def _judged(stored: StoredCell, name: str) -> dict[str, Any]:
    levels = np.array([row.scores[f"{name}_pit"] for row in stored.rows if f"{name}_pit" in row.scores])
    inside = [row.scores["band_inside_95"] for row in stored.rows if "band_inside_95" in row.scores]
    band = {"band_95": float(np.mean(inside)) if inside else np.nan}
    if levels.size < FEWEST:
        return {"n": levels.size, "verdict": "-", **band}
    found = calibration(levels)
    shares = {f"coverage_{round(100 * c.level)}": c.share for c in found.coverage}
    widest = found.coverage[-1]
    return {
        "n": found.n, **shares, "low_95": widest.low, "high_95": widest.high, "mean_z": found.mean_z,
        "sd_z": found.sd_z, "uniform_p": found.uniform, "verdict": found.verdict, **band,
    }  # fmt: skip


def markdown(data: pd.DataFrame) -> str:
    """The table for reading."""
    parts = ["# Calibration of the stated uncertainties", LEGEND]
    for told, panel in data.groupby("initial_state", sort=False):
        rows = [_row(own) for _, own in panel.groupby(["method", "snr_db"], sort=False)]
        headers = ["method", "SNR (dB)", "n"]
        headers += [f"{symbol} {what}" for symbol in SYMBOLS.values() for what in ("95 %", "sd of z", "verdict")]
        table = tabulate(rows, headers=[*headers, "band 95 %"], tablefmt="github", disable_numparse=True)
        parts += [f"## Initial state {told}", table]
    parts.append(f"Regenerate: `python -m bench -m experiment={EXPERIMENT} && python -m bench.calibration`")
    return "\n\n".join(parts) + "\n"


def _row(own: pd.DataFrame) -> list[str]:
    """One method at one noise level, its quantities side by side."""
    by_name = own.set_index("quantity")
    method, snr = str(own.method.iloc[0]), float(own.snr_db.iloc[0])
    cells = [TITLES.get(method, method), f"{snr:g}", str(by_name.n.iloc[0])]
    for name in SYMBOLS:
        line = by_name.loc[name]
        if line.verdict == "-":
            cells += ["-", "-", "-"]
            continue
        share = f"{100 * line.coverage_95:.1f} ({100 * line.low_95:.1f} to {100 * line.high_95:.1f})"
        cells += [share, f"{line.sd_z:.2f}", line.verdict]
    band = by_name.band_95.iloc[0]
    return [*cells, f"{100 * band:.1f}" if np.isfinite(band) else "-"]


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.calibration [store=results/rows] [out=results]``; exit status 2 for bad input."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if {"-h", "--help"} & set(arguments):
        print("usage: python -m bench.calibration [store=results/rows] [out=results]\n\n" + str(__doc__))
        return 0
    try:
        folders = read_folders(arguments, {"store": "results/rows", "out": "results"})
        _, _, found = entries(EXPERIMENT, Store(folders["store"]))
        if not any(entry.stored for entry in found):
            raise InputError("store", folders["store"], f"no cell of it there; run -m experiment={EXPERIMENT} first")
        Store(folders["out"]).prepare()
    except InputError as error:
        print(f"bench.calibration: {error}", file=sys.stderr)
        return 2
    for path in write(lines(found), folders["out"]):
        print(path)
    return 0


def write(data: pd.DataFrame, out: Path) -> list[Path]:
    """Write both forms; returns the paths."""
    paths = [out / "calibration.md", out / "calibration.csv"]
    paths[0].write_text(markdown(data), encoding="utf-8")
    paths[1].write_text(data.to_csv(index=False, float_format="%.5g"), encoding="utf-8")
    return paths


if __name__ == "__main__":
    sys.exit(main())
