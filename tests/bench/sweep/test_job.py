"""Jobs in a shared store are data: they come back as they were, and nothing else comes in by their way."""

from __future__ import annotations

import ast
import json
import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY

from bench import InputError
from bench.commands.main import main
from bench.config.experiment import Experiment, expand
from bench.engine.pool import Limits
from bench.isolation.limit import limited
from bench.isolation.private import VARIABLE, make_private_folder
from bench.scenario.force import ForceSpec
from bench.store.archive import Archive
from bench.store.cell import Cell
from bench.store.seal import sealed
from bench.store.store import Store
from bench.sweep import launch
from bench.sweep.job import FORMAT, CellJob, Job, read_job
from bench.sweep.plan import Planned, State, plan

PICKLERS = ("pickle", "marshal", "dill", "cloudpickle")
FIELDS = ["method=ls,collocation", "system=sdof,duffing,chain2", "snr=20,10", "seed=3", "replicates=2", "prior=wrong"]


@pytest.fixture(scope="module")
def cells() -> list[Cell]:
    settings = ["method=collocation", "method.degree=4", "replicates=2"]
    disturbed = ["method=ls", "disturbance=glob(*)", "replicates=2"]
    found = [job.cell() for texts in (FIELDS, settings, disturbed) for job in expand(texts, True)]
    drawn = [cell for name in ("sbc", "forced", "mdof") for cell in Experiment(name).cells()[::40]]
    return [*found, *drawn]


@pytest.fixture
def job(cells: list[Cell], tmp_path: Path) -> CellJob:
    store = Store(tmp_path / "rows", Archive(tmp_path / "archive"))
    store.prepare()
    planned = tuple(
        replace(one, state=State.STALE, why="numpy 1.0, now größer", stamp=1_700_000_000_123_456_789 + i)
        for i, one in enumerate(plan(cells, Store(store.folder)))
    )
    return CellJob(planned, store, Limits(7, 1.5, 3.0, ("torch",)))


def read(path: Path, folder: Path) -> CellJob:
    job = read_job(path, folder)
    assert isinstance(job, CellJob)
    return job


def test_a_job_comes_back_as_it_was(job: CellJob, tmp_path: Path) -> None:
    job.write(tmp_path / "0.job")
    back = read(tmp_path / "0.job", job.store.folder)
    assert (back.store.folder, back.store.archive.folder) == (job.store.folder, tmp_path / "archive")  # type: ignore[union-attr]
    assert back.limits == Limits(timeout_s=1.5, memory_mb=3.0)  # cores and packages are the node's own
    for one, two in zip(job.items, back.items, strict=True):
        assert (one.state, one.why, one.stamp, one.cell.identity) == (two.state, two.why, two.stamp, two.cell.identity)
        assert (one.cell.label, one.cell.method, one.cell.seed) == (two.cell.label, two.cell.method, two.cell.seed)
        assert dict(one.cell.settings) == dict(two.cell.settings)
        assert _without_name(one.cell) == _without_name(two.cell)


