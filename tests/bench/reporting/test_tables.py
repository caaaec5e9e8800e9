"""Tables: from stored rows alone, with every number of the paper found, and the same on every run."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bench import Status
from bench.commands.main import main
from bench.config.experiment import Experiment
from bench.errors import InputError
from bench.information.fisher import Bound
from bench.reporting.frame import Frame, Result
from bench.reporting.paper import paper_value, printed
from bench.reporting.tables.paper_tables import COLUMNS, HEADINGS, paper_table
from bench.reporting.tables.tidy import frame_page, tidy_frame
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.scoring.verdict import judge
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.stored import StoredCell

NAN = math.nan
PAPER = {
    # table: (row, method): m, c, k errors in percent, displacement RMSE; read off the printed article once more
    2: {("identified", "pinn"): (1.11, 1.13, 1.30, NAN)},
    3: {
        ("comparison", "ls"): (18.2, 36.9, 20.7, 0.119),
        ("comparison", "rls"): (13.8, 28.4, 16.5, 0.094),
        ("comparison", "ddnn"): (9.4, 18.7, 11.2, 0.047),
        ("comparison", "pinn"): (2.6, 4.8, 2.3, 0.016),
    },
    4: {
        ("1", "pinn"): (2.4, 6.1, 2.9, 0.017),
        ("2", "pinn"): (1.8, 5.6, 2.1, 0.014),
        ("3", "pinn"): (2.9, 7.4, 3.4, 0.019),
        ("4", "pinn"): (3.7, 9.2, 4.6, 0.024),
        ("5", "pinn"): (4.3, 10.8, 5.4, 0.027),
    },
    5: {
        ("40", "pinn"): (2.1, 4.2, 2.5, 0.013),
        ("30", "pinn"): (2.8, 5.6, 3.3, 0.016),
        ("20", "pinn"): (3.9, 7.8, 4.4, 0.021),
        ("10", "pinn"): (7.1, 12.9, 8.2, 0.035),
        ("5", "pinn"): (11.8, 18.7, 13.1, 0.056),
    },
}
KEYS = ("m_error_pct", "c_error_pct", "k_error_pct", "rmse")
BOUND = Bound(
    ("m", "c", "k"),
    {"m": 0.02, "c": 0.04, "k": 0.02, "k_over_m": 0.005, "c_over_m": 0.035},
    {"m": False, "c": False, "k": False, "k_over_m": True, "c_over_m": True},
    {"m": 0.999, "c": 0.25, "k": 0.95, "k_over_m": 0.001, "c_over_m": 0.001},
    0.0107,
    0.006,
    (),
)
SIZES = dict(zip(HEADINGS, (0.4, 2.8, 0.0107, 1.6, 3.0, 1.6), strict=True))


def stored(cell: Cell, scale: float = 1.0, failures: int = 0) -> StoredCell:
    """A cell as if it had run: errors half-normal in size, the last replicates failed."""
    rng = np.random.default_rng(len(cell.label) + int(cell.scenario.snr_db))
    rows = []
    for i in range(cell.replicates):
        scores = {name: scale * size * abs(float(rng.standard_normal())) for name, size in SIZES.items()}
        scores |= {"rmse_simulated": scores["rmse"], "rmse_forecast": 0.006, "realised_snr_db": 20.0}
        failed = i >= cell.replicates - failures
        rows.append(Row(i, Status.DIVERGED, "took too large a step") if failed else Row(i, Status.OK, scores=scores))
    summary = summarise(rows, BOUND)
    described = {**cell.description(), "label": cell.label}
    shares, known = dict(BOUND.prior_share), dict(BOUND.identifiable)
    return StoredCell(cell.identity, described, tuple(rows), summary, shares, known, 1.0, {})


def result(reference: Scenario, label: str, scale: float = 1.0, failures: int = 0) -> Result:
    cell = Cell(reference, label, {}, 40, 0, label)
    return Result.of_cell(cell, stored(cell, scale, failures))


def tidy(results: list[Result]) -> pd.DataFrame:
    """The lines of Table 3, as its CSV has them."""
    return pd.read_csv(io.StringIO(written(results)["table3.csv"]))


def written(results: list[Result]) -> Mapping[str, str]:
    """The files of Table 3."""
    return paper_table(Frame("table3", "Title", {"number": 3}, tuple(results)))


def three(reference: Scenario) -> list[Result]:
    """An oracle, a method about as good, and one that is far off."""
    return [result(reference, name, scale) for name, scale in (("oracle", 1.0), ("pinn", 1.2), ("ls", 9.0))]


def test_the_papers_59_numbers_are_all_found() -> None:
    labels = {"ls": ["ls"], "rls": ["rls"], "ddnn": ["ddnn"], "pinn": ["pinn", "pinn_adam"]}
    found = 0
    for table, rows in PAPER.items():
        for (row, method), values in rows.items():
            for key, value in zip(KEYS, values, strict=True):
                for label in labels[method]:
                    ours = paper_value(table, row, label, key)
                    assert ours == value or (math.isnan(ours) and math.isnan(value)), (table, row, label, key)
                found += not math.isnan(value)
    assert found == 59
    assert len(printed()) == 59


@pytest.mark.parametrize(
    ("table", "row", "method", "metric"),
    [
        (3, "comparison", "oracle", "rmse"),
        (3, "comparison", "pinn", "k_over_m_error_pct"),
        (2, "identified", "ls", "m_error_pct"),
        (2, "identified", "pinn", "rmse"),
        (5, "25", "pinn", "rmse"),
        (4, "6", "pinn", "rmse"),
    ],
)
def test_what_the_paper_does_not_say_is_nan(table: int, row: str, method: str, metric: str) -> None:
    assert math.isnan(paper_value(table, row, method, metric))


def test_tidy_has_a_line_a_metric_with_the_bound_and_the_papers_number(reference: Scenario) -> None:
    found = three(reference)
    data = tidy(found)
    assert tuple(data.columns) == COLUMNS
    assert set(data.method) == {"bound", "oracle", "pinn", "ls"}
    lines = data.set_index(["method", "metric"])
    assert lines.loc[("bound", "rmse")].bound == 0.0107
    assert math.isnan(lines.loc[("bound", "rmse")]["median"])
    assert (data.method == "bound").sum() == len(set(data[data.method == "bound"].metric))  # once, not once a method
    pinn = found[1].stored
    assert pinn is not None
    line = lines.loc[("pinn", "rmse")]
    assert line["median"] == pytest.approx(np.median([row.scores["rmse"] for row in pinn.rows]), rel=1e-5)
    assert (line.n_ok, line.n, line.paper, line.initial_state, line.snr_db) == (40, 40, 0.016, "known", 20.0)
    assert "realised_snr_db" not in set(data.metric)


def test_each_number_of_the_paper_has_the_verdict_of_judge_and_nothing_else_has_one(reference: Scenario) -> None:
    found = three(reference)
    lines = tidy(found).set_index(["method", "metric"])
    with_verdict = lines[lines.verdict.fillna("").astype(bool)]
    assert set(with_verdict.index) == {(method, key) for method in ("pinn", "ls") for key in KEYS}
    assert lines.loc[("pinn", "m_error_pct")].verdict == "not decidable (100 % prior)"
    assert lines.loc[("pinn", "k_error_pct")].verdict == "not decidable (95 % prior)"
    errors = {
        name: np.array([row.scores["rmse"] for row in e.stored.rows])  # type: ignore[union-attr]
        for name, e in zip(("oracle", "pinn", "ls"), found, strict=True)
    }
    for method in ("pinn", "ls"):
        paper = PAPER[3][("comparison", method)][3]
        assert lines.loc[(method, "rmse")].verdict == judge(paper, errors[method], errors["oracle"], 0.0).text


def test_without_an_oracle_there_is_no_verdict(reference: Scenario) -> None:
    lines = tidy([result(reference, "pinn")]).set_index(["method", "metric"])
    assert lines.loc[("pinn", "rmse")].verdict == "no oracle stored"


def test_a_cell_that_was_not_run_is_a_row_that_says_so(reference: Scenario) -> None:
    missing = Result.of_cell(Cell(reference, "rls", {}, 40, 0, "rls"), None)
    found = [result(reference, "oracle"), missing]
    data = tidy(found)
    lines = data[data.method == "rls"]
    assert set(lines.metric) == set(HEADINGS)
    assert set(lines.verdict) == {"not run"}
    text = written(found)["table3.md"]
    (row,) = [line for line in text.splitlines() if line.startswith("| RLS")]
    assert "not run" in row
    assert "1 cells were not run" in text


def test_failures_stand_in_the_table_with_their_reason(reference: Scenario) -> None:
    found = [result(reference, "oracle"), result(reference, "ls", 3.0, failures=25)]
    data = tidy(found)
    text = written(found)["table3.md"]
    (row,) = [line for line in text.splitlines() if line.startswith("| LS, finite differences") and "/40" in line]
    assert "15/40" in row
    assert "failed ×" in row  # more than half failed: the median is a failure, the excess that of the others
    assert "- 25 × LS, finite differences: diverged, took too large a step" in text
    oracle, ls = ([row.scores.get("rmse", math.inf) for row in e.stored.rows] for e in found if e.stored)
    verdict = data[(data.method == "ls") & (data.metric == "rmse")].verdict.iloc[0]
    assert verdict == judge(0.119, np.array(ls), np.array(oracle), 0.0).text
    assert verdict != judge(0.119, np.array(ls)[np.isfinite(ls)], np.array(oracle), 0.0).text


@pytest.fixture
def _short_experiments(monkeypatch: pytest.MonkeyPatch) -> None:
    """The four experiments with two methods and 30 replicates."""
    original = Experiment.content.func  # type: ignore[attr-defined]

    def shortened(self: Experiment) -> dict[str, Any]:
        described = original(self)
        sweep = {**described["sweep"], "method": ["prior", "oracle"]}
        return {**described, "replicates": 30, "sweep": sweep, "also": []}

    monkeypatch.setattr(Experiment, "content", property(shortened))


@pytest.fixture
def small_store(tmp_path: Path, _short_experiments: None) -> Store:
    """All cells of the short experiments but for one that was not run."""
    store = Store(tmp_path / "rows")
    store.prepare()
    for name in ("table2", "table3", "table4", "table5"):
        for cell in Experiment(name).cells():
            scenario = cell.scenario
            if not (scenario.label == "table4_5" and cell.method == "oracle" and scenario.initial_state == "known"):
                store.save(stored(cell))
    return store


def test_the_command_writes_every_table_in_three_forms_the_same_each_time(small_store: Store, tmp_path: Path) -> None:
    out, tex = tmp_path / "out", tmp_path / "tex"

    def made() -> dict[str, bytes]:
        assert main(["tables", f"store={small_store.folder}", f"out={out}", f"tex={tex}"]) == 0
        assert {path.suffix for path in tex.iterdir()} == {".tex"}
        return {path.name: path.read_bytes() for path in (*out.iterdir(), *tex.iterdir())}

    first = made()
    assert {path.suffix for path in out.iterdir()} == {".md", ".csv"}
    assert set(first) == {f"table{i}.{ending}" for i in (2, 3, 4, 5) for ending in ("md", "csv", "tex")}
    assert made() == first
    for i in (2, 3, 4, 5):
        lines = list(csv.reader(io.StringIO(first[f"table{i}.csv"].decode())))
        assert tuple(lines[0]) == COLUMNS
        assert {len(line) for line in lines} == {len(COLUMNS)}
        text = first[f"table{i}.md"].decode()
        assert text.index("Initial state known") < text.index("Initial state unknown")
        assert f"python -m bench -m experiment=table{i} && python -m bench tables" in text
        assert str(tmp_path) not in text
        printed = first[f"table{i}.tex"].decode()
        assert printed.count("\\begin{tabular}") == printed.count("\\end{tabular}") == 2
        assert "×" not in printed
        assert not re.search(r"(?<!\\)%(?! needs| regenerate)", printed)
    rows5 = list(csv.DictReader(io.StringIO(first["table5.csv"].decode())))
    snrs, told, methods = ("40", "30", "20", "10", "5"), ("known", "unknown"), ("bound", "prior", "oracle")
    found = {(line["row"], line["initial_state"], line["method"]) for line in rows5}
    assert found == {(snr, start, method) for snr in snrs for start in told for method in methods}
    rows4 = list(csv.DictReader(io.StringIO(first["table4.csv"].decode())))
    not_run = [line for line in rows4 if line["verdict"] == "not run"]
    assert {line["metric"] for line in not_run} == set(HEADINGS)
    assert {(line["row"], line["initial_state"], line["method"]) for line in not_run} == {("5", "known", "oracle")}


@pytest.mark.usefixtures("_short_experiments")
def test_a_table_without_any_cell_is_not_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    assert main(["tables", f"store={tmp_path / 'empty'}", f"out={tmp_path / 'out'}", f"tex={tmp_path / 'tex'}"]) == 2
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []
    assert "no cell is there; run python -m bench -m experiment=table5 first" in capsys.readouterr().err


@pytest.mark.parametrize("bad", ["store=nowhere", "stor=x", "out=", "x"])
def test_bad_input_is_one_line(bad: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tables", bad]) == 2
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert err.startswith("bench: ")


def test_one_scenario_at_two_starts_has_two_bounds(reference: Scenario) -> None:
    known = result(reference, "oracle")
    cell = Cell(replace(reference, initial_state="unknown"), "oracle", {}, 40, 0, "oracle")
    data = tidy([known, Result.of_cell(cell, stored(cell))])
    bounds = data[(data.method == "bound") & (data.metric == "rmse")]
    assert list(bounds.initial_state) == ["known", "unknown"]


def test_the_frame_of_everything_holds_ties_verdicts_and_states() -> None:
    """The best by errors ten times smaller stands alone, and the oracle competes with nobody."""
    cells = [cell for cell in Experiment("table3").cells() if cell.scenario.initial_state == "known"]
    scale = {"ls": 0.1, "rls": 1.0, "oracle": 0.01}
    results = [Result.of_cell(cell, stored(cell, scale[cell.label]) if cell.label in scale else None) for cell in cells]
    frame = tidy_frame([Frame("table3", "Comparison", {"number": 3}, tuple(results))])
    lines = frame.set_index(["method", "metric"])
    assert [bool(lines.tied[name, "k_over_m_error_pct"]) for name in ("ls", "rls", "oracle")] == [True, False, False]
    assert lines.paper["rls", "m_error_pct"] == 13.8
    assert lines.verdict["rls", "m_error_pct"] == "not decidable (100 % prior)"
    assert lines.state["pinn", ""] == "missing"
    assert lines.state["ls", "rmse"] == "stale"  # its cell says nothing of versions
    assert lines.excess["ls", "rmse"] == pytest.approx(results[[c.label for c in cells].index("ls")].excess("rmse"))
    page = frame_page(frame, "k_over_m_error_pct")
    assert [line.split()[0] for line in page.splitlines() if " + " in line] == ["ls"]
    with pytest.raises(InputError, match="metric"):
        frame_page(frame, "mass")
