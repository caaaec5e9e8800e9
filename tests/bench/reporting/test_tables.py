"""Tables: numbers of stored rows that follow by hand, every number of the paper, and the same files on every run."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from sites import BOUND

from bench import Status
from bench.commands.main import main
from bench.config.experiment import Experiment, expand
from bench.errors import InputError
from bench.reporting.frame import ERROR, Frame, Result, computed
from bench.reporting.paper import paper_number, printed
from bench.reporting.residuals import coloured, residuals
from bench.reporting.tables import estimates
from bench.reporting.tables.pooling import identified, pooled_coverage, pooled_excess
from bench.reporting.tables.systems import SYSTEMS, describe, system_lines
from bench.reporting.tables.tidy import frame_page, tidy_frame
from bench.scenario.disturbance import Disturbance
from bench.scenario.model_error import SecondMode
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.scoring.verdict import judge
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.stored_cell import StoredCell

PRINTED = {
    # (table, row, method): m, c, k errors in percent, displacement RMSE; read off the printed article once more
    (2, "identified", "pinn"): (1.11, 1.13, 1.30, math.nan),
    (3, "comparison", "ls"): (18.2, 36.9, 20.7, 0.119), (3, "comparison", "rls"): (13.8, 28.4, 16.5, 0.094),
    (3, "comparison", "ddnn"): (9.4, 18.7, 11.2, 0.047), (3, "comparison", "pinn"): (2.6, 4.8, 2.3, 0.016),
    (4, "1", "pinn"): (2.4, 6.1, 2.9, 0.017), (4, "2", "pinn"): (1.8, 5.6, 2.1, 0.014),
    (4, "3", "pinn"): (2.9, 7.4, 3.4, 0.019), (4, "4", "pinn"): (3.7, 9.2, 4.6, 0.024),
    (4, "5", "pinn"): (4.3, 10.8, 5.4, 0.027), (5, "40", "pinn"): (2.1, 4.2, 2.5, 0.013),
    (5, "30", "pinn"): (2.8, 5.6, 3.3, 0.016), (5, "20", "pinn"): (3.9, 7.8, 4.4, 0.021),
    (5, "10", "pinn"): (7.1, 12.9, 8.2, 0.035), (5, "5", "pinn"): (11.8, 18.7, 13.1, 0.056),
}  # fmt: skip
KEYS = ("m_error_pct", "c_error_pct", "k_error_pct", "rmse")
SIZES = dict(zip(estimates.HEADINGS, (0.5, 3.5, 0.0107, 1.6, 3.0, 1.6), strict=True))


def stored(cell: Cell, scores: Sequence[Mapping[str, float]], failures: int = 0) -> StoredCell:
    """A cell as if it had run, with these scores and some failures behind them."""
    rows = [Row(i, Status.OK, scores=dict(own)) for i, own in enumerate(scores)]
    rows += [Row(len(rows) + i, Status.DIVERGED, "lost") for i in range(failures)]
    described = {**cell.description(), "label": cell.label}
    told = dict(BOUND.prior_share), dict(BOUND.identifiable)
    return StoredCell(cell.identity, described, tuple(rows), summarise(rows, BOUND), *told, 1.0, {})


def normal(cell: Cell, scale: float = 1.0, failures: int = 0) -> Result:
    """A cell whose errors are half-normal in size."""
    rng = np.random.default_rng(len(cell.label) + int(cell.scenario.snr_db))
    sizes = np.abs(rng.standard_normal((cell.replicates - failures, len(SIZES)))) * list(SIZES.values()) * scale
    scores = [dict(zip(SIZES, own, strict=True)) for own in sizes.tolist()]
    return Result.of_cell(cell, stored(cell, scores, failures))


def asked(scenario: Scenario, method: str, n: int = 40) -> Cell:
    return Cell(scenario, method, {}, n, 0, method)


def written(table: Any, name: str, results: Sequence[Result], **facts: Any) -> tuple[str, list[dict[str, str]]]:
    """The page and the CSV's lines of a table of results."""
    files = table.files(Frame(name, "Title", facts, tuple(results)))
    name = f"table{facts['number']}" if "number" in facts else name
    return files[f"{name}.md"], list(csv.DictReader(io.StringIO(files[f"{name}.csv"])))


