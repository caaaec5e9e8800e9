"""What each method is expected to do at a free decay, from the atlas and its model."""

from __future__ import annotations

import math
import zlib
from pathlib import Path

import pandas as pd

from bench.atlas.model import AtlasModel, unknown
from bench.atlas.point import FreeDecay
from bench.entrants.registry import load_method
from bench.errors import InputError
from bench.reporting.atlas import RARE, point_frame
from bench.reporting.plans.request import TITLES
from bench.reporting.terminal import table, wrapped

WRITTEN = "a file that python -m bench -m experiment=atlas has written"
MEANING = (
    "The bound on the standard deviation of {quantity} is {bound:.2g} %; in {wrong:.2g} % of such records the "
    "likelihood is largest at a wrong frequency. Errors are those of fits without a gross error, with the range of "
    "eight in ten tests like this; a gross error is beyond five times the bound."
)


def read_atlas(path: Path, quantity: str) -> pd.DataFrame:
    """Read the atlas; raises InputError for a file that is none, or is not of this quantity."""
    try:
        atlas = pd.read_csv(path)
    except (OSError, ValueError, EOFError, zlib.error):
        raise InputError("atlas", path, WRITTEN) from None
    if not {"method", f"{quantity}_core", f"{quantity}_gross"} <= set(atlas):
        raise InputError("atlas", path, WRITTEN)
    return atlas


def expected_page(point: FreeDecay, atlas: pd.DataFrame, quantity: str) -> str:
    """Return a table of methods with their expected errors; raises InputError for an atlas with too few points."""
    frame = point_frame(point)
    why = unknown(frame, quantity)
    if why:
        return wrapped(f"The atlas does not cover this test: {why}.")
    rows = []
    for name, fits in atlas.groupby("method", sort=False):
        try:
            answer = AtlasModel(fits, quantity).expected(frame)[0]
        except ValueError:  # too few points of this method
            continue
        low, middle, high = answer.excess
        spread = "-" if math.isnan(middle) else f"{middle:.2f} ({low:.2f} to {high:.2f})"
        order = (answer.gross > RARE, middle if math.isfinite(middle) else math.inf)
        rows.append((order, [load_method(str(name)).card.title, spread, f"{100 * answer.gross:.1f}"]))
    if not rows:
        raise InputError("atlas", "", "an atlas with more points of some method")
    cells = [cells for _, cells in sorted(rows, key=lambda row: row[0])]
    bound, wrong = float(frame[f"bound_{quantity}"].iloc[0]), float(frame.wrong_basin.iloc[0])
    meaning = MEANING.format(quantity=TITLES[quantity], bound=100 * bound, wrong=100 * wrong)
    text = table(cells, ["method", "error over the bound (range)", "gross errors, %"])
    return f"{text}\n\n{wrapped(meaning, '')}"
