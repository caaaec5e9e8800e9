"""The command of the pictures: what it draws from what store, the same each time, and bad input in one line."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import Python
from stored import described, fill, recorded, save, scored

from bench.commands.figures import main
from bench.reporting.figures.pictures import PICTURES
from bench.store.store import Store

pytest.importorskip("matplotlib")
ALONE = {
    "record", "reconstruction", "training_loss", "scatter", "basin", "band", "error_against_noise",
    "displacement_against_noise", "forest", "coverage", "accuracy_against_time", "waterfall",
}  # fmt: skip
"""What a method alone gives on one mass that never failed: no comparison, no failure, no second mass."""


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Two methods at three noise levels, as if they had run."""
    store = Store(tmp_path / "rows")
    store.prepare()
    fill(store, ["shooting", "somebody's"], (40.0, 20.0, 10.0))
    return store


def pictures(out: Path) -> set[str]:
    return {path.stem for path in out.glob("*.svg")}


def test_every_picture_is_the_same_each_time_and_has_a_caption(store: Store, tmp_path: Path, python: Python) -> None:
    out, again = tmp_path / "out", tmp_path / "again"
    assert main([f"store={store.folder}", f"out={out}"]) == 0
    first = {path.name: path.read_bytes() for path in out.iterdir()}
    assert pictures(out) == {*ALONE, "profiles"}
    assert set(first) == {f"{name}.{ending}" for name in pictures(out) for ending in ("svg", "png", "txt")}
    for name in pictures(out):
        text = first[f"{name}.txt"].decode()
        assert text.endswith(".\n")
        assert len(text.splitlines()) == 1
        assert "nan" not in text
    done = python("-m", "bench.figures", f"store={store.folder}", f"out={again}", env={"PYTHONHASHSEED": "7"})
    assert done.returncode == 0, done.stderr
    assert {path.name: path.read_bytes() for path in again.iterdir()} == first


def test_a_store_of_one_method_gives_all_but_comparisons(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store(tmp_path / "rows")
    store.prepare()
    fill(store, ["pinn"])
    assert main([f"store={store.folder}", f"out={tmp_path / 'out'}"]) == 0
    assert pictures(tmp_path / "out") == ALONE
    missing = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[1] for line in missing] == [name for name in PICTURES if name not in ALONE]


ARRAYS_LOST: dict[str, Callable[[Path], object]] = {
    "missing": Path.unlink,
    "empty": lambda path: path.write_bytes(b""),
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-10]),
    "flipped": lambda path: path.write_bytes(
        bytes([*path.read_bytes()[:99], path.read_bytes()[99] ^ 1]) + path.read_bytes()[100:]
    ),
}


@pytest.mark.parametrize("how", ARRAYS_LOST)
def test_a_store_that_lost_its_arrays_still_gives_what_rows_tell(tmp_path: Path, how: str) -> None:
    store = Store(tmp_path / "rows")
    store.prepare()
    rows = scored("shooting", 30)
    stored = save(store, described("shooting"), rows, recorded(rows, True, True))
    ARRAYS_LOST[how](store.folder / stored.arrays)
    assert main([f"store={store.folder}", f"out={tmp_path / 'out'}"]) == 0
    assert pictures(tmp_path / "out") == {
        "scatter", "error_against_noise", "displacement_against_noise", "forest", "coverage", "accuracy_against_time"
    }  # fmt: skip


@pytest.mark.parametrize("bad", [["store=nowhere"], ["stor=x"], ["out="]])
def test_bad_input_is_one_line(
    bad: list[str], store: Store, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main([*bad, *([f"store={tmp_path}"] if bad == ["out="] else [])]) == 2
    assert_one_line(capsys)


def test_an_empty_store_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Store(tmp_path / "rows").prepare()
    assert main([f"store={tmp_path / 'rows'}", f"out={tmp_path / 'out'}"]) == 2
    assert_one_line(capsys)
    assert not (tmp_path / "out").exists()


def test_a_damaged_cell_is_one_line(store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = store.path(store.identities()[0])
    path.write_text(path.read_text()[:1000])
    assert main([f"store={store.folder}", f"out={tmp_path / 'out'}"]) == 2
    assert_one_line(capsys)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_one_line(
    store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    assert main([f"store={store.folder}", f"out={tmp_path / 'locked' / 'out'}"]) == 2
    assert_one_line(capsys)


def assert_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    err = capsys.readouterr().err
    assert err.startswith("bench.figures: ")
    assert len(err.splitlines()) == 1
