"""What a plan makes of cells that could not be read."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest
from conftest import Plugins, StoreFactory

from bench import InputError
from bench.run.pool import Limits
from bench.scenario.scenario import Scenario
from bench.store import answers
from bench.store.cell import Cell
from bench.store.seal import read_regular
from bench.sweep.plan import State, plan
from bench.sweep.runner import run_cells


@pytest.mark.parametrize("few", [0, 50], ids=["from the view", "from the files"])
def test_a_cell_that_could_not_be_read_for_a_moment_is_not_computed_again(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory, monkeypatch: pytest.MonkeyPatch, few: int
) -> None:
    plugins("Wrong")
    store, cell = new_store(), Cell(reference, "wrong", {"kind": "good"}, 1, 0, "wrong")
    run_cells(plan([cell], store), store, Limits(1, 60.0, 1000.0))
    read, failures = read_regular, 1

    def failing(path: Path) -> bytes:
        nonlocal failures
        if path == store.path(cell.identity) and failures:
            failures -= 1
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return read(path)

    monkeypatch.setattr(answers, "FEW", few)
    monkeypatch.setattr("bench.store.store.read_regular", failing)
    (again,) = plan([cell], store)
    assert (again.state, again.run) == (State.DONE, False)
    assert failures == 0
    failures = 9
    store.path(cell.identity).write_text(json.dumps(json.loads(read(store.path(cell.identity))), indent=1))
    with pytest.raises(InputError, match="cannot be read now"):
        plan([cell], store)
