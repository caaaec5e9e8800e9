"""An atlas as a frame, a line a point and method, and what is written of it."""

from __future__ import annotations

import gzip
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd

from bench.atlas.forced import Forced
from bench.atlas.model import FOLDS, TOLD, HeldOut, held_out, told
from bench.atlas.point import GROUPS, FreeDecay, Point
from bench.atlas.run import PointBlock, bound_at, read_block
from bench.atlas.statistics import DISPLACEMENT, columns
from bench.atlas.threshold import wrong_basin
from bench.entrants.registry import load_method
from bench.reporting.rounding import percent, readable
from bench.reporting.tables.render import MISSING, Columns, listing, markdown_table
from bench.reporting.whole_file import write

NEAR = 1.2
"""A method is near the bound where its core error is within so many times it, and gross errors are rare."""
RARE = 0.05
"""Share of gross errors."""


def atlas_frame(blocks: Sequence[PointBlock], folder: Path) -> pd.DataFrame:
    """A line for each point and method of the blocks that are finished, with the bound; all of one kind of test."""
    lines = []
    for block in blocks:
        stored = read_block(folder, block) or ()
        for point, statistics in zip(block.points, stored, strict=bool(stored)):
            values = zip(columns(point.QUANTITIES), statistics.row().tolist(), strict=True)
            lines.append({**_test(point), "method": block.label, **_bounds(point), **dict(values)})
    return pd.DataFrame(lines)


def point_frame(point: Point) -> pd.DataFrame:
    """A line for a point, with the bound, as the model of the atlas asks for it."""
    return pd.DataFrame([{**_test(point), **_bounds(point)}])


def test_columns(kind: type[Point]) -> list[str]:
    """The columns that say which test it is."""
    return [*(axis.name for axis in kind.AXES), kind.CHOICE.name, "aliased"]


def _test(point: Point) -> dict[str, Any]:
    return {name: getattr(point, name) for name in test_columns(type(point))}


@cache
def _bounds(point: Point) -> dict[str, float]:
    """The bounds, and the expected share of wrong basins, NaN where it is not known."""
    least = bound_at(point)
    basin = wrong_basin(point) if isinstance(point, FreeDecay) and not point.aliased else math.nan
    bounds = {**least.sds, DISPLACEMENT: least.displacement}
    return {**{f"bound_{name}": bound for name, bound in bounds.items()}, "wrong_basin": basin}


def near(frame: pd.DataFrame, quantity: str = GROUPS[0]) -> pd.Series:
    """Whether each line is near the bound in a quantity."""
    return (frame[f"{quantity}_core"] <= NEAR) & (frame[f"{quantity}_gross"] <= RARE)


@dataclass(frozen=True)
class AtlasPage:
    """What is said of the atlas of a kind of test, in files called ``name``."""

    kind: type[Point]
    name: str
    title: str
    box: str
    words: Mapping[str, str]
    modelled: bool = False


def written(frame: pd.DataFrame, page: AtlasPage, out: Path, command: str) -> list[Path]:
    """The atlas as compressed CSV, and its summary with the data dictionary."""
    summed = out / f"{page.name}.md"
    write(summed, summary(frame, page, command), out)
    return [packed(frame, out / f"{page.name}.csv.gz"), summed]


def packed(frame: pd.DataFrame, path: Path) -> Path:
    """Write a frame as compressed CSV: of the same frame the same bytes."""
    text = frame.dropna(axis=1, how="all").to_csv(index=False, float_format="%.4g", lineterminator="\n")
    content = io.BytesIO()
    with gzip.GzipFile("", "wb", fileobj=content, mtime=0) as file:
        file.write(text.encode())
    write(path, content.getvalue(), path.parent)
    return path


