"""Checksums: no changed bit of a cell, its arrays, a bound or a file of the archive is read as if nothing had been."""

from __future__ import annotations

import json
import random
import secrets
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stored import described, recorded, resealed, save, scored

from bench import InputError
from bench.commands.publish import Described, main, publish
from bench.information.fisher import compute_bound
from bench.scenario.scenario import Scenario
from bench.store.archive.archive import Archive
from bench.store.bounds import Replicates, bound_identity, load_bounds
from bench.store.seal import OtherFormat, Unsealed, sealed, unsealed
from bench.store.store import Store
from bench.store.stored import StoredCell, cell_file

FLIPS = 400
LINEAR = Scenario("sdof", {"m": 1.0, "c": 0.4, "k": 8.0}, ((1.0,), (0.0,)), 20.0, dense=25, forecast=0.5)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Two cells with arrays and tracebacks, of different methods."""
    store = Store(tmp_path / "rows")
    store.prepare()
    for label in ("shooting", "pinn"):
        rows = scored(label, 20)
        stored = save(store, described(label), rows, recorded(rows, True, True))
        store.save(stored, store.arrays(stored), f"replicate 3\nTraceback of {label}\n")
    return store


def read(store: Store) -> list[tuple[StoredCell, dict[str, np.ndarray], str]]:
    """All that a reader takes from a store."""
    return [(cell, store.arrays(cell), store.tracebacks(cell)) for cell in store]


def complaint(store: Store) -> str:
    """What a reader of a store says of a damaged one; nothing where it finds none."""
    try:
        read(store)
    except InputError as error:
        return str(error)
    return ""


def dice() -> random.Random:
    """Other flips each time; pytest shows the seed where one goes unnoticed."""
    seed = secrets.randbits(32)
    print(f"seed {seed}")
    return random.Random(seed)


def flip(content: bytes, rng: random.Random) -> bytes:
    """The same bytes but for one bit."""
    at = rng.randrange(len(content))
    return content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]


def test_every_flipped_bit_of_a_cell_or_of_the_files_beside_it_is_noticed(store: Store) -> None:
    rng, whole = dice(), read(store)
    files = sorted(store.folder.iterdir())
    assert sorted(path.suffix for path in files) == [".json", ".json", ".npz", ".npz", ".txt", ".txt"]
    missed = []
    for i in range(FLIPS):
        path = files[i % len(files)]
        before = path.read_bytes()
        path.write_bytes(flip(before, rng))
        said = complaint(store)
        if path.name not in said or len(said.splitlines()) != 1:
            missed.append((i, path.name, said))
        path.write_bytes(before)
    assert missed == []
    assert str(read(store)) == str(whole)


def test_every_flipped_bit_of_the_archive_is_noticed(store: Store, tmp_path: Path) -> None:
    load_bounds([Replicates(LINEAR)], store.bounds)
    folder, rng = tmp_path / "archive", dice()
    folder.mkdir()
    publish(store, Archive(folder), Described())
    files = sorted(folder.iterdir())
    assert [path.name for path in files] == ["bounds.parquet", "other.parquet"]
    for i in range(FLIPS):
        path = files[i % len(files)]
        before = path.read_bytes()
        path.write_bytes(flip(before, rng))
        with pytest.raises(InputError, match=r"archive=.*parquet: "):  # noqa: PT012
            archive = Archive(folder)
            archive.identities()
            archive.bounds()
            print(f"flip {i} of {path.name} went unnoticed")
        path.write_bytes(before)
    assert len(list(Store(tmp_path / "none", Archive(folder)))) == 2


def test_a_bound_with_a_flipped_bit_is_computed_anew(tmp_path: Path) -> None:
    rng, path = dice(), tmp_path / f"{bound_identity(Replicates(LINEAR))}.bound"
    (expected,) = load_bounds([Replicates(LINEAR)], tmp_path)
    assert expected == compute_bound(LINEAR)
    whole = path.read_bytes()
    for _ in range(20):
        path.write_bytes(flip(whole, rng))
        assert load_bounds([Replicates(LINEAR)], tmp_path) == [expected]
        assert path.read_bytes() == whole


def test_what_is_cut_at_any_byte_is_noticed(store: Store) -> None:
    rng = dice()
    for path in sorted(store.folder.iterdir()):
        whole = path.read_bytes()
        for n in (0, 1, len(whole) - 1, *(rng.randrange(len(whole)) for _ in range(20))):
            path.write_bytes(whole[:n])
            with pytest.raises(InputError):
                read(store)
        path.write_bytes(whole)
    read(store)


def test_arrays_of_another_cell_are_noticed(store: Store) -> None:
    one, two = (store.folder / cell.arrays for cell in store)
    ours, theirs = one.read_bytes(), two.read_bytes()
    one.write_bytes(theirs)
    two.write_bytes(ours)
    for cell in store:
        with pytest.raises(InputError, match="not the arrays of its cell"):
            store.arrays(cell)


@pytest.mark.parametrize("gone", [False, True])
def test_tracebacks_of_another_cell_and_none_are_noticed(store: Store, gone: bool) -> None:
    one, two = store
    path = store.errors(one)
    path.unlink()
    if not gone:
        path.write_bytes(store.errors(two).read_bytes())
    with pytest.raises(InputError, match="cannot be read" if gone else "not the tracebacks of its cell"):
        store.tracebacks(one)
    assert path.name in store.damage(one.identity)
    assert store.damage(two.identity) == ""


def test_tracebacks_of_before_they_had_a_checksum_are_read_and_go_with_their_cell(store: Store) -> None:
    """Their file has the cell's name alone, and the cell does not name it."""
    identity = store.identities()[0]
    stored = store.load(identity)
    assert stored is not None
    store.save(stored, store.arrays(stored))
    before = store.folder / f"{identity}.errors.txt"
    before.write_text("Traceback of then\n")
    stored = store.load(identity)
    assert stored is not None
    assert (stored.errors, store.errors(stored)) == ("", before)
    assert store.tracebacks(stored) == "Traceback of then\n"
    store.restate(stored)
    assert before.exists()
    again = store.save(stored, {}, store.tracebacks(stored))
    assert store.tracebacks(again) == "Traceback of then\n"
    assert not before.exists()
    assert {path.name for path in store.folder.glob(f"{identity}*")} == {f"{identity}.json", again.errors}