def row_of(text: str, name: str) -> list[str]:
    """The texts of the first row of a method."""
    (line, *_) = [line for line in text.splitlines() if line.startswith(f"| {name}")]
    return [cell.strip() for cell in line.split("|")[2:-1]]


# ---- Tables 2 to 5


def test_the_papers_59_numbers_are_all_found_and_no_others() -> None:
    for place, values in PRINTED.items():
        found = [paper_number(*place, key) for key in KEYS]
        np.testing.assert_equal([number.value if number else math.nan for number in found], values)
    assert len(printed()) == sum(math.isfinite(value) for values in PRINTED.values() for value in values) == 59
    assert paper_number(3, "comparison", "pinn_adam", "rmse").value == 0.016  # type: ignore[union-attr]
    for place in ((3, "comparison", "oracle"), (2, "identified", "ls"), (5, "25", "pinn"), (4, "6", "pinn")):
        assert paper_number(*place, "rmse") is None


def test_a_table_of_the_paper_has_bounds_numbers_and_the_verdicts_of_judge(reference: Scenario) -> None:
    found = [normal(asked(reference, name), scale) for name, scale in (("oracle", 1.0), ("pinn", 1.2), ("ls", 9.0))]
    found += [normal(asked(reference, "rls"), 3.0, failures=25), Result.of_cell(asked(reference, "sindy"), None)]
    text, data = written(estimates.PAPER, "table3", found, number=3)
    lines = {(line["method"], line["metric"]): line for line in data}
    assert len(lines) == len(data)  # the bound once, not once a method
    assert (lines["bound", "rmse"]["bound"], lines["bound", "rmse"]["median"]) == ("0.0107", "")
    errors = {result.label: result.errors("rmse") for result in found}
    pinn = lines["pinn", "rmse"]
    assert float(pinn["median"]) == pytest.approx(np.median(errors["pinn"]), rel=1e-5)
    assert [pinn[name] for name in ("n_ok", "n", "paper", "snr_db")] == ["40", "40", "0.016", "20"]
    judged = {place for place, line in lines.items() if line["verdict"] and place[0] != "sindy"}
    assert judged == {(method, key) for method in ("pinn", "ls", "rls") for key in KEYS}
    assert lines["pinn", "m_error_pct"]["verdict"] == "not decidable (100 % prior)"
    for method in ("pinn", "ls", "rls"):  # failures are infinite errors
        paper = PRINTED[3, "comparison", method][3]
        assert lines[method, "rmse"]["verdict"] == judge(paper, errors[method], errors["oracle"], 0.0).text
    assert {line["verdict"] for line in data if line["method"] == "sindy"} == {"not run"}
    assert row_of(text, "SINDy")[-1] == "not run"
    assert row_of(text, "RLS")[-1] == "15/40"
    assert row_of(text, "RLS")[0].startswith("failed ×")  # the median is a failure, the excess that of the others
    assert "- 25 × RLS: diverged, lost\n- 1 cells were not run" in text
    without_oracle = written(estimates.PAPER, "table3", found[1:2], number=3)[1]
    assert {line["verdict"] for line in without_oracle if line["metric"] == "rmse"} == {"", "no oracle stored"}


