"""Whether stated uncertainties hold: the table of ``experiment=calibration``, from its stored rows.

For every method, noise and start: how often the intervals of k/m and c/m held the truth, how its normal scores are
spread, and the share of the displacement inside the band.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from bench.reporting.frame import Frame, Result
from bench.reporting.labels import title as title_of
from bench.reporting.tables.common import markdown_table
from bench.scoring.calibration import calibration

SYMBOLS = {"k_over_m": "k/m", "c_over_m": "c/m"}
FEWEST = 20
"""Replicates below which nothing is judged."""
LEGEND = """Of each interval of 95 %: the share of replicates in which it held the truth, with its own 95 % interval
(Wilson's). z is the truth's normal score under the belief: of mean 0 and standard deviation 1 if the belief is
calibrated; a standard deviation of 2 means intervals half as wide as they should be. The verdict is by three tests
(mean of z, its variance, uniformity of the levels) at 5 % after Holm's adjustment. Band: the share of the record, 1,000
points in each replicate, where the true displacement lies in the method's own 95 % band. A dash: the method states no
uncertainty. A verdict is wrong in one case of twenty by chance alone."""


def lines(results: Iterable[Result]) -> pd.DataFrame:
    """One line a method, noise, start and quantity."""
    rows: list[dict[str, Any]] = []
    for result in results:
        for name in SYMBOLS if result.stored else ():
            head = {"method": result.label, "initial_state": result.initial_state, "snr_db": result.snr_db}
            rows.append({**head, "quantity": name, **_judged(result, name)})
    return pd.DataFrame(rows)


def _judged(result: Result, name: str) -> dict[str, Any]:
    levels, inside = (result.scores(score) for score in (f"{name}_pit", "band_inside_95"))
    levels, inside = levels[~np.isnan(levels)], inside[~np.isnan(inside)]
    band = {"band_95": float(np.mean(inside)) if inside.size else np.nan}
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
        parts += [f"## Initial state {told}", markdown_table(rows, [*headers, "band 95 %"])]
    return "\n\n".join(parts) + "\n"


def _row(own: pd.DataFrame) -> list[str]:
    """One method at one noise level, its quantities side by side."""
    by_name = own.set_index("quantity")
    method, snr = str(own.method.iloc[0]), float(own.snr_db.iloc[0])
    cells = [title_of(method), f"{snr:g}", str(by_name.n.iloc[0])]
    for name in SYMBOLS:
        line = by_name.loc[name]
        if line.verdict == "-":
            cells += ["-", "-", "-"]
            continue
        share = f"{100 * line.coverage_95:.1f} ({100 * line.low_95:.1f} to {100 * line.high_95:.1f})"
        cells += [share, f"{line.sd_z:.2f}", line.verdict]
    band = by_name.band_95.iloc[0]
    return [*cells, f"{100 * band:.1f}" if np.isfinite(band) else "-"]


def calibration_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of it."""
    if not frame.any_stored:
        return {}
    data = lines(frame)
    text = f"{markdown(data, frame.title)}\nRegenerate: `{frame.command}`\n"
    name = frame.experiment
    return {f"{name}.md": text, f"{name}.csv": data.to_csv(index=False, float_format="%.5g")}
