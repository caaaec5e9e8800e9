"""The verdicts' page: which numbers, which readings, and what follows from known replicates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.contract.estimate import Status
from bench.reporting.frame import Result
from bench.reporting.paper import printed
from bench.reporting.reproduction import (
    ASSUMPTIONS,
    Place,
    all_cells,
    ratio_verdicts,
    simple,
    verdicts,
)
from bench.reporting.reproduction_page import consistency, implied_rmse, written
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.store.stored import StoredCell


def test_there_are_59_numbers() -> None:
    """Table 2: 3; Table 3: 4 methods, 4 each; Tables 4 and 5: 5 rows, 4 each."""
    found = printed()
    assert [sum(p.table == table for p in found) for table in (2, 3, 4, 5)] == [3, 16, 20, 20]
    assert max(found, key=lambda p: p.value).value == 36.9  # damping by LS in its Table 3


def test_readings_change_what_they_say_and_nothing_else(reference: Scenario) -> None:
    changed = {name: change(reference) for name, change in ASSUMPTIONS.items()}
    assert changed["records of 5 s"] == replace(reference, duration=5.0)
    assert changed["start unknown"].initial_state == "unknown"
    # the peak is the start; noise of the same decibels from the peak is larger by peak over root mean square
    other = changed["SNR from the peak"]
    peak = abs(reference.initial[0][0])
    assert other.sigmas(0)[0] == pytest.approx(peak * 10.0 ** (-reference.snr_db / 20.0), rel=1e-9)


def test_implied_rmse_by_hand(reference: Scenario) -> None:
    """Errors of m, c and k that are equal and of one sign change nothing; a larger error of k alone, something."""
    low, high = implied_rmse(reference, [3.0, 3.0, 3.0])
    assert low == pytest.approx(0.0, abs=1e-12)
    assert high > implied_rmse(reference, [0.0, 0.0, 3.0])[1] > 0.0


def stored(cell: dict[str, float], n: int = 100) -> StoredCell:
    """Errors spread evenly from 0 to twice a centre by metric."""
    share = (np.arange(n) + 0.5) / n
    rows = tuple(Row(i, Status.OK, scores={k: 2.0 * c * float(share[i]) for k, c in cell.items()}) for i in range(n))
    return StoredCell("x", {}, rows, {k: {"excess": 1.0} for k in cell}, {"m": 1.0}, {}, 0.0, {})


def test_verdicts_and_firmness_follow_from_the_replicates() -> None:
    """Ours equal to the paper's everywhere, but ten times smaller where records are 20 s long."""
    cells = all_cells()
    numbers = {(p.table, p.row, p.method, p.metric): p.value for p in printed()}

    def made(place: Place, scale: float) -> Result:
        table, row, method = place
        name = "pinn" if method in ("oracle", "pinn_adam") else method
        own = {m: scale * v for (t, r, n, m), v in numbers.items() if (t, r, n) == (table, row, name)}
        return Result.of_stored(stored(own or {"rmse": 1.0}))

    found = {
        reading: {place: made(place, 0.1 if reading == "records of 20 s" else 1.0) for place in own}
        for reading, own in cells.items()
    }
    data = verdicts(found)
    assert len(data) == 59
    masses = data.metric == "m_error_pct"
    assert set(data[masses]["as in the protocol"].map(simple)) == {"not decidable"}
    assert not data[masses].decided.any()
    assert not data[masses].firm.any()  # what is not decided cannot be firm
    others = data[~masses & (data.method == "pinn")]
    assert set(others["as in the protocol"]) == {"reproduced"}
    assert others.decided.all()
    assert not others.firm.any()
    assert set(others["records of 20 s"]) == {"ours better"}
    base = next(iter(cells.values()))
    text = written(data, ratio_verdicts(found), base)["reproduction.md"]
    assert "no: records of 20 s" in text
    assert f"{data.decided.sum()} of 59 numbers are decided, and 0 of these verdicts are firm" in text
    assert "6 of the 15 mass errors that it prints exceed 3.9 %" in text  # 18.2, 13.8, 9.4, 4.3, 7.1, 11.8
    assert isinstance(consistency(base), list)
