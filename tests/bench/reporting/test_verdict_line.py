"""The verdict under a cell's table: of summaries that are made to be good, biased, overconfident or silent."""

from __future__ import annotations

import math
from typing import Any

import pytest

from bench.contract.estimate import Status
from bench.reporting.terminal import coloured
from bench.reporting.verdict import good, verdict
from bench.scoring.row import Row
from bench.store.stored import StoredCell


def cell(excess: dict[str, float], cover: dict[str, float], ok: int = 100, silent: int = 0) -> StoredCell:
    rows = [Row(i, Status.OK if i < ok else Status.DIVERGED) for i in range(ok + silent)]
    summary: dict[str, Any] = {f"{name}_error_pct": {"excess": value} for name, value in excess.items()}
    summary |= {f"{name}_coverage_95": {"mean": value} for name, value in cover.items()}
    return StoredCell("0" * 20, {}, rows, summary, {}, {"m": False}, 0.0)


GOOD = {"k_over_m": 1.05, "c_over_m": 0.98}
COVER = {"k_over_m": 0.95, "c_over_m": 0.93}


@pytest.mark.parametrize(
    ("excess", "cover", "said"),
    [
        (GOOD, COVER, "on the bound; intervals hold"),
        # 100 errors: a root mean square is within about 14 % of its own, so 1.3 may be chance and 1.5 may not
        ({**GOOD, "k_over_m": 1.3}, COVER, "on the bound; intervals hold"),
        ({**GOOD, "k_over_m": 1.5}, COVER, "1.50 times the bound in k/m, on it in others; intervals hold"),
        ({"k_over_m": 9.0, "c_over_m": 2.0}, COVER, "9.00 times the bound in k/m; intervals hold"),
        # of 100 intervals at 95 % fewer than 90 hold in less than one case of 40
        (GOOD, {**COVER, "c_over_m": 0.90}, "on the bound; intervals hold"),
        (GOOD, {**COVER, "c_over_m": 0.89}, "on the bound; 95 % intervals of c/m hold in 89 %"),
        (GOOD, {}, "on the bound; no intervals are told"),
        # what the prior alone tells is not the method's
        ({**GOOD, "m": 30.0}, {**COVER, "m": 0.1}, "on the bound; intervals hold"),
    ],
)
def test_it_says_what_the_numbers_say(excess: dict[str, float], cover: dict[str, float], said: str) -> None:
    assert verdict(cell(excess, cover)) == said


def test_fits_without_an_answer_are_counted_and_few_give_no_verdict() -> None:
    assert verdict(cell(GOOD, COVER, 95, 5)).endswith("5 of 100 fits have no answer")
    assert not good(verdict(cell(GOOD, COVER, 95, 5)))
    assert good(verdict(cell(GOOD, COVER)))
    assert verdict(cell(GOOD, COVER, 4, 96)).startswith("no verdict: 4 of 100")
    assert verdict(cell({"k_over_m": math.nan}, {})).startswith("no verdict: nothing")


def test_colour_is_for_terminals_that_want_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert coloured("x", "green") == "x"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert coloured("x", "green") == "\x1b[32mx\x1b[0m"
    monkeypatch.setenv("NO_COLOR", "1")
    assert coloured("x", "green") == "x"
