"""Whatever lies in a store is one line or a cell that every command can read; no changed bit passes for a result."""

from __future__ import annotations

import copy
import json
import os
import random
import secrets
import stat
import uuid
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from stored import content, described, recorded, resealed, save, scored

from bench import InputError
from bench.commands import status
from bench.isolation.limit import limited
from bench.reporting.frame import Result
from bench.store.cell import stored_as_cell
from bench.store.cell_file import FORMAT
from bench.store.seal import OtherFormat, Unsealed, sealed, unsealed
from bench.store.store import Store
from bench.store.stored import StoredCell

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
        stored = save(store, {**described(label), "settings": {"width": 3}}, rows, recorded(rows, True, True))
        store.save(stored, store.arrays(stored), f"replicate 3\nTraceback of {label}\n")
    return store


@pytest.fixture
def path(store: Store) -> Path:
    return store.path(store.identities()[0])


def read(store: Store) -> list[tuple[StoredCell, dict[str, np.ndarray], str]]:
    """All that a reader takes from a store."""
    return [(cell, store.arrays(cell), store.tracebacks(cell)) for cell in store]


def flip(content: bytes, rng: random.Random) -> bytes:
    """The same bytes but for one bit."""
    at = rng.randrange(len(content))
    return content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]


def test_every_flipped_bit_of_a_cell_or_of_the_files_beside_it_is_noticed(store: Store) -> None:
    seed = secrets.randbits(32)
    print(f"seed {seed}")
    rng, whole = random.Random(seed), read(store)
    files = sorted(store.folder.iterdir())
    assert sorted(path.suffix for path in files) == [".json", ".json", ".npz", ".npz", ".txt", ".txt"]
    for i in range(FLIPS):
        path = files[i % len(files)]
        before = path.read_bytes()
        path.write_bytes(flip(before, rng) if i % 10 else before[: rng.randrange(len(before))])
        with pytest.raises(InputError) as caught:
            read(store)
        assert path.name in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1
        path.write_bytes(before)
    assert str(read(store)) == str(whole)


def test_files_of_another_cell_are_noticed(store: Store) -> None:
    one, two = store
    for name, what in (("arrays", "arrays"), ("errors", "tracebacks")):
        ours, theirs = (store.folder / getattr(cell, name) for cell in (one, two))
        whole = ours.read_bytes()
        ours.write_bytes(theirs.read_bytes())
        with pytest.raises(InputError, match=f"not the {what} of its cell"):
            getattr(store, {"errors": "tracebacks"}.get(name, name))(one)
        assert ours.name in store.damage(one.identity)
        ours.unlink()
        with pytest.raises(InputError, match="cannot be read"):
            getattr(store, {"errors": "tracebacks"}.get(name, name))(one)
        ours.write_bytes(whole)
    assert store.damage(two.identity) == ""


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
    "a text for a number": set_to(["one"] * 5, "rows", "cpu_s"),
    "10^400 as a seed": set_to(10**400, "cell", "seed"),
    "summary of numbers": set_to({"rmse": 3}, "summary"),
    "another cell": set_to("f" * 20, "identity"),
    "a disturbance in a text": set_to("jitter", "cell", "data", "disturbance"),
    "a version of texts": set_to({"method": "new"}, "version"),
    "arrays elsewhere": set_to("../precious.0123456789abcdef.npz", "arrays"),
    "tracebacks of the root": set_to("/etc/passwd", "errors"),
}
TEXTS = {
    "nested 10^5 deep": '{"cell":' + "[" * 10**5,
    "nested 10^5 deep and closed": '{"cell":' + "[" * 10**5 + "]" * 10**5 + "}",
    "NaN": '{"wall_s": NaN}',
    "a number of 10^5 digits": '{"wall_s": ' + "1" * 10**5 + "}",
    "no JSON": '{"wall_s": ',
}


