"""A change that alters nothing keeps the cells; one that alters anything does not."""

import json
import shutil

import pytest

from bench.commands import recheck
from bench.config.config import expand
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.launch import complete
from bench.sweep.workers import Limits


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    """Two cells, computed once; never written to."""
    store = Store(tmp_path_factory.mktemp("computed") / "rows")
    store.prepare()
    jobs = expand(["method=ls,matrix_pencil", "replicates=4", "system=sdof"], multirun=True)
    complete([job.cell() for job in jobs], store, Limits(1, 60.0))
    return store


@pytest.fixture
def store(computed, tmp_path):
    return Store(shutil.copytree(computed.folder, tmp_path / "rows"))


def _edit(store: Store, method: str, **changes):
    """Rewrite the file of a method's cell."""
    for path in store.folder.glob("*.json"):
        content = json.loads(path.read_text())
        if content["cell"]["method"] == method:
            for key, value in changes.items():
                content[key] = value(content[key])
            path.write_text(json.dumps(content))
            return path
    raise AssertionError(method)


def _older(version):
    return {**version, "digest": "0123456789abcdef"}


def test_nothing_is_stale(store, capsys):
    assert recheck.main([f"store={store.folder}"]) == 0
    assert "no cell is stale" in capsys.readouterr().out


def test_cells_that_come_out_the_same_are_kept_and_say_so(store, capsys):
    path = _edit(store, "ls", version=_older)
    before = json.loads(path.read_text())
    assert recheck.main([f"store={store.folder}", "replicates=2"]) == 0
    assert "1 stale cells: 1 come out the same" in capsys.readouterr().out
    after = json.loads(path.read_text())
    assert after["rows"] == before["rows"]
    assert after["arrays"] == before["arrays"]
    (note,) = after["provenance"]["rechecked"]
    assert note["replicates"] == 2
    assert note["computed_by"] == "0123456789abcdef"
    assert not recheck.stale_cells(store)


def test_a_cell_that_comes_out_otherwise_stays_stale(store, capsys):
    """Its stored k/m error is moved by one part in ten thousand: more than the stored digits hide."""

    def moved(rows):
        scores = rows["scores"]
        name = "k_over_m_error_pct"
        return {**rows, "scores": {**scores, name: [v * 1.0001 for v in scores[name]]}}

    path = _edit(store, "ls", version=_older, rows=moved)
    assert recheck.main([f"store={store.folder}"]) == 0
    assert "comes out otherwise" in capsys.readouterr().out
    assert json.loads(path.read_text())["version"]["digest"] == "0123456789abcdef"


def test_a_cell_with_failures_is_not_vouched_for(store):
    """A change may be the repair of just that failure."""
    _edit(store, "ls", version=_older, rows=lambda rows: {**rows, "status": ["crashed", *rows["status"][1:]]})
    assert not recheck.stale_cells(store)


def test_bad_input_is_one_line(tmp_path, capsys):
    assert recheck.main([f"store={tmp_path}/none"]) == 2
    assert recheck.main(["replicates=none"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_the_first_replicates_are_the_same_question():
    cell = expand(["method=ls", "replicates=9"], multirun=False)[0].cell()
    short = recheck.shortened(cell, 2)
    assert isinstance(short, Cell)
    assert short.replicates == 2
    ours, theirs = (c.scenario.replicates(c.seed, 1)[0][0] for c in (cell, short))
    assert list(ours.records[0].channels[0].values) == list(theirs.records[0].channels[0].values)
