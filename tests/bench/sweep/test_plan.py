"""What a plan makes of cells that could not be read."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from conftest import Plugins, StoreFactory

from bench import InputError
from bench.engine.pool import Limits
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.sweep.plan import State, plan
from bench.sweep.runner import run_cells


def test_a_cell_that_cannot_be_read_for_a_moment_is_not_computed_again(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugins("Wrong")
    store, cell = new_store(), Cell(reference, "wrong", {"kind": "good"}, 1, 0, "wrong")
    run_cells(plan([cell], store), store, Limits(1, 60.0, 1000.0))

    def failing(path: Path) -> bytes:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as disk:
        for name in ("read_regular", "open_regular"):
            disk.setattr(f"bench.store.store.{name}", failing)
        with pytest.raises(InputError, match="cannot be read now"):
            plan([cell], store)
    (again,) = plan([cell], store)
    assert (again.state, again.run) == (State.DONE, False)
