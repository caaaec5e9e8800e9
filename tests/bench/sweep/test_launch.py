"""A sweep by way of a launcher: the same rows as on this machine, and only what is missing."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bench import InputError
from bench.commands.main import main
from bench.config.experiment import expand
from bench.engine.pool import Limits
from bench.engine.progress import Look
from bench.store.bounds import load_bounds
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep import job as job_module
from bench.sweep import launch
from bench.sweep.job import CellJob, read_job
from bench.sweep.launch import Launch
from bench.sweep.plan import plan

SWEEP = ("method=ls,log_decrement", "seed=0,1", "replicates=3")


@pytest.fixture(scope="module")
def cells() -> list[Cell]:
    return list([job.cell() for job in expand(list(SWEEP), True)])


@pytest.fixture(scope="module")
def make_store(cells: list[Cell], tmp_path_factory: pytest.TempPathFactory) -> Callable[[], Store]:
    """Empty stores with the bounds of the sweep."""
    bounds = tmp_path_factory.mktemp("bounds")
    load_bounds(cells, bounds)

    def make() -> Store:
        store = Store(tmp_path_factory.mktemp("rows"))
        store.prepare()
        store.bounds.symlink_to(bounds)
        return store

    return make


def _outcomes(store: Store, cells: list[Cell]) -> list[Any]:
    """All that must not depend on where a cell was computed: not its times, nor its machine's memory."""
    found = [store.load(cell.identity) for cell in cells]
    return [
        [json.loads(json.dumps([row.status, row.message, row.scores, row.data])) for row in cell.rows] if cell else None
        for cell in found
    ]


def _run(store: Store, launcher: str, *more: str) -> int:
    return main(["-m", *SWEEP, f"store={store.folder}", f"hydra/launcher={launcher}", *more])


@pytest.mark.parametrize(
    ("launcher", "options", "cores"), [("basic", (), 1), ("submitit_local", ("hydra.launcher.cpus_per_task=2",), 2)]
)
def test_a_launcher_gives_the_rows_that_this_machine_gives(
    launcher: str, options: tuple[str, ...], cores: int, cells: list[Cell], make_store: Callable[[], Store]
) -> None:
    if launcher == "submitit_local":
        pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    here, there = make_store(), make_store()
    assert _run(here, "local", "workers=1") == 0
    assert _run(there, launcher, "cells_per_job=3", *options) == 0  # two jobs, of three cells and of one
    rows = _outcomes(here, cells)
    assert None not in rows
    assert _outcomes(there, cells) == rows
    assert {found.provenance["workers"] for found in there} == {cores}
    assert not (there.folder / "launches").exists()


def test_a_second_run_computes_only_what_is_missing(cells: list[Cell], make_store: Callable[[], Store]) -> None:
    store = make_store()
    assert _run(store, "basic") == 0
    lost, kept = store.path(cells[2].identity), [store.path(cells[i].identity) for i in (0, 1, 3)]
    before = {path: path.stat().st_ino for path in kept}  # a cell that is stored again is another file
    outcomes = _outcomes(store, cells)
    lost.unlink()
    assert _run(store, "basic") == 0
    assert {path: path.stat().st_ino for path in kept} == before
    assert _outcomes(store, cells) == outcomes


def test_an_unknown_launcher_is_one_line(make_store: Callable[[], Store], capsys: pytest.CaptureFixture[str]) -> None:
    store = make_store()
    assert _run(store, "nowhere", "format=json") == 2
    said = capsys.readouterr().err
    assert said.startswith("bench: hydra/launcher=nowhere: known: ")
    assert said.count("\n") == 1
    assert store.identities() == []


def test_an_option_of_a_launcher_that_is_not_named_is_one_line(
    make_store: Callable[[], Store], capsys: pytest.CaptureFixture[str]
) -> None:
    store = make_store()
    assert _run(store, "local", "hydra.launcher.cpus_per_task=2", "format=json") == 2
    said = capsys.readouterr().err
    assert said.startswith("bench: argument=hydra.launcher.cpus_per_task=2: an option of a launcher")
    assert said.count("\n") == 1
    assert store.identities() == []


