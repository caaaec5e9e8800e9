"""A file is there whole, or as it was before."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.errors import InputError
from bench.reporting.whole_file import write


def test_a_failed_write_keeps_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "certificate.html"
    path.write_text("before", encoding="utf-8")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(InputError, match="No space left"):
        write(path, "after")
    assert [one.name for one in tmp_path.iterdir()] == ["certificate.html"]
    assert path.read_text(encoding="utf-8") == "before"
