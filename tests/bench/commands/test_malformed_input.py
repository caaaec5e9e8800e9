"""Every malformed input is one line that names field, value and remedy, exit status 2, and leaves nothing behind."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from forked import Call, Ended, Forked
from malformed import Malformed, all_malformed, entry
from malformed_files import Shelf

NOTICE = "line(s) left out that do not read"
"""What is said of a stream's lines as they come, before anybody knows how it ends."""
LONGEST = 2000
"""Letters of the one line; the longest lists all methods or scenarios."""
CASES = all_malformed()


@pytest.fixture(scope="module")
def forked() -> Iterator[Forked]:
    process = Forked()
    yield process
    process.close()


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Shelf:
    return Shelf(tmp_path_factory.mktemp("shelf"))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, forked: Forked) -> Path:
    """A store with one cell, of a method that takes no time."""
    folder = tmp_path_factory.mktemp("own")
    line = ["method=prior", "replicates=2", "workers=1", "store=rows"]
    assert forked.run(Call(line, str(folder))).status == 0
    return folder / "rows"


def run(case: Malformed, forked: Forked, place: Path) -> Ended:
    """Run a case in a folder that holds the files it names."""
    return forked.run(Call([*entry(case.command), *case.arguments], str(place)))


def everything(folder: Path) -> dict[str, int]:
    """All that lies below a folder, files with the time of their last change."""
    return {
        str(path.relative_to(folder)): 0 if path.is_dir() else path.lstat().st_mtime_ns for path in folder.rglob("*")
    }


def shown(value: str) -> list[str]:
    """How a line may show a value: its beginning, or the number that was read."""
    try:
        return [value[:20], f"={float(value)}"]
    except ValueError:
        return [value[:20]]


def objections(case: Malformed, ended: Ended, before: dict[str, int], after: dict[str, int]) -> list[str]:
    """What is not as it is wanted, in words."""
    lines = [line for line in ended.err.splitlines() if NOTICE not in line]
    program = "bench"
    found = [f"status {ended.status}"] if ended.status != 2 else []
    found += [f"{len(lines)} lines on the error stream"] if len(lines) != 1 else []
    line = lines[-1] if lines else ""
    said, _, remedy = line.removeprefix(f"{program}: ").partition("=")
    _, colon, remedy = remedy.partition(": ")
    found += [f"begins otherwise than {program}"] if not line.startswith(f"{program}: ") else []
    found += [f"names {said!r}, not {case.field!r}"] if case.field and not said.startswith(case.field) else []
    if case.value and case.value.isprintable() and not any(text in line for text in shown(case.value)):
        found.append(f"does not show the value {case.value[:20]!r}")
    found += ["says no remedy"] if not (colon and remedy.strip()) else []
    found += [f"does not say {case.remedy!r}"] if case.remedy.lower() not in line.lower() else []
    found += ["is too long"] if len(line) > LONGEST else []
    found += ["holds control characters"] if not line.isprintable() else []
    found += ["something on the output"] if ended.out else []
    changed = sorted(set(before.items()) ^ set(after.items()))
    found += [f"left behind: {changed[:3]}"] if changed else []
    return found


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_malformed_input_is_one_line(
    case: Malformed, forked: Forked, shelf: Shelf, store: Path, tmp_path: Path
) -> None:
    place = tmp_path / "here"
    place.mkdir()
    shelf.lay_out(place, " ".join(case.arguments), store)
    before = everything(tmp_path)
    ended = run(case, forked, place)
    assert not objections(case, ended, before, everything(tmp_path)), ended
