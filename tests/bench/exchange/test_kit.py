"""The whole way of a method: written from the template, tested, run, submitted, and merged by somebody else."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import pytest
from conftest import Python, StoreFactory, install

from bench.commands.main import main
from bench.store.store import Store


@pytest.mark.slow
def test_a_method_from_the_template_is_run_submitted_and_merged(
    tmp_path: Path, python: Python, new_store: StoreFactory
) -> None:
    folder, theirs, ours = tmp_path / "own", new_store(), Store(tmp_path / "ours")
    assert main(["new", "method=quarter_car", f"out={folder}"]) == 0
    done = python("-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder))
    assert "1 passed" in done.stdout, done.stdout + done.stderr
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    ((group, points),) = project["entry-points"].items()
    env = install(folder, project["name"], f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in points.items()))
    ours.prepare()
    shutil.copytree(theirs.bounds, ours.bounds)
    sent = tmp_path / "sent.submission"
    for arguments in (
        ["bench", "method=quarter_car", "replicates=6", "workers=1", f"store={theirs.folder}"],
        ["bench", "share", "action=submit", "method=quarter_car", f"store={theirs.folder}", f"out={sent}"],
        ["bench", "share", "action=merge", f"submission={sent}", f"store={ours.folder}", "workers=1", "fresh=4"],
    ):
        done = python("-m", *arguments, env=env)
        assert done.returncode == 0, done.stdout + done.stderr
    assert "5 of 6 rows computed again, and all come out the same" in done.stdout
    (before,), (after,) = theirs, ours
    assert after.cell == {**before.cell, "label": "quarter_car (submitted)"}
    assert [(row.status, row.scores) for row in after.rows] == [(row.status, row.scores) for row in before.rows]
    assert after.n_ok == 6
    refused = python(
        "-m", "bench", "share", "action=merge", f"submission={sent}", f"store={ours.folder}"
    )  # where the method is not installed
    assert refused.returncode == 2
    assert "method=quarter_car: known methods" in refused.stderr