def test_tracebacks_are_never_those_of_another_folder(store: Store, tmp_path: Path) -> None:
    identity = store.identities()[0]
    (tmp_path / "precious.0123456789abcdef.errors.txt").write_text("precious")
    path = store.path(identity)
    for name in ("../precious.0123456789abcdef.errors.txt", "/etc/passwd", 3, None, f"{identity}.json"):
        path.write_bytes(resealed({**json.loads(path.read_text()), "errors": name}))
        with pytest.raises(InputError, match="no cell of this benchmark"):
            store.load(identity)


def test_a_summary_that_was_edited_is_noticed(store: Store) -> None:
    path = store.path(store.identities()[0])
    text = path.read_text()
    better = text.replace('"excess":', '"excess":0.5,"was":', 1)
    assert json.loads(better) != json.loads(text)  # a JSON file as good as before
    path.write_text(better)
    with pytest.raises(InputError, match="its checksum is not that of its content"):
        read(store)


def test_a_cell_of_before_checksums_is_refused_until_its_owner_has_it_sealed(
    store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = store.identities()
    before, whole = str(read(store)), {path.name: path.read_bytes() for path in store.folder.iterdir()}
    for identity in (first, second):
        path = store.path(identity)
        path.write_text('{"format":2,' + path.read_text().partition('",')[2])
    cells = list(store.folder.glob("*.json"))
    assert {json.loads(path.read_text())["format"] for path in cells} == {2}
    with pytest.raises(InputError, match=r"it has no checksum: python -m bench\.publish seal=true"):
        read(store)
    arrays = next(store.folder.glob(f"{second}.*.npz"))
    arrays.write_bytes(flip(arrays.read_bytes(), dice()))
    arguments = [f"store={store.folder}", f"archive={tmp_path / 'none'}", "seal=true"]
    capsys.readouterr()
    assert main(arguments) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(f"store={store.path(second)}: left as it is: its checksum")
    assert "1 cells taken as they were, and sealed; 1 left" in said[1]
    assert store.path(first).read_bytes() == whole[store.path(first).name]  # the same content, to the byte
    assert store.load(first) is not None
    arrays.write_bytes(whole[arrays.name])
    assert main(arguments) == 0
    assert str(read(store)) == before
    assert main(arguments) == 0
    assert "0 cells taken as they were, and sealed; 0 left" in capsys.readouterr().out


def test_a_sealed_cell_that_has_lost_a_bit_of_its_format_is_not_taken_for_an_older_one(store: Store) -> None:
    path = store.path(store.identities()[0])
    path.write_bytes(path.read_bytes().replace(b'{"format":3,', b'{"format":2,', 1))  # one bit
    assert main([f"store={store.folder}", f"archive={store.folder / 'none'}", "seal=true"]) == 1
    with pytest.raises(InputError, match="format 2"):
        read(store)


def test_an_archive_of_before_checksums_is_refused_until_its_owner_has_it_sealed(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The files of before are those of now without the key of the checksum."""
    folder = tmp_path / "archive"
    folder.mkdir()
    load_bounds([Replicates(LINEAR)], store.bounds)
    with monkeypatch.context() as older:
        older.setattr("bench.store.archive.checked.FORMAT", 1)
        publish(store, Archive(folder), Described())
    for path in folder.iterdir():
        content = path.read_bytes()
        at = content.index(b"vibration-bench sha256")
        path.write_bytes(content[:at] + b"somebody's" + content[at + 10 :])  # another key, of the same length
    with pytest.raises(InputError, match=r"an archive of format 1.*it has no checksum: python -m bench\.publish seal="):
        Archive(folder).identities()
    assert main([f"store={tmp_path / 'none'}", f"archive={folder}", "seal=true"]) == 0
    assert "2 of 2 files written" in capsys.readouterr().out
    found = Archive(folder)
    assert found.identities() == store.identities()
    for cell, arrays, tracebacks in read(store):
        back = found.load(cell.identity)
        assert back is not None
        assert cell_file(back) == cell_file(replace(cell, errors=""))  # which stand in the same file
        assert found.tracebacks(cell.identity) == tracebacks
        assert {name: a.tobytes() for name, a in found.arrays(cell.identity).items()} == {
            name: a.tobytes() for name, a in arrays.items()
        }
    assert found.bounds().keys() == {bound_identity(Replicates(LINEAR))}


@pytest.mark.parametrize("bad", ["seal=yes", "seal=", "sael=true"])
def test_another_word_than_true_is_one_line(bad: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main([bad, f"store={tmp_path}"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_file_is_sealed_in_one_format_alone() -> None:
    content = sealed(7, '{"a": [1, 2], "b": "größer"}')
    assert unsealed(7, content) == {"a": [1, 2], "b": "größer"}
    assert json.loads(content)["format"] == 7
    with pytest.raises(OtherFormat, match="of format 7"):
        unsealed(8, content)
    for bad in (b"", b"{}", b"[]", b'{"format":7}', content[1:], b" " + content, content + b" "):
        with pytest.raises(Unsealed):
            unsealed(7, bad)
    assert json.loads(resealed({"format": 1, "sha256": "", "x": 1}))["x"] == 1
