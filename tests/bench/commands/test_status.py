"""Status and reproduction of stored cells: what is there, what is stale and why, and whether it comes out again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from conftest import a_cell, computed
from stored import content, resealed

from bench.commands import reproduce, status
from bench.commands.main import main
from bench.engine.plan import plan
from bench.scenario.scenario import Scenario
from bench.store.cell import stored_as_cell
from bench.store.store import Store


@pytest.fixture
def store(reference: Scenario, store: Store) -> Store:
    """Two cells."""
    computed(store, a_cell(reference, "prior"), a_cell(reference, "oracle"))
    return store


def edit(store: Store, label: str, **changes: object) -> Path:
    """Rewrite fields of the stored cell of a method."""
    (path,) = (p for p in store.folder.glob("*.json") if content(p)["cell"]["label"] == label)
    path.write_bytes(resealed({**content(path), **changes}))
    return path


def test_a_store_is_described_by_method_and_state(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    edit(store, "prior", version={"method": 0, "system": 1, "scoring": 1})
    store.path("broken").write_text("{")
    assert main(["status", f"store={store.folder}"]) == 0
    out = capsys.readouterr().out
    assert "3 cells: 1 done, 1 stale, 1 damaged" in out
    assert "method version 0, today 1" in out
    assert "damaged: 1 x" in out


def test_a_cell_comes_out_again(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    (oracle,) = (cell for cell in store if cell.cell["label"] == "oracle")
    assert main(["reproduce", f"cell={oracle.identity[:6]}", f"store={store.folder}"]) == 0
    assert "run again: identical" in capsys.readouterr().out


def test_what_comes_out_differently_is_named(store: Store) -> None:
    """The stored errors are moved by a part in 10⁴, then by a tenth: the verdict must follow."""
    (oracle,) = (cell for cell in store if cell.cell["label"] == "oracle")
    for factor, verdict in ((1.0, "identical"), (1 + 1e-4, "within tolerance"), (1.1, "drifted")):
        path = store.path(oracle.identity)
        whole = content(path)
        moved = [value * factor for value in whole["rows"]["scores"]["rmse"]]
        whole["rows"]["scores"]["rmse"] = moved
        other = Store(path.parent.parent / f"other{verdict[:3]}")
        other.folder.mkdir()
        other.path(oracle.identity).write_bytes(resealed(whole))
        stored = other.load(oracle.identity)
        assert stored is not None
        found, lines = reproduce.compare(stored, oracle.rows)
        assert found == verdict
        assert all(line.startswith("rmse: relative difference") for line in lines)


def test_a_cell_is_shown_with_its_tracebacks(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    (oracle,) = (cell for cell in store if cell.cell["label"] == "oracle")
    store.save(replace(oracle, tracebacks="replicate 0\nTraceback: größer\n"))
    assert main(["status", f"cell={oracle.identity[:6]}", f"store={store.folder}"]) == 0
    out = capsys.readouterr().out
    assert "replicate 0\nTraceback: größer" in out
    assert str(store.path(oracle.identity)) in out


def test_a_cell_that_lacked_its_package_is_no_more_done_in_the_store_s_page_than_in_a_sweep_s(store: Store) -> None:
    """Where a stored cell stands is decided in one place; both pages must say the same of it."""
    path = edit(store, "prior")
    whole = content(path)
    whole["rows"]["status"] = ["missing_dependency", "missing_dependency"]
    path.write_bytes(resealed({**whole, "statuses": {"missing_dependency": 2}}))
    (one,) = (
        planned for planned in plan([stored_as_cell(cell) for cell in store], store) if planned.cell.label == "prior"
    )
    page = {head.identity: (state, why) for head, state, why in status.standings(store)}
    assert page[one.cell.identity] == (one.state.value, one.why)
    assert one.state.value == "failed"