def test_the_frame_of_everything_holds_ties_verdicts_and_states() -> None:
    """The best by errors ten times smaller stands alone, and the oracle competes with nobody."""
    cells = [cell for cell in Experiment("table3").cells() if cell.scenario.initial_state == "known"]
    scale = {"ls": 0.1, "rls": 1.0, "oracle": 0.01}
    results = [normal(cell, scale[cell.label]) if cell.label in scale else Result.of_cell(cell, None) for cell in cells]
    frame = tidy_frame([Frame("table3", "Comparison", {"number": 3}, tuple(results))])
    lines = frame.set_index(["method", "metric"])
    assert [bool(lines.tied[name, "k_over_m_error_pct"]) for name in ("ls", "rls", "oracle")] == [True, False, False]
    assert lines.paper["rls", "m_error_pct"] == 13.8
    assert lines.state["pinn", ""] == "missing"
    assert lines.state["ls", "rmse"] == "stale"  # its cell says nothing of versions
    page = frame_page(frame, "k_over_m_error_pct")
    assert [line.split()[0] for line in page.splitlines() if " + " in line] == ["ls"]
    with pytest.raises(InputError, match="metric"):
        frame_page(frame, "mass")


# ---- calibration, wrong models, disturbances


def test_honest_and_halved_uncertainties_are_told_apart(reference: Scenario) -> None:
    """Half the standard deviation doubles every normal score: inside 1.96 is then inside 0.98, which 67 % are."""
    even = (np.arange(200) + 0.5) / 200
    levels = {"shooting": even, "pinn": stats.norm.cdf(2.0 * stats.norm.ppf(even)), "ls": np.array([0.5, *[0.999] * 9])}
    levels["rls"] = (np.arange(10) + 0.5) / 10
    cells = {name: asked(reference, name, own.size) for name, own in levels.items()}
    scores = {name: [{"k_over_m_pit": v, "band_inside_95": 0.9} for v in own.tolist()] for name, own in levels.items()}
    found = tuple(Result.of_cell(cell, stored(cell, scores[name])) for name, cell in cells.items())
    lines = {
        (one["method"], one["quantity"]): one
        for one in estimates.calibration_lines(Frame("calibration", "T", {}, found))
    }
    honest, halved, few, few_honest = (lines[name, "k_over_m"] for name in levels)
    assert (honest["verdict"], honest["coverage_95"]) == ("calibrated", pytest.approx(0.95))
    assert "overconfident" in halved["verdict"]
    assert (halved["rms_z"], halved["coverage_95"]) == (pytest.approx(2.0, rel=0.02), pytest.approx(0.67, abs=0.01))
    assert (few["coverage_95"], few["verdict"], few["n"]) == (0.1, "overconfident, biased downwards", 10)
    assert few_honest["verdict"] == "-"  # ten are not enough to call it calibrated
    assert lines["pinn", "c_over_m"]["verdict"] == "-"
    assert row_of(written(estimates.CALIBRATION, "calibration", found)[0], "PINN")[-2:] == ["90.0", "200"]


def test_a_wrong_model_has_its_bias_coverage_and_what_was_said(reference: Scenario) -> None:
    """Ratios of 1.1, 1.3 and 0.9: 10 % too large on average; one interval of three right, one fit of four failed."""
    assert reference.prior is not None
    scenarios = (
        reference, replace(reference, disturbance=SecondMode(0.1)),
        replace(reference, prior=replace(reference.prior, wrong=True)),
    )  # fmt: skip
    cells = [asked(scenario, "ls", 4) for scenario in scenarios]
    scores = [{"k_over_m_ratio": value, "k_over_m_coverage_95": float(value > 1.2)} for value in (1.1, 1.3, 0.9)]
    found = tuple(Result.of_cell(cell, stored(cell, scores, failures=1)) for cell in cells)
    line = estimates.misspecified_lines(Frame("misspecified", "T", {}, found))[3]
    assert (line["wrong"], line["quantity"], line["said"]) == ("second_mode", "k_over_m", 0.25)
    assert (line["bias_pct"], line["coverage_95"]) == (pytest.approx(10.0), pytest.approx(1 / 3))
    text, _ = written(estimates.MISSPECIFIED, "misspecified", found)
    headings = [line.split(";")[0] for line in text.splitlines() if line.startswith("## ")]
    assert headings == [f"## Wrong: {what}" for what in ("nothing", "second mode", "wrong prior")]
    assert estimates.MISSPECIFIED.files(Frame("misspecified", "T", {}, found[:1])) == {}


