"""The picture of Table 5 comes from stored rows alone, and bad input is one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bench import config
from bench.bound import Bound
from bench.cell import Cell
from bench.figures import main
from bench.statistics import summarise
from bench.store import Row, Status, Store, StoredCell

pytest.importorskip("matplotlib")


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    """Two SNRs of one method, as if they had run."""
    sweep = {"method": ["oracle"], "snr": [40, 10]}
    described: dict[str, Any] = {"sweep": sweep, "replicates": 4, "table": {"number": 5, "title": "T"}}
    monkeypatch.setattr(config, "_experiment", lambda name: described if name else {})
    store = Store(tmp_path / "rows")
    store.prepare()
    for cell in config.jobs_to_cells(config.expand(["experiment=table5"], multirun=True)):
        store.save(as_if_run(cell))
    return store


def as_if_run(cell: Cell) -> StoredCell:
    scores = {"k_over_m_error_pct": 1.0, "c_over_m_error_pct": 4.0, "rmse": 0.02}
    rows = tuple(Row(i, Status.OK, scores=scores) for i in range(4))
    bound = Bound(("m",), {"k_over_m": 0.01, "c_over_m": 0.03}, {}, {}, 0.01, 0.01, ())
    summary = {name: vars(line) for name, line in summarise(rows, bound).items()}
    return StoredCell(cell.identity, cell.description(), rows, summary, {}, {}, 1.0, {})


def test_the_figure_is_written_the_same_each_time(store: Store, tmp_path: Path) -> None:
    out = tmp_path / "figures"
    assert main([f"store={store.folder}", f"out={out}"]) == 0
    first = {path.name: path.read_bytes() for path in out.iterdir()}
    names = ("error_against_noise", "accuracy_against_time")
    assert set(first) == {f"{name}.{ending}" for name in names for ending in ("svg", "png", "txt")}
    assert main([f"store={store.folder}", f"out={out}"]) == 0
    assert {path.name: path.read_bytes() for path in out.iterdir()} == first


@pytest.mark.parametrize("bad", [["store=nowhere"], ["stor=x"], ["out="]])
def test_bad_input_is_one_line(
    bad: list[str], store: Store, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main([*bad, *([f"store={tmp_path}"] if bad == ["out="] else [])]) == 2
    err = capsys.readouterr().err
    assert err.startswith("bench.figures: ")
    assert len(err.splitlines()) == 1
