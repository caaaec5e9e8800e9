"""Progress of a run and its estimated time, against simulated sweeps."""

from __future__ import annotations

import heapq
import io
import math
import re
import sys
from dataclasses import replace

import pytest
from conftest import Plugins, StoreFactory

from bench.engine import progress as bars
from bench.engine.plan import plan
from bench.engine.pool import Limits
from bench.engine.progress import Progress, RunState, first_of_each_kind_first, progress_bar
from bench.engine.runner import run_cells
from bench.entrants.registry import default_settings
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell

START_S, FIT_S, REPLICATES = 0.4, {"ls": 0.02, "mcmc": 2.0}, 10
"""Start-up time of a cell (s), time of a fit by method (s) and fits per cell of the simulated sweeps."""
ORDERS = {
    "ls first": [*("ls",) * 8, *("mcmc",) * 8],
    "mcmc first": [*("mcmc",) * 8, *("ls",) * 8],
    "mixed": [*("ls", "mcmc") * 8],
}


def progress_of(methods: list[str], n: int = REPLICATES, workers: int = 2) -> Progress:
    """Return the progress of cells of ``n`` fits each by these methods; the keys are their indices."""
    keys = [str(i) for i in range(len(methods))]
    kinds = {key: (method, "sdof") for key, method in zip(keys, methods, strict=True)}
    return Progress("fit", dict.fromkeys(keys, n), kinds, workers, "cell")


def course(methods: list[str]) -> list[tuple[float, str, float]]:
    """Return end time, cell and duration of each fit, if each of two workers takes the next cell when it is free."""
    free, events = [0.0, 0.0], []
    for i, method in enumerate(methods):
        now = heapq.heappop(free)
        for replicate in range(REPLICATES):
            seconds = FIT_S[method] + (START_S if replicate == 0 else 0.0)
            now += seconds
            events.append((now, str(i), seconds))
        heapq.heappush(free, now)
    return sorted(events)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("share", [0.25, 0.75])
def test_the_estimated_time_left_is_within_a_factor_of_two(order: str, share: float) -> None:
    """The costs of the methods differ by a factor of 100; the estimate is made after a share of the time."""
    methods = first_of_each_kind_first(ORDERS[order], lambda method: method)
    progress, events = progress_of(methods), course(methods)
    end = events[-1][0]
    for now, key, seconds in events:
        look = progress.add(key, 1, seconds)
        if now >= share * end:
            break
    assert not look.at_least
    assert 0.5 * (end - now) <= look.seconds_left <= 2.0 * (end - now)
    if order == "ls first" and share == 0.25:  # equal costs per fit would give less than half
        assert now * (look.total - look.done) / look.done < 0.5 * (end - now)


def test_unknown_costs_are_not_guessed() -> None:
    progress = progress_of(["ls", "mcmc"], 4, workers=1)
    begin = progress.state()
    assert (math.isnan(begin.seconds_left), begin.at_least, begin.done, begin.total) == (True, True, 0, 8)
    look = progress.add("0", 1, 3.0)
    assert (look.seconds_left, look.at_least) == (9.0, True)  # three more fits
    look = progress.add("1", 1, 10.0)
    assert (look.seconds_left, look.at_least) == (39.0, False)


def test_the_cost_of_the_first_is_left_out_once_there_is_a_second() -> None:
    """The first bound of a system includes compilation."""
    systems = ["duffing", "sdof", "duffing", "duffing", "sdof"]
    keys = list("01234")
    progress = Progress(
        "bound", dict.fromkeys(keys, 1), {key: (name, "") for key, name in zip(keys, systems, strict=True)}
    )
    looks = [progress.state(), *(progress.add(str(i), 1, took) for i, took in enumerate((20.0, 1.0, 2.0, 4.0)))]
    shown = [(look.done, None if math.isnan(look.seconds_left) else look.seconds_left, look.at_least) for look in looks]
    assert shown == [(0, None, True), (1, 40.0, True), (2, 41.0, False), (3, 3.0, False), (4, 1.0, False)]


FITS = RunState("fit", 9, 40, "ls 20 dB", 100.0, False, "2/8 cells, 3 failed")


@pytest.mark.parametrize(
    ("state", "since", "text"),
    [
        (FITS, 0.0, "about 1.7 min left"),
        (FITS, 40.0, "about 60 s left"),
        (FITS, 101.0, "longer than expected"),
        (replace(FITS, seconds_left=math.nan, at_least=True), 0.0, "time left not known yet"),
    ],
)
def test_the_time_left_decreases_and_comes_first(state: RunState, since: float, text: str) -> None:
    """A narrow terminal shows only the beginning."""
    assert state.words(since, 30.0) == f"{text}, 2/8 cells, 3 failed, 9/40 fits, 30 s so far, ls 20 dB"
    assert RunState("bound", 4, 4, "sdof", 0.0, False).words(0.0, 12.0) == "4/4 bounds, in 12 s"


def test_a_run_shows_its_bounds_and_then_all_its_fits(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a terminal there is a line from time to time, and one at the end of each stage."""
    monkeypatch.setattr(bars, "LINE_S", 0.0)
    monkeypatch.setattr("sys.stderr", io.StringIO())
    plugins("Wrong")
    store, looks = new_store(), list[RunState]()
    settings = {**default_settings("wrong"), "kind": "raise"}
    louder = replace(reference, snr_db=19.0)  # a scenario whose bound is not stored
    cells = [Cell(louder, "wrong", settings, 3, 0, "wrong"), Cell(louder, "prior", {}, 4, 0, "prior")]
    with progress_bar() as show:
        run_cells(plan(cells, store), store, Limits(1, 60.0, 2000.0), lambda look: (looks.append(look), show(look)))
        lines = sys.stderr.getvalue().splitlines()  # type: ignore[attr-defined]
    units = [look.unit for look in looks]
    assert units == sorted(units)  # bounds come before fits
    bound, fit = (next(look for look in reversed(looks) if look.unit == unit) for unit in ("bound", "fit"))
    assert (bound.done, bound.total) == (1, 1)
    assert (fit.done, fit.total, fit.note, fit.seconds_left) == (7, 7, "2/2 cells, 3 failed", 0.0)
    assert [line.partition(", in")[0] for line in lines if "100 %" in line] == [
        "bench: bounds 100 %, 1/1 bounds", "bench: fits 100 %, 2/2 cells, 3 failed, 7/7 fits",
    ]  # fmt: skip
    assert re.search(r"\nbench: fits \d+ %, (about|at least|time left) .* so far", "\n".join(lines))