def test_a_force_that_was_read_from_a_file_comes_along(
    job: CellJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The job names the file; the cell's name hangs on the numbers in it, so another file is refused."""
    monkeypatch.chdir(tmp_path)
    column = tmp_path / "force.txt"
    column.write_text("0\n1\n0.5\n-1\n0\n")
    force = ForceSpec(1.0, None, None, kind="column", file="force.txt")
    cell = replace(job.items[0].cell, scenario=replace(job.items[0].cell.scenario, force=force))
    replace(job, items=(Planned(cell, State.MISSING, "", True),)).write(tmp_path / "0.job")
    (tmp_path / "below").mkdir()
    monkeypatch.chdir(tmp_path / "below")
    (back,) = read(tmp_path / "0.job", job.store.folder).items
    assert back.cell.identity == cell.identity
    assert back.cell.scenario.forces(0)[0].values.tolist() == [0.0, 1.0, 0.5, -1.0, 0.0]
    for other in (lambda: column.write_text("0\n2\n"), column.unlink, lambda: os.mkfifo(column)):
        other()
        with limited(20.0), pytest.raises(InputError, match="cell="):
            read_job(tmp_path / "0.job", job.store.folder)


def test_a_stored_description_has_no_file_opened(tmp_path: Path, cells: list[Cell]) -> None:
    stated = cells[0].stated()
    for file in ("/dev/zero", str(tmp_path)):
        data = {**stated["data"], "force": {"kind": "column", "amplitude": 1.0, "file": file, "hold": "zero_order"}}
        with limited(20.0), pytest.raises(InputError, match="the file of its force is not there"):
            Cell.restored({**stated, "data": data}, cells[0].identity)


def _without_name(cell: Cell) -> Any:
    """A scenario without the name of its prior's widths, which decides nothing and is not stored."""
    scenario = cell.scenario
    return replace(scenario, prior=scenario.prior and replace(scenario.prior, name=""))


def test_a_job_is_text(job: CellJob, tmp_path: Path) -> None:
    job.write(tmp_path / "0.job")
    stated = json.loads((tmp_path / "0.job").read_text(encoding="utf-8"))
    assert [one["identity"] for one in stated["cell"]["cells"]] == [one.cell.identity for one in job.items]


class Raised(Exception):
    """What a pickle that is rebuilt would do here."""


class Trap:
    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _spring, ()


def _spring() -> None:
    raise Raised("code of another hand has run")


def edited(path: Path, *keys: Any, value: Any) -> bytes:
    """A job's file with another value under some keys, sealed by another hand."""
    whole = json.loads(path.read_text(encoding="utf-8"))
    inner = whole
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return sealed(FORMAT, json.dumps({key: item for key, item in whole.items() if key not in ("format", "sha256")}))


HOSTILE: dict[str, Callable[[Path], bytes]] = {
    "a pickle": lambda path: pickle.dumps(Trap()),
    "a bit": lambda path: bytes([*path.read_bytes()[:-5], path.read_bytes()[-5] ^ 4, *path.read_bytes()[-4:]]),
    "half": lambda path: path.read_bytes()[: path.stat().st_size // 2],
    "nothing": lambda path: b"",
    "another method": lambda path: edited(path, "cell", "cells", 0, "stated", "method", value="shooting"),
    "a method of os": lambda path: edited(path, "cell", "cells", 0, "stated", "method", value="os.system"),
    "another seed": lambda path: edited(path, "cell", "cells", 0, "stated", "seed", value=4),
    "a list for a scenario": lambda path: edited(path, "cell", "cells", 0, "stated", "data", value=[]),
    "no scenario": lambda path: edited(path, "cell", "cells", 0, "stated", "data", value={}),
    "samples without end": lambda path: edited(path, "cell", "cells", 0, "stated", "data", "samples", value=10**18),
    "cells in a text": lambda path: edited(path, "cell", "cells", value="all"),
    "a state of its own": lambda path: edited(path, "cell", "cells", 0, "state", value="urgent"),
    "no limit": lambda path: edited(path, "timeout_s", value=-1.0),
    "a target": lambda path: edited(path, "_target_", value="os.system"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_what_another_hand_has_put_in_the_place_of_a_job_is_one_line(job: CellJob, tmp_path: Path, what: str) -> None:
    path = tmp_path / "0.job"
    job.write(path)
    path.write_bytes(HOSTILE[what](path))
    with pytest.raises(InputError) as caught:
        read_job(path, job.store.folder)
    assert len(str(caught.value).splitlines()) == 1


def test_a_job_does_not_say_where_its_cells_are_written(job: CellJob, tmp_path: Path) -> None:
    job.write(tmp_path / "0.job")
    assert str(job.store.folder) not in (tmp_path / "0.job").read_text(encoding="utf-8")
    assert read(tmp_path / "0.job", tmp_path / "here").folder == tmp_path / "here"


def test_while_a_launcher_runs_nothing_in_the_store_is_a_pickle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Submitit hands its jobs over as pickles: they lie in a folder of the user alone, and go with the sweep."""
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    seen: dict[str, list[Path]] = {}

    rounds = launch._rounds

    def looked(launcher: Any, sweep: Job, folder: Path, how: Any) -> None:
        rounds(launcher, sweep, folder, how)
        for name in ("rows", "cache"):
            seen[name] = [path for path in (tmp_path / name).rglob("*") if path.is_file()]
        seen["pickles"] = [path for path in (*seen["rows"], *seen["cache"]) if _is_pickle(path)]

    monkeypatch.setattr(launch, "_rounds", looked)
    fields = ["-m", "method=prior", "seed=0,1", "replicates=2", f"store={tmp_path / 'rows'}"]
    assert main([*fields, "hydra/launcher=submitit_local", "cells_per_job=1"]) == 0
    assert len([path for path in seen["rows"] if path.suffix == ".job"]) == 2
    assert seen["pickles"]
    assert all(path.is_relative_to(tmp_path / "cache") for path in seen["pickles"])
    assert [path for path in (tmp_path / "cache").rglob("*") if path.is_file()] == []
    assert not (tmp_path / "rows" / "launches").exists()


def _is_pickle(path: Path) -> bool:
    content = path.read_bytes()
    return content[:1] == b"\x80" and content[-1:] == b"."


def test_the_private_folder_is_its_user_s_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    before = os.umask(0)
    try:
        one, two = make_private_folder(), make_private_folder()
    finally:
        os.umask(before)
    assert one != two
    for folder in (one, two, one.parent):
        assert folder.stat().st_mode & 0o077 == 0
    one.parent.chmod(0o770)
    with pytest.raises(InputError, match="others can write there"):
        make_private_folder()


def test_a_cache_that_cannot_be_written_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file"))
    with pytest.raises(InputError, match=f"{VARIABLE}=.*cannot be written") as caught:
        make_private_folder()
    assert len(str(caught.value).splitlines()) == 1


def test_pickles_are_rebuilt_from_pipes_alone() -> None:
    """Every ``pickle.load`` of the harness is of bytes of its own, or of one of its processes, not of a file."""
    found = set()
    for path in sorted((REPOSITORY / "bench").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            rebuilds = isinstance(node, ast.Attribute) and node.attr in ("load", "loads", "Unpickler")
            if rebuilds and isinstance(node.value, ast.Name) and node.value.id in PICKLERS:
                found.add(path.relative_to(REPOSITORY / "bench").as_posix())
    assert found == {
        "conformance/method_checks.py", "conformance/process.py",
        "conformance/system_checks.py", "measured/apart.py",
        "engine/pool.py", "sweep/cells.py", "sweep/method_process.py", "sweep/scoring_process.py", "sweep/wire.py",
    }  # fmt: skip
    assert not any((REPOSITORY / "bench" / name).read_text().count("read_bytes") for name in found)
