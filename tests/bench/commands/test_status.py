"""Status and reproduction of stored cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from conftest import a_cell, computed
from stored import content, resealed

from bench.commands import reproduce
from bench.commands.main import main
from bench.scenario.scenario import Scenario
from bench.store.store import Store


@pytest.fixture
def store(reference: Scenario, store: Store) -> Store:
    """Return a store of two cells."""
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


def test_scores_that_differ_are_listed(store: Store) -> None:
    """The stored errors are changed by two parts in 10⁴, then by a tenth."""
    (oracle,) = (cell for cell in store if cell.cell["label"] == "oracle")
    for factor, verdict in ((1.0, "identical"), (1 + 2e-4, "within tolerance"), (1.1, "drifted")):
        path = store.path(oracle.identity)
        whole = content(path)
        whole["rows"]["scores"]["rmse"] = [value * factor for value in whole["rows"]["scores"]["rmse"]]
        other = Store(path.parent.parent / f"other{verdict[:3]}")
        other.folder.mkdir()
        other.path(oracle.identity).write_bytes(resealed(whole))
        stored = other.load(oracle.identity)
        assert stored is not None
        result, lines = reproduce.compare(stored, oracle.rows)
        assert result == verdict
        assert bool(lines) == (verdict != "identical")
        assert all(line.startswith("rmse: relative difference") for line in lines)


def test_a_cell_is_shown_with_its_tracebacks(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    (oracle,) = (cell for cell in store if cell.cell["label"] == "oracle")
    store.save(replace(oracle, tracebacks="replicate 0\nTraceback: größer\n"))
    assert main(["status", f"cell={oracle.identity[:6]}", f"store={store.folder}"]) == 0
    out = capsys.readouterr().out
    assert "replicate 0\nTraceback: größer" in out
    assert str(store.path(oracle.identity)) in out