def test_residuals_of_a_wrong_answer_are_coloured_and_those_of_the_truth_are_not(reference: Scenario) -> None:
    """At 40 dB: k/m right, and 10 % off; the response by the closed form must leave what the data leave."""
    scenario = replace(reference, snr_db=40.0)
    cells = {ratio: asked(scenario, method, 20) for ratio, method in ((1.0, "ls"), (1.1, "rls"))}
    scores = {ratio: [{"k_over_m_ratio": ratio, "c_over_m_ratio": 1.0}] * 20 for ratio in cells}
    right, off = (Result.of_cell(cell, stored(cell, scores[ratio])) for ratio, cell in cells.items())
    found = coloured([right, off])
    assert found[right.identity].mean() <= 0.25
    assert np.all(found[off.identity])
    channel = scenario.replicates(0, 1)[0][0].records[0].channels[0]
    basis = np.stack([closed_form(scenario.parameters, *start, channel.times) for start in np.eye(2)], axis=1)
    best = np.linalg.lstsq(basis, channel.values, rcond=None)[0]
    left, start = residuals(channel.times, channel.values[None], np.array([[8.0, 0.4]]))
    np.testing.assert_allclose(start[0], best, atol=1e-9)
    np.testing.assert_allclose(left[0], channel.values - basis @ best, atol=1e-9)


def test_the_ratio_is_that_of_pairs_and_its_interval_holds_it_as_often_as_it_says() -> None:
    """Independent normal errors of standard deviation 1 and 1.5; 200 intervals, binomial around 0.95."""
    errors = np.abs(np.random.default_rng(1).standard_normal(50))
    failed = np.where(np.arange(50) % 7, errors, math.inf)
    assert estimates.ratio(failed, 2.0 * errors) == pytest.approx((0.5, 0.5, 0.5))
    assert np.isnan([estimates.ratio(np.full(50, math.inf), errors), estimates.ratio(errors, np.zeros(50))]).all()
    rng = np.random.default_rng(2)
    ends = [estimates.ratio(1.5 * rng.standard_normal(100), rng.standard_normal(100))[1:] for _ in range(200)]
    assert 0.87 <= np.mean([low <= 1.5 <= high for low, high in ends]) <= 0.995


def test_a_disturbed_cell_stands_beside_its_undisturbed_one(reference: Scenario) -> None:
    """Errors 2 and 5 times the bound, known start; 1 and 1 times, unknown start; intervals right in 4 of 10."""
    hit = Disturbance.from_dict({"kind": "bias", "size": 0.05})
    sizes = {(None, "known"): 2.0, (hit, "known"): 5.0, (None, "unknown"): 1.0, (hit, "unknown"): 1.0}
    found = []
    for (disturbance, start), scale in sizes.items():
        cell, failed = (
            asked(replace(reference, disturbance=disturbance, initial_state=start), "ls", 10),
            3 * (scale == 1),
        )
        sizes_of = {name: scale * size for name, size in SIZES.items()}
        scores = [{**sizes_of, "k_over_m_coverage_95": float(i < 4)} for i in range(10 - failed)]
        found.append(Result.of_cell(cell, stored(cell, scores, failed)))
    found.append(Result.of_cell(asked(replace(reference, disturbance=SecondMode(0.1)), "ls", 10), None))
    lines = estimates.robustness_lines(Frame("robustness", "T", {}, tuple(found)))
    line = next(one for one in lines if (one["disturbance"], one["metric"]) == ("bias", "k_over_m_error_pct"))
    numbers = [line[name] for name in ("excess", "excess_undisturbed", "ratio", "ratio_low", "coverage_95", "size")]
    assert numbers == pytest.approx([5.0, 2.0, 2.5, 2.5, 0.4, 0.05], rel=1e-5)
    text, data = written(estimates.ROBUSTNESS, "robustness", found)
    assert row_of(text, "LS") == ["2.00", "5.00 *", "1.00 (7/10)", "1.00 (7/10)", "not run"]
    assert len(data) == 3 * len(found)
    assert "1 cells were not run" in text


