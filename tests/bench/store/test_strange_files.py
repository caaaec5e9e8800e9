"""Whatever lies in a store: one line or a cell that every command can read, no wait, nothing touched outside of it."""

from __future__ import annotations

import copy
import json
import os
import stat
import uuid
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from stored import described, recorded, resealed, save, scored

from bench import InputError
from bench.commands import status
from bench.commands.reproduce import stored_as_cell
from bench.isolation.limit import limited
from bench.reporting.frame import Result
from bench.store import index as view
from bench.store.line import SCHEMA
from bench.store.line import described as described_in_a_line
from bench.store.seal import sealed
from bench.store.store import Store
from bench.store.stored import FORMAT, StoredCell

OWN = ("mtime_ns", "size", "problem")
"""What a line of the view says of the file, not of the cell."""
LONG_S = 20.0
"""What waits for ever is seen after this time; nothing here takes a second."""


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "rows")
    store.prepare()
    rows = scored("shooting", 5)
    save(store, {**described("shooting"), "settings": {"width": 3}}, rows, recorded(rows, True, True))
    return store


@pytest.fixture
def path(store: Store) -> Path:
    return store.path(store.identities()[0])


def content(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def set_to(value: Any, *keys: Any) -> Callable[[dict[str, Any]], Any]:
    """A change of a file's content: another value under some keys."""

    def change(whole: dict[str, Any]) -> None:
        for key in keys[:-1]:
            whole = whole[key]
        whole[keys[-1]] = value

    return change


SHAPES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "cell: 3": set_to(3, "cell"),
    "no rows": lambda whole: whole.pop("rows"),
    "no replicate": lambda whole: whole["rows"].update({key: [] for key in whole["rows"] if key != "scores"}),
    "a short column": lambda whole: whole["rows"]["message"].pop(),
    "a short score": lambda whole: whole["rows"]["scores"]["rmse"].pop(),
    "scores in a list": set_to([], "rows", "scores"),
    "an unknown status": set_to(["fine"] * 5, "rows", "status"),
    "a text for a number": set_to(["1"] * 5, "rows", "cpu_s"),
    "10^400": set_to([10**400] * 5, "rows", "scores", "rmse"),
    "10^400 as a seed": set_to(10**400, "cell", "seed"),
    "a truth for a number": set_to(True, "wall_s"),
    "summary of numbers": set_to({"rmse": 3}, "summary"),
    "a summary in a text": set_to("rmse", "summary"),
    "another cell": set_to("f" * 20, "identity"),
    "data in a list": set_to([], "cell", "data"),
    "a disturbance in a text": set_to("jitter", "cell", "data", "disturbance"),
    "prior of lists": set_to({"mass": []}, "cell", "told", "prior"),
    "limits in a list": set_to([], "provenance", "limits"),
    "recheck without replicates": set_to([{}], "provenance", "rechecked"),
    "a digest of numbers": set_to({"digest": 3}, "version"),
    "arrays elsewhere": set_to("../precious.npz", "arrays"),
    "arrays of the root": set_to("/etc/passwd", "arrays"),
}


@pytest.mark.parametrize("what", SHAPES)
def test_a_sealed_file_of_another_shape_is_one_line(store: Store, path: Path, what: str) -> None:
    whole = content(path)
    SHAPES[what](whole)
    path.write_bytes(resealed(whole))
    assert_one_line(store, path)


TEXTS = {
    "nested 10^5 deep": b'{"format":3,"cell":' + b"[" * 10**5,
    "nested 10^5 deep and closed": b'{"cell":' + b"[" * 10**5 + b"]" * 10**5 + b"}",
    "NaN": b'{"wall_s": NaN}',
    "a number of 10^5 digits": b'{"wall_s": ' + b"1" * 10**5 + b"}",
    "not UTF-8": b'{"wall_s": "\xff"}',
    "no JSON": b'{"wall_s": ',
}


@pytest.mark.parametrize("what", TEXTS)
@pytest.mark.parametrize("seal", [False, True])
def test_a_text_that_is_no_cell_is_one_line(store: Store, path: Path, what: str, seal: bool) -> None:
    text = TEXTS[what]
    if seal and "UTF-8" not in what:
        text = sealed(FORMAT, text.decode())
    path.write_bytes(text)
    assert_one_line(store, path)


def pipe(path: Path) -> None:
    os.mkfifo(path)


def loop(path: Path) -> None:
    path.symlink_to(path)


THINGS: dict[str, Callable[[Path], None]] = {
    "a pipe": pipe,
    "a folder": Path.mkdir,
    "a link to zeros": lambda path: path.symlink_to("/dev/zero"),
    "a link to itself": loop,
}


