"""A sweep by way of a launcher: the same rows as on this machine, only what is missing, and jobs that are data."""

from __future__ import annotations

import json
import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bench import InputError
from bench.commands.main import main
from bench.config.atlas import atlas_blocks
from bench.config.experiment import Experiment, expand
from bench.engine import job_file, launch
from bench.engine.job_file import FORMAT, LaunchJob, read_job
from bench.engine.launch import CACHE, Launch, make_private_folder
from bench.engine.plan import CellState, Planned, plan
from bench.engine.pool import Limits
from bench.engine.progress import RunState
from bench.isolation.limits import limited
from bench.scenario.force import ForceSpec
from bench.store.archive import Archive
from bench.store.bounds import load_bounds
from bench.store.cell import Cell
from bench.store.seal import sealed
from bench.store.store import Store

SWEEP = ("method=ls,log_decrement", "seed=0,1", "replicates=3")
FIELDS = ["method=ls,collocation", "system=sdof,duffing,chain2", "snr=20,10", "seed=3", "replicates=2", "prior=wrong"]


@pytest.fixture(scope="module")
def cells() -> list[Cell]:
    return [job.cell() for job in expand(list(SWEEP), True)]


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
    """Return all that must not depend on where a cell was computed: not its times, nor its machine's memory."""
    stored = [store.load(cell.identity) for cell in cells]
    return [cell and [(row.status, row.message, dict(row.scores), row.data) for row in cell.rows] for cell in stored]


