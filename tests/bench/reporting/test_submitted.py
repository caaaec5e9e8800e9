"""A submitted method stands in the tables of which it has every scenario, with its mark; others do not."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from stored import BOUND, scored

from bench.commands.main import main
from bench.config.experiment import Experiment
from bench.reporting.frame import experiment_frame, stored_results, submitted_results, with_submitted
from bench.reporting.labels import title
from bench.reporting.tables.leaderboard import leaderboard
from bench.scoring.summary import summarise
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.stored_cell import StoredCell

METHOD = "srivc"  # registered, and not one of those that Table 4 asks for


def keep(store: Store, cells: list[Cell], method: str = METHOD) -> None:
    for cell in cells:
        rows = scored(cell.identity, 10)
        what = {**cell.description(), "method": method, "label": method, "system": cell.scenario.label, "sigma": [0.05],
                "snr_db": cell.scenario.snr_db, "initial_state": cell.scenario.initial_state}  # fmt: skip
        summary = summarise(rows, BOUND)
        told = {"k_over_m": True, "c_over_m": True}
        stored = StoredCell(cell.identity, what, tuple(rows), summary, {}, told, 1.0)
        store.save(stored.marked({"by": "somebody"}))


def cells() -> list[Cell]:
    return Experiment("table4").cells({"method": [METHOD]})


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "rows")
    store.prepare()
    return store


@pytest.mark.slow
def test_a_method_with_every_scenario_stands_in_the_table_and_is_marked(store: Store, tmp_path: Path) -> None:
    keep(store, cells())
    assert main(["tables", f"store={store.folder}", f"out={tmp_path / 'out'}", f"tex={tmp_path / 'tex'}"]) == 0
    name = title(METHOD) + " (submitted)"
    assert name in (tmp_path / "out" / "table4.md").read_text(encoding="utf-8")
    assert f"{METHOD} (submitted)" in (tmp_path / "out" / "table4.csv").read_text(encoding="utf-8")


def test_a_method_that_lacks_a_scenario_does_not(store: Store) -> None:
    keep(store, cells()[:-1])
    frame = experiment_frame("table4", store)
    submitted = submitted_results(store)
    assert len(submitted) == len(cells()) - 1
    assert with_submitted(frame, submitted).results == frame.results


@pytest.mark.slow
def test_a_method_that_is_not_installed_here_stands_in_the_leaderboard(store: Store, tmp_path: Path) -> None:
    """Whoever clones the repository has its cells in the archive, and not its package."""
    keep(store, Experiment("open").cells({"method": ["era"], "method.bootstrap": [7]}), "elsewhere")
    shown = with_submitted(experiment_frame("open", store), submitted_results(store))
    assert re.search(r"\| 1 +\| elsewhere \(submitted\) +\|", leaderboard(shown)["leaderboard.md"])
    assert "elsewhere (submitted): submitted; its verification" in leaderboard(shown)["leaderboard.md"]


def test_a_store_may_state_anything_of_a_verification(store: Store) -> None:
    keep(store, cells()[:1])
    (found,) = stored_results(store)
    assert found.stored
    facts = {"rows_compared": 5, "of_rows": 24, "missed_5_percent": 0.791}
    said = "submitted; 5 of its 24 rows were recomputed when it was merged, with the same result"
    missed = f"{said} (a change of 5 % of the rows is missed with probability 0.79)"
    for stated, line in (
        (facts, missed),
        ({**facts, "missed_5_percent": "<script>"}, said),
        ({**facts, "rows_compared": "<script>"}, "submitted; its verification is not recorded"),
    ):
        assert replace(found, stored=found.stored.marked(stated)).verification == line
