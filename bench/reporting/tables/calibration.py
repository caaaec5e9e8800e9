"""Whether stated uncertainties hold: the table of ``experiment=calibration``, from its stored rows.

For every method, noise and start: how often the intervals of k/m and c/m held the truth, how its normal scores are
spread, and the share of the displacement inside the band.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bench.reporting.frame import ERROR, Frame, Line, Result, group, line
from bench.reporting.rounding import percent, percent_between
from bench.reporting.tables.render import MISSING, NAMED, NOISE, Columns, Rows, files, panel
from bench.scoring.calibration import Calibration, calibration, together

COLUMNS = (
    "method", "initial_state", "snr_db", "quantity", "n", "coverage_50", "coverage_80", "coverage_95", "low_95",
    "high_95", "mean_z", "rms_z", "uniform_p", "verdict", "band_95",
)  # fmt: skip
SYMBOLS = {"k_over_m": "k/m", "c_over_m": "c/m"}
FEWEST = 20
"""Replicates below which nothing is judged."""
COUNTED = 5
"""Replicates below which nothing is counted either."""
LEGEND = """Of each interval of 95 %: the share of replicates in which it held the truth, with its own 95 % interval
(Wilson's). z is the truth's normal score under the belief, cut at 6: of mean 0 and root mean square (RMS) 1 if the
belief is calibrated; an RMS of 2 means intervals half as wide as the errors ask for, bias included: too sure; one
below 1, too wide. The verdict is by three tests (mean of z, its mean square, uniformity of the levels) at 5 %,
adjusted over all tests of all lines of this table (Benjamini and Hochberg): of what they find, one in twenty is
expected to be a false alarm, and if all lines were calibrated, nothing would be found with 95 % probability. Fewer than
{fewest} replicates have no verdict. Band: the share of the record, 1,000 points in each replicate, where the true
displacement lies in the method's own 95 % band. A dash: the method states no uncertainty, or there is no verdict."""


def lines(results: Iterable[Result]) -> list[Line]:
    """One line a method, noise, start and quantity; the tests of all of them are adjusted together."""
    places = [(result, name) for result in results if result.stored for name in SYMBOLS]
    levels = [_told(result, f"{name}_pit") for result, name in places]
    alone = [calibration(own) if own.size >= COUNTED else None for own in levels]
    judged = iter(together([one for one in alone if one and one.n >= FEWEST]))
    return [
        {
            **line(result, name + ERROR, ("method", "initial_state", "snr_db", "quantity")),
            **(_counted(one) if one else {}), "verdict": next(judged).verdict if own.size >= FEWEST else MISSING,
            "n": own.size,
            "band_95": np.mean(inside) if (inside := _told(result, "band_inside_95")).size else np.nan,
        }
        for (result, name), own, one in zip(places, levels, alone, strict=True)
    ]  # fmt: skip


def _told(result: Result, score: str) -> np.ndarray:
    scores = result.scores(score)
    return np.asarray(scores[~np.isnan(scores)])


def _counted(found: Calibration) -> Line:
    shares = {f"coverage_{round(100 * c.level)}": c.share for c in found.coverage}
    widest = found.coverage[-1]
    return {
        **shares, "low_95": widest.low, "high_95": widest.high, "mean_z": found.mean_z, "rms_z": found.rms_z,
        "uniform_p": found.p_values[2],
    }  # fmt: skip


def _panel(data: Sequence[Line]) -> Rows:
    return panel(
        data,
        lambda one: (one["method"], one["snr_db"]),
        {**NAMED, **NOISE, "n": lambda own: str(own[0]["n"])},
        lambda one: one["quantity"],
        _quantity,
        {"band 95 %": lambda own: percent(own[0]["band_95"], 1)},
    )


def _quantity(any_line: Line) -> Columns[Line]:
    name = SYMBOLS[any_line["quantity"]]
    return {
        f"{name} 95 %": lambda one: _coverage(one),
        f"{name} RMS of z": lambda one: f"{one['rms_z']:.2f}" if "rms_z" in one else MISSING,
        f"{name} verdict": lambda one: one["verdict"],
    }


def _coverage(one: Line) -> str:
    return percent_between(one["coverage_95"], one["low_95"], one["high_95"], 1) if "low_95" in one else MISSING


def calibration_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of it."""
    if not frame.any_stored:
        return {}
    data = lines(frame)
    parts: list[str | Rows] = [f"# {frame.title}", LEGEND.format(fewest=FEWEST)]
    for told, own in group(data, lambda one: one["initial_state"]).items():
        parts += [f"## Initial state {told}", _panel(own)]
    return files(frame.name, [*parts, f"Regenerate: `{frame.command}`"], data, COLUMNS, 5)
