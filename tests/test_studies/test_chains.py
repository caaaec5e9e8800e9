"""The benchmark of growing chains: its scenarios, what it makes of stored cells, its command line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.store.store import Store
from tests.studies import chains
from tests.studies.chains import PER_PERIOD, PERIODS, main, natural_frequencies, reach, scenario
from tests.studies.chains_picture import caption, reaching


def test_natural_frequencies_are_those_of_equal_chains(monkeypatch: pytest.MonkeyPatch) -> None:
    """``2 sqrt(k/m) sin((2 i - 1) π / (4 n + 2))`` for equal masses tied at one end (Rao, Mechanical Vibrations)."""
    equal = {f"{kind}{i}": value for kind, value in (("m", 2.0), ("c", 0.1), ("k", 18.0)) for i in range(1, 6)}
    monkeypatch.setattr(chains, "true_parameters", lambda n: equal)
    expected = 6.0 * np.sin((2 * np.arange(1, 6) - 1) * np.pi / 22)
    assert np.allclose(natural_frequencies(5), expected)


@pytest.mark.parametrize("n", [1, 5, 20])
def test_records_are_as_long_and_as_fast_as_stated(n: int) -> None:
    """Poles from the state matrix of the scenario's own parameters: enough periods of the slowest, samples of each."""
    cell = scenario(n)
    p, size = cell.parameters, cell.make_system().n_dof
    assert size == n
    mass, damping, stiffness = np.zeros((3, n, n))
    for i in range(n):
        mass[i, i] = p[f"m{i + 1}"]
        for matrix, kind in ((damping, "c"), (stiffness, "k")):
            matrix[i, i] += p[f"{kind}{i + 1}"]
            if i:
                matrix[i - 1, i - 1] += p[f"{kind}{i + 1}"]
                matrix[i, i - 1] = matrix[i - 1, i] = -p[f"{kind}{i + 1}"]
    inverse = np.linalg.inv(mass)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    rates = np.abs(np.linalg.eigvals(state))
    step = cell.duration / (cell.samples - 1)
    assert cell.duration * rates.min() / (2 * np.pi) > 0.97 * PERIODS  # |pole|: of coupled damped modes not quite w
    assert 2 * np.pi / rates.max() / step >= 0.97 * PER_PERIOD > 4.0
    assert np.isin(np.round(cell.times / step, 6), np.round(cell.dense_times / step, 6)).all()
    assert np.allclose(np.diff(cell.forecast_times), cell.dense_times[1])


def lines(**fields: list[object]) -> pd.DataFrame:
    n = len(fields["n"])
    plain = {"method": ["shooting"] * n, "n_fits": [5] * n, "message": [""] * n, "cpu_s": [1.0] * n}
    excesses = {"parameters_excess": [1.0] * n, "ratios_excess": [1.0] * n}
    return pd.DataFrame({**plain, **excesses, **fields})


def test_where_a_method_gives_up_is_said() -> None:
    data = lines(
        n=[1, 2, 3, 5],
        n_ok=[5, 5, 3, 0],
        rmse_excess=[1.0, 1.2, 40.0, math.nan],
        status=["ok", "ok", "ok", "not tried"],
        message=["", "", "stopped after the limit", ""],
    )
    assert reach(data) == "| 2 | 3: 2 of 5 failed (stopped after the limit); excess 40 |"
    assert reach(data[:2]) == "| 2 | - |"
    assert reach(data[2:]) == "| none | 3: 2 of 5 failed (stopped after the limit); excess 40 |"


def test_methods_are_ordered_by_the_chains_they_solve_and_those_of_the_longest_are_named() -> None:
    """One that answers long chains wrongly is behind one that solves short ones; one failure is no solution."""
    data = lines(
        n=[1, 5, 1, 5, 1, 5],
        method=["ls", "ls", "shooting", "shooting", "pinn", "pinn"],
        n_ok=[5, 5, 5, 5, 5, 4],
        rmse_excess=[80.0, 90.0, 1.0, 1.1, 1.0, 1.0],
        status=["ok"] * 6,
    )
    assert reaching(data) == ["shooting", "pinn", "ls"]
    assert caption(data).startswith("Up to 5 masses: Multiple shooting solved it every time.")
    failed = data.assign(n_ok=0)
    assert reaching(failed) == []


@pytest.mark.slow
def test_a_second_run_computes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One mass, two methods, one of which is given up on after its first data set and not asked for two masses."""
    monkeypatch.setattr(chains, "replicates", lambda n: 2)
    arguments = [f"store={tmp_path / 'rows'}", f"out={tmp_path}", "sizes=1,2", "methods=ls,log_decrement"]
    assert main(arguments) == 0
    data = pd.read_csv(tmp_path / "chains.csv").set_index(["method", "n"])
    assert list(data.loc["ls"].n_fits) == [2, 2]
    assert list(data.loc["log_decrement"].n_fits) == [2, 1]
    assert data.loc[("log_decrement", 2), "status"] == "unsupported"
    store = Store(tmp_path / "rows")
    before = {name: store.stamp(name) for name in store.identities()}
    page_before = (tmp_path / "chains.md").read_bytes()
    assert main(arguments) == 0
    assert {name: store.stamp(name) for name in store.identities()} == before
    assert (tmp_path / "chains.md").read_bytes() == page_before
    (tmp_path / "chains.md").unlink()
    assert main([arguments[1], "fit=false"]) == 0  # from the table alone
    assert (tmp_path / "chains.md").read_bytes() == page_before
    (tmp_path / "chains.csv").unlink()
    assert main([arguments[1], "fit=false"]) == 2