@pytest.mark.parametrize("what", [*SHAPES, *TEXTS])
def test_a_sealed_file_of_another_shape_is_one_line(store: Store, path: Path, what: str) -> None:
    whole = content(path)
    if what in SHAPES:
        SHAPES[what](whole)
        path.write_bytes(resealed(whole))
    else:
        path.write_bytes(sealed(FORMAT, TEXTS[what]))
    before = path.read_bytes()
    with limited(LONG_S), pytest.raises(InputError) as caught:
        store.load(path.stem)
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert path.read_bytes() == before


THINGS: dict[str, Callable[[Path], None]] = {
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "a link to zeros": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("what", THINGS)
def test_what_is_no_file_is_one_line_at_once(store: Store, path: Path, what: str) -> None:
    cell = store.load(path.stem)
    assert cell is not None
    reads: Mapping[Path, Callable[[], Any]] = {
        store.folder / cell.arrays: lambda: store.arrays(cell),
        store.folder / cell.errors: lambda: store.tracebacks(cell),
        path: lambda: store.load(path.stem),
    }
    for place, reading in reads.items():
        place.unlink()
        THINGS[what](place)
        with limited(LONG_S), pytest.raises(InputError) as caught:
            reading()
        assert place.name in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1
    with limited(LONG_S):
        assert "1 damaged" in status.store_page(store)


def test_a_name_that_is_not_utf_8_is_no_cell_s(store: Store) -> None:
    with open(os.fsencode(store.folder) + b"/\xff.json", "wb") as file:
        file.write(b"{}")
    assert "2 cells" in status.store_page(store)


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
            status.store_page(store)
    finally:
        path.write_bytes(whole)


def test_a_file_is_sealed_in_one_format_alone() -> None:
    whole = sealed(7, '{"a": [1, 2], "b": "größer"}')
    assert unsealed(7, whole) == {"a": [1, 2], "b": "größer"}
    assert json.loads(whole)["format"] == 7
    with pytest.raises(OtherFormat, match="of format 7"):
        unsealed(8, whole)
    for bad in (b"", b"{}", b"[]", b'{"format":7}', whole[1:], b" " + whole, whole + b" "):
        with pytest.raises(Unsealed):
            unsealed(7, bad)


# ---- what a store does to others' files


def test_no_write_goes_through_a_link_that_somebody_has_left(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The names of temporary files are known to somebody who guesses them."""
    monkeypatch.setattr(uuid, "uuid4", lambda: uuid.UUID(int=7))
    drawn = uuid.UUID(int=7).hex
    cell, _ = store
    mine = tmp_path / "mine"
    mine.write_text("mine")
    for name in (f"write-test.{drawn}.tmp", f"{cell.identity}.json.{drawn}.tmp"):
        (store.folder / name).symlink_to(mine)
    with pytest.raises(InputError, match="cannot be written"):
        store.prepare()
    with pytest.raises(OSError, match="exists"):
        store.save(cell)
    assert mine.read_text() == "mine"


def test_a_cell_takes_the_place_of_a_link_and_not_of_what_it_points_to(store: Store, tmp_path: Path) -> None:
    cell, _ = store
    mine = tmp_path / "mine"
    mine.write_text("mine")
    arrays = store.arrays(cell)
    for path in (store.path(cell.identity), store.folder / cell.arrays, store.folder / cell.errors):
        path.unlink()
        path.symlink_to(mine)
    store.save(cell, arrays, "replicate 3\nTraceback of shooting\n")
    assert mine.read_text() == "mine"
    assert not store.path(cell.identity).is_symlink()
    assert store.damage(cell.identity) == ""


@pytest.mark.parametrize("mask", [0o002, 0o022, 0o077])
def test_files_have_the_rights_that_the_umask_leaves(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        store = Store(tmp_path / "rows")
        store.prepare()
        rows = scored("shooting", 5)
        save(store, described("shooting"), rows, recorded(rows, True, True))
    finally:
        os.umask(before)
    files = [path for path in store.folder.rglob("*") if path.is_file()]
    assert {path.suffix for path in files} == {".json", ".npz"}
    assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o666 & ~mask}
    assert stat.S_IMODE(store.folder.stat().st_mode) == 0o777 & ~mask