@pytest.mark.parametrize("what", THINGS)
@pytest.mark.parametrize("ending", [".json", ".npz", ".errors.txt"])
def test_what_is_no_file_is_one_line_at_once(store: Store, path: Path, what: str, ending: str) -> None:
    (cell,) = store
    named = {".json": path, ".npz": store.folder / cell.arrays, ".errors.txt": store.errors(cell)}[ending]
    named.unlink(missing_ok=True)
    THINGS[what](named)
    read: Callable[[], Any] = {
        ".json": lambda: list(store) and pytest.fail("it was read"),
        ".npz": lambda: store.arrays(cell),
        ".errors.txt": lambda: store.tracebacks(cell),
    }[ending]
    if what == "a link to itself" and ending != ".npz":
        with limited(LONG_S):  # as if it were not there
            assert not [*store.identities()] or ending == ".errors.txt" or not store.own(cell.identity)
        return
    with limited(LONG_S), pytest.raises(InputError) as caught:
        read()
    assert named.name in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_pipe_named_as_a_cell_does_not_stop_the_status(
    store: Store, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe(store.path("0" * 20))
    with limited(LONG_S):
        assert status.main([f"store={store.folder}"]) == 0
    assert "1 damaged" in capsys.readouterr().out


def test_a_name_that_is_not_utf_8_is_no_cell_s(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    with open(os.fsencode(store.folder) + b"/\xff.json", "wb") as file:
        file.write(b"{}")
    assert len(store.identities()) == 1
    assert status.main([f"store={store.folder}"]) == 0
    assert "1 cells" in capsys.readouterr().out


def assert_one_line(store: Store, path: Path) -> None:
    before = path.read_bytes()
    with limited(LONG_S), pytest.raises(InputError) as caught:
        store.load(path.stem)
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert view.cells(store, ("problem",))["problem"].tolist() == [str(caught.value)]
    assert path.read_bytes() == before


# ---- whatever another hand has sealed

JUNK = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**70), 2**70)
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from(["nan", "inf", "sdof", "known", "drawn", 10**400, -1, 0]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


def places(value: Any, *above: Any) -> Iterator[tuple[Any, ...]]:
    """The keys to everything in a JSON value."""
    if above:
        yield above
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inner:
        yield from places(item, *above, key)


def one_line_or(read: Callable[[], Any]) -> tuple[str, Any]:
    """What is read, or the one line that says why it cannot be."""
    try:
        return "", read()
    except InputError as error:
        said = str(error)
    assert len(said.splitlines()) == 1
    return said, None


def read_all(cell: StoredCell) -> None:
    """What commands do with any cell of a store; none is left out for what it says."""
    result = Result.of_stored(cell)
    for name in dir(Result):
        if isinstance(getattr(Result, name), property) and name not in ("model", "scenario"):
            getattr(result, name)
    for name in ("question", "series", "statuses", "n_ok", "ok", "cpu_s", "known_model"):
        getattr(result, name)
    pa.Table.from_pylist([described_in_a_line(cell)], pa.schema([field for field in SCHEMA if field.name not in OWN]))
    for metric in cell.summary:
        result.errors(metric)
        result.statistic(metric, "mean")
    assert cell.status in result.statuses
    one_line_or(lambda: stored_as_cell(cell))


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_what_another_hand_has_sealed_is_one_line_or_can_be_read(store: Store, path: Path, data: st.DataObject) -> None:
    whole = path.read_bytes()
    changed = copy.deepcopy(content(path))
    at = data.draw(st.sampled_from(list(places(changed))))
    set_to(data.draw(JUNK), *at)(changed)
    try:
        path.write_bytes(resealed(changed))
        said, cell = one_line_or(lambda: store.load(path.stem))
        assert bool(said) == (cell is None)
        if cell is not None:
            read_all(cell)
    finally:
        path.write_bytes(whole)


# ---- what a store does to others' files


def test_arrays_named_by_a_damaged_cell_are_never_removed_elsewhere(store: Store, path: Path, tmp_path: Path) -> None:
    (cell,) = store
    precious = tmp_path / "precious.npz"
    precious.write_bytes(b"precious")
    path.write_bytes(resealed({**content(path), "arrays": "../precious.npz"}))
    store.save(cell, {})
    assert precious.read_bytes() == b"precious"


@pytest.fixture
def known_names(monkeypatch: pytest.MonkeyPatch) -> str:
    """Names that are drawn, as somebody who guesses them would know them."""
    monkeypatch.setattr(uuid, "uuid4", lambda: uuid.UUID(int=7))
    return uuid.UUID(int=7).hex


def test_no_write_goes_through_a_link_that_somebody_has_left(store: Store, tmp_path: Path, known_names: str) -> None:
    (cell,) = store
    mine = tmp_path / "mine"
    mine.write_text("mine")
    for name in (f"write-test.{known_names}.tmp", f"{cell.identity}.json.{known_names}.tmp"):
        (store.folder / name).symlink_to(mine)
    with pytest.raises(InputError, match="cannot be written"):
        store.prepare()
    with pytest.raises(OSError, match="exists"):
        store.save(cell)
    assert mine.read_text() == "mine"


def test_a_cell_takes_the_place_of_a_link_and_not_of_what_it_points_to(store: Store, tmp_path: Path) -> None:
    (cell,) = store
    mine = tmp_path / "mine"
    mine.write_text("mine")
    for path in (store.path(cell.identity), store.folder / cell.arrays, store.errors(cell)):
        path.unlink(missing_ok=True)
        path.symlink_to(mine)
    store.save(cell, recorded(scored("shooting", 5), True, True), "Traceback")
    assert mine.read_text() == "mine"
    assert not any(path.is_symlink() for path in store.folder.iterdir())
    assert store.damage(cell.identity) == ""


@pytest.mark.parametrize("mask", [0o002, 0o022, 0o077])
def test_files_have_the_rights_that_the_umask_leaves(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        store = Store(tmp_path / "rows")
        store.prepare()
        rows = scored("shooting", 5)
        save(store, described("shooting"), rows, recorded(rows, True, True))
        view.cells(store)
    finally:
        os.umask(before)
    files = [path for path in store.folder.rglob("*") if path.is_file()]
    assert {path.suffix for path in files} == {".json", ".npz", ".parquet"}
    assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o666 & ~mask}
    assert stat.S_IMODE(store.folder.stat().st_mode) == 0o777 & ~mask
