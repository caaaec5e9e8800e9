"""Whether stated uncertainties hold: the table of ``experiment=calibration``, from its stored rows.

For every method, noise and start: how often the intervals of k/m and c/m held the truth, how its normal scores are
spread, and the share of the displacement inside the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from tabulate import tabulate

from bench.reporting.tables.tables import TITLES, Entry, described_cells
from bench.scoring.calibration import calibration
from bench.store.store import Store, StoredCell

SYMBOLS = {"k_over_m": "k/m", "c_over_m": "c/m"}
FEWEST = 20
"""Replicates below which nothing is judged."""
LEGEND = """Of each interval of 95 %: the share of replicates in which it held the truth, with its own 95 % interval
(Wilson's). z is the truth's normal score under the belief: of mean 0 and standard deviation 1 if the belief is
calibrated; a standard deviation of 2 means intervals half as wide as they should be. The verdict is by three tests
(mean of z, its variance, uniformity of the levels) at 5 % after Holm's adjustment. Band: the share of the record, 1,000
points in each replicate, where the true displacement lies in the method's own 95 % band. A dash: the method states no
uncertainty. A verdict is wrong in one case of twenty by chance alone."""


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


def markdown(data: pd.DataFrame, title: str) -> str:
    """The table for reading."""
    parts = [f"# {title}", LEGEND]
    for told, panel in data.groupby("initial_state", sort=False):
        rows = [_row(own) for _, own in panel.groupby(["method", "snr_db"], sort=False)]
        headers = ["method", "SNR (dB)", "n"]
        headers += [f"{symbol} {what}" for symbol in SYMBOLS.values() for what in ("95 %", "sd of z", "verdict")]
        table = tabulate(rows, headers=[*headers, "band 95 %"], tablefmt="github", disable_numparse=True)
        parts += [f"## Initial state {told}", table]
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


def calibration_table(experiment: str, store: Store) -> dict[str, str]:
    """The files of the table by name; none where the store holds no cell of it."""
    title, cells = described_cells(experiment)
    found = [Entry("", cell, store.load(cell.identity)) for cell in cells]
    if all(entry.stored is None for entry in found):
        return {}
    data = lines(found)
    command = f"python -m bench -m experiment={experiment} && python -m bench.tables"
    text = f"{markdown(data, title)}\nRegenerate: `{command}`\n"
    return {f"{experiment}.md": text, f"{experiment}.csv": data.to_csv(index=False, float_format="%.5g")}
