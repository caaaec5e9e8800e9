"""The published archive: what comes out is what went in, pandas reads it, and a user's own cells stand before it."""

from __future__ import annotations

import hashlib
import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from conftest import damaged
from stored import VERSION

from bench import InputError, Status
from bench.exchange.publishing import Described, write_published
from bench.scoring.row import STATISTICS, Row
from bench.store.archive import Archive
from bench.store.cell_file import cell_file
from bench.store.digits import binary, decimal
from bench.store.publication import ARRAY_BITS
from bench.store.seal import sealed, unsealed_text
from bench.store.store import BOUND_FORMAT, VARIABLE, Store, open_store
from bench.store.stored_cell import StoredCell

NAN, INF = math.nan, math.inf
ODD = ("", "größer", "a\nline", '"quoted"', "\u2028 \U0001f600", "nan", "null", "0")
SPECIAL = (0.0, INF, -INF, 1.0, 0.5, 1e-12, 1e-30, 1e18, -123.456, 99999.9, 999999.0)
FLIPS = 400


def five_digits(value: float) -> float:
    return float(f"{value:.5g}")


def random_cell(seed: int, **changes: Any) -> StoredCell:
    """A cell as a store would have it, of whatever a seed draws; replicates lack some scores."""
    rng = np.random.default_rng(seed)
    rows = []
    for i in range(int(rng.integers(1, 12))):
        scores = {
            name: five_digits(rng.lognormal(0, 3)) for name in ("m_error_pct", "m_pit", "rmse") if rng.random() > 0.1
        }
        scores |= {"wild": float(rng.choice(SPECIAL)), f"own_{seed}": 1e300}
        ok = rng.random() > 0.2
        times = [five_digits(float(v)) for v in rng.choice([0.12346, NAN, 3.0, 17.5], 3)]
        rows.append(
            Row(i, Status.OK if ok else Status.TIMEOUT, str(rng.choice(ODD)), scores if ok else {}, *times, seed, "ab")
        )
    summary = {name: {key: five_digits(rng.lognormal()) for key in STATISTICS} for name in ("rmse", "m_error_pct")}
    cell = StoredCell(
        identity=f"{seed:020x}",
        cell={
            "method": "ls", "label": str(rng.choice(["ls", "pinn"])), "system": "sdof", "snr_db": 20.0, "seed": 0,
            "initial_state": "known", "third": 1.0 / 3.0, "odd": list(ODD), "data": {"system": "sdof"}, "none": None,
        },
        rows=tuple(rows), summary=summary, prior_share={"m": 0.999}, identifiable={"m": False}, wall_s=1.5,
        provenance={"started": "2026", "text": ODD[4], "limits": {"timeout_s": 3.0}}, version=dict(VERSION),
    )  # fmt: skip
    return replace(cell, **changes)


