"""The output of the commands: no wider than the terminal, aligned in any script, with the digits of the interval."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.commands.main import main
from bench.config.experiment import expand
from bench.contract.estimate import Status
from bench.records.intervals import StatedInterval
from bench.reporting.record_page import record_page
from bench.reporting.rounding import rounded
from bench.reporting.sweep_summary import SweepSummary
from bench.reporting.terminal import table
from bench.reporting.terminal_tables import cell_table
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.stored_cell import StoredCell


def places(line: str) -> int:
    """Return the width of a line on a screen by the Unicode database."""
    return sum(
        0 if unicodedata.combining(letter) else 2 if unicodedata.east_asian_width(letter) in "WF" else 1
        for letter in line
    )


def widest(text: str) -> int:
    return max(places(line) for line in text.splitlines())


@pytest.fixture(params=[60, 80, 200])
def terminal(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setenv("COLUMNS", str(request.param))
    return int(request.param)


@pytest.fixture(autouse=True)
def eighty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the width of the usual terminal."""
    monkeypatch.setenv("COLUMNS", "80")


def cell_of(*fields: str) -> Cell:
    return expand([*fields, "replicates=20"], multirun=False)[0].cell()


def stored_of(cell: Cell, errors: np.ndarray, excess: float = 1.0) -> StoredCell:
    """Return a stored cell whose every metric has these errors and an interval of 0.5 to 1.5 times the median."""
    quantities = [f"{q.name}_error_pct" for q in cell.scenario.make_system().quantities]
    metrics = [*quantities, "rmse", "rmse_simulated", "rmse_forecast"]
    rows = tuple(
        Row(i, Status.OK if math.isfinite(e) else Status.DIVERGED, "", dict.fromkeys(metrics, float(e)), 0.1)
        for i, e in enumerate(errors)
    )
    median = float(np.median(errors))
    line = {"mean": median, "median": median, "ci_low": 0.5 * median, "ci_high": 1.5 * median, "bound": 0.123456}
    summary = {metric: {**line, "excess": excess} for metric in metrics}
    return StoredCell(cell.identity, {}, rows, summary, {}, {"m": False}, 2.0)


@pytest.mark.parametrize(
    ("value", "low", "high", "texts"),
    [
        # half the width 0.078 has two digits in the third decimal; 281 in the tens; 0.0996 is 0.10, so two decimals
        (7.92551, 7.84717, 8.00385, ("7.926", "7.847", "8.004")),
        (851.0, 559.0, 1121.0, ("850", "560", "1120")),
        (1.23456, 1.23456 - 0.0996, 1.23456 + 0.0996, ("1.23", "1.13", "1.33")),
        (-0.001, -0.5, 0.5, ("0.00", "-0.50", "0.50")),
        # 0.5e-9: two digits are ten decimals, the third digit of 1.234e-8
        (1.234e-8, 1.184e-8, 1.284e-8, ("1.234e-08", "1.184e-08", "1.284e-08")),
        (1.234e9, 1.134e9, 1.334e9, ("1.23e+09", "1.13e+09", "1.33e+09")),
        (2.34567, 2.34567, 2.34567, ("2.35", "2.35", "2.35")),
        (2.34567, 1.23456, math.inf, ("2.35", "1.23", "failed")),
        (math.nan, math.nan, math.nan, ("-", "-", "-")),
        # six digits at most, however narrow the interval
        (7.88, 7.8799999962, 7.8800000038, ("7.88000", "7.88000", "7.88000")),
    ],
)
def test_a_value_is_rounded_to_two_digits_of_half_its_interval(
    value: float, low: float, high: float, texts: tuple[str, str, str]
) -> None:
    assert rounded(value, low, high) == texts


def test_a_table_is_aligned_on_the_screen_whatever_script_its_names_are_in() -> None:
    """Every column begins, or ends, at the same place of the screen; Japanese letters take two places, accents none."""
    names = ["梁の固有振動数", "poutre encastre\N{COMBINING ACUTE ACCENT}e", "balka", "건물"]
    rows = [[name, f"{10.0**i:g}", "kg"] for i, name in enumerate(names)]
    lines = table(rows, ["", "値", "unit"], (0, 2)).splitlines()
    ends = []
    for name, row, line in zip(names, rows, lines[2:], strict=True):
        assert line.startswith(name)
        ends.append(places(line[: line.index(f" {row[1]} ") + len(row[1]) + 1]))
    assert len(set(ends)) == 1
    assert {places(line[: line.rindex("kg")]) for line in lines[2:]} == {ends[0] + 2}
    rule = lines[1]
    assert set(rule) == {"-", " "}
    assert places(rule.split("  ")[0]) == max(map(places, names))


