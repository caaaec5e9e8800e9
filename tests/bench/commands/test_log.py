"""Messages on the error stream: the levels of -v and -q, and the logger ``bench`` for other programs."""

from __future__ import annotations

import logging

import pytest

from bench.commands.main import main
from bench.store.store import Store

SWEEP = ["-m", "method=prior", "replicates=2,3", "workers=1"]


@pytest.mark.usefixtures("any_bound")
def test_quiet_prints_results_only_and_verbose_the_reason_of_each_cell(
    store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    for option, lines in (("-v", ["2 cells: 2 missing", "prior on sdof 20 dB known: missing"]), ("-q", [])):
        assert main([*SWEEP, option, f"store={store.folder}", "seed=7"]) == 0
        out, err = capsys.readouterr()
        assert "full results" in out
        assert all(line in err for line in lines)
        assert bool(err) == bool(lines)
    assert main(["-q", "method=pin"]) == 2
    assert "did you mean" in capsys.readouterr().err


@pytest.mark.usefixtures("any_bound")
def test_the_log_of_other_programs_is_not_changed(store: Store) -> None:
    log = logging.getLogger("bench")
    before = (log.level, log.propagate, list(log.handlers))
    assert main([*SWEEP, "-q", f"store={store.folder}"]) == 0
    assert (log.level, log.propagate, list(log.handlers)) == before
