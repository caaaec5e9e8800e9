"""The command line of every study: its page of help, and a field that it does not have."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

from tests import studies

FOLDER = Path(studies.__file__).parent
NAMES = sorted(
    {path.relative_to(FOLDER).with_suffix("").as_posix().replace("/", ".") for path in FOLDER.rglob("*.py")
     if "\nmain = partial(study, " in path.read_text(encoding="utf-8")}
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_study_has_a_page_of_help_and_refuses_other_fields(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    main = import_module(f"tests.studies.{name}").main
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"usage: python -m tests.studies.{name.removesuffix('.__main__')}")
    assert "fields (defaults in brackets):" in said
    assert main(["colour=red"]) == 2
    error = capsys.readouterr().err
    assert "colour=red: not a field" in error
    assert error.count("\n") == 1