def _run(store: Store, launcher: str, *more: str) -> int:
    return main(["-m", *SWEEP, f"store={store.folder}", f"hydra/launcher={launcher}", *more])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("launcher", "options", "cores"), [("basic", (), 1), ("submitit_local", ("hydra.launcher.cpus_per_task=2",), 2)]
)
def test_a_launcher_gives_the_rows_that_this_machine_gives_and_computes_only_what_is_missing(
    launcher: str, options: tuple[str, ...], cores: int,
    cells: list[Cell], make_store: Callable[[], Store], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Submitit hands its jobs over as pickles: they lie in a folder of the user alone, and go with the sweep."""
    if launcher == "submitit_local":
        pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    here, there = make_store(), make_store()
    monkeypatch.setenv(CACHE, str(tmp_path))
    pickles, jobs, rounds = list[Path](), list[Path](), launch._launch_rounds

    def looked(submitter: Any, sweep: LaunchJob, folder: Path, how: Any) -> None:
        rounds(submitter, sweep, folder, how)
        written = [path for root in (there.folder, tmp_path) for path in root.rglob("*") if path.is_file()]
        pickles.extend(path for path in written if path.read_bytes()[:1] == b"\x80")
        jobs.extend(path for path in written if path.suffix == ".job")

    monkeypatch.setattr(launch, "_launch_rounds", looked)
    assert _run(here, "local", "workers=1") == 0
    assert _run(there, launcher, "cells_per_job=3", *options) == 0  # two jobs, of three cells and of one
    rows = _outcomes(here, cells)
    assert None not in rows
    assert _outcomes(there, cells) == rows
    assert {cell.provenance["workers"] for cell in there} == {cores}
    assert not (there.folder / "launches").exists()
    assert len(jobs) == 2
    assert bool(pickles) == (launcher == "submitit_local")
    assert all(path.is_relative_to(tmp_path) for path in pickles)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    before = {cell.identity: there.path(cell.identity).stat().st_ino for cell in cells}
    there.path(cells[2].identity).unlink()
    assert _run(there, "basic") == 0
    after = {cell.identity: there.path(cell.identity).stat().st_ino for cell in cells}
    assert {name for name in after if after[name] != before[name]} <= {cells[2].identity}
    assert _outcomes(there, cells) == rows


def test_a_job_that_is_tried_again_takes_what_its_first_try_did_not_store(
    cells: list[Cell], make_store: Callable[[], Store]
) -> None:
    store = make_store()
    job = LaunchJob(tuple(plan(cells, store)), store, Limits())
    path = store.path(cells[1].identity)
    path.write_text("{}")
    assert [task.key for task in job.left()] == [cell.identity for cell in (cells[0], *cells[2:])]
    stale = job.part([Planned(cells[1], CellState.STALE, "", True, store.stamp(cells[1].identity))])
    assert stale.left() == list(stale.tasks)
    os.utime(path, ns=(0, 1))
    assert stale.left() == []


class Flaky:
    """A launcher whose jobs store ``stored`` cells a round, in all, and then end in an error."""

    def __init__(self, store: Store, stored: int, error: Exception) -> None:
        self.store, self.stored, self.error, self.rounds = store, stored, error, 0

    def launch(self, jobs: list[list[str]], first: int) -> list[Any]:
        self.rounds += 1
        folder = Path(jobs[0][0].partition("=")[2].strip("'"))
        parts = [read_job(folder / f"{first + i}.job", self.store.folder) for i in range(len(jobs))]
        for task in [task for job in parts for task in job.left()][: self.stored]:
            self.store.path(task.key).write_text("{}")
        raise self.error


@pytest.mark.parametrize(
    ("stored", "rounds", "said"),
    [(3, 2, "1 cells unfinished, launching them again (ConnectionError: a node is gone)"),
     (0, 1, "4 cells unfinished, giving up")],
)  # fmt: skip
def test_cells_of_a_lost_node_are_launched_again_as_long_as_a_round_brings_some(
    stored: int, rounds: int, said: str,
    cells: list[Cell], make_store: Callable[[], Store], tmp_path: Path, caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    store = make_store()
    launcher, job = (
        Flaky(store, stored, ConnectionError("a node is gone")),
        LaunchJob(tuple(plan(cells, store)), store, Limits()),
    )
    launch._launch_rounds(launcher, job, tmp_path, Launch(("hydra/launcher=flaky",), 1))
    assert (launcher.rounds, len(store.identities())) == (rounds, len(cells) if stored else 0)
    assert said in caplog.text
    full = Flaky(store, 0, InputError("store", "here", "cannot be written"))  # is not tried again
    with pytest.raises(InputError, match="cannot be written"):
        launch._launch_rounds(full, job, tmp_path / "full", Launch(("hydra/launcher=flaky",), 1))


def test_a_job_ends_with_its_sweep(
    make_store: Callable[[], Store], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever waits for a job removes the sweep's folder when it ends: the job sees it after its next fit.

    Where somebody else removes it, the sweep says so in one line.
    """
    store, after = make_store(), []

    def interrupted(planned: Any, store: Store, limits: Limits, on_progress: Any) -> None:
        shutil.rmtree(store.folder / "launches")
        on_progress(RunState("fit", 1, 2, "", 1.0, False))
        after.append(planned)

    monkeypatch.setattr(job_file, "run_cells", interrupted)
    assert _run(store, "basic", "cells_per_job=4") == 2
    assert after == []
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("bench: store=")
    assert "was removed during the sweep; start it again" in last


@pytest.fixture(scope="module")
def many() -> list[Cell]:
    settings = ["method=collocation", "method.degree=4", "replicates=2"]
    disturbed = ["method=ls", "disturbance=glob(*)", "replicates=2"]
    swept = [job.cell() for texts in (FIELDS, settings, disturbed) for job in expand(texts, True)]
    return [*swept, *(cell for name in ("sbc", "forced", "mdof") for cell in Experiment(name).cells()[::40])]


@pytest.fixture
def job(many: list[Cell], tmp_path: Path) -> LaunchJob:
    store = Store(tmp_path / "rows", Archive(tmp_path / "archive"))
    store.prepare()
    planned = [replace(cell, state=CellState.STALE, stamp=10**18 + i) for i, cell in enumerate(plan(many, store))]
    blocks = [block for test in ("free_decay", "forced") for block in atlas_blocks("points", [], 32, test)]
    return LaunchJob((*planned, *blocks), store, Limits(7, 1.5, 3.0, ("torch",)))


def test_a_job_comes_back_as_it_was(job: LaunchJob, tmp_path: Path) -> None:
    job.write(tmp_path / "0.job")
    text = (tmp_path / "0.job").read_text(encoding="utf-8")
    assert [task["key"] for task in json.loads(text)["tasks"]] == [task.key for task in job.tasks]
    assert str(job.store.folder) not in text, "a job does not name the store that it lies in"
    back = read_job(tmp_path / "0.job", tmp_path / "here")
    assert (back.store.folder, back.store.archive.folder) == (tmp_path / "here", tmp_path / "archive")  # type: ignore[union-attr]
    assert back.limits == Limits(timeout_s=1.5, memory_mb=3.0)  # cores and packages are the node's own
    assert [task.key for task in back.tasks] == [task.key for task in job.tasks]
    for before, after in zip(job.tasks, back.tasks, strict=True):
        if isinstance(before, Planned):
            assert isinstance(after, Planned)
            assert (after.state, after.stamp) == (before.state, before.stamp)
            assert (after.cell.label, dict(after.cell.settings)) == (before.cell.label, dict(before.cell.settings))


def test_a_force_that_was_read_from_a_file_comes_along(
    job: LaunchJob, many: list[Cell], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The job names the file; the cell's name hangs on the numbers in it, so another file is refused."""
    monkeypatch.chdir(tmp_path)
    column = tmp_path / "force.txt"
    column.write_text("0\n1\n0.5\n-1\n0\n")
    force = ForceSpec(1.0, None, None, kind="column", file="force.txt")
    cell = replace(many[0], scenario=replace(many[0].scenario, force=force))
    job.part([Planned(cell, CellState.MISSING, "", True)]).write(tmp_path / "0.job")
    monkeypatch.chdir(job.store.folder)
    (back,) = read_job(tmp_path / "0.job", job.store.folder).tasks
    assert isinstance(back, Planned)
    assert back.key == cell.identity
    assert back.cell.scenario.forces(0)[0].values.tolist() == [0.0, 1.0, 0.5, -1.0, 0.0]
    for other in (lambda: column.write_text("0\n2\n"), column.unlink, lambda: os.mkfifo(column)):
        other()
        with limited(20.0), pytest.raises(InputError, match="cell="):
            read_job(tmp_path / "0.job", job.store.folder)


class Trap:
    """What a pickle that is rebuilt would do here."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return pytest.fail, ("code of another hand has run",)


def edited(path: Path, *keys: Any, value: Any) -> bytes:
    """Return a job's file with another value under some keys, sealed by another hand."""
    whole = json.loads(path.read_text(encoding="utf-8"))
    inner = whole
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return sealed(FORMAT, json.dumps({key: item for key, item in whole.items() if key not in ("format", "sha256")}))


HOSTILE: dict[str, Callable[[Path], bytes]] = {
    "a pickle": lambda path: pickle.dumps(Trap()),
    "a bit": lambda path: bytes([*path.read_bytes()[:-5], path.read_bytes()[-5] ^ 4, *path.read_bytes()[-4:]]),
    "a method of os": lambda path: edited(path, "tasks", 0, "content", "method", value="os.system"),
    "another seed": lambda path: edited(path, "tasks", 0, "content", "seed", value=4),
    "samples without end": lambda path: edited(path, "tasks", 0, "content", "data", "samples", value=10**18),
    "a block with another seed": lambda path: edited(path, "tasks", -1, "content", "seed", value=4),
    "tasks in a text": lambda path: edited(path, "tasks", value="all"),
    "no limit": lambda path: edited(path, "timeout_s", value=-1.0),
    "a target": lambda path: edited(path, "_target_", value="os.system"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_what_another_hand_has_put_in_the_place_of_a_job_is_one_line(job: LaunchJob, tmp_path: Path, what: str) -> None:
    path = tmp_path / "0.job"
    job.part([job.tasks[0], job.tasks[-1]]).write(path)
    path.write_bytes(HOSTILE[what](path))
    with limited(20.0), pytest.raises(InputError) as caught:
        read_job(path, job.store.folder)
    assert len(str(caught.value).splitlines()) == 1


def test_the_private_folder_is_its_user_s_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE, str(tmp_path / "cache"))
    before = os.umask(0)
    try:
        first, second = make_private_folder(), make_private_folder()
    finally:
        os.umask(before)
    assert first != second
    assert [folder.stat().st_mode & 0o077 for folder in (first, second, first.parent)] == [0, 0, 0]
    first.parent.chmod(0o770)
    with pytest.raises(InputError, match="other users can write there"):
        make_private_folder()
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(CACHE, str(tmp_path / "file"))
    with pytest.raises(InputError, match=f"{CACHE}=.*cannot be written") as caught:
        make_private_folder()
    assert len(str(caught.value).splitlines()) == 1
