"""Damaged cells of a sweep: one line that names the file, and ``retry=failed`` computes them and nothing else."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from stored import resealed

from bench.commands.main import main
from bench.config.experiment import expand
from bench.store.cell_file import cell_file
from bench.store.store import Store
from bench.sweep.plan import FAILURES, State, plan

DAMAGE: dict[str, Callable[[Path], object]] = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:1000]),
    "without its arrays": lambda path: path.write_bytes(path.read_bytes()[:-100]),
    "empty": lambda path: path.write_bytes(b""),
    "flipped": lambda path: flip(path),
    "of another shape": lambda path: path.write_bytes(resealed({"cell": 3})),
    "a pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "whole": lambda path: None,
}


def flip(path: Path) -> None:
    """Another bit in the middle of a file."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 16
    path.write_bytes(content)


@pytest.fixture(scope="module")
def computed(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A cell for each kind of damage, by seed."""
    store = Store(tmp_path_factory.mktemp("damaged") / "rows")
    assert main(command(store)) == 0
    return store


def command(store: Store, *more: str) -> list[str]:
    seeds = ",".join(map(str, range(len(DAMAGE))))
    return ["-m", "method=prior", f"seed={seeds}", "replicates=2", f"store={store.folder}", *more]


def scores(store: Store, identity: str) -> list[object]:
    cell = store.load(identity)
    assert cell is not None
    return [(row.status, dict(row.scores), row.data) for row in cell.rows]


def test_damaged_cells_are_named_and_computed_again_when_failures_are(
    computed: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    store = computed
    cells = [job.cell() for job in expand(command(store)[1:], True)]
    names = [cell.identity for cell in cells]
    before = {name: scores(store, name) for name in names}
    whole = store.path(names[-1]).stat().st_ino
    for name, damage in zip(names, DAMAGE.values(), strict=True):
        damage(store.path(name))

    capsys.readouterr()
    assert main(command(store)) == 2  # as it stands: the first damaged file is named, nothing runs
    (said,) = capsys.readouterr().err.splitlines()
    assert "retry=failed computes it again" in said
    assert sum(str(store.path(name)) in said for name in names) == 1
    found = plan(cells, store, FAILURES)
    assert [one.state for one in found] == [State.DAMAGED] * (len(DAMAGE) - 1) + [State.DONE]
    assert [one.run for one in found] == [True] * (len(DAMAGE) - 1) + [False]

    assert main(command(store, "retry=failed")) == 0
    assert {name: scores(store, name) for name in names} == before
    assert [store.damage(name) for name in names] == [""] * len(DAMAGE)
    assert store.path(names[-1]).stat().st_ino == whole
    assert all(cell_file(cell) for cell in store)
