"""The table of robustness: from stored rows alone, each disturbed cell beside its undisturbed one."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import Status
from bench.commands.main import main
from bench.config.experiment import Experiment
from bench.information.fisher import Bound
from bench.reporting.frame import Frame, Result, table_experiments
from bench.reporting.tables.robustness import COLUMNS, PANELS, lines, ratio, robustness_table
from bench.scenario.disturbance import Disturbance
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.stored import StoredCell

BOUND = Bound(("m", "c", "k"), {"k_over_m": 0.005, "c_over_m": 0.035}, {}, {}, 0.0107, 0.006, ())
SIZES = {"k_over_m_error_pct": 0.5, "c_over_m_error_pct": 3.5, "rmse": 0.0107}


def stored(cell: Cell, scale: float = 1.0, covered: float = 1.0, failures: int = 0) -> StoredCell:
    """A cell as if it had run: every error ``scale`` times its bound, so the excess is ``scale``."""
    rows = []
    for i in range(cell.replicates):
        scores = {name: scale * size for name, size in SIZES.items()}
        scores["k_over_m_coverage_95"] = float(i < covered * cell.replicates)
        failed = i >= cell.replicates - failures
        rows.append(Row(i, Status.DIVERGED, "too large") if failed else Row(i, Status.OK, scores=scores))
    summary = summarise(rows, BOUND)
    return StoredCell(cell.identity, cell.description(), tuple(rows), summary, {}, {}, 1.0, {})


@pytest.fixture
def store(tmp_path: Path) -> Store:
    found = Store(tmp_path / "rows")
    found.prepare()
    return found


def results(cells: list[Cell], store: Store) -> tuple[Result, ...]:
    """Cells as the store has them."""
    return tuple(Result.of_cell(one, store.load(one.identity)) for one in cells)


def text_of(cells: list[Cell], store: Store) -> str:
    return robustness_table(Frame("robustness", "T", {}, results(cells, store)), store)["robustness.md"]


def cell(reference: Scenario, method: str, kind: str | None, n: int = 10) -> Cell:
    disturbance = Disturbance.from_dict({"kind": kind, "size": 0.05}) if kind else None
    return Cell(replace(reference, disturbance=disturbance), method, {}, n, 0, method)


def test_the_ratio_is_that_of_pairs_and_leaves_failures_out() -> None:
    errors = np.abs(np.random.default_rng(1).standard_normal(50))
    assert ratio(3.0 * errors, errors) == pytest.approx((3.0, 3.0, 3.0))
    failed = errors.copy()
    failed[::7] = math.inf
    assert ratio(failed, 2.0 * errors) == pytest.approx((0.5, 0.5, 0.5))
    assert all(map(math.isnan, ratio(np.full(50, math.inf), errors)))
    assert all(map(math.isnan, ratio(errors, np.zeros(50))))


def test_the_interval_of_the_ratio_holds_its_true_value_about_as_often_as_it_says() -> None:
    """Independent normal errors of standard deviation 1 and 1.5; 200 intervals, binomial around 0.95."""
    rng, hits = np.random.default_rng(2), 0
    for _ in range(200):
        _, low, high = ratio(1.5 * rng.standard_normal(100), rng.standard_normal(100))
        hits += low <= 1.5 <= high
    assert 0.87 <= hits / 200 <= 0.995


def test_each_line_stands_beside_its_undisturbed_value(reference: Scenario, store: Store) -> None:
    plain, hit = cell(reference, "ls", None), cell(reference, "ls", "bias")
    store.save(stored(plain, 2.0))
    store.save(stored(hit, 5.0, covered=0.4))
    data = lines(results([plain, hit], store), store)
    assert all(set(line) == set(COLUMNS) for line in data)
    by_place = {(line["disturbance"], line["metric"]): line for line in data}
    for metric in PANELS:
        line = by_place["bias", metric]
        assert line["excess"] == pytest.approx(5.0, rel=1e-5)
        assert line["excess_undisturbed"] == pytest.approx(2.0, rel=1e-5)
        assert [line[name] for name in ("ratio", "ratio_low", "ratio_high")] == pytest.approx([2.5] * 3, rel=1e-5)
        assert (line["size"], line["n"], line["n_ok"]) == (0.05, 10, 10)
    assert by_place["bias", "k_over_m_error_pct"]["coverage_95"] == pytest.approx(0.4)
    assert by_place["bias", "k_over_m_error_pct"]["coverage_95_undisturbed"] == 1.0
    assert math.isnan(by_place["bias", "rmse"]["coverage_95"])
    panels = text_of([plain, hit], store).split("## ")
    for panel in panels[1:4]:
        assert [x.strip() for x in panel.splitlines()[4].split("|")[2:4]] == ["2.00", "5.00 *"]
    assert [x.strip() for x in panels[4].splitlines()[4].split("|")[2:4]] == ["100", "40"]


def test_the_undisturbed_value_is_of_the_same_reading_of_the_start(reference: Scenario, store: Store) -> None:
    found = [cell(reference, "ls", kind) for kind in (None, "late_trigger")]
    found += [replace(c, scenario=replace(c.scenario, initial_state="unknown")) for c in found]
    for c, scale in zip(found, (1.0, 4.0, 3.0, 3.0), strict=True):
        store.save(stored(c, scale))
    own = [line for line in lines(results(found, store), store) if line["metric"] == "rmse"]
    ratios = {(line["initial_state"], line["disturbance"]): line["ratio"] for line in own}
    assert ratios["known", "late_trigger"] == pytest.approx(4.0, rel=1e-5)
    assert ratios["unknown", "late_trigger"] == pytest.approx(1.0, rel=1e-5)


def test_failures_and_cells_that_were_not_run_say_so(reference: Scenario, store: Store) -> None:
    found = [cell(reference, "ls", kind) for kind in (None, "bias", "drift")]
    store.save(stored(found[0]))
    store.save(stored(found[1], 1.0, failures=3))
    text = text_of(found, store)
    (row,) = [line for line in text.split("## ")[1].splitlines() if line.startswith("| LS")]
    assert [x.strip() for x in row.split("|")[2:5]] == ["1.00", "1.00 (7/10)", "not run"]
    assert "1 cells were not run" in text


@pytest.fixture
def _short_experiments(monkeypatch: pytest.MonkeyPatch) -> None:
    original = Experiment.content.func  # type: ignore[attr-defined]

    def shortened(self: Experiment) -> dict[str, Any]:
        described = original(self)
        return {**described, "replicates": 4, "sweep": {**described["sweep"], "method": ["oracle"]}}

    monkeypatch.setattr(Experiment, "content", property(shortened))


@pytest.mark.usefixtures("_short_experiments")
def test_the_command_finds_the_table_by_its_experiment(store: Store, tmp_path: Path) -> None:
    assert {"table2", "table3", "table4", "table5", "robustness"} <= set(table_experiments())
    cells = Experiment("robustness").cells()
    out = tmp_path / "out"
    arguments = [f"store={store.folder}", f"out={out}", f"tex={tmp_path / 'tex'}"]
    for c in cells:
        if c.scenario.disturbance is None:
            store.save(stored(c))
    assert main(["tables", *arguments]) == 0
    assert not list(out.glob("robustness*"))  # its undisturbed cells are other tables' too
    for c in cells:
        store.save(stored(c))
    assert main(["tables", *arguments]) == 0
    first = {path.name: path.read_bytes() for path in out.glob("robustness*")}
    assert set(first) == {"robustness.md", "robustness.csv"}
    assert main(["tables", *arguments]) == 0
    assert {path.name: path.read_bytes() for path in out.glob("robustness*")} == first
    written = list(csv.DictReader(io.StringIO(first["robustness.csv"].decode())))
    assert len(written) == len(cells) * len(PANELS)
    assert "python -m bench -m experiment=robustness && python -m bench tables" in first["robustness.md"].decode()
