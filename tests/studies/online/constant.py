"""Nothing changes: errors at the end of a record over the batch bound for the samples that a method uses; alarms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.config.online import online_scenario
from bench.engine.pool import Limits, run_tasks
from bench.engine.progress import progress_bar
from bench.entrants.online import online_card
from bench.online.bound import bound_variances
from bench.online.follow import Followed
from bench.online.paths import Tracking, in_order, read_paths
from bench.online.scenario import OnlineScenario, OnlineTruth, Stream
from bench.online.score import Z95, scored
from bench.reporting.tables.render import markdown_table

SCENARIO = "constant_multisine"
QUANTITIES = ("k_over_m", "c_over_m")


@dataclass(frozen=True)
class Row:
    """A method, its share of the records, the last samples that it uses (0: all), and what its alarm promises.

    ``threshold``: of the alarm; ``stated``: false alarms in 10,000 samples at most, by its card; NaN without one.
    """

    method: str
    share: float = 1.0
    uses: int = 0
    threshold: float = float("nan")
    stated: float = float("nan")


ROWS = (
    Row("ekf"),
    Row("ukf", 0.1),
    Row("square_root", 0.1),
    Row("imm"),
    Row("change_points", threshold=1.0, stated=0.001),  # odds of 10, a hazard of one in a million
    Row("cusum", threshold=16.0, stated=0.009),  # as the next
    Row("glr", threshold=13.0, stated=0.009),  # Ville's inequality: three births every 8 samples, exp(-13) each
    Row("ar"),
    Row("window_shooting", 0.1, uses=150),
)


def constant(records: int, store: Path, workers: int) -> str:
    """Follow the records, and tell errors and alarms; finished records are kept in ``store``."""
    scenario = online_scenario(SCENARIO)
    tasks = [Tracking(scenario, row.method, _settings(row), max(1, round(row.share * records)), 1) for row in ROWS]
    with progress_bar() as on_progress:
        run_tasks(in_order(tasks), store, Limits(workers), ("record", ""), on_progress)
    rows = [_row(row, task, store) for row, task in zip(ROWS, tasks, strict=True)]
    headers = ["method", "records", "samples used", "k/m excess", "c/m excess", "k/m cov. %", "c/m cov. %",
               "false alarms in 10,000 samples", "at most, stated"]  # fmt: skip
    return f"{HEAD.format(describe=scenario.describe())}\n\n{markdown_table(rows, headers)}"


HEAD = """## Nothing changes

{describe} **excess**: root mean square error of the logarithm at the last sample, over the Cramér-Rao bound for the
samples used, with its standard error; **cov.**: 95 % intervals at the last sample that hold the truth. A window is
compared with the bound for its own samples, at whose start the motion is unknown."""


def _settings(row: Row) -> dict[str, int]:
    """A window that is fitted once, at the end."""
    return {"length": row.uses, "every": online_scenario(SCENARIO).samples} if row.uses else {}


def _row(row: Row, task: Tracking, store: Path) -> list[str]:
    kept = read_paths(store, task)
    cells = [online_card(row.method).title, f"{len(kept)}", f"{row.uses or task.scenario.samples}"]
    squares, held = _ends(row, task, kept)
    for own in squares.T:
        excess = np.sqrt(np.mean(own))
        cells.append(f"{excess:.2f} ± {excess * np.std(own) / np.mean(own) / 2.0 / np.sqrt(own.size):.2f}")
    cells += [f"{100 * share:.1f}" for share in held.mean(axis=0)]
    if np.isnan(row.threshold):
        return [*cells, "-", "-"]
    return [*cells, f"{_alarms(row, list(kept.values())):.2f}", f"{row.stated:g}"]


def _ends(row: Row, task: Tracking, kept: dict[int, Followed]) -> tuple[np.ndarray, np.ndarray]:
    """Squared errors over the bound, and whether the intervals hold, at the last sample, each (n, 2)."""
    squares, held = [], []
    for i, path in kept.items():
        stream = task.scenario.stream(task.seed, i)
        bound = bound_variances(*(_last(task.scenario, stream, row.uses) if row.uses else (task.scenario, stream)))
        ends = [scored(stream, path, bound, name) for name in QUANTITIES]
        squares.append([end.squared[-1] / end.bound[-1] for end in ends])
        held.append([end.squared[-1] <= Z95**2 * end.stated[-1] for end in ends])
    there = np.isfinite(squares).all(axis=1)
    return np.array(squares)[there], np.array(held)[there]


def _last(scenario: OnlineScenario, stream: Stream, n: int) -> tuple[OnlineScenario, Stream]:
    """The same with its last n samples alone."""
    t = stream.truth
    truth = OnlineTruth(
        {name: value[-n:] for name, value in t.parameters.items()}, t.motion[-n:], t.known[-n:], t.ambient[-n:],
        t.clean[-n:], t.sigma,
    )  # fmt: skip
    return replace(scenario, samples=n), Stream(stream.layout, stream.times[-n:], stream.values[-n:], truth)


def _alarms(row: Row, paths: Sequence[Followed]) -> float:
    """Return how often the alarm begins to ring, in 10,000 samples behind the first estimate."""
    rings = samples = 0
    for path in paths:
        alarms = path.alarms[np.isfinite(path.alarms)]
        ringing = alarms > row.threshold
        rings += int(np.sum(ringing[1:] & ~ringing[:-1])) + int(ringing[:1].sum())
        samples += alarms.size
    return 1e4 * rings / max(samples, 1)
