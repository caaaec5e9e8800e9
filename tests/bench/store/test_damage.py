"""Whatever lies in a store is one line or a cell that every command can read; no changed bit passes for a result."""

from __future__ import annotations

import base64
import copy
import io
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import damaged
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from stored import content, described, recorded, resealed, save, scored

from bench import InputError
from bench.commands import status
from bench.isolation.limits import limited
from bench.reporting.frame import Result
from bench.store.cell import stored_as_cell
from bench.store.cell_file import FORMAT
from bench.store.seal import sealed
from bench.store.store import Store
from bench.store.stored_cell import StoredCell

FLIPS = 400
LONG_S = 20.0
"""A read that waits for ever is seen after this time; nothing here takes a second."""


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Two cells with arrays and tracebacks, of different methods."""
    store = Store(tmp_path / "rows")
    store.prepare()
    for label in ("shooting", "pinn"):
        rows = scored(label, 5)
        described_cell = {**described(label), "settings": {"width": 3}}
        save(store, described_cell, rows, recorded(rows, True, True), tracebacks=f"replicate 3\nTraceback of {label}\n")
    return store


@pytest.fixture
def path(store: Store) -> Path:
    return store.path(store.identities()[0])


def read(store: Store) -> list[tuple[StoredCell, dict[str, np.ndarray]]]:
    """All that a reader takes from a store."""
    return [(cell, dict(cell.arrays)) for cell in store]


def test_every_flipped_bit_of_a_cell_is_noticed(store: Store) -> None:
    whole = str(read(store))
    files = sorted(store.folder.iterdir())
    assert [path.suffix for path in files] == [".json", ".json"]
    for path in damaged(files, FLIPS):
        with pytest.raises(InputError) as caught:
            read(store)
        assert path.name in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1
    assert str(read(store)) == whole


def set_to(value: Any, *keys: Any) -> Callable[[dict[str, Any]], Any]:
    """A change of a file's content: another value under some keys."""

    def change(whole: dict[str, Any]) -> None:
        for key in keys[:-1]:
            whole = whole[key]
        whole[keys[-1]] = value

    return change


SHAPES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "no rows": lambda whole: whole.pop("rows"),
    "a short column": lambda whole: whole["rows"]["message"].pop(),
    "an unknown status": set_to(["fine"] * 5, "rows", "status"),
    "10^400 as a seed": set_to(10**400, "cell", "seed"),
    "a version of texts": set_to({"method": "new"}, "version"),
}
TEXTS = {
    "nested 10^5 deep": '{"cell":' + "[" * 10**5 + "]" * 10**5 + "}",
    "NaN": '{"wall_s": NaN}',
    "a number of 10^5 digits": '{"wall_s": ' + "1" * 10**5 + "}",
}
FOREIGN = {
    "binary": b"\x80\x04\x95\xff\xfe",
    "foreign": b'{"name": "package", "version": "1.0"}',
    "another format": b'{"format": 99, "identity": "0123456789abcdef0123"}',
}


@pytest.mark.parametrize("what", [*SHAPES, *TEXTS, *FOREIGN, "another cell"])
def test_a_file_of_another_shape_is_one_line_and_left_alone(store: Store, path: Path, what: str) -> None:
    whole = content(path)
    if what in SHAPES:
        SHAPES[what](whole)
        path.write_bytes(resealed(whole))
    elif what in TEXTS:
        path.write_bytes(sealed(FORMAT, TEXTS[what]))
    else:
        path.write_bytes(FOREIGN.get(what) or store.path(store.identities()[1]).read_bytes())
    before = path.read_bytes()
    with limited(LONG_S), pytest.raises(InputError) as caught:
        store.load(path.stem)
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert path.read_bytes() == before


def pickled() -> bytes:
    """An npz whose array would run code where it is unpickled."""
    file = io.BytesIO()
    np.savez(file, times=np.array([print], object))
    return file.getvalue()


@pytest.mark.parametrize("npz", [b"nothing", pickled()], ids=["no npz", "pickled"])
def test_arrays_of_another_hand_are_one_line_when_they_are_read(store: Store, path: Path, npz: bytes) -> None:
    path.write_bytes(resealed({**content(path), "npz": base64.b64encode(npz).decode()}))
    cell = store.load(path.stem)
    assert cell is not None
    with pytest.raises(InputError, match="its arrays"):
        dict(cell.arrays)


THINGS: dict[str, Callable[[Path], None]] = {
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "a link to zeros": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("what", THINGS)
def test_what_is_no_file_is_one_line_at_once(store: Store, path: Path, what: str) -> None:
    path.unlink()
    THINGS[what](path)
    with limited(LONG_S), pytest.raises(InputError) as caught:
        store.load(path.stem)
    assert path.name in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    with open(os.fsencode(store.folder) + b"/\xff.json", "wb") as file:
        file.write(b"{}")  # a name that is not UTF-8 is no cell's
    with limited(LONG_S):
        assert "2 cells: 1 done, 1 damaged" in status.store_page(store)


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


def one_line_or(reading: Callable[[], Any]) -> tuple[str, Any]:
    """What is read, or the one line that says why it cannot be."""
    try:
        return "", reading()
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
    for metric in cell.summary:
        result.errors(metric)
        result.statistic(metric, "mean")
    assert cell.status in result.statuses
    one_line_or(lambda: stored_as_cell(cell))


@settings(
    max_examples=200, deadline=None, derandomize=False, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
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
            status.store_page(store)
    finally:
        path.write_bytes(whole)
