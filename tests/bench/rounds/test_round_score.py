"""Scores of predictions: against closed forms, against the harness, and what must not pay."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.commands.main import main
from bench.reporting.round_score import KINDS, round_report
from bench.rounds.folder import write_round
from bench.rounds.scoring import score_rows, summarise_rows

N = 60


@pytest.fixture
def truth() -> pd.DataFrame:
    """The truth of problems of two kinds with two quantities each."""
    rng = np.random.default_rng(5)
    rows = {"scenario": np.repeat([f"P{i:03d}" for i in range(1, N + 1)], 2), "quantity": ["k/m", "c/m"] * N,
            "value": rng.uniform(1, 9, 2 * N), "bound": rng.uniform(0.1, 0.5, 2 * N),
            "kind": np.repeat(["free decay", "drift"], N)}  # fmt: skip
    return pd.DataFrame(rows)


def predictions(truth: pd.DataFrame, errors: np.ndarray, half_width: float = 1.96) -> pd.DataFrame:
    """Return predictions off the truth by so many bounds, with intervals of so many bounds to either side."""
    value = truth["value"] + errors * truth["bound"]
    ends = {"low": value - half_width * truth["bound"], "high": value + half_width * truth["bound"]}
    return truth[["scenario", "quantity"]].assign(value=value, **ends, seconds=0.5)


def test_excess_outliers_and_coverage_are_those_of_known_errors(truth: pd.DataFrame) -> None:
    errors = np.tile([1.0, -3.0], N)  # c/m beyond 1.96 bounds, within 5
    errors[1] = 6.0
    result = summarise_rows(score_rows(predictions(truth, errors), truth))
    assert result.excess == pytest.approx(math.sqrt((N * 1 + (N - 1) * 9 + 36) / (2 * N)))
    assert (result.problems, result.answered, result.outliers) == (N, N, 1)
    assert (result.intervals, result.covered, result.seconds) == (2 * N, N, 0.5)
    # over the ideal 4.676: k/m has the width alone, c/m 40 times the miss too (Gneiting and Raftery 2007, eq. 43)
    width, ideal = 3.92, 4.6756
    c = [width + 40 * (6 - 1.96), *[width + 40 * (3 - 1.96)] * (N - 1)]
    assert result.interval_score == pytest.approx((N * width + sum(c)) / (2 * N * ideal), rel=1e-4)


def test_the_interval_score_is_one_for_an_efficient_estimator_and_more_for_other_widths() -> None:
    n = 20_000
    truth = pd.DataFrame(
        {"scenario": [f"P{i}" for i in range(n)], "quantity": "m", "value": 2.0, "bound": 0.1, "kind": "a"}
    )
    errors = np.random.default_rng(0).standard_normal(n)
    by_width = {
        half: summarise_rows(score_rows(predictions(truth, errors, half), truth)) for half in (0.5, 1.5, 1.96, 2.5, 50)
    }
    assert by_width[1.96].interval_score == pytest.approx(1.0, abs=0.02)
    assert min(by_width, key=lambda half: by_width[half].interval_score) == 1.96
    assert by_width[50].interval_score > 20  # it covers everything, and says nothing
    assert by_width[50].covered == n


def test_a_refusal_leaves_the_excess_and_is_seen(truth: pd.DataFrame) -> None:
    errors = np.random.default_rng(1).standard_normal(2 * N)
    errors[:20] *= 4.0
    whole = predictions(truth, errors)
    evasive = whole.copy()
    evasive.loc[:19, ["value", "low", "high"]] = math.nan  # the ten problems with the worst answers
    report = round_report("evasive", {"evasive": score_rows(evasive, truth), "whole": score_rows(whole, truth)})
    all_row = dict(zip(KINDS, report.kinds[-1], strict=True))
    assert all_row["answered"] == f"{N - 10}/{N}"
    assert "50 of 60 problems answered" in report.sentences[0]
    places = {row[1]: row for row in report.ranking}
    assert float(places["evasive"][3].split()[0]) > float(places["whole"][3].split()[0])
    assert places["evasive"][5] == f"10 of {N}"


def blank(table: pd.DataFrame, rows: slice, *names: str) -> pd.DataFrame:
    """Return predictions without the values of some columns in some rows."""
    table = table.copy()
    table.loc[rows, list(names or ("value", "low", "high"))] = math.nan
    return table


@pytest.mark.parametrize(("rows", "start", "end"), [
    (slice(0, None, 2), "error 10.00 ", ""),  # half an answer is none
    (slice(N, None), "", "times the Cramér-Rao bound on 30 of 60 problems, no tier"),  # nothing about one kind
    (slice(0, None), "no answer to any problem", ""),
])  # fmt: skip
def test_problems_without_an_answer_count(truth: pd.DataFrame, rows: slice, start: str, end: str) -> None:
    table = predictions(truth, np.random.default_rng(1).standard_normal(2 * N))
    report = round_report("part", {"part": score_rows(blank(table, rows), truth), "all": score_rows(table, truth)})
    assert report.answer.startswith(start)
    assert report.answer.endswith(end)


def test_without_intervals_no_coverage_is_stated(truth: pd.DataFrame) -> None:
    table = blank(predictions(truth, np.ones(2 * N)), slice(0, None), "low", "high", "seconds")
    report = round_report("bare", {"bare": score_rows(table, truth)})
    assert [dict(zip(KINDS, row, strict=True))["95 % cover"] for row in report.kinds] == ["-"] * 3
    assert "not stated" in report.sentences[1]


def test_errors_too_small_for_chance_are_called_so(truth: pd.DataFrame) -> None:
    report = round_report("seer", {"seer": score_rows(predictions(truth, np.full(2 * N, 1e-3)), truth)})
    assert "more than chance allows" in report.sentences[2]
    disturbed = truth.assign(kind="coloured noise")  # whose bound is no limit
    report = round_report("seer", {"seer": score_rows(predictions(truth, np.full(2 * N, 1e-3)), disturbed)})
    assert len(report.sentences) == 2
    assert "no method to compare with" in report.text()


@pytest.fixture(scope="module")
def round_folder(six: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A round of one problem of each kind, solved from its files by shooting and by the matrix pencil."""
    folder = shutil.copytree(six[0], tmp_path_factory.mktemp("rounds") / "r")
    secret = shutil.copytree(six[1], folder.with_name("r_secret"))
    for method in ("shooting", "matrix_pencil"):
        assert (
            main(["round", "solve", str(folder), f"method={method}", f"out={secret / 'methods' / f'{method}.csv'}"])
            == 0
        )
    return folder


