"""A measured record on the command line: its plot, and the picture that is saved."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from bench.commands.main import main

BELOW = "the values are not stored: format=json prints all, with residuals"


@pytest.fixture(autouse=True)
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A record of a decay in the working folder, and a flat one that no method has an answer to."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    times = np.arange(0.0, 5.0, 0.05)
    values = 3.0 * np.exp(-0.3 * times) * np.cos(12.0 * times) + 0.05 * np.random.default_rng(2).standard_normal(100)
    for name, column in (("record.csv", values), ("flat.csv", np.ones(100))):
        rows = "\n".join(f"{t:.6g},{x:.6g}" for t, x in zip(times, column, strict=True))
        Path(name).write_text(f"t [s],x [mm]\n{rows}\n")
    return tmp_path


def printed(capsys: pytest.CaptureFixture[str], *fields: str, status: int = 0) -> str:
    given = [one for one in ("data=record.csv", "method=matrix_pencil") if one.split("=")[0] not in str(fields)]
    assert main([*given, *fields]) == status
    return capsys.readouterr().out


def words_of(path: Path) -> str:
    """The names and texts of a picture, which must be well-formed."""
    return " ".join(f"{item.tag} {item.text or ''}" for item in ElementTree.parse(path).iter())


def test_a_pipe_gets_the_table_alone(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed(capsys)
    assert "measured" not in out
    assert out.splitlines()[-1] == BELOW
    assert sorted(path.name for path in Path().iterdir()) == ["flat.csv", "record.csv"]


def test_the_best_of_several_methods_is_drawn_and_saved_where_it_is_asked_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = printed(capsys, "method=ls,matrix_pencil", "plot=always", "picture=a/mine.svg").splitlines()
    assert any(line.endswith("measured  ⠤ fitted by matrix_pencil") for line in lines)
    assert any(line.startswith("residual: rms ") for line in lines)
    assert lines[-1] == "picture of the fit: a/mine.svg"
    assert "svg" in words_of(Path("a/mine.svg"))
    assert "var(" not in Path("a/mine.svg").read_text(encoding="utf-8")  # it has colours of its own, outside of a page


def test_a_record_without_a_fit_is_drawn_all_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed(capsys, "data=flat.csv", "plot=always", "picture=flat.svg", status=1)
    assert "found no fit to draw" in out
    assert Path("flat.svg").is_file()


def test_json_is_json_with_a_picture_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert json.loads(printed(capsys, "format=json", "picture=b.svg"))["method"] == "matrix_pencil"
    assert Path("b.svg").is_file()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        (["picture=fit.png"], "picture=fit.png: a file whose name ends in .svg"),
        (["plot=always", "format=json"], "plot=always: with format=table"),
    ],
)
def test_what_cannot_be_is_said_before_the_work(
    fields: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.records.identification.identify_all", None)
    assert main(["data=record.csv", "method=matrix_pencil", *fields]) == 2
    out, err = capsys.readouterr()
    assert (out, len(err.splitlines())) == ("", 1)
    assert said in err
