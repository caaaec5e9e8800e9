"""A measured record on the command line: its plot, and the picture that is saved."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from bench.commands.main import main

BELOW = "the values are not stored: format=json prints all, with residuals"
DEFAULT = Path("outputs/fits/record_matrix_pencil.svg")


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


def test_a_pipe_gets_the_table_alone_and_a_picture_is_beside_the_store(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed(capsys)
    assert "measured" not in out
    assert out.splitlines()[-2:] == [BELOW, f"picture of the fit: {DEFAULT}"]
    assert "svg" in words_of(DEFAULT)
    assert "var(" not in DEFAULT.read_text(encoding="utf-8")  # it has colours of its own, outside of a page
    assert printed(capsys, "store=elsewhere/rows").splitlines()[-1].endswith("elsewhere/fits/record_matrix_pencil.svg")


def test_a_plot_is_drawn_where_it_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, "plot=always", "picture=none").splitlines()
    assert lines[-1] == BELOW
    assert any(line.endswith("measured  ⠤ fitted by matrix_pencil") for line in lines)
    assert any(line.startswith("residual: rms ") for line in lines)
    assert not Path("outputs/fits").exists()


def test_of_several_methods_the_best_is_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed(capsys, "method=ls,matrix_pencil", "plot=always", "picture=mine.svg")
    assert "fitted by matrix_pencil" in out
    assert out.splitlines()[-1] == "picture of the fit: mine.svg"
    assert Path("mine.svg").stat().st_size > 1000


def test_a_record_without_a_fit_is_drawn_all_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed(capsys, "data=flat.csv", "plot=always", status=1)
    assert "found no fit to draw" in out
    assert Path("outputs/fits/flat_matrix_pencil.svg").is_file()


def test_json_is_json_and_has_a_picture_where_it_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert json.loads(printed(capsys, "format=json"))["method"] == "matrix_pencil"
    assert not Path("outputs").exists()
    json.loads(printed(capsys, "format=json", "picture=a/b.svg"))
    assert Path("a/b.svg").is_file()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        (["picture=fit.png"], "picture=fit.png: a file whose name ends in .svg, or none"),
        (["picture=record.csv/fit.svg"], "picture=record.csv/fit.svg: cannot be written"),
        (["plot=true"], "plot="),
        (["plot=always", "format=json"], "plot=always: with format=table"),
        (["plot=sometimes"], "plot=sometimes"),
    ],
)
def test_what_cannot_be_is_said_before_the_work(
    fields: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.face.identification.found_by", None)
    assert main(["data=record.csv", "method=matrix_pencil", *fields]) == 2
    out, err = capsys.readouterr()
    assert (out, len(err.splitlines())) == ("", 1)
    assert said in err


def test_a_picture_that_nobody_asked_for_spoils_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    Path("outputs").write_text("no folder")
    assert main(["data=record.csv", "method=matrix_pencil"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[-1] == BELOW
    assert err.splitlines()[-1].startswith("bench: no picture of the fit: picture=")


def test_plots_and_pictures_are_of_records(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["method=ls", "plot=always"]) == 2
    assert "plot=always: it is of a measured record" in capsys.readouterr().err
    assert main(["certify", "data=record.csv", "picture=x.svg"]) == 2
    assert "picture=x.svg: not a field" in capsys.readouterr().err
