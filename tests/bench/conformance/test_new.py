"""A package from the template passes the checks as it is, and its own test says so."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import REPOSITORY, Python

from bench.commands.main import main


@pytest.mark.parametrize("kind", ["method", "system"])
def test_a_new_package_passes_its_own_test(kind: str, tmp_path: Path, python: Python) -> None:
    folder = tmp_path / "somewhere"
    assert main(["new", f"{kind}=quarter_car", f"out={folder}"]) == 0
    assert (folder / "README.md").read_text(encoding="utf-8").startswith("# Quarter car\n")
    for path in folder.iterdir():
        assert "$" not in path.name + path.read_text(encoding="utf-8"), path
        assert "template" not in path.name
    env = {"PYTHONPATH": str(REPOSITORY)}
    done = python("-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder), env=env)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ([], "method=: write method=<name>"),
        (["method=own", "system=own"], "method=own: write method=<name> or system=<name>"),
        (["method=true"], "method=true: small letters"),  # its class would be True
        (["system=_2nd"], "system=_2nd: small letters"),  # its class would be 2nd
        (["method=own", "out=."], "out=.: it is there already"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    arguments: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").touch()
    assert main(["new", *arguments]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
