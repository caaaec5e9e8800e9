"""Score intervals of a repeat on groups of repeats: ``python -m tests.studies.repeats data=../shared/data``.

The interval score (T. Gneiting, A. E. Raftery, J. Am. Stat. Assoc. 102:359, 2007) of ln k/m and ln c/m of each record
against the mean of the others, over that of the ideal interval, 1.96 times the standard deviation between repeats.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd

from bench.commands.declaration import Within
from bench.contract.estimate import Cost
from bench.contract.problem import Channel, Problem, Record
from bench.likelihood.output_error import OutputError, estimate_at
from bench.records.dominant_frequency import dominant_frequency
from bench.records.intervals import StatedInterval, stated_intervals
from bench.records.linearised_fit import LinearisedFit, at_theta, linearise
from bench.records.parts import parts_of
from bench.records.siblings import KINDS, interval_score
from bench.systems.sums import sum_from
from tests.studies.common import study, tracked
from tests.studies.repeats.groups import Group, measured, simulated

MAIN = ("k_over_m", "c_over_m")


def fitted(t: np.ndarray, y: np.ndarray, measures: Literal["displacement", "velocity"]) -> LinearisedFit | None:
    """Fit one linear mode with an unknown start and offset, from several damping ratios."""
    model = OutputError(Problem(sum_from("sdof"), (Record((Channel(t, y, measures, offset=True),)),)))
    rate = 2 * np.pi * dominant_frequency(t, y)
    starts = [
        model.vector({"m": 1.0, "c": 2 * ratio * w, "k": w**2})
        for ratio in (0.003, 0.02, 0.06)
        for w in rate * np.array([0.985, 1.0, 1.015])
    ]
    thetas = model.settle(np.stack(starts), iterations=30)
    return at_theta(model, min(thetas, key=model.profile))


def stated(fit: LinearisedFit) -> dict[str, StatedInterval]:
    """State the intervals of a fit, as of a record."""
    estimate = estimate_at(fit.model, fit.theta, fit.white, fit.used, Cost())
    at = linearise(fit.model.problem, estimate)
    assert at is not None
    frequency = float(np.exp(fit.theta[1] / 2)) / (2 * np.pi)
    return stated_intervals(estimate, at, parts_of(at, frequency * fit.model.problem.natural_units().time))


def scores(group: Group) -> Iterator[tuple[str, str, float, float, float]]:
    """Yield quantity, kind of interval, score over the ideal's, coverage and median width of a group."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fits = [fitted(t, y, group.measures) for t, y in group.repeats]
        intervals = [stated(fit) for fit in fits if fit is not None]
    for name in MAIN:
        compared = [interval[name] for interval in intervals if not interval[name].limit]
        for kind in KINDS if len(compared) > 1 else ():
            score = interval_score(pd.DataFrame(map(vars, compared)), kind)
            yield name, kind, score.score, score.covered / len(compared), score.width


def repeats(
    data: Annotated[Path, "folder of the measured records"] = Path("../shared/data"),
    count: Annotated[int, Within(ge=0), "simulated groups of each kind"] = 6,
    seed: Annotated[int, Within(ge=0), "of the simulated groups"] = 0,
) -> int:
    """Score the intervals of a repeat, of the record and assuming white noise on measured and simulated groups."""
    groups = [*measured(data), *simulated(count, seed)]
    rows = [(group, *row) for group in tracked(groups, "group") for row in scores(group)]
    for group, name, kind, score, covered, width in rows:
        print(f"{group.name:18s} {name} {kind:6s} {score:8.2f} {covered:5.2f} {width:9.4g}")
    for held_out in (False, True):
        for name in MAIN:
            for kind in KINDS:
                some = np.array([row[3:] for row in rows if row[0].held_out == held_out and row[1:3] == (name, kind)])
                middle, worst = np.median(some[:, 0]), np.max(some[:, 0])
                print(f"held out {held_out}: {name} {kind:6s} median {middle:.2f} worst {worst:.1f} ",
                      f"coverage {np.mean(some[:, 1]):.2f}")  # fmt: skip
    return 0


if __name__ == "__main__":
    raise SystemExit(study(repeats, "tests.studies.repeats"))
