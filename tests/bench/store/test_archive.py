"""The published archive: what comes out is what went in, to the last bit, and a user's own cells stand before it."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import InputError, Status
from bench.commands.publish import Described, publish
from bench.config.experiment import expand
from bench.run.pool import Limits
from bench.scoring.row import Row
from bench.store import index as view
from bench.store import line
from bench.store.archive import curves
from bench.store.archive.archive import Archive
from bench.store.archive.decimals import from_codes, listed, to_codes
from bench.store.archive.part import Part
from bench.store.bound_file import bound_file, bound_text
from bench.store.opening import VARIABLE, open_store
from bench.store.store import Store
from bench.store.stored import StoredCell, cell_file
from bench.sweep.launch import complete

NAN, INF = math.nan, math.inf
ODD = ("", "größer", "a\nline", '"quoted"', "\u2028 \U0001f600", "nan", "null", "0")
SPECIAL = (0.0, INF, -INF, NAN, 1.0, 0.5, 1e-300, 1e300, 5e-324, -123.456, 99999.95, 999999.0)


def rounded(value: float) -> float:
    """To the six digits of a stored number."""
    return float(f"{value:.6g}")


def score_rows(rng: np.random.Generator, n: int) -> list[dict[str, float]]:
    """Scores as methods have them, some of a wild kind, some of which replicates lack."""
    rows = []
    for _ in range(n):
        m, group = 1 + rng.normal(0, 0.03), 1 + rng.normal(0, 0.01)
        scores: dict[str, float] = {}
        for name, ratio in (("m", m), ("k_over_m", group), ("k", m * group), ("natural_frequency", math.sqrt(group))):
            scores |= {f"{name}_error_pct": 100 * abs(ratio - 1), f"{name}_ratio": ratio}
            scores |= {f"{name}_pit": rng.uniform(), f"{name}_coverage_95": float(rng.integers(2))}
            scores |= {f"{name}_interval_score_pct": rng.lognormal(), f"{name}_crps_pct": float(rng.choice(SPECIAL))}
        scores |= {"rmse": rng.lognormal(), "other.kind": float(rng.choice(SPECIAL)), "x_ratio": 2.0, "y_crps_pct": 3.0}
        names = [name for name in scores if rng.uniform() > 0.05]
        rows.append({name: rounded(scores[name]) for name in names} if rng.uniform() > 0.1 else {})
    return rows


def random_cell(seed: int, **changes: Any) -> StoredCell:
    """A cell as a store would have it, of whatever a seed draws."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 12))
    rows = tuple(
        Row(
            i, Status.OK if scores else Status.TIMEOUT, str(rng.choice(ODD)), scores,
            *(rounded(float(v)) for v in rng.choice([0.123456, NAN, 3.0, 17.5], 3)), int(rng.integers(10**12)), "ab" * 8
        )
        for i, scores in enumerate(score_rows(rng, n))
    )  # fmt: skip
    metrics = sorted({name for row in rows for name in row.scores})
    keys = (*line.STATISTICS, "n_ok")
    summary = {name: {key: rounded(float(rng.choice(SPECIAL))) for key in keys} for name in metrics}
    cell = StoredCell(
        identity=f"{seed:020x}",
        cell={
            "method": "ls", "label": str(rng.choice(["ls", "pinn"])), "system": "sdof", "snr_db": 20.0, "seed": 0,
            "initial_state": "known", "third": 1.0 / 3.0, "odd": list(ODD), "data": {"system": "sdof"}, "none": None,
        },
        rows=rows,
        summary=summary,
        prior_share={"m": 0.999, "c": NAN},
        identifiable={"m": False},
        wall_s=1.5,
        provenance={"started": "2026", "text": ODD[4], "limits": {"timeout_s": 3.0}},
        version={"digest": "abc", "modules": {"bench": "1"}, "packages": {}},
    )  # fmt: skip
    return replace(cell, **changes)