@pytest.mark.parametrize("system", ["sdof", "chain10"])
def test_the_scores_of_a_cell_fit(system: str, terminal: int) -> None:
    cell = cell_of("method=ls", f"system={system}", "disturbance=heavy_tails")
    stored = stored_of(cell, np.geomspace(1e-5, 1e5, 20), 123456.7)
    worst = replace(stored, rows=(*stored.rows, Row(20, Status.CRASHED, "a long message " * 20)))
    text = cell_table(cell, worst)
    assert widest(text) <= terminal
    lines = [line for line in text.splitlines() if " % " in line and line.startswith(("k", "natural"))]
    assert all(len(line.rpartition(" % ")[2].split()) == 6 for line in lines[:-1]) or terminal < 80


def summary_of(*entries: tuple[Cell, StoredCell]) -> SweepSummary:
    summary = SweepSummary()
    for cell, stored in entries:
        summary.add(cell, stored)
    return summary


def marked(text: str) -> list[str]:
    """Return the methods with a mark in the table of a sweep, in order."""
    return [line.split()[0] for line in text.splitlines() if " + " in line and not line.startswith("+")]


def test_the_best_methods_of_a_scenario_are_marked_and_reference_rows_are_not() -> None:
    """Equal errors are tied; errors twice as large on every data set, and outlier fits, are not tied with them."""
    errors = 0.123456 * np.random.default_rng(0).uniform(0.5, 1.5, 20)  # the bound is 0.123456
    rare = np.where(np.arange(20) < 5, 30.0 * errors, errors)
    of_method = {"ls": errors, "rls": errors, "pinn": 2.0 * errors, "oracle": 0.1 * errors, "sindy": rare}
    cells = {name: cell_of(f"method={name}") for name in of_method}
    text = summary_of(*((cell, stored_of(cell, of_method[name])) for name, cell in cells.items())).text()
    assert marked(text) == ["ls", "rls"]
    assert "first tier" in text
    assert widest(text) <= 80


def test_methods_on_different_data_or_with_different_knowledge_are_not_compared() -> None:
    errors = np.linspace(1.0, 2.0, 20)
    alone = [cell_of("method=ls"), cell_of("method=rls", "snr=40"), cell_of("method=rls", "initial_state=unknown")]
    text = summary_of(*((cell, stored_of(cell, errors)) for cell in alone)).text()
    assert marked(text) == []
    assert "first tier" not in text


def test_fields_that_all_cells_share_are_stated_once(terminal: int) -> None:
    cells = [cell_of(f"method={name}", f"snr={snr}") for name in ("ls", "collocation") for snr in (40, 20)]
    text = summary_of(*((cell, stored_of(cell, np.linspace(1.0, 2.0, 20))) for cell in cells)).text()
    assert widest(text) <= terminal
    first, rest = text.split("\n\n", 1)
    lines = rest.splitlines()
    assert " ".join(first.split()) == "every cell: system sdof, initial state known, disturbance none"
    assert not any("sdof" in line for line in lines)
    assert [line.split()[:2] for line in lines if "20/20" in line] == [
        ["ls", "40"], ["ls", "20"], ["collocation", "40"], ["collocation", "20"]
    ]  # fmt: skip


