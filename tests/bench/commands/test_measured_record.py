"""A measured record on the command line: table, plot, and the picture that is saved."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from bench.commands.main import main

LAST_LINE = "results are not saved; format=json prints all of them, with residuals"


@pytest.fixture(autouse=True)
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a record of a free decay, and one without motion, to the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    times = np.arange(0.0, 5.0, 0.05)
    values = 3.0 * np.exp(-0.3 * times) * np.cos(12.0 * times) + 0.05 * np.random.default_rng(2).standard_normal(100)
    for name, column in (("record.csv", values), ("flat.csv", np.ones(100))):
        rows = "\n".join(f"{t:.6g},{x:.6g}" for t, x in zip(times, column, strict=True))
        Path(name).write_text(f"t [s],x [mm]\n{rows}\n")
    return tmp_path


def printed(capsys: pytest.CaptureFixture[str], *fields: str, status: int = 0) -> str:
    defaults = [word for word in ("data=record.csv", "method=matrix_pencil") if word.split("=")[0] not in str(fields)]
    assert main([*defaults, *fields]) == status
    return capsys.readouterr().out


def words_of(path: Path) -> str:
    """Return the names and texts of a picture, which must be well-formed."""
    return " ".join(f"{item.tag} {item.text or ''}" for item in ElementTree.parse(path).iter())


def test_a_pipe_gets_no_plot(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed(capsys)
    assert "measured" not in out
    assert out.splitlines()[-1] == LAST_LINE
    assert sorted(path.name for path in Path().iterdir()) == ["flat.csv", "record.csv"]


def test_the_fit_of_the_best_method_is_drawn_and_saved(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = printed(capsys, "method=ls,matrix_pencil", "plot=always", "picture=a/mine.svg").splitlines()
    assert any(line.endswith("measured  ⠤ fitted by matrix_pencil") for line in lines)
    assert any(line.startswith("residual RMS: ") for line in lines)
    assert lines[-1] == "picture of the fit: a/mine.svg"
    assert "svg" in words_of(Path("a/mine.svg"))
    assert "var(" not in Path("a/mine.svg").read_text(
        encoding="utf-8"
    )  # outside of a page the picture defines its colours


def test_a_record_without_a_fit_is_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed(capsys, "data=flat.csv", "plot=always", status=1)
    assert "no fit by matrix_pencil" in out
    assert json.loads(printed(capsys, "data=flat.csv", "format=json", "picture=flat.svg", status=1))["trust"]
    assert Path("flat.svg").is_file()


def test_methods_without_an_estimate_are_grouped_by_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    """ddnn cannot estimate an offset; a straight line through a record without motion is no decay."""
    out = printed(capsys, "method=matrix_pencil,ddnn")
    table, not_applicable = out.split("not applicable:\n")
    assert "matrix_pencil" in table
    assert "ddnn" not in table
    assert not_applicable.strip().startswith("ddnn: ")


def test_a_record_needs_no_method_and_a_certificate_no_field_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data=record.csv", "plot=never"]) == 0
    assert "shooting: " in capsys.readouterr().out
    assert main(["record.csv"]) == 2
    assert "python -m bench certify record.csv" in capsys.readouterr().err
    assert main(["certify", "record.csv", "twins=0", "method=matrix_pencil", "system=sdof"]) in (0, 1)
    assert Path("certificate/certificate.html").is_file()
