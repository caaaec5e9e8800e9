"""The tutorial's example of a new method, taken from its page to the letter; test_gallery.py runs the page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from conftest import REPOSITORY

from bench.commands.main import main
from bench.conformance.method_checks import METHOD_CHECKS

PAGE = REPOSITORY / "docs" / "gallery" / "new_method.md"


def test_it_keeps_the_contract(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The copied code passes the checks of any method."""
    found = re.search(r"```python title=\"zero_crossings.py\"\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert found
    (tmp_path / "zero_crossings.py").write_text(found.group(1), encoding="utf-8")
    status, lines = main(["check", f"package={tmp_path / 'zero_crossings.py'}"]), capsys.readouterr().out.splitlines()
    assert (status, lines[0]) == (0, "method zero_crossings (zero_crossings:ZeroCrossings)"), lines
    assert lines[-1] == f"{len(METHOD_CHECKS)} of {len(METHOD_CHECKS)} checks passed"
