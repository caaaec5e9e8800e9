"""Every malformed input is one line that names field, value and remedy, exit status 2, and leaves nothing behind."""

from __future__ import annotations

from pathlib import Path

import pytest
from forked import Call, Forked
from malformed import Malformed, all_malformed
from malformed_files import Shelf

NOTICE = "line(s) ignored, not of the form"
"""A warning about lines of a stream, which precedes the error."""
LONGEST = 2000
"""Largest length of the line; the longest lists all methods or scenarios."""


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Shelf:
    return Shelf(tmp_path_factory.mktemp("shelf"))


def files(folder: Path) -> dict[str, int]:
    """Return the paths below a folder, with the modification time of files."""
    return {str(path): 0 if path.is_dir() else path.lstat().st_mtime_ns for path in folder.rglob("*")}


@pytest.mark.parametrize("case", all_malformed(), ids=lambda case: case.name)
def test_malformed_input_is_one_line(
    case: Malformed, forked: Forked, shelf: Shelf, one_cell: Path, tmp_path: Path
) -> None:
    place = tmp_path / "here"
    place.mkdir()
    shelf.lay_out(place, " ".join(case.words), one_cell)
    before = files(tmp_path)
    ended = forked.run(Call(case.words, str(place)))
    lines = [line for line in ended.err.splitlines() if NOTICE not in line]
    assert (ended.status, ended.out, len(lines)) == (2, "", 1), ended
    (line,) = lines
    assert line.startswith(f"bench: {case.start}")
    assert case.remedy.lower() in line.partition(": ")[2].partition(": ")[2].lower()
    assert line.rpartition(": ")[2].strip(), "no remedy"
    assert line.isprintable()
    assert len(line) <= LONGEST
    assert files(tmp_path) == before
