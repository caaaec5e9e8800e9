"""What pictures are drawn from: the cells of a store, those of one scenario side by side."""

from __future__ import annotations

import contextlib
import json
import zipfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.reporting.figures.style import Look, in_order, looks
from bench.store.store import Store, StoredCell

USUAL_SNR = 20.0
"""The noise level (dB) that pictures of a single one show, or the nearest there is: that of the paper's figures."""
UNUSED = ("_interval_score_pct", "_crps_pct")
Told = Literal["known", "unknown"]


class Nothing(Exception):
    """Why a picture cannot be drawn from a store: a sentence."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure of matplotlib's and the text that says what to see in it."""

    figure: Any
    caption: str


@dataclass(frozen=True, eq=False)
class Shown:
    """One stored cell; ``scores`` (n,) by name, NaN where a replicate has none. ``cpu_s`` (n,)."""

    label: str
    series: str
    settings: str
    statuses: tuple[Status, ...]
    scores: Mapping[str, np.ndarray]
    cpu_s: np.ndarray
    stored: StoredCell

    @property
    def data(self) -> dict[str, Any]:
        """What decides the data."""
        return dict(self.stored.cell["data"])

    @property
    def snr_db(self) -> float:
        return float(self.data["snr_db"])

    @property
    def told(self) -> str:
        return str(self.stored.cell["told"]["initial_state"])

    @property
    def system(self) -> str:
        return str(self.stored.cell.get("system", self.data["system"]))

    @property
    def seed(self) -> int:
        return int(self.stored.cell["seed"])

    @property
    def disturbance(self) -> str:
        """The kind of what disturbs the data; empty where nothing does."""
        return str((self.data.get("disturbance") or {}).get("kind", "")).removeprefix("none")

    @property
    def prior(self) -> Any:
        return self.stored.cell["told"]["prior"]

    @property
    def n(self) -> int:
        return len(self.statuses)

    @property
    def n_ok(self) -> int:
        return sum(status is Status.OK for status in self.statuses)

    def bound(self, metric: str) -> float:
        """The bound on the root mean square of a metric; NaN where the cell has none."""
        return float(self.stored.summary.get(metric, {}).get("bound", np.nan))

    def successful(self, name: str) -> np.ndarray:
        """A score of the replicates that succeeded and have it, shape (at most n,)."""
        values = self.scores.get(name, np.full(self.n, np.nan))
        ok = np.array([status is Status.OK for status in self.statuses])
        return np.asarray(values[ok & np.isfinite(values)])

    def errors(self, metric: str) -> np.ndarray:
        """A metric's errors, replicate by replicate; infinite where a replicate failed."""
        values = self.scores.get(metric, np.full(self.n, np.nan))
        return np.where(np.isnan(values), np.inf, values)

    def first(self, name: str) -> float:
        """The score of replicate 0, the one whose arrays are kept."""
        return float(self.scores[name][0]) if name in self.scores and self.n else float("nan")


def shown(cell: StoredCell) -> Shown:
    """A stored cell with its rows as columns."""
    names = {name for row in cell.rows for name in row.scores if not name.endswith(UNUSED)}
    scores = {name: np.array([row.scores.get(name, np.nan) for row in cell.rows]) for name in sorted(names)}
    data = {key: value for key, value in cell.cell["data"].items() if key != "snr_db"}
    series = {"data": data, "prior": cell.cell["told"]["prior"], "seed": cell.cell["seed"]}
    return Shown(
        label=str(cell.cell.get("label", cell.cell["method"])),
        series=json.dumps(series, sort_keys=True),
        settings=json.dumps(cell.cell["settings"], sort_keys=True),
        statuses=tuple(row.status for row in cell.rows),
        scores=scores,
        cpu_s=np.array([row.cpu_s for row in cell.rows]),
        stored=replace(cell, rows=()),
    )


class Gallery:
    """All cells of a store, and the look of every method among them.

    Of cells that differ in nothing but a method's settings or the number of replicates one is kept: with the settings
    that this method has most often in the store, then of most replicates.
    """

    def __init__(self, store: Store) -> None:
        self.store = store
        found = [shown(cell) for cell in store]
        often = Counter((one.label, one.settings) for one in found)
        found.sort(key=lambda one: (-often[one.label, one.settings], -one.n, one.stored.identity))
        best: dict[tuple[Any, ...], Shown] = {}
        for one in found:
            best.setdefault((one.series, one.snr_db, one.told, one.label), one)
        order = {label: i for i, label in enumerate(in_order(one.label for one in best.values()))}
        self.cells = sorted(best.values(), key=lambda one: (order[one.label], one.series, -one.snr_db, one.told))
        self.looks: dict[str, Look] = looks(order)

    def arrays(self, cell: Shown) -> dict[str, np.ndarray]:
        """The arrays kept of a cell's replicate 0, as double precision; none where they are missing."""
        with contextlib.suppress(OSError, ValueError, zipfile.BadZipFile):
            arrays = self.store.arrays(cell.stored)
            return {name: a.astype(float) if a.dtype.kind == "f" else a for name, a in arrays.items()}
        return {}

    @cached_property
    def main(self) -> list[Shown]:
        """The cells of the scenario that the store has most of, at its usual noise levels and at either start.

        A noise level with fewer than half as many methods as another is somebody's own question, not the sweep's.
        """
        cells = self.largest(self.cells)
        methods: dict[float, set[str]] = {}
        for one in cells:
            methods.setdefault(one.snr_db, set()).add(one.label)
        most = max(map(len, methods.values()))
        return [one for one in cells if 2 * len(methods[one.snr_db]) >= most]

    def largest(self, cells: Iterable[Shown]) -> list[Shown]:
        """The largest group of cells that differ in method, noise level and start alone; undisturbed before others."""
        groups: dict[str, list[Shown]] = {}
        for one in cells:
            groups.setdefault(one.series, []).append(one)
        if not groups:
            raise Nothing("no such cell is stored")
        return min(groups.values(), key=lambda own: (-len(own), bool(own[0].disturbance), own[0].series))

    def scene(self, cells: Sequence[Shown], told: Told, snr: float = USUAL_SNR) -> list[Shown]:
        """The cells at the noise level nearest to ``snr``, one a method, with the start as wanted.

        With the other start where that has more than twice as many methods.
        """
        level = min({one.snr_db for one in cells}, key=lambda own: (abs(own - snr), own))
        own = [one for one in cells if one.snr_db == level]
        wanted = [one for one in own if one.told == told]
        others = [one for one in own if one.told != told]
        return wanted if 2 * len(wanted) >= len(others) else others


def methods_only(cells: Iterable[Shown]) -> list[Shown]:
    """Without the reference rows."""
    return [one for one in cells if one.stored.cell["method"] not in REFERENCES]


def where(cell: Shown) -> str:
    """A cell's scenario in words, for captions."""
    disturbed = f", disturbance {cell.disturbance.replace('_', ' ')}" if cell.disturbance else ""
    drawn = ", truth drawn" if cell.data.get("truth") == "drawn" else ""
    return f"{cell.system}, {cell.snr_db:.4g} dB, initial state {cell.told}{disturbed}{drawn}"


def counts(cells: Iterable[Shown]) -> str:
    """How many replicates cells have, for captions."""
    numbers = sorted({one.n for one in cells})
    return f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
