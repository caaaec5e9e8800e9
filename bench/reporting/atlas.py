"""The atlas as a table with one line per point and method, and the page that summarises it."""

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

from bench.atlas.forced_test import Forced
from bench.atlas.model import FOLDS, MAX_SD, CrossValidation, cross_validate, determined
from bench.atlas.point import GROUPS, FreeDecay, Point
from bench.atlas.run import PointBlock, bound_at, read_block
from bench.atlas.statistics import DISPLACEMENT, columns
from bench.atlas.threshold import wrong_basin
from bench.entrants.registry import load_method
from bench.reporting.rounding import percent, readable
from bench.reporting.tables.render import MISSING, Columns, listing, markdown_table
from bench.reporting.whole_file import write

NEAR = 1.2
"""Largest ratio of error (without outlier fits) to bound of a method that counts as near the bound."""
RARE = 0.05
"""Largest share of outlier fits of a method that counts as near the bound."""


def atlas_frame(blocks: Sequence[PointBlock], folder: Path) -> pd.DataFrame:
    """Return one line per point and method of the finished blocks, with the bound; all of one kind of test."""
    lines = []
    for block in blocks:
        stored = read_block(folder, block) or ()
        for point, statistics in zip(block.points, stored, strict=bool(stored)):
            values = zip(columns(point.QUANTITIES), statistics.row().tolist(), strict=True)
            lines.append({**_test(point), "method": block.label, **_bounds(point), **dict(values)})
    return pd.DataFrame(lines)


def point_frame(point: Point) -> pd.DataFrame:
    """Return one line for a point, with the bound, as input of the model of the atlas."""
    return pd.DataFrame([{**_test(point), **_bounds(point)}])


def test_columns(kind: type[Point]) -> list[str]:
    """Return the columns that identify a test."""
    return [*(axis.name for axis in kind.AXES), kind.CHOICE.name, "aliased"]


def _test(point: Point) -> dict[str, Any]:
    return {name: getattr(point, name) for name in test_columns(type(point))}


@cache
def _bounds(point: Point) -> dict[str, float]:
    """Return the bounds, and the expected share of wrong basins (NaN if unknown)."""
    least = bound_at(point)
    basin = wrong_basin(point) if isinstance(point, FreeDecay) and not point.aliased else math.nan
    bounds = {**least.sds, DISPLACEMENT: least.displacement}
    return {**{f"bound_{name}": bound for name, bound in bounds.items()}, "wrong_basin": basin}


def near(frame: pd.DataFrame, quantity: str = GROUPS[0]) -> pd.Series:
    """Return whether each line is near the bound in a quantity."""
    return (frame[f"{quantity}_core"] <= NEAR) & (frame[f"{quantity}_gross"] <= RARE)


@dataclass(frozen=True)
class AtlasPage:
    """Texts of the page of an atlas.

    Attributes:
        kind: Kind of test.
        name: Name of the files.
        title: Title.
        box: Description of the points.
        columns: Descriptions of the columns of this kind of test.
        modelled: Whether the page describes the model of the atlas.
    """

    kind: type[Point]
    name: str
    title: str
    box: str
    columns: Mapping[str, str]
    modelled: bool = False


def write_atlas(frame: pd.DataFrame, page: AtlasPage, out: Path, command: str) -> list[Path]:
    """Write the atlas as compressed CSV, and its summary with the data dictionary."""
    summary_file = out / f"{page.name}.md"
    write(summary_file, summary(frame, page, command), out)
    return [write_compressed(frame, out / f"{page.name}.csv.gz"), summary_file]


def write_compressed(frame: pd.DataFrame, path: Path) -> Path:
    """Write a table as compressed CSV; the same table gives the same bytes."""
    text = frame.dropna(axis=1, how="all").to_csv(index=False, float_format="%.4g", lineterminator="\n")
    content = io.BytesIO()
    with gzip.GzipFile("", "wb", fileobj=content, mtime=0) as file:
        file.write(text.encode())
    write(path, content.getvalue(), path.parent)
    return path