@pytest.mark.slow
def test_a_score_is_printed_and_written_the_same_at_every_call(
    round_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.csv"
    mine.write_bytes((round_folder.with_name("r_secret") / "methods" / "shooting.csv").read_bytes())
    command = ["score", str(mine), f"round={round_folder}", f"secret={round_folder}_secret", "name=A <b> & | C"]
    written = []
    for i in range(2):
        assert main([*command, f"out={tmp_path / str(i)}"]) == 0
        written.append((tmp_path / str(i) / "score.md").read_text("utf-8"))
    assert written[0] == written[1]
    page, line = written[0], written[0].partition("\n")[0]
    printed = capsys.readouterr().out
    assert line in printed
    assert "Multiple shooting" in printed
    commitment = json.loads((round_folder / "commitment.json").read_text())["commitment"]
    assert commitment in page
    assert commitment[:12] in line
    assert r"A <b> & \| C" in page


def test_a_name_that_is_taken_and_a_secret_of_another_round_are_refused(
    round_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = round_folder.with_name("r_secret") / "methods" / "shooting.csv"
    assert main(["score", str(mine), f"round={round_folder}", f"secret={round_folder}_secret"]) == 2
    assert "name=shooting: " in capsys.readouterr().err
    other = tmp_path / "other_secret"
    write_round(tmp_path / "other", other, 3, 1)
    assert (
        main(["score", str(mine), f"round={round_folder}", f"secret={other}", "name=a", f"out={tmp_path / 'o'}"]) == 2
    )
    assert f"secret={other}: " in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_an_opened_round_needs_no_secret(
    round_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "r"
    shutil.copytree(round_folder, folder)
    assert main(["round", "open", str(folder), f"secret={round_folder}_secret"]) == 0
    mine = shutil.copy(folder / "methods" / "matrix_pencil.csv", tmp_path / "mine.csv")
    capsys.readouterr()
    assert main(["score", str(mine), f"round={folder}"]) == 0
    assert "Multiple shooting" in capsys.readouterr().out
