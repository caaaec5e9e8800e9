"""The collected view: always what the cells' files say, however they come, change and go."""

from __future__ import annotations

import errno
import json
import os
import random
import secrets
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from test_store import CELL

from bench.store import index as view
from bench.store.seal import read_regular
from bench.store.store import Store
from bench.store.stored import StoredCell


def a_cell(i: int, **changes: object) -> StoredCell:
    summary = {"rmse": {"mean": 1.0, "median": float(i), "excess": 1.0}, "other": {"median": -1.0}}
    stored = replace(CELL, identity=f"{i:020x}", summary=summary, version={"digest": "v"}, **changes)  # type: ignore[arg-type]
    return replace(stored, cell={**CELL.cell, "label": f"m{i % 2}", "data": {"system": "sdof"}})


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "rows")
    store.prepare()
    return store


def test_it_follows_the_files(store: Store) -> None:
    assert list(view.cells(store).index) == []
    for i in range(5):
        store.save(a_cell(i))
    assert list(view.cells(store)["label"]) == ["m0", "m1", "m0", "m1", "m0"]
    store.save(a_cell(1, wall_s=99.0))
    store.path(f"{2:020x}").unlink()
    found = view.cells(store, ("wall_s", "n_ok", "statuses"))
    assert list(found.index) == [f"{i:020x}" for i in (0, 1, 3, 4)]
    assert list(found["wall_s"]) == [1.5, 99.0, 1.5, 1.5]
    assert json.loads(found["statuses"].iloc[0]) == {"ok": 2, "timeout": 1}
    whole = pd.read_parquet(store.view)
    assert set(found.index) <= set(whole["identity"])


def test_many_small_changes_are_compacted_and_nothing_is_lost(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view, "MOST_PARTS", 3)
    for i in range(12):
        store.save(a_cell(i))
        store.save(a_cell(0, wall_s=float(i)))
        assert len(view.cells(store)) == max(1, i + 1)
        assert len(list(store.view.glob("*.parquet"))) <= 4
    assert view.cells(store, ("wall_s",))["wall_s"].iloc[0] == 11.0
    assert list(view.summaries(store, ["rmse"])["median"]) == [float(i) for i in range(12)]


def test_summaries_are_one_line_a_cell_and_metric(store: Store) -> None:
    for i in range(3):
        store.save(a_cell(i))
    found = view.summaries(store, ["rmse", "absent"])
    assert sorted(zip(found["identity"], found["median"], strict=True)) == [(f"{i:020x}", float(i)) for i in range(3)]
    assert set(found["metric"]) == {"rmse"}
    assert view.summaries(Store(store.folder / "nowhere"), ["rmse"]).empty


def test_a_damaged_or_foreign_file_is_a_line_that_says_so(store: Store) -> None:
    store.save(a_cell(0))
    store.path("broken").write_text("{")
    store.path("old").write_text('{"format": 1}')
    found = view.cells(store, ("problem",))
    assert found.loc[f"{0:020x}", "problem"] == ""
    assert "not a whole cell" in found.loc["broken", "problem"]
    assert "format 1, this version reads 3" in found.loc["old", "problem"]


def test_the_view_may_be_deleted_damaged_or_impossible_to_write(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    for i in range(3):
        store.save(a_cell(i))
    view.cells(store)
    for part in store.view.glob("*.parquet"):
        part.write_bytes(b"PAR1 and nothing more")
    assert len(view.cells(store)) == 3
    for part in store.view.glob("*.parquet"):
        part.unlink()
    monkeypatch.setattr(view, "_write", lambda store, part: False)
    assert len(view.cells(store)) == 3
    assert len(view.summaries(store, ["rmse"])) == 3


@pytest.fixture
def unreadable(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of files whose reading fails, as by a server of files that is away for a moment."""
    names: list[str] = []
    read = read_regular

    def failing(path: Path) -> bytes:
        if path.name in names:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return read(path)

    monkeypatch.setattr("bench.store.store.read_regular", failing)
    return names


def test_a_read_error_is_said_and_not_kept(store: Store, unreadable: list[str]) -> None:
    for i in range(2):
        store.save(a_cell(i))
    away, there = (f"{i:020x}" for i in range(2))
    unreadable.append(f"{away}.json")
    found = view.cells(store, ("problem", "label"))
    assert list(found["problem"] == "") == [False, True]
    assert "cannot be read now (Input/output error)" in found["problem"][away]
    assert list(view.cells(store)["problem"] == "") == [False, True]
    unreadable.clear()
    assert list(view.cells(store, ("label",))["label"]) == ["m0", "m1"]
    assert list(view.cells(store)["problem"]) == ["", ""]
    assert there in view.cells(store).index


def test_what_is_damaged_is_kept_as_such_until_its_file_changes(store: Store, unreadable: list[str]) -> None:
    store.save(a_cell(0))
    store.path(f"{0:020x}").write_text("{")
    assert "not a whole cell" in view.cells(store)["problem"].iloc[0]
    unreadable.append(f"{0:020x}.json")  # nobody reads it again
    assert "not a whole cell" in view.cells(store)["problem"].iloc[0]


def test_a_view_with_a_flipped_bit_tells_what_the_cells_tell(store: Store) -> None:
    """Wherever the bit is: in a column that is looked at first, or in one that only the statistics are read from."""
    for i in range(3):
        store.save(a_cell(i, wall_s=1.0 + i))
    whole = view.summaries(store, ["rmse"]).drop(columns=["mtime_ns", "size"])
    (part,) = store.view.iterdir()
    content, seed = part.read_bytes(), secrets.randbits(32)
    print(f"seed {seed}")
    rng = random.Random(seed)
    for _ in range(60):
        for left in store.view.iterdir():
            left.unlink()
        at = rng.randrange(len(content))
        part.write_bytes(content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :])
        assert view.cells(store, ("wall_s",))["wall_s"].tolist() == [1.0, 2.0, 3.0]
        found = view.summaries(store, ["rmse"]).drop(columns=["mtime_ns", "size"])
        pd.testing.assert_frame_equal(found, whole)


def test_a_view_that_was_made_from_cells_of_another_format_is_made_anew(store: Store) -> None:
    """It would say of a file that is refused now what it held."""
    store.save(a_cell(0))
    view.cells(store)
    (part,) = store.view.iterdir()
    part.rename(store.view / f"2-{part.name}")
    path = store.path(f"{0:020x}")
    stamp = path.stat().st_mtime_ns
    path.write_bytes(b" " * path.stat().st_size)
    os.utime(path, ns=(stamp, stamp))
    assert "not a whole cell" in view.cells(store, ("problem",))["problem"].iloc[0]
    assert len(list(store.view.iterdir())) == 1