def summary(frame: pd.DataFrame, page: AtlasPage, command: str) -> str:
    """Return the page of an atlas: one table per quantity with a row per method, the model, and the columns."""
    points = len(frame.drop_duplicates([axis.name for axis in page.kind.AXES]))
    head = f"{int(frame.fits.sum()):,} fits at {points:,} points. {page.box}\n\n{HEAD}"
    tables = [f"## {TITLES[name]}\n\n{_table(frame, name)}" for name in page.kind.QUANTITIES]
    dictionary = "\n".join(f"- `{name}`: {text}" for name, text in {**page.columns, **DICTIONARY}.items())
    model = [f"## Its model\n\n{MODEL}\n\n{_model_table(frame)}"] if page.modelled else []
    parts = [
        f"# {page.title}", head, *tables, *model, f"## Columns of `{page.name}.csv.gz`\n\n{dictionary}",
        f"Regenerate: `{command}`",
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


TITLES = {"k_over_m": "k/m, the squared natural frequency", "c_over_m": "c/m, the decay rate", "m": "m, the mass"}
HEAD = f"""A quantity is identifiable at a point if the Cramér-Rao bound on the standard deviation of its logarithm is
at most {MAX_SD:g}. A test is ambiguous if its samples do not distinguish the natural frequency from its aliases. The
tables are over unambiguous points with an identifiable quantity.

**near**: share of points where a method's errors without outlier fits are within {NEAR:g} times the bound, and at most
{100 * RARE:g} % of the fits are outliers; **outliers**: share of outlier fits, with an error beyond five times the
bound or without an estimate; **coverage**: of the 95 % intervals, mean over points."""
MODEL = f"""`python -m bench design` predicts the errors of a method at any test within the ranges of the atlas, by
gradient-boosted trees fitted to `atlas.csv.gz`. The table is a cross-validation in {FOLDS} parts. **error**: median
absolute error of the predicted log excess, part of which is the error of the observed one, an average over few fits;
**in range**: share of points within the predicted range of 10 % to 90 %; **outliers, error**: mean difference of
predicted and observed share of outlier fits, over tenths of the points sorted by prediction, in percentage points."""
DICTIONARY = {
    "aliased": "whether the test is ambiguous: no force, and a natural frequency at or above half the sampling rate",
    "method": "name of the method, as in `method=`",
    "bound_*": "Cramér-Rao bound on the standard deviation of the logarithm; for the displacement, bound on the root "
    "mean square error over the record, m",
    "fits, failed, seconds": "number of fits at the point; share without an estimate; median wall time of a fit",
    "*_bias, *_core": "mean and root mean square of error over bound, without outlier fits",
    "*_median, *_p90": "quantiles of the absolute error over the bound, all fits",
    "*_gross": "share of outlier fits: error beyond five times the bound, or no estimate",
    "*_held, *_told": "coverage of the 95 % intervals; share of fits with an interval",
}
FREE_DECAYS = AtlasPage(
    FreeDecay,
    "atlas",
    "The atlas of free decays",
    "The points are spread evenly over the ranges of samples, cycles and damping ratio (logarithmic), SNR, phase of\n"
    "the initial state, and known or unknown initial state.",
    {
        "samples, cycles, damping_ratio, snr_db, phase, start_known": "the test; `phase` (rad) of the initial state "
        "`x0 = A cos(phase)`, `v0 = -A ω sin(phase)`, with ω the undamped natural frequency; `cycles` are undamped "
        "periods",
        "wrong_basin": "expected share of records whose likelihood is largest in a wrong basin; empty if aliased",
    },
    modelled=True,
)
FORCED_TESTS = AtlasPage(
    Forced,
    "atlas_forced",
    "The atlas of tests with a measured force",
    "Tests from rest under a force that is measured with noise. The points are spread evenly over the ranges of\n"
    "samples, cycles, damping ratio and bandwidth of the force (logarithmic), SNR of displacement and of force, and\n"
    "kind of force. The methods treat the measured force as exact; the bound is that of an exactly known force.",
    {
        "samples, cycles, damping_ratio, snr_db": "the test; `cycles` are undamped periods in the record",
        "bandwidth": "highest frequency of the force over the natural frequency; for a pulse, the frequency where its "
        "spectrum has fallen to half",
        "force_snr_db": "mean square of the force over the variance of its sensor's noise",
        "force": "kind of force, as in `system.force.kind`",
    },
)
PAGES = (FREE_DECAYS, FORCED_TESTS)


def _table(frame: pd.DataFrame, quantity: str) -> str:
    """Return one row per method, in the order of the share of points near the bound."""
    columns: Columns[pd.DataFrame] = {
        "method": _method,
        "points": lambda lines: f"{len(lines):,}",
        "near %": lambda lines: percent(near(lines, quantity).mean()),
        "median error over the bound": lambda lines: f"{lines[f'{quantity}_core'].median():.2f}",
        "outliers %": lambda lines: percent(lines[f"{quantity}_gross"].mean(), 1),
        "coverage %": lambda lines: percent(lines[f"{quantity}_held"].mean()),
        "ms per fit": lambda lines: f"{1e3 * lines.seconds.median():.1f}",
    }
    methods = [own for _, own in determined(frame, quantity).groupby("method", sort=False)]
    return markdown_table(*listing(sorted(methods, key=lambda lines: -near(lines, quantity).mean()), columns))


HELD_OUT: Columns[CrossValidation] = {
    "points": lambda model: f"{model.points:,}",
    "error": lambda model: MISSING if math.isnan(model.error) else f"{model.error:.3f}",
    "in range %": lambda model: percent(model.within),
    "outliers, error": lambda model: percent(model.calibration, 1),
}


def _model_table(frame: pd.DataFrame) -> str:
    """Return the cross-validation of the model, one row per method; dashes if there are too few points."""
    rows = []
    for _, lines in frame.groupby("method", sort=False):
        cells = [_method(lines)]
        for name in GROUPS:
            try:
                model = cross_validate(lines, name)
                cells += [text(model) for text in HELD_OUT.values()]
            except ValueError:
                cells += [MISSING] * len(HELD_OUT)
        rows.append(cells)
    return markdown_table(rows, ["method", *(f"{readable(name)} {word}" for name in GROUPS for word in HELD_OUT)])


def _method(lines: pd.DataFrame) -> str:
    return load_method(str(lines.method.iloc[0])).card.title