def random_arrays(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "noise": rng.normal(size=50).astype("f4"), "empty": np.empty(0, "f4"),
        "special": np.array([0.0, INF, -INF], "f4"),
        "sample_dof": np.repeat([0, 1], 5), "point": np.float32(2.5).reshape(()), "shared": np.ones((2, 30), "f4"),
    }  # fmt: skip


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Twelve cells, some with arrays, one with tracebacks, one of a class of another package, and a bound."""
    store = Store(tmp_path / "rows")
    store.prepare()
    for seed in range(12):
        arrays, tracebacks = random_arrays(seed) if seed % 2 else {}, "Traceback\n  größer\n" if seed == 5 else ""
        version = {**VERSION, "optimizer lion_pinn:Lion": 3} if seed == 7 else VERSION
        store.save(random_cell(seed, arrays=arrays, tracebacks=tracebacks, version=dict(version)))
    store.bounds.mkdir()
    (store.bounds / "0123.bound").write_bytes(sealed(BOUND_FORMAT, '{"rmse": 0.1234567890123456}'))
    (store.bounds / "0124.bound").write_text('{"rmse": 0.1234567890123456}')  # without a checksum
    return store


PLACES = {f"{seed:020x}": f"table{seed % 3}" for seed in range(12)}


@pytest.fixture
def archive(store: Store, tmp_path: Path) -> Archive:
    folder = tmp_path / "archive"
    write_published(store, Archive(folder), Described(PLACES))
    return Archive(folder)


def contents(archive: Archive) -> dict[str, bytes]:
    files = (path for path in sorted(archive.folder.rglob("*")) if path.is_file())
    return {path.relative_to(archive.folder).as_posix(): path.read_bytes() for path in files}


def test_every_cell_comes_back_as_it_is(store: Store, archive: Archive) -> None:
    assert archive.identities() == store.identities()
    for identity in store.identities():
        before, after = store.load(identity), archive.load(identity)
        assert before is not None
        assert after is not None
        assert [repr(dict(sorted(row.scores.items()))) for row in after.rows] == [
            repr(dict(sorted(row.scores.items()))) for row in before.rows
        ]
        bare = [replace(c, arrays={}, rows=tuple(replace(r, scores={}) for r in c.rows)) for c in (before, after)]
        assert cell_file(bare[0]) == cell_file(bare[1])
        assert (after.n_ok, after.status, bool(after.arrays)) == (before.n_ok, before.status, bool(before.arrays))
        assert archive.head(identity) == replace(store.head(identity), stamp=0)  # type: ignore[type-var]
        arrays, back = before.arrays, after.arrays
        assert back.keys() == arrays.keys()
        for name, values in arrays.items():
            assert (back[name].dtype, back[name].shape) == (values.dtype, values.shape)
            np.testing.assert_allclose(back[name], values, rtol=2.0**-ARRAY_BITS)
    assert archive.bounds() == {"0123": '{"rmse": 0.1234567890123456}'}
    assert archive.load("nobody") is None


def test_pandas_reads_every_file(store: Store, archive: Archive) -> None:
    cells = pd.read_parquet(archive.folder / "cells.parquet")
    assert set(cells["identity"]) == set(store.identities())
    rows = pd.concat([pd.read_parquet(path) for path in (archive.folder / "rows").iterdir()])
    assert len(rows) == cells["replicates"].sum() == sum(len(cell.rows) for cell in store)
    assert (rows["status"] == "ok").sum() == cells["n_ok"].sum()
    expected = [row.scores["rmse"] for cell in store for row in cell.rows if "rmse" in row.scores]
    assert sorted(rows["rmse"].dropna()) == pytest.approx(sorted(expected), rel=1e-5)
    assert len(pd.read_parquet(archive.folder / "summaries.parquet")) == 24
    for line in (archive.folder / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split("  ")
        assert hashlib.sha256((archive.folder / name).read_bytes()).hexdigest() == digest


def test_five_digits_come_back_exactly() -> None:
    rng = np.random.default_rng(0)
    values = np.array([five_digits(v) for v in 10.0 ** rng.uniform(-14, 19, 50_000)])
    single = binary(values).astype(np.float32)
    assert np.array_equal(decimal(single.astype(float)), values)
    assert np.array_equal(
        decimal(np.array([0.0, -INF, INF, -1.5, 1.23456789e-30, 1.23456789e306])),
        [0.0, -INF, INF, -1.5, 1.2346e-30, 1.2346e306],
    )


def test_curves_of_drawn_scenarios_and_bounds_that_no_experiment_uses_are_not_published(
    store: Store, tmp_path: Path
) -> None:
    (store.bounds / "4567.bound").write_bytes(sealed(BOUND_FORMAT, '{"rmse": 1.0}'))
    write_published(store, Archive(tmp_path / "drawn"), Described(PLACES, drawn=("table1",), bounds=("0123",)))
    found = Archive(tmp_path / "drawn")
    assert list(found.bounds()) == ["0123"]
    for cell in store:
        drawn = PLACES.get(cell.identity) == "table1"
        published = found.load(cell.identity)
        assert published is not None
        assert published.arrays.keys() == ({} if drawn else cell.arrays).keys()
        assert len(published.rows) == len(cell.rows)


def test_the_same_cells_are_the_same_bytes_and_are_not_written_again(store: Store, archive: Archive) -> None:
    before = contents(archive)
    assert write_published(store, Archive(archive.folder), Described(PLACES)) == []
    nothing = Store(store.folder.parent / "nothing")
    assert write_published(nothing, Archive(archive.folder), Described(PLACES)) == []
    assert contents(archive) == before


def test_a_changed_cell_changes_its_own_rows_alone(store: Store, archive: Archive, tmp_path: Path) -> None:
    before = contents(archive)
    other = Store(tmp_path / "other")  # that holds nothing else: the archive keeps what it has
    other.prepare()
    changed = replace(random_cell(4), wall_s=7.0, rows=random_cell(77).rows)
    other.save(changed)
    write_published(other, Archive(archive.folder), Described(PLACES))
    after = contents(archive)
    assert {name for name in after if after[name] != before[name] and "rows/" in name} == {"rows/table1.parquet"}
    again = Archive(archive.folder)
    assert again.identities() == store.identities()
    assert again.load(changed.identity).wall_s == 7.0  # type: ignore[union-attr]
    write_published(other, again, Described({changed.identity: "table7"}))
    assert {name for name in contents(archive) if "rows/" in name} == {"rows/table7.parquet"}
    assert Archive(archive.folder).identities() == [changed.identity]  # no experiment describes the others


def test_a_write_that_fails_leaves_the_archive_of_before(
    store: Store, archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(archive)
    store.save(replace(random_cell(4), wall_s=7.0))

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_published(store, Archive(archive.folder), Described(PLACES))
    assert contents(archive) == before


def read_all(folder: Path) -> None:
    archive = Archive(folder)
    for identity in archive.identities():
        cell = archive.load(identity)
        assert cell is not None
        dict(cell.arrays)
    archive.bounds()


@pytest.mark.slow
def test_every_flipped_bit_is_noticed(archive: Archive) -> None:
    files = [archive.folder / name for name in contents(archive)]
    assert len(files) == 8
    for _ in damaged(files, FLIPS):
        with pytest.raises(InputError, match=r"^archive=") as error:
            read_all(archive.folder)
        assert "\n" not in str(error.value)
    read_all(archive.folder)
    (archive.folder / "SHA256SUMS").unlink()
    with pytest.raises(InputError, match="SHA256SUMS is missing"):
        read_all(archive.folder)


def test_a_store_lies_over_the_archive(store: Store, archive: Archive, tmp_path: Path) -> None:
    both = Store(tmp_path / "mine", archive)
    assert both.exists()
    assert both.identities() == store.identities()  # before the folder is there
    identity = f"{4:020x}"
    assert both.location(identity) == f"published archive: {archive.folder / 'rows' / 'table1.parquet'}"
    both.prepare()
    both.save(replace(random_cell(4), wall_s=7.0))
    both.save(random_cell(99))
    assert both.location(identity) == f"full result: {both.path(identity)}"
    assert both.load(identity).wall_s == both.head(identity).wall_s == 7.0  # type: ignore[union-attr]
    assert len(list(both)) == 13
    assert [head.identity for head in both.heads()] == both.identities()
    assert both.stamp(f"{3:020x}") == 0  # nothing has been stored there
    both.fetch_bounds({"0123", "unknown"})
    assert [path.name for path in both.bounds.iterdir()] == ["0123.bound"]
    assert unsealed_text(BOUND_FORMAT, (both.bounds / "0123.bound").read_bytes()) == '{"rmse": 0.1234567890123456}'


def test_the_archive_is_named_by_field_or_environment(archive: Archive, monkeypatch: pytest.MonkeyPatch) -> None:
    assert open_store("x").archive is None  # the tests' environment says so
    monkeypatch.setenv(VARIABLE, str(archive.folder))
    assert open_store("x").archive.folder == archive.folder  # type: ignore[union-attr]
    assert open_store("x", "none").archive is None
    with pytest.raises(InputError, match="folder not found"):
        open_store("x", "nowhere")
    assert pickle.loads(pickle.dumps(Store(Path("x"), archive))).archive.identities() == archive.identities()
    cell = archive.load(f"{4:020x}")
    assert repr(pickle.loads(pickle.dumps(cell)).rows) == repr(tuple(cell.rows))  # type: ignore[union-attr]
