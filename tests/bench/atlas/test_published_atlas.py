"""Points of the published atlases, drawn at random and fitted again, are near the bound where the atlas says so.

Every run draws other points; set ATLAS_SEED to repeat a draw.
"""

from __future__ import annotations

import os
import random
import time
from pathlib import Path

import pandas as pd
import pytest

from bench.atlas.model import MAX_SD
from bench.atlas.run import fit_point
from bench.atlas.statistics import columns
from bench.config.atlas import FORCED, FREE_DECAY, SAMPLED, atlas_blocks
from bench.entrants.registry import make_method
from bench.reporting.atlas import near

RESULTS = Path(__file__).parents[3] / "results"
PUBLISHED = {FREE_DECAY: RESULTS / "atlas.csv.gz", FORCED: RESULTS / "atlas_forced.csv.gz"}
SEED = os.environ.get("ATLAS_SEED", str(time.time_ns()))
DRAWN = {FREE_DECAY: 12, FORCED: 5}
LONGEST_S = 0.3
"""Points whose fits took longer are not drawn, to save time."""
MOST_DIFFERENT = 1
"""A point at the limit may change sides when a fit in fifty ends elsewhere."""
METHODS = {
    FREE_DECAY: ["output_error", "matrix_pencil", "frequency", "iqml", "ls", "log_decrement"],
    FORCED: ["output_error", "srivc", "frequency", "ls", "rls"],
}


@pytest.mark.slow
@pytest.mark.parametrize(("test", "method"), [(test, method) for test in METHODS for method in METHODS[test]])
def test_drawn_points_are_on_the_published_side_of_the_limit(test: str, method: str) -> None:
    published = pd.read_csv(PUBLISHED[test])
    published = published[published.method == method].reset_index(drop=True)
    points = [(block, point) for block in atlas_blocks(SAMPLED, [method], test=test) for point in block.points]
    assert [point.samples for _, point in points] == published.samples.tolist()
    determined = (published.bound_k_over_m <= MAX_SD) & ~published.aliased & (published.seconds < LONGEST_S)
    differing = []
    for place in random.Random(f"{SEED} {method}").sample(sorted(published.index[determined]), DRAWN[test]):
        block, point = points[place]
        statistics = fit_point(block, make_method(block.method, block.settings), point)
        again = pd.DataFrame([statistics.row()], [place], columns(point.QUANTITIES)).round(3)
        if near(again)[place] != near(published.loc[[place]])[place]:
            differing.append(f"{place}: {again.iloc[0].to_dict()}; published {published.loc[place].to_dict()}")
    assert len(differing) <= MOST_DIFFERENT, f"ATLAS_SEED={SEED}: {differing}"
