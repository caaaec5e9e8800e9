"""The store: whole files or none, what was put in comes out, and a stranger's file is left alone."""

from __future__ import annotations

import json
import math
import os
import pickle
import stat
import uuid
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stored import content

from bench import InputError, Status
from bench.scoring.row import Row
from bench.store.store import Store
from bench.store.stored_cell import StoredCell

NAN, INF = math.nan, math.inf
ROWS = (
    Row(0, Status.OK, "", {"rmse": 0.0123456789012, "only_here": 1.0}, 0.5, 0.4, 100.0, 12),
    Row(1, Status.TIMEOUT, "stopped after the limit of 3 s"),
    Row(2, Status.OK, "größer", {"rmse": INF}, 0.25, NAN, 50.0, 3),
)
CELL = StoredCell(
    identity="0123456789abcdef0123",
    cell={"method": "ls", "settings": {"derivative": "finite", "list": [1, 2]}, "third": 1.0 / 3.0},
    rows=ROWS,
    summary={"rmse": {"mean": INF, "median": 0.5, "excess": NAN}},
    prior_share={"m": 0.999},
    identifiable={"m": False},
    wall_s=1.5,
    provenance={"python": "3.11"},
    arrays={"times": np.linspace(0.0, 1.0, 7), "dof": np.arange(3)},
    tracebacks="replicate 1\nTraceback: größer\n",
)


def same(one: Any, two: Any) -> bool:
    """Equality that takes NaN for NaN, to 5 significant digits."""
    if isinstance(one, float) and isinstance(two, float):
        return (math.isnan(one) and math.isnan(two)) or one == two or math.isclose(one, two, rel_tol=5.1e-5)
    if isinstance(one, dict) and isinstance(two, dict):
        return one.keys() == two.keys() and all(same(one[key], two[key]) for key in one)
    if isinstance(one, Row):
        return same(vars(one), vars(two))
    return bool(one == two)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "rows")
    store.prepare()
    return store


def test_what_is_saved_is_loaded(store: Store) -> None:
    assert (store.load("absent"), list(store)) == (None, [])
    store.save(CELL)
    store.save(CELL)
    assert [path.name for path in store.folder.iterdir()] == [f"{CELL.identity}.json"]
    loaded = store.load(CELL.identity)
    assert loaded is not None
    apart = ("rows", "columns", "arrays")
    assert same(*({k: v for k, v in vars(cell).items() if k not in apart} for cell in (loaded, CELL)))
    assert all(same(one, two) for one, two in zip(loaded.rows, ROWS, strict=True))
    assert loaded.arrays.keys() == CELL.arrays.keys()
    for name, values in CELL.arrays.items():
        np.testing.assert_allclose(loaded.arrays[name], values, rtol=1e-6)
    assert (loaded.n_ok, loaded.status) == (2, Status.OK)
    assert loaded.cell["third"] == 1.0 / 3.0  # the description of what was computed is exact
    assert repr(pickle.loads(pickle.dumps(loaded))) == repr(loaded)
    bounds = store.bounds / "x.bound"
    bounds.parent.mkdir()
    bounds.write_text("{}")
    assert [cell.identity for cell in store] == [CELL.identity]


def test_the_file_is_lines_of_strict_json(store: Store) -> None:
    store.save(CELL)

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    for line in store.path(CELL.identity).read_text(encoding="utf-8").splitlines()[:2]:
        json.loads(line, parse_constant=refuse)
    found = content(store.path(CELL.identity))
    assert found["statuses"] == {"ok": 2, "timeout": 1}
    assert found["rows"]["status"] == ["ok", "timeout", "ok"]
    assert found["rows"]["scores"]["only_here"] == [1.0, None, None]


def test_the_status_of_a_cell_without_success_is_its_most_frequent_failure() -> None:
    rows = [Row(i, s) for i, s in enumerate([Status.TIMEOUT, Status.CRASHED, Status.CRASHED])]
    assert replace(CELL, rows=tuple(rows)).status is Status.CRASHED


WRITER = """
import os, pickle, signal, sys, time
from dataclasses import replace
from pathlib import Path
from bench.store.store import Store
store, small = Store(Path(sys.argv[1])), pickle.loads(bytes.fromhex(sys.argv[2]))
large = replace(small, rows=small.rows * 200)
for delay in (0.001, 0.003, 0.006, 0.010, 0.015, 0.021, 0.028, 0.036, 0.045, 0.055):
    child = os.fork()
    while child == 0:
        store.save(large)
        store.save(small)
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    found = [len(cell.rows) for cell in store]
    assert found in ([3], [600]), found
print("whole")
"""


def test_a_writer_killed_at_any_moment_leaves_a_whole_cell(store: Store, python: Callable[..., Any]) -> None:
    store.save(CELL)
    done = python("-c", WRITER, str(store.folder), pickle.dumps(CELL).hex())
    assert done.stdout == "whole\n", done.stderr


def test_no_write_goes_through_a_link_that_somebody_has_left(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The names of temporary files are known to somebody who guesses them; a cell's name to everybody."""
    mine = tmp_path / "mine"
    mine.write_text("mine")
    store.path(CELL.identity).symlink_to(mine)
    store.save(CELL)
    assert not store.path(CELL.identity).is_symlink()
    monkeypatch.setattr(uuid, "uuid4", lambda: uuid.UUID(int=7))
    for name in ("write-test", f"{CELL.identity}.json"):
        (store.folder / f".{name}.{uuid.UUID(int=7).hex}.tmp").symlink_to(mine)
    with pytest.raises(InputError, match="cannot be written"):
        store.prepare()
    with pytest.raises(OSError, match="exists"):
        store.save(CELL)
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("mask", [0o002, 0o077])
def test_files_have_the_rights_that_the_umask_leaves(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        store = Store(tmp_path / "rows")
        store.prepare()
        store.save(CELL)
    finally:
        os.umask(before)
    assert [stat.S_IMODE(path.stat().st_mode) for path in store.folder.iterdir()] == [0o666 & ~mask]
    assert stat.S_IMODE(store.folder.stat().st_mode) == 0o777 & ~mask