def test_few_cells_are_listed_and_many_are_summarised_by_method(terminal: int) -> None:
    """A method at the bound, an equal one with a fifth of outlier fits, and one that was not run, at 20 seeds each.

    The bound is 0.123456: errors of it have a loss of zero, and six times it is an outlier fit.
    """
    at_bound = np.full(20, 0.123456)
    outliers = np.where(np.arange(20) < 4, 6.0, 1.0) * at_bound
    errors = {"ls": at_bound, "rls": outliers, "prior": at_bound}
    cells = [cell_of(f"method={name}", f"seed={seed}") for name in errors for seed in range(20)]
    results = [(cell, stored_of(cell, errors[cell.label], 1.5)) for cell in cells]
    not_installed = tuple(Row(i, Status.MISSING_DEPENDENCY, "needs jinns") for i in range(20))
    rival = cell_of("method=rival_jinns")
    results.append((rival, replace(stored_of(rival, at_bound), rows=not_installed)))
    few = summary_of(*results[:4]).text()
    assert [line.split()[:2] for line in few.splitlines() if "20/20" in line] == [["ls", str(i)] for i in range(4)]
    summary = summary_of(*results, *results)  # a cell may stand in several tables
    text = summary.text()
    assert widest(text) <= terminal
    assert [line.split() for line in text.splitlines() if "400/400" in line and terminal >= 80] == [
        ["ls", "20", "400/400", "1.50", "0.0", "-", "100", "ms", "1"],
        ["rls", "20", "400/400", "1.50", "20.0", "-", "100", "ms", "2"],
        ["prior", "20", "400/400", "1.50", "0.0", "-", "100", "ms", "-"],
    ] * (terminal >= 80)
    outliers = [line.split()[4] for line in text.splitlines() if line.startswith("rival_jinns") and terminal >= 80]
    assert outliers == ["-"] * (terminal >= 80), "a method that is not installed has no outlier fits"
    assert sum("20/20" in line for line in summary.text(every_cell=True).splitlines()) == 60
    assert summary.report_failures() == 0
    summary.add(cell_of("method=pinn"), None)
    assert summary.report_failures() == 1


def test_the_page_of_a_record_fits_and_values_have_the_digits_of_their_intervals(terminal: int) -> None:
    interval = vars(StatedInterval(7.92551, 7.84717, 8.00385, 7.89717, 7.95385, 7.90017, 7.95085, "1/s²"))
    residuals = {
        "rms": 4.23e-4, "unit": "m", "part_of_signal": 0.1, "lag1_autocorrelation": 0.16, "offset": 3.35e-5,
        "whiteness": 0.5,
    }  # fmt: skip
    result = {
        "method": "shooting", "data": "測定/梁の自由振動の記録.csv", "samples": 60, "status": "ok",
        "trust": "use with caution", "reasons": ["words " * 40], "modes": [], "notes": ["words " * 20],
        "estimates": {"k_over_m": interval}, "withdrawn": {}, "runs": {},
    }  # fmt: skip
    text = record_page({**result, "residuals": residuals}, True)
    assert widest(text) <= terminal
    assert text.startswith("k/m = 7.926 ± 0.078 1/s²")
    words = " ".join(text.split())
    for ends in ("7.847 to 8.004", "7.897 to 7.954"):
        assert ends in words


def test_the_path_of_the_full_result_is_one_unbroken_line(
    tmp_path: Path, bounds_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "a folder with a name that is so long that it cannot stand on one line of eighty places"
    folder.mkdir()
    (folder / "bounds").symlink_to(bounds_folder)
    assert main(["method=prior", "replicates=2", "workers=1", f"store='{folder}'"]) == 0
    (path,) = folder.glob("*.json")
    out = capsys.readouterr().out
    assert out.splitlines()[-1] == f"full result: {path}"
    assert widest("\n".join(out.splitlines()[:-1])) <= 80
    assert main(["-m", "method=prior", "replicates=2", "workers=1", f"store='{folder}'"]) == 0
    assert str(path.parent) in capsys.readouterr().out.splitlines()[-1]


@pytest.mark.parametrize("words", [["--help"], ["identifiability"]])
def test_a_closed_pipe_is_no_traceback(words: list[str]) -> None:
    """The reading end is closed before the first line is written, as by ``| head -0``."""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "bench", *words], stdout=write, stderr=subprocess.PIPE, text=True, timeout=120
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


def test_characters_outside_of_the_encoding_of_the_output_are_no_traceback(python: Callable[..., Any]) -> None:
    printed = "sys.exit(guarded('x', lambda: print('Cramér 梁 k²') or 0))"
    script = f"from bench.commands.guard import guarded\nimport sys\n{printed}"
    done = python("-c", script, env={"PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stdout, done.stderr) == (0, "Cram?r ? k?\n", "")


@pytest.mark.parametrize("width", [50, 80])
def test_a_table_too_wide_becomes_a_list_with_all_of_its_numbers(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten columns of width six and the gaps between them take 78."""
    monkeypatch.setenv("COLUMNS", str(width))
    headers = ["test", *(f"size {letter}" for letter in "abcdefghi")]
    rows = [[f"test {row}", *(f"{row}{i}{i}.{i}{i}" for i in range(1, 10))] for row in "pq"]
    text = table(rows, headers)
    assert widest(text) <= width
    assert {cell for row in rows for cell in row[1:]} <= set(text.split())
    assert ("test test p\n" in text) == (width < 80)