def random_arrays(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 9, 400).astype("f4")
    smooth = np.exp(-0.2 * t) * np.cos(5 * t + rng.uniform())
    return {
        "dense_times": t, "displacement": np.stack([smooth, 2 * smooth]).astype("f4"), "empty": np.empty(0, "f4"),
        "noise": rng.normal(size=50).astype("f4"),
        "sample_dof": np.repeat([0, 1], 5), "point": np.float32(2.5).reshape(()),
        "special": np.array([0.0, -0.0, INF, NAN, 1e-45] * 5, "f4"), "zeros": np.zeros(30, "f4"),
    }  # fmt: skip


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Twelve cells, some with arrays and tracebacks, one of which the columns cannot hold; and a bound."""
    store = Store(tmp_path / "rows")
    store.prepare()
    for seed in range(12):
        arrays = random_arrays(seed % 3) if seed % 2 else None
        store.save(random_cell(seed), arrays, "Traceback\n  größer\n" if seed == 5 else "")
    store.save(random_cell(12, summary={"rmse": {"mean": 1.0, "another": 2.0}}), {"flags": np.array([True, False])})
    store.bounds.mkdir()
    (store.bounds / "0123.bound").write_bytes(bound_file('{"rmse": 0.1234567890123456}'))
    (store.bounds / "0124.bound").write_text('{"rmse": 0.1234567890123456}')  # without a checksum
    return store


PLACES = {f"{seed:020x}": f"table{seed % 3}" for seed in range(12)}


@pytest.fixture
def archive(store: Store, tmp_path: Path) -> Archive:
    archive = Archive(tmp_path / "archive")
    archive.folder.mkdir()
    publish(store, archive, Described(PLACES))
    return Archive(archive.folder)


def contents(archive: Archive) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(archive.folder.iterdir())}


def test_every_cell_comes_back_as_its_file_is(store: Store, archive: Archive) -> None:
    assert archive.identities() == store.identities()
    for identity in store.identities():
        one, two = store.load(identity), archive.load(identity)
        assert one is not None
        assert two is not None
        assert cell_file(two) == cell_file(replace(one, errors=""))  # tracebacks stand in the same file
        assert [str(dict(row.scores)) for row in two.rows] == [str(dict(row.scores)) for row in one.rows]
        assert pickle.loads(pickle.dumps(two)).rows[0].scores.keys() == one.rows[0].scores.keys()
        arrays = store.arrays(one)
        back = archive.arrays(identity)
        assert back.keys() == arrays.keys()
        for name, values in arrays.items():
            assert (back[name].dtype, back[name].shape) == (values.dtype, values.shape)
            assert back[name].tobytes() == values.tobytes()
        assert archive.tracebacks(identity) == store.tracebacks(one)
    assert archive.bounds() == {"0123": '{"rmse": 0.1234567890123456}'}
    assert archive.load("nobody") is None


def test_of_drawn_scenarios_rows_are_published_and_curves_are_not(store: Store, tmp_path: Path) -> None:
    folder = tmp_path / "drawn"
    folder.mkdir()
    publish(store, Archive(folder), Described(PLACES, drawn=("table1",)))
    found = Archive(folder)
    for identity in store.identities():
        before, after = store.load(identity), found.load(identity)
        assert before is not None
        assert after is not None
        drawn = PLACES.get(identity) == "table1"
        assert found.arrays(identity).keys() == ({} if drawn else store.arrays(before)).keys()
        assert cell_file(after) == cell_file(replace(before, errors="", **({"arrays": ""} if drawn else {})))


def test_bounds_that_no_experiment_uses_are_not_published(store: Store, tmp_path: Path) -> None:
    folder = tmp_path / "used"
    folder.mkdir()
    (store.bounds / "4567.bound").write_bytes(bound_file('{"rmse": 1.0}'))
    publish(store, Archive(folder), Described(PLACES, bounds=("0123",)))
    assert list(Archive(folder).bounds()) == ["0123"]


def test_a_cell_that_columns_cannot_hold_is_kept_whole(archive: Archive) -> None:
    whole = archive.parts["other"].line(0, ("whole", "npz"))
    assert json.loads(whole["whole"])["summary"] == {"rmse": {"mean": 1.0, "another": 2.0}}
    assert archive.arrays(f"{12:020x}")["flags"].tolist() == [True, False]


def test_six_digits_are_integers_in_order() -> None:
    rng = np.random.default_rng(0)
    drawn = np.concatenate([10.0 ** rng.uniform(-320, 308, 3000), 10.0 ** rng.uniform(-9, 9, 20000)])
    values = np.array([rounded(v) for v in (*drawn, *-drawn, *SPECIAL)])
    codes = to_codes(values)
    np.testing.assert_array_equal(from_codes(codes), values)
    finite = np.isfinite(values)
    order = np.argsort(values[finite], kind="stable")
    assert np.all(np.diff(codes[finite][order]) >= 0)
    assert to_codes(np.array([1.23457]))[0] - to_codes(np.array([1.23456]))[0] == 1
    with pytest.raises(ValueError, match="six digits"):
        listed([0.12345678])


def test_curves_come_back_to_the_last_bit_and_smooth_ones_are_small() -> None:
    rng = np.random.default_rng(1)
    t = np.linspace(0, 10, 1000)
    shapes = [np.sin(t), 1e-20 * np.sin(t), np.exp(3 * t), t, rng.normal(size=1000), np.r_[0.0, np.sin(t)]]
    for values in (np.array(shape, "f4") for shape in shapes):
        order, exponent, finer_bits, steps, finer = curves.taken(values)
        assert curves.restored(order, exponent, finer_bits, steps, finer).tobytes() == values.tobytes()
    order, *_, steps, _ = curves.taken(np.sin(t).astype("f4"))
    assert order > 2
    assert np.median(np.abs(steps)) < 2**12  # of 24 bits


def test_the_same_cells_are_the_same_bytes_and_are_not_written_again(store: Store, archive: Archive) -> None:
    before = contents(archive)
    times = {path: path.stat().st_mtime_ns for path in archive.folder.iterdir()}
    assert publish(store, Archive(archive.folder), Described(PLACES)) == []
    assert times == {path: path.stat().st_mtime_ns for path in archive.folder.iterdir()}
    for path in archive.folder.iterdir():
        path.unlink()
    publish(store, Archive(archive.folder), Described(PLACES))
    assert contents(archive) == before


def test_a_changed_cell_changes_its_own_file_alone(store: Store, archive: Archive, tmp_path: Path) -> None:
    before = contents(archive)
    other = Store(tmp_path / "other")  # that holds nothing else: the archive keeps what it has
    other.prepare()
    changed = replace(random_cell(4), wall_s=7.0)
    other.save(changed)
    assert [path.name for path in publish(other, Archive(archive.folder), Described(PLACES))] == ["table1.parquet"]
    after = contents(archive)
    assert {name for name in after if after[name] != before[name]} == {"table1.parquet"}
    again = Archive(archive.folder)
    assert again.identities() == store.identities()
    assert again.load(changed.identity).wall_s == 7.0  # type: ignore[union-attr]


def test_what_stands_elsewhere_now_leaves_no_file_behind(store: Store, archive: Archive) -> None:
    publish(store, Archive(archive.folder), Described())
    assert sorted(contents(archive)) == ["bounds.parquet", "other.parquet"]
    assert Archive(archive.folder).identities() == store.identities()


@pytest.mark.parametrize("what", ["arrays", "table"])
def test_a_write_that_fails_leaves_the_file_of_before(
    store: Store, archive: Archive, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """What is written does not come back as it is."""
    before = contents(archive)
    store.save(replace(random_cell(4), wall_s=7.0))
    read = Part.table
    wrong = {"arrays": lambda self, line: {}, "table": lambda self, names: read(self, names).slice(1)}
    monkeypatch.setattr(Part, what, wrong[what])
    with pytest.raises(ValueError, match="not come back"):
        publish(store, Archive(archive.folder), Described(PLACES))
    assert contents(archive) == before


@pytest.mark.parametrize("what", ["cut", "empty", "changed", "text"])
def test_a_damaged_file_is_one_line(archive: Archive, what: str) -> None:
    path = archive.folder / "table1.parquet"
    whole = path.read_bytes()
    middle = len(whole) // 3
    damaged = {
        "cut": whole[: len(whole) // 2], "empty": b"", "text": b"not a table",
        "changed": whole[:middle] + bytes(255 - b for b in whole[middle : middle + 400]) + whole[middle + 400 :],
    }  # fmt: skip
    path.write_bytes(damaged[what])
    with pytest.raises(InputError, match="not a whole file of the archive") as error:  # noqa: PT012
        again = Archive(archive.folder)
        for identity in again.identities():
            for row in again.load(identity).rows:  # type: ignore[union-attr]
                dict(row.scores)
            again.arrays(identity)
    assert "\n" not in str(error.value)


def test_an_archive_of_another_format_is_refused(archive: Archive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.store.archive.checked.FORMAT", 3)
    with pytest.raises(InputError, match="an archive of format 2, this version reads 3; fetch the archive again"):
        Archive(archive.folder).identities()


def test_a_store_lies_over_the_archive(store: Store, archive: Archive, tmp_path: Path) -> None:
    both = Store(tmp_path / "mine", archive)
    assert both.there()
    assert both.identities() == store.identities()  # before the folder is there
    identity = f"{4:020x}"
    assert both.whereabouts(identity) == f"published archive: {archive.folder / 'table1.parquet'}"
    both.prepare()
    both.save(replace(random_cell(4), wall_s=7.0, version={"digest": "new"}))
    both.save(random_cell(99))
    assert both.whereabouts(identity) == f"full result: {both.path(identity)}"
    assert both.load(identity).wall_s == 7.0  # type: ignore[union-attr]
    assert len(list(both)) == 14
    lines = view.cells(both, ("version", "wall_s", "problem"))
    assert lines.index.tolist() == both.identities()
    assert lines.loc[identity, "version"] == "new"
    assert set(lines["problem"]) == {""}
    assert both.stamp(f"{3:020x}") == 0  # nothing has been stored there


def test_the_view_of_the_archive_is_that_of_its_cells(store: Store, archive: Archive, tmp_path: Path) -> None:
    both = Store(tmp_path / "mine", archive)
    plain = [name for name in line.PLAIN if name not in ("identity", "mtime_ns", "size")]
    one, two = (view.cells(s, (*plain, *line.STATISTICS)) for s in (store, both))
    for name in one.columns:
        assert [_plain(v) for v in one[name]] == [_plain(v) for v in two[name]], name
    one, two = (view.summaries(s, ["rmse", "m_error_pct"]).drop(columns=["mtime_ns", "size"]) for s in (store, both))
    assert one.astype(str).equals(two.astype(str))


def _plain(value: Any) -> str:
    return str([float(v) for v in value]) if isinstance(value, np.ndarray) else str(value)


def test_a_cell_of_the_archive_that_is_restated_is_whole_in_the_store(
    store: Store, archive: Archive, tmp_path: Path
) -> None:
    both = Store(tmp_path / "mine", archive)
    cell = both.load(f"{5:020x}")
    assert cell is not None
    both.restate(replace(cell, provenance={"rechecked": []}))
    alone = Store(tmp_path / "mine")
    found = alone.load(cell.identity)
    assert found is not None
    assert found.provenance == {"rechecked": []}
    assert alone.arrays(found).keys() == random_arrays(0).keys()
    assert alone.tracebacks(found) == "Traceback\n  größer\n"


def test_bounds_are_fetched_from_the_archive(archive: Archive, tmp_path: Path) -> None:
    both = Store(tmp_path / "mine", archive)
    both.fetch_bounds({"0123", "unknown"})
    assert [path.name for path in both.bounds.iterdir()] == ["0123.bound"]
    assert bound_text((both.bounds / "0123.bound").read_bytes()) == '{"rmse": 0.1234567890123456}'


def test_the_archive_is_named_by_field_or_environment(archive: Archive, monkeypatch: pytest.MonkeyPatch) -> None:
    assert open_store("x").archive is None  # the tests' environment says so
    monkeypatch.setenv(VARIABLE, str(archive.folder))
    assert open_store("x").archive.folder == archive.folder  # type: ignore[union-attr]
    assert open_store("x", "none").archive is None
    with pytest.raises(InputError, match="no such folder"):
        open_store("x", "nowhere")
    assert pickle.loads(pickle.dumps(Store(Path("x"), archive))).archive.identities() == archive.identities()


@pytest.mark.usefixtures("any_bound")
def test_a_cell_gives_way_to_one_that_asks_the_same_of_more_replicates(tmp_path: Path) -> None:
    """As soon as that one is stored; settings at their defaults, named or not, ask the same."""
    store, archive = Store(tmp_path / "rows"), Archive(tmp_path / "archive")
    store.prepare()
    archive.folder.mkdir()
    few, more = (expand(["method=prior", f"replicates={n}"], multirun=False)[0].cell() for n in (3, 4))
    asked = Described({more.identity: "table1"}, {more.question: more.identity})
    for cell, kept in ((few, [few.identity]), (more, [more.identity])):
        complete([cell], store, Limits(1, 60.0))
        publish(store, archive, asked)
        archive = Archive(archive.folder)
        assert archive.identities() == kept