def summary(frame: pd.DataFrame, page: AtlasPage, command: str) -> str:
    """What a sampled atlas holds, a line a method, and what its columns mean."""
    points = len(frame.drop_duplicates([axis.name for axis in page.kind.AXES]))
    head = f"{int(frame.fits.sum()):,} fits at {points:,} points. {page.box}\n\n{HEAD}"
    tables = [f"## {TITLES[name]}\n\n{_table(frame, name)}" for name in page.kind.QUANTITIES]
    words = "\n".join(f"- `{name}`: {text}" for name, text in {**page.words, **DICTIONARY}.items())
    model = [f"## Its model\n\n{MODEL}\n\n{_model_table(frame)}"] if page.modelled else []
    parts = [
        f"# {page.title}", head, *tables, *model, f"## Columns of `{page.name}.csv.gz`\n\n{words}",
        f"Regenerate: `{command}`",
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


TITLES = {"k_over_m": "k/m, the squared natural frequency", "c_over_m": "c/m, the decay rate", "m": "m, the mass"}
HEAD = f"""Of a quantity a test tells nothing useful where the Cramér-Rao bound on the standard deviation of its
logarithm is above {TOLD:g}, and it is ambiguous where the samples do not tell its frequency from others; the tables are
over the other points.

**near**: share of points at which a method's errors are within {NEAR:g} times the bound, gross ones left out, and at
most {100 * RARE:g} % are gross; **gross**: share of fits whose error is beyond five times the bound, or that give no
answer; **coverage**: of 95 % intervals, the mean over points."""
MODEL = f"""`python -m bench design` says what a method is expected to do at any test inside the box, by trees with
gradient boosting, fitted to `atlas.csv.gz`. Here is how they do at points that they were not fitted to, each left out
once in {FOLDS} parts. **error**: median size of the error of the log excess, which is itself counted in few fits; **in
range**: share of points inside the range from the 10 % to the 90 % quantile; **gross, off by**: mean distance of
predicted and counted share of gross errors, in tenths of the points by prediction, in percentage points."""
DICTIONARY = {
    "aliased": "whether the test is ambiguous: without a force, where the natural frequency is at or above half the "
    "sampling rate",
    "method": "by the name that `method=` takes",
    "bound_*": "Cramér-Rao bound on the standard deviation of the logarithm; of the displacement, that on the root "
    "mean square error over the record, m",
    "fits, failed, seconds": "fits at the point; share without an estimate; median wall time of one",
    "*_bias, *_core": "mean and root mean square error over the bound, of fits that are not gross",
    "*_median, *_p90": "quantiles of the error's size over the bound, of all fits",
    "*_gross": "share of fits beyond five times the bound, or without an answer",
    "*_held, *_told": "share of 95 % intervals that hold the truth, of those there are; share of fits with one",
}
FREE_DECAYS = AtlasPage(
    FreeDecay,
    "atlas",
    "The atlas of free decays",
    "Points are spread evenly over the box of all tests: samples, cycles and damping ratio by their logarithms, SNR,\n"
    "phase of the start, and whether the start is told.",
    {
        "samples, cycles, damping_ratio, snr_db, phase, start_known": "the test; `phase` in rad: the start is "
        "`x0 = A cos(phase)`, `v0 = -A ω sin(phase)`, with ω the undamped natural frequency; `cycles` are undamped "
        "periods",
        "wrong_basin": "expected share of records whose likelihood is largest in a wrong basin; empty where aliased",
    },
    modelled=True,
)
FORCED_TESTS = AtlasPage(
    Forced,
    "atlas_forced",
    "The atlas of tests with a measured force",
    "Points are spread evenly over the box of all tests from rest under a force that is measured with noise: samples,\n"
    "cycles, damping ratio and the force's bandwidth by their logarithms, SNR of displacement and of force, and the\n"
    "kind of force. Every method takes the force as told; the bound is that of a force known exactly.",
    {
        "samples, cycles, damping_ratio, snr_db": "the test; `cycles` are undamped periods in the record",
        "bandwidth": "highest frequency of the force over the natural frequency; of a pulse, where its spectrum has "
        "fallen to half",
        "force_snr_db": "mean square of the force over the variance of its sensor's noise",
        "force": "its kind, as in `system.force.kind`",
    },
)
PAGES = (FREE_DECAYS, FORCED_TESTS)


def _table(frame: pd.DataFrame, quantity: str) -> str:
    """Return a line a method, those first that are near the bound most often."""
    columns: Columns[pd.DataFrame] = {
        "method": _method,
        "points": lambda own: f"{len(own):,}",
        "near %": lambda own: percent(near(own, quantity).mean()),
        "median error over the bound": lambda own: f"{own[f'{quantity}_core'].median():.2f}",
        "gross %": lambda own: percent(own[f"{quantity}_gross"].mean(), 1),
        "coverage %": lambda own: percent(own[f"{quantity}_held"].mean()),
        "ms a fit": lambda own: f"{1e3 * own.seconds.median():.1f}",
    }
    methods = [own for _, own in told(frame, quantity).groupby("method", sort=False)]
    return markdown_table(*listing(sorted(methods, key=lambda own: -near(own, quantity).mean()), columns))


HELD_OUT: Columns[HeldOut] = {
    "points": lambda model: f"{model.points:,}",
    "error": lambda model: MISSING if math.isnan(model.error) else f"{model.error:.3f}",
    "in range %": lambda model: percent(model.within),
    "gross, off by": lambda model: percent(model.calibration, 1),
}


def _model_table(frame: pd.DataFrame) -> str:
    """Return how the model does at points that it has not seen, a line a method; dashes where these are too few."""
    rows = []
    for _, own in frame.groupby("method", sort=False):
        cells = [_method(own)]
        for name in GROUPS:
            try:
                model = held_out(own, name)
                cells += [text(model) for text in HELD_OUT.values()]
            except ValueError:
                cells += [MISSING] * len(HELD_OUT)
        rows.append(cells)
    return markdown_table(rows, ["method", *(f"{readable(name)} {word}" for name in GROUPS for word in HELD_OUT)])


def _method(own: pd.DataFrame) -> str:
    return load_method(str(own.method.iloc[0])).card.title
