"""The benchmark command times every method of Tables 3 to 5 and says where it extrapolates."""

from __future__ import annotations

from typing import Any

import pytest

from bench.commands import benchmark
from bench.config.experiment import Experiment


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch, any_bound: None) -> None:
    """Tables of two methods at one noise level, four replicates, and bounds that say nothing."""
    sweep = {"method": ["prior", "oracle"], "snr": [20], "initial_state": ["known"]}
    described: dict[str, Any] = {"sweep": sweep, "replicates": 4, "table": {"number": 3, "title": "T"}}
    monkeypatch.setattr(Experiment, "content", property(lambda self: described))


def lines(out: str) -> dict[str, list[str]]:
    return {line.split()[0]: line.split() for line in out.splitlines() if line.startswith(("prior", "oracle"))}


def test_every_cell_is_timed_once_although_three_tables_hold_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmark.main(["workers=1"]) == 0
    found = lines(capsys.readouterr().out)
    assert {method: line[1:3] for method, line in found.items()} == {"prior": ["1", "4"], "oracle": ["1", "4"]}
    assert not any("(extrapolated)" in line for line in found.values())


def test_fewer_replicates_are_marked_as_extrapolated(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmark.main(["method=prior", "replicates=2", "workers=1"]) == 0
    found = lines(capsys.readouterr().out)
    assert set(found) == {"prior"}
    assert found["prior"][2] == "2"
    assert found["prior"][-1] == "(extrapolated)"


@pytest.mark.parametrize("bad", ["workers=abc", "workers=0", "replicates=0", "foo=1", "method=pin"])
def test_bad_input_is_one_line(bad: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmark.main([bad]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"bench.benchmark: {bad.partition('=')[0]}=")
    assert len(err.splitlines()) == 1
