"""Whether stated uncertainties hold: the table of ``experiment=calibration``, from its stored rows.

For every method, noise and start: how often the intervals of k/m and c/m held the truth, how its normal scores are
spread, and the share of the displacement inside the band.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from bench.reporting.frame import Frame, Result
from bench.reporting.labels import title as title_of
from bench.reporting.tables.common import Line, csv, markdown_table
from bench.scoring.calibration import Calibration, calibration, together

SYMBOLS = {"k_over_m": "k/m", "c_over_m": "c/m"}
FEWEST = 20
"""Replicates below which nothing is judged."""
LEGEND = """Of each interval of 95 %: the share of replicates in which it held the truth, with its own 95 % interval
(Wilson's). z is the truth's normal score under the belief, cut at 6: of mean 0 and root mean square (RMS) 1 if the
belief is calibrated; an RMS of 2 means intervals half as wide as the errors ask for, bias included: too sure; one
below 1, too wide. The verdict is by three tests (mean of z, its mean square, uniformity of the levels) at 5 %,
adjusted over all tests of all lines of this table (Benjamini and Hochberg): of what they find, one in twenty is
expected to be a false alarm, and if all lines were calibrated, nothing would be found with 95 % probability. Band: the
share of the record, 1,000 points in each replicate, where the true displacement lies in the method's own 95 % band. A
dash: the method states no uncertainty."""


def lines(results: Iterable[Result]) -> list[Line]:
    """One line a method, noise, start and quantity; the tests of all of them are adjusted together."""
    places = [(result, name) for result in results if result.stored for name in SYMBOLS]
    levels = [_told(result, f"{name}_pit") for result, name in places]
    judged = iter(together([calibration(own) for own in levels if own.size >= FEWEST]))
    rows: list[Line] = []
    for (result, name), own in zip(places, levels, strict=True):
        inside = _told(result, "band_inside_95")
        rows.append(
            {
                "method": result.label, "initial_state": result.initial_state, "snr_db": result.snr_db,
                "quantity": name,
                **(_line(next(judged)) if own.size >= FEWEST else {"n": own.size, "verdict": "-"}),
                "band_95": float(np.mean(inside)) if inside.size else np.nan,
            }
        )  # fmt: skip
    return rows


def _told(result: Result, score: str) -> np.ndarray:
    scores = result.scores(score)
    return np.asarray(scores[~np.isnan(scores)])


def _line(found: Calibration) -> Line:
    shares = {f"coverage_{round(100 * c.level)}": c.share for c in found.coverage}
    widest = found.coverage[-1]
    return {
        "n": found.n, **shares, "low_95": widest.low, "high_95": widest.high, "mean_z": found.mean_z,
        "rms_z": found.rms_z, "uniform_p": found.p_values[2], "verdict": found.verdict,
    }  # fmt: skip


def markdown(data: Iterable[Line], title: str) -> str:
    """The table for reading."""
    panels: dict[str, dict[tuple[str, float], dict[str, Line]]] = {}
    for line in data:
        rows = panels.setdefault(line["initial_state"], {})
        rows.setdefault((line["method"], line["snr_db"]), {})[line["quantity"]] = line
    headers = ["method", "SNR (dB)", "n"]
    headers += [f"{symbol} {what}" for symbol in SYMBOLS.values() for what in ("95 %", "RMS of z", "verdict")]
    parts = [f"# {title}", LEGEND]
    for told, rows in panels.items():
        table = markdown_table([_row(*place, own) for place, own in rows.items()], [*headers, "band 95 %"])
        parts += [f"## Initial state {told}", table]
    return "\n\n".join(parts) + "\n"


def _row(method: str, snr: float, own: Mapping[str, Line]) -> list[str]:
    """One method at one noise level, its quantities side by side."""
    first = next(iter(own.values()))
    cells = [title_of(method), f"{snr:g}", str(first["n"])]
    for name in SYMBOLS:
        line = own[name]
        if line["verdict"] == "-":
            cells += ["-", "-", "-"]
            continue
        share, low, high = (f"{100 * line[key]:.1f}" for key in ("coverage_95", "low_95", "high_95"))
        cells += [f"{share} ({low} to {high})", f"{line['rms_z']:.2f}", line["verdict"]]
    return [*cells, f"{100 * first['band_95']:.1f}" if np.isfinite(first["band_95"]) else "-"]


def calibration_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of it."""
    if not frame.any_stored:
        return {}
    data = lines(frame)
    text = f"{markdown(data, frame.title)}\nRegenerate: `{frame.command}`\n"
    name = frame.experiment
    return {f"{name}.md": text, f"{name}.csv": csv(data, 5)}
