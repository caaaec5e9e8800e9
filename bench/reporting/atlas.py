"""The atlas as a frame, a line a point and method, and what is written of it."""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bench.atlas.design import AXES
from bench.atlas.point import GROUPS, Point
from bench.atlas.run import Blocks, Task, bound_at
from bench.atlas.statistics import COLUMNS
from bench.atlas.threshold import wrong_basin
from bench.entrants.registry import load_method
from bench.reporting.tables.common import markdown_table

NEAR = 1.2
"""A method is near the bound where its core error is within so many times it, and gross errors are rare."""
RARE = 0.05
"""Share of gross errors."""
TOLD = 0.2
"""Standard deviation of a logarithm, by the bound, above which a test is said not to tell a quantity."""


def atlas_frame(tasks: Sequence[Task], blocks: Blocks) -> pd.DataFrame:
    """A line for each point and method of the blocks that are finished, with the bound."""
    lines, bounds = [], dict[Point, tuple[float, ...]]()
    for task in tasks:
        found = blocks.get(task)
        if found is None:
            continue
        for point, statistics in zip(task.points, found, strict=True):
            if point not in bounds:
                least = bound_at(point)
                wrong = float("nan") if point.aliased else wrong_basin(point)
                bounds[point] = (*least.sds, least.displacement, wrong)
            numbers = [*(getattr(point, axis.name) for axis in AXES), point.start_known, point.aliased]
            lines.append([*numbers, task.label, *bounds[point], *statistics.row().tolist()])
    names = [*(axis.name for axis in AXES), "start_known", "aliased", "method"]
    return pd.DataFrame(
        lines, columns=[*names, *(f"bound_{name}" for name in (*GROUPS, "displacement")), "wrong_basin", *COLUMNS]
    )


def near(frame: pd.DataFrame, quantity: str = GROUPS[0]) -> pd.Series:
    """Whether each line is near the bound in a quantity."""
    return (frame[f"{quantity}_core"] <= NEAR) & (frame[f"{quantity}_gross"] <= RARE)


def written(frame: pd.DataFrame, out: Path, command: str) -> list[Path]:
    """The atlas as compressed CSV, and its summary with the data dictionary."""
    data, page = out / "atlas.csv.gz", out / "atlas.md"
    text = frame.to_csv(index=False, float_format="%.4g", lineterminator="\n")
    with data.open("wb") as raw, gzip.GzipFile("", "wb", fileobj=raw, mtime=0) as packed:  # the same bytes again
        packed.write(text.encode())
    page.write_text(summary(frame, command), encoding="utf-8")
    return [data, page]


def summary(frame: pd.DataFrame, command: str) -> str:
    """What the sampled atlas holds, a line a method, and what its columns mean."""
    points = len(frame.drop_duplicates([axis.name for axis in AXES]))
    head = f"{int(frame.fits.sum()):,} fits at {points:,} points. {HEAD}"
    tables = [f"## {GROUP_TITLES[name]}\n\n{_table(frame, name)}" for name in GROUPS]
    words = "\n".join(f"- `{name}`: {text}" for name, text in DICTIONARY.items())
    return "\n\n".join(
        ["# The atlas of free decays", head, *tables, f"## Columns of `atlas.csv.gz`\n\n{words}",
         f"Regenerate: `{command}`"]
    ) + "\n"  # fmt: skip


GROUP_TITLES = {"k_over_m": "k/m, the squared natural frequency", "c_over_m": "c/m, the decay rate"}
HEAD = f"""Points are spread evenly over the box of all tests: samples, cycles and damping ratio by their logarithms,
SNR, phase of the start, and whether the start is told. Of a quantity a test tells nothing useful where the Cramér-Rao
bound on the standard deviation of its logarithm is above {TOLD:g}, and it is ambiguous where the natural frequency is
above half the sampling rate; the tables are over the other points.

**near**: share of points at which a method's errors are within {NEAR:g} times the bound, gross ones left out, and at
most {100 * RARE:g} % are gross; **gross**: share of fits whose error is beyond five times the bound, or that give no
answer; **coverage**: of 95 % intervals, the mean over points."""
DICTIONARY = {
    "samples, cycles, damping_ratio, snr_db, phase, start_known": "the test; `phase` in rad: the start is "
    "`x0 = A cos(phase)`, `v0 = -A ω sin(phase)`, with ω the undamped natural frequency; `cycles` are undamped periods",
    "aliased": "whether the natural frequency is at or above half the sampling rate",
    "method": "by the name that `method=` takes",
    "bound_k_over_m, bound_c_over_m": "Cramér-Rao bound on the standard deviation of the logarithm",
    "bound_displacement": "that on the root mean square displacement error over the record, m",
    "wrong_basin": "expected share of records whose likelihood is largest in a wrong basin; empty where aliased",
    "fits, failed, seconds": "fits at the point; share without an estimate; median wall time of one",
    "*_bias, *_core": "mean and root mean square error over the bound, of fits that are not gross",
    "*_median, *_p90": "quantiles of the error's size over the bound, of all fits",
    "*_gross": "share of fits beyond five times the bound, or without an answer",
    "*_held, *_told": "share of 95 % intervals that hold the truth, of those there are; share of fits with one",
}


def _table(frame: pd.DataFrame, quantity: str) -> str:
    told = frame[(frame[f"bound_{quantity}"] <= TOLD) & ~frame.aliased]
    rows = []
    for method, own in told.groupby("method", sort=False):
        share = float(near(own, quantity).mean())
        cells = [load_method(str(method)).card.title, f"{len(own):,}", f"{100 * share:.0f}",
                 f"{own[f'{quantity}_core'].median():.2f}", f"{100 * own[f'{quantity}_gross'].mean():.1f}",
                 f"{100 * own[f'{quantity}_held'].mean():.0f}", f"{1e3 * own.seconds.median():.1f}"]  # fmt: skip
        rows.append((-share, cells))
    headers = ["method", "points", "near %", "median error over the bound", "gross %", "coverage %", "ms a fit"]
    return markdown_table([cells for _, cells in sorted(rows, key=lambda row: row[0])], headers)
