"""The benchmark of growing chains: its scenarios, what it makes of stored cells, its command line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.contract.estimate import Status
from bench.reporting.pictures.png import caption_of
from bench.scoring.row import Row
from bench.store.store import Store
from bench.store.stored_cell import StoredCell
from bench.systems import Chain
from tests.studies import chains
from tests.studies.chains import PER_PERIOD, PERIODS, main, natural_frequencies, page, picture, reach, scenario
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


def test_page_and_picture_of_what_is_there(tmp_path: Path) -> None:
    data = lines(n=[1, 2], n_ok=[5, 0], rmse_excess=[1.1, math.nan], status=["ok", "unsupported"])
    data.loc[1, ["method", "message", "cpu_s"]] = ["era", "it cannot", math.nan]
    text = page(data, 120.0)
    assert "it cannot (n = 2)" in text
    assert "3 parameters, 21 samples of each mass over 6 s" in text
    assert "One mass" not in text
    assert [path.suffix for path in picture(data, tmp_path)] == [".png"]
    assert caption_of(tmp_path / "chains.png") == caption(data)


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


def test_an_excess_is_a_root_mean_over_quantities() -> None:
    """Errors of 3 and 4 times the bound: the root of (9 + 16) / 2; none where a quantity is not given."""
    names = {"parameters": Chain(1).names, "ratios": [group.name for group in Chain(1).groups]}
    size = dict(zip(names["parameters"], (3.0, 4.0, math.sqrt(12.5)), strict=True))
    scores = {f"{name}_error_pct": value for name, value in size.items()}
    bound = {"median": 1.0, "bound": 1.0, "excess": 1.0}
    summary = {f"{name}_error_pct": bound for own in names.values() for name in own} | {"rmse": bound}
    stored = StoredCell("", {}, (Row(0, Status.OK, scores=scores),), summary, {}, {}, 0.0)
    got = chains.line(1, "ls", stored)
    assert got["parameters_excess"] == pytest.approx(math.sqrt(12.5))
    assert math.isnan(got["ratios_excess"])


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
    assert main([*arguments[:2], "sizes=1,2", "methods=ls,rls", "fit=false"]) == 0  # of what is stored alone
    assert set(pd.read_csv(tmp_path / "chains.csv").method) == {"ls"}
    assert main([*arguments[:2], "methods=rls", "fit=false"]) == 2


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("sizes=0", "sizes"),
        ("methods=pin", "did you mean pinn?"),
        ("timeout_s=nan", "finite"),
        ("snr=20", "fields: sizes"),
    ],
)
def test_a_wrong_argument_is_one_line(argument: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([argument]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