# ---- several systems


def cell_of(*overrides: str, method: str = "shooting") -> Cell:
    return expand([f"method={method}", *overrides], multirun=False)[0].cell()


def result(
    errors: Mapping[str, Sequence[float]], bounds: Mapping[str, float], failures: int = 0, **more: Any
) -> Result:
    """A result whose replicate i has the errors ``errors[name][i]`` (%), under the given bounds."""
    cell = more.get("cell") or cell_of("system=sdof_forced")
    scores = [
        {f"{name}_error_pct": own[i] for name, own in errors.items()}
        | {f"{name}_ratio": 1 + own[i] / 100 for name, own in errors.items()}
        | {f"{name}_coverage_95": own[i] for name, own in more.get("coverage", {}).items()}
        for i in range(len(next(iter(errors.values()))))
    ]
    made = stored(cell, scores, failures)
    whole = {"mean": 0.0, "median": 1.0, "ci_low": 0.0, "ci_high": 0.0, "excess": 1.0}
    summary = {f"{name}{ERROR}": {**whole, "bound": bound} for name, bound in bounds.items()}
    summary["rmse"] = {**whole, "bound": 0.01}
    return Result.of_cell(cell, replace(made, summary=summary, identifiable=dict.fromkeys(bounds, True)))


def test_pooling_by_hand() -> None:
    """Errors (3, 4) % over bounds (1, 1) %: sqrt((9 + 16)/2) of a replicate; over two replicates the mean square."""
    one = result({"m": [3.0, 0.0], "k": [4.0, 2.0], "c": [1.0, 1.0]}, {"m": 1.0, "k": 1.0, "c": math.inf}, failures=1,
                 coverage={"m": [1.0, 0.0], "k": [1.0, 1.0]})  # fmt: skip
    assert pooled_excess(one, ("m", "k", "c")) == pytest.approx(math.sqrt((12.5 + 2.0) / 2))  # c has no bound
    assert pooled_coverage(one, ("m", "k")) == 0.75
    assert math.isnan(pooled_coverage(one, ("c",)))


def test_parameters_from_ratios_and_from_groups() -> None:
    cell = cell_of("system=chain2")
    system, true = cell.scenario.make_system(), cell.scenario.parameters
    groups = {f"{group.name}_ratio": 1.0 for group in system.groups}
    found = identified(Result.of_cell(cell, stored(cell, [{f"{name}_ratio": 2.0 for name in system.names}, groups], 1)))
    assert {name: own[0] for name, own in found.items()} == {name: 2.0 * true[name] for name in system.names}
    assert (found["m1"][1], found["k2"][1]) == (1.0, pytest.approx(true["k2"] / true["m1"]))
    assert all(math.isnan(own[2]) for own in found.values())


def test_the_record_is_described_in_numbers() -> None:
    """Reference system: 0.45 Hz, so 4.5 periods in 10 s and 1/(0.45 * 10/24) = 5.3 samples in each."""
    text = describe(cell_of("system=sdof").scenario)
    assert "25 samples over 10 s; 4.5 periods of the slowest mode, 5.33 samples" in text
    assert "0.5 kg added" in describe(cell_of("system=sdof_added_mass").scenario)
    assert "no prior" in describe(cell_of("system=sdof_forced").scenario)