def test_a_job_that_is_tried_again_takes_what_its_first_try_did_not_store(
    cells: list[Cell], make_store: Callable[[], Store], tmp_path: Path
) -> None:
    store = make_store()
    CellJob(tuple(plan(cells, store)), store, Limits()).write(tmp_path / "0.job")
    store.path(cells[1].identity).write_text("{}")
    left = [one.cell.identity for one in read_job(tmp_path / "0.job", store.folder).left()]
    assert left == [cell.identity for cell in (cells[0], *cells[2:])]


def test_a_stale_cell_is_left_until_it_is_stored_anew(cells: list[Cell], make_store: Callable[[], Store]) -> None:
    store, identity = make_store(), cells[0].identity
    wanted = tuple(plan(cells[:1], store))
    store.path(identity).write_text("{}")
    wanted = (replace(wanted[0], stamp=store.path(identity).stat().st_mtime_ns),)
    job = CellJob(wanted, store, Limits())
    assert job.left() == list(wanted)
    os.utime(store.path(identity), ns=(0, 1))
    assert job.left() == []


class Flaky:
    """A launcher whose jobs store ``stored`` cells a round, in all, and then end in an error."""

    def __init__(self, store: Store, stored: int) -> None:
        self.store, self.stored, self.rounds = store, stored, 0

    def launch(self, jobs: list[list[str]], first: int) -> list[Any]:
        self.rounds += 1
        folder = Path(jobs[0][0].partition("=")[2].strip("'"))
        own = [read_job(folder / f"{first + i}.job", self.store.folder) for i in range(len(jobs))]
        todo = [one for job in own for one in job.left()]
        for one in todo[: self.stored]:
            self.store.path(one.cell.identity).write_text("{}")
        raise ConnectionError("a node is gone")


def _rounds(store: Store, cells: list[Cell], tmp_path: Path, stored: int) -> Flaky:
    launcher = Flaky(store, stored)
    sweep = CellJob(tuple(plan(cells, store)), store, Limits())
    launch._rounds(launcher, sweep, tmp_path, Launch(("hydra/launcher=flaky",), 1))
    return launcher


def test_cells_of_a_lost_node_are_launched_again(
    cells: list[Cell], make_store: Callable[[], Store], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = make_store()
    assert _rounds(store, cells, tmp_path, 3).rounds == 2
    assert len(store.identities()) == len(cells)
    assert "has left 1 cells, launched again (ConnectionError: a node is gone)" in capsys.readouterr().err


def test_a_round_that_brings_nothing_is_the_last(
    cells: list[Cell], make_store: Callable[[], Store], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _rounds(make_store(), cells, tmp_path, 0).rounds == 1
    assert "has left 4 cells, given up" in capsys.readouterr().err


def test_a_full_store_is_not_tried_again(cells: list[Cell], make_store: Callable[[], Store], tmp_path: Path) -> None:
    class Full:
        def launch(self, jobs: list[list[str]], first: int) -> list[Any]:
            raise InputError("store", "here", "cannot be written")

    store = make_store()
    with pytest.raises(InputError, match="cannot be written"):
        launch._rounds(Full(), CellJob(tuple(plan(cells, store)), store, Limits()), tmp_path, Launch(("x",)))


def test_a_job_ends_with_its_sweep(
    make_store: Callable[[], Store], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever waits for a job removes the sweep's folder when it ends: the job sees it after its next fit.

    Where somebody else removes it, the sweep says so in one line.
    """
    store, after = make_store(), []

    def interrupted(planned: Any, store: Store, limits: Limits, on_look: Any) -> None:
        shutil.rmtree(store.folder / "launches")
        on_look(Look("fit", 1, 2, "", 1.0, False))
        after.append(planned)

    monkeypatch.setattr(job_module, "run_cells", interrupted)
    assert _run(store, "basic", "cells_per_job=4") == 2
    assert after == []
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("bench: store=")
    assert "was removed while the sweep ran; start it again" in last