def test_a_table_of_missing_failed_and_good_cells() -> None:
    names = ["m", "c", "k", "k_over_m", "c_over_m"]
    bounds = dict.fromkeys(names, 1.0)
    nines = {name: [9.0, 9.0, 9.0] for name in names}
    found = [
        result({name: [1.0, 2.0, 1.5] for name in names}, bounds),
        result(nines, bounds, failures=2, cell=cell_of("system=sdof_forced", method="pinn")),
        Result.of_cell(cell_of("system=sdof_forced", method="ls"), None),
        Result.of_cell(cell_of("system=sdof_forced", "snr=10", method="rls"), None),
    ]
    text, _ = written(SYSTEMS, "forced", found, number=6)
    assert "- 2 × PINN: diverged, lost\n- 2 cells were not run" in text
    assert row_of(text, "Multiple shooting")[0].strip("*") == "×1.55"  # sqrt((1 + 4 + 2.25) / 3)
    assert row_of(text, "PINN")[-1] == "3/5"
    assert row_of(text, "LS, finite")[0] == "not run"
    tidy = {(line["method"], line["metric"]): line for line in system_lines(Frame("forced", "T", {}, tuple(found)))}
    assert tidy["pinn", "told_pooled"]["excess"] == pytest.approx(9.0)


def test_a_table_says_on_which_days_it_was_computed() -> None:
    days = ("2026-01-31T23:59:59+00:00", "2025-12-01T00:00:00+00:00", None)
    made = [result({"k": [1.0]}, {"k": 1.0}) for _ in days]
    dated = [
        replace(one, stored=one.stored and replace(one.stored, provenance={"started": day}))
        for one, day in zip(made, days, strict=True)
    ]
    assert computed(dated) == "Computed 2025-12-01 to 2026-01-31. "
    assert (computed(dated[:1]), computed(dated[2:])) == ("Computed 2026-01-31. ", "")


# ---- the command


@pytest.fixture
def small_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    """All cells of short experiments, with two methods and 30 replicates, but for one that was not run."""
    original = Experiment.content.func  # type: ignore[attr-defined]

    def shortened(self: Experiment) -> dict[str, Any]:
        described = original(self)
        sweep = {**described["sweep"], "method": ["prior", "oracle"]}
        return {**described, "replicates": 30, "sweep": sweep, "also": []}

    monkeypatch.setattr(Experiment, "content", property(shortened))
    store = Store(tmp_path / "rows")
    store.prepare()
    for cell in (cell for name in ("table2", "table4", "robustness") for cell in Experiment(name).cells()):
        made = normal(cell).stored
        if made and (cell.scenario.label, cell.method, cell.scenario.initial_state) != ("table4_5", "oracle", "known"):
            store.save(made)
    return store


def test_the_command_writes_every_table_the_same_each_time(small_store: Store, tmp_path: Path) -> None:
    asked = ["tables", f"store={small_store.folder}", f"out={tmp_path / 'out'}", f"tex={tmp_path / 'tex'}"]

    def made() -> dict[str, str]:
        assert main(asked) == 0
        return {path.name: path.read_text() for path in (*tmp_path.glob("out/*"), *tmp_path.glob("tex/*"))}

    first = made()
    assert {"table2.md", "table4.csv", "table4.tex", "robustness.md"} <= first.keys()
    assert made() == first
    assert str(tmp_path) not in "".join(first.values())
    rows = list(csv.reader(io.StringIO(first["table4.csv"])))
    assert tuple(rows[0]) == estimates.PAPER_COLUMNS
    assert {len(row) for row in rows} == {len(estimates.PAPER_COLUMNS)}
    not_run = {(row[1], row[3], row[5]) for row in rows if row[-1] == "not run"}
    assert not_run == {("5", "known", "oracle")}
    assert first["table4.tex"].count("\\begin{tabular}") == first["table4.tex"].count("\\end{tabular}") == 2
    assert "python -m bench -m experiment=table4 && python -m bench tables" in first["table4.md"]
