"""Measured records on the command line: errors, results, several files and several sensors.

File formats are tested in test_reading.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from bench.commands.main import main
from bench.config import choices
from bench.config.overrides import read_overrides
from bench.entrants import registry
from bench.records.request import request_of
from bench.scenario.truth import closed_form

P = {"m": 1.0, "c": 0.5, "k": 9.0}
T = np.linspace(0.0, 6.0, 31)
LONG = np.linspace(0.0, 8.0, 200)
OFFSET = 0.3
Capture = pytest.CaptureFixture[str]


def free_record(offset: float = 0.0) -> np.ndarray:
    return closed_form(P, 0.8, -0.4, T) + offset


def noise(size: float, seed: int, n: int = LONG.size) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal(n)


def written(path: Path, head: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=head, comments="", fmt="%.17g")
    return path


def record(folder: Path, name: str = "record.csv") -> Path:
    return written(folder / name, "t [s],x [m]", T, free_record())


def answers(arguments: list[str], capsys: Capture) -> list[dict[str, Any]]:
    """Return the JSON of every method; the exit status is 1 if no method is trusted."""
    status = main([*arguments, "format=json"])
    out, err = capsys.readouterr()
    assert err == ""
    results = [json.loads(line) for line in out.splitlines()]
    assert status == int(all(result["trust"] == "do not trust" for result in results))
    return results


def refusal(arguments: list[str], capsys: Capture) -> str:
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    return err


# errors in one line


def test_too_many_samples_are_rejected_with_advice(tmp_path: Path, capsys: Capture) -> None:
    times = np.arange(100_001) / 1000
    path = written(tmp_path / "long.csv", "t [s],x [m]", times, np.cos(times))
    error = refusal(["method=ls", f"data={path}"], capsys)
    assert "100001 samples: at most 100000; select a part by from= and to=" in error


def test_more_degrees_of_freedom_than_the_system_has_are_rejected(tmp_path: Path, capsys: Capture) -> None:
    path = written(tmp_path / "r.csv", "t [s],x1 [m],x2 [m]", T, free_record(), free_record())
    error = refusal(["method=ls", f"data={path}"], capsys)
    assert "the system has 1 DOF; choose a system of more DOF, or other columns=" in error


# results of estimates that are known


@pytest.fixture
def _exact(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Register a method that returns the groups in its settings, and methods that fail."""
    caches = (choices.choices, registry.load_method)
    names = {"exact": "Exact", "wrong": "Wrong", "needy": "Needy"}
    doubles = {name: EntryPoint(name, f"misbehaving:{attribute}", registry.GROUP) for name, attribute in names.items()}
    known = {**registry.registered(), **doubles}
    for module in (registry, choices):
        monkeypatch.setattr(module, "registered", lambda: known)
    for cached in caches:
        cached.cache_clear()
    yield
    for cached in caches:
        cached.cache_clear()


@pytest.mark.usefixtures("_exact")
def test_values_intervals_and_residuals_of_a_record_with_an_offset(tmp_path: Path, capsys: Capture) -> None:
    """With exact groups the residuals are the noise and the offset is exact; ω = 3 rad/s, ζ = 0.5/(2·3)."""
    left = noise(0.01, 2, 31)
    path = written(tmp_path / "record.csv", "t [s],x [mm]", T, 1e3 * (free_record(OFFSET) + left))
    (result,) = answers(["method=exact", f"data={path}"], capsys)
    assert (result["samples"], result["status"], result["message"]) == (31, "ok", "")
    estimates = result["estimates"]
    assert set(estimates) == {"k_over_m", "c_over_m", "natural_frequency", "damping_ratio"}
    k = estimates["k_over_m"]
    assert (k["value"], k["unit"]) == (9.0, "1/s²")
    assert (k["white_low"], k["white_high"]) == pytest.approx((9 - 1.959964 * 0.2, 9 + 1.959964 * 0.2), rel=1e-6)
    assert k["low"] < 9.0 < k["high"]
    assert estimates["natural_frequency"]["value"] == pytest.approx(3 / (2 * math.pi))
    assert estimates["damping_ratio"]["value"] == pytest.approx(0.5 / 6)
    residuals = result["residuals"]
    assert residuals["unit"] == "mm"
    assert residuals["offset"] == pytest.approx(1e3 * OFFSET, abs=10.0)
    assert len(residuals["values"]) == 31
    assert residuals["rms"] == pytest.approx(10.0, rel=0.3)
    assert residuals["rms"] <= 1e3 * np.sqrt(np.mean(left**2)) * 1.0001  # initial state and offset are fitted


@pytest.mark.usefixtures("_exact")
def test_a_prior_sets_the_scale_and_a_known_initial_state_excludes_an_offset(tmp_path: Path, capsys: Capture) -> None:
    nominal = ["prior=nominal", "nominal.m=2", "nominal.c=1", "nominal.k=18"]
    start = ["initial_state=known", "start=[0.8,-0.4]"]
    (result,) = answers(["method=exact", f"data={record(tmp_path)}", *nominal, *start], capsys)
    estimates = result["estimates"]
    assert estimates["m"]["value"] == pytest.approx(2.0, rel=1e-3)  # the nominal ratios equal the groups
    assert estimates["k"]["value"] == pytest.approx(18.0, rel=1e-3)
    m = estimates["m"]
    assert m["white_high"] / m["white_low"] == pytest.approx(math.exp(2 * 1.96 * 0.02), rel=1e-3)
    assert result["residuals"]["offset"] == 0.0
    assert result["residuals"]["rms"] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.usefixtures("_exact")
def test_a_known_mass_scales_stiffness_and_damping(tmp_path: Path, capsys: Capture) -> None:
    (result,) = answers(["method=exact", f"data={record(tmp_path)}", "fixed.m=2"], capsys)
    estimates = result["estimates"]
    for name, unit in (("k", "N/m"), ("c", "N·s/m")):
        parameter, ratio = estimates[name], estimates[f"{name}_over_m"]
        assert parameter["unit"] == unit
        for end in ("value", "low", "high", "white_low", "white_high"):
            assert parameter[end] == pytest.approx(2.0 * ratio[end])
    assert main(["method=exact", f"data={record(tmp_path)}", "fixed.m=2"]) == 0
    assert "not individually identifiable" not in capsys.readouterr().out


@pytest.mark.usefixtures("_exact")
def test_residuals_of_wrong_groups_are_the_difference_of_the_responses(tmp_path: Path, capsys: Capture) -> None:
    given = ["method.k_over_m=8.5", "initial_state=known", "start=[0.8,-0.4]"]
    (result,) = answers(["method=exact", f"data={record(tmp_path)}", *given], capsys)
    residuals = result["residuals"]
    r = free_record() - closed_form({"m": 1.0, "c": 0.5, "k": 8.5}, 0.8, -0.4, T)
    np.testing.assert_allclose(residuals["values"], r, atol=1e-9)
    assert residuals["rms"] == pytest.approx(np.sqrt(np.mean(r**2)))
    assert residuals["part_of_signal"] == pytest.approx(np.sqrt(np.mean(r**2)) / np.std(free_record()))
    centred = r - np.mean(r)
    assert residuals["lag1_autocorrelation"] == pytest.approx(np.sum(centred[1:] * centred[:-1]) / np.sum(centred**2))
    assert result["trust"] != "trust"


@pytest.mark.usefixtures("_exact")
def test_the_table_states_that_the_scale_is_not_identifiable(tmp_path: Path, capsys: Capture) -> None:
    assert main(["method=exact", f"data={record(tmp_path)}"]) == 0
    out = capsys.readouterr().out
    assert "31 samples" in " ".join(out.split())
    assert "m, c and k are not individually identifiable" in " ".join(out.split())
    assert "k/m" in out


@pytest.mark.usefixtures("_exact")
@pytest.mark.parametrize(
    ("method", "status", "part"),
    [
        (["method=wrong", "method.kind=raise"], "crashed", "two lines of reasons"),
        (["method=wrong", "method.kind=good"], "unsupported", "offset"),
        (["method=wrong", "method.kind=exit"], "crashed", ""),
        (["method=needy"], "missing_dependency", "pip install"),
    ],
)
def test_a_fit_that_fails_is_reported_not_raised_and_the_status_is_1(
    method: list[str], status: str, part: str, tmp_path: Path, capsys: Capture
) -> None:
    known = ["initial_state=known", "start=[0.8,-0.4]"] if status == "crashed" else []
    assert main([*method, f"data={record(tmp_path)}", "format=json", *known]) == 1
    result = json.loads(capsys.readouterr().out)
    assert (result["status"], result["estimates"], result["residuals"]) == (status, {}, None)
    assert result["trust"] == "do not trust"
    assert part in result["message"]
    assert f"no estimate ({status})" in result["reasons"][0]


@pytest.mark.usefixtures("_exact")
def test_one_of_several_methods_suffices_for_exit_status_0(tmp_path: Path, capsys: Capture) -> None:
    path = [f"data={record(tmp_path)}", "initial_state=known", "start=[0.8,-0.4]"]
    results = answers(["method=exact,wrong", *path], capsys)
    assert [(result["method"], result["status"]) for result in results] == [("exact", "ok"), ("wrong", "crashed")]
    assert main(["method=exact,wrong", *path]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"record: {tmp_path / 'record.csv'}"
    assert [line.split()[0] for line in lines if line.startswith(("exact ", "wrong "))] == ["exact"]
    assert any(line.strip().startswith("wrong") for line in lines)
    assert main(["method=wrong,needy", *path]) == 1


def test_all_can_be_written_on_the_command_line(tmp_path: Path, capsys: Capture) -> None:
    overrides = read_overrides(["method=all", f"data={record(tmp_path)}"])
    assert len(request_of(overrides).jobs) == len(registry.registered())
    assert main(["method=ls", f"data={record(tmp_path)}", "--cfg", "job"]) == 0
    assert "record.csv" in capsys.readouterr().out
    assert "method=all" in refusal(["method=all"], capsys)  # a scenario has a single method


# several files, several sensors


def run(folder: Path, name: str, k: float, start: tuple[float, float], seed: int) -> Path:
    x = closed_form({**P, "k": k}, *start, LONG) + noise(0.003, seed)
    return written(folder / name, "t [s],x [m]", LONG, x)


def test_repeats_are_combined(tmp_path: Path, capsys: Capture) -> None:
    first, second = run(tmp_path, "run1.csv", 9.0, (0.8, -0.4), 1), run(tmp_path, "run2.csv", 9.0, (-0.2, 2.0), 2)
    (both,) = answers(["method=output_error", f"data={first},{second}"], capsys)
    (single,) = answers(["method=output_error", f"data={first}"], capsys)
    assert both["samples"] == 400
    assert both["data"] == f"{first}, {second}"
    narrow, wide = both["estimates"]["k_over_m"], single["estimates"]["k_over_m"]
    assert narrow["low"] < 9.0 < narrow["high"]
    assert narrow["white_high"] - narrow["white_low"] < wide["white_high"] - wide["white_low"]
    by_run = [run["estimates"]["k_over_m"]["value"] for run in both["runs"].values()]
    assert by_run == pytest.approx([9.0, 9.0], rel=0.01)
    assert by_run[0] == pytest.approx(wide["value"], rel=1e-4)


def test_different_runs_are_reported_and_the_interval_covers_both(tmp_path: Path, capsys: Capture) -> None:
    first, second = run(tmp_path, "run1.csv", 9.0, (0.8, -0.4), 1), run(tmp_path, "run2.csv", 9.3, (0.8, -0.4), 2)
    (both,) = answers(["method=output_error", f"data={first},{second}"], capsys)
    assert [run["estimates"]["k_over_m"]["value"] for run in both["runs"].values()] == pytest.approx(
        [9.0, 9.3], rel=0.01
    )
    assert both["trust"] == "use with caution"
    assert any("differs by up to" in reason for reason in both["reasons"])
    k = both["estimates"]["k_over_m"]
    assert k["low"] < 9.0 < 9.3 < k["high"]
    assert k["white_high"] < 9.3


def test_displacement_and_velocity_are_fitted_jointly(tmp_path: Path, capsys: Capture) -> None:

    def law(t: float, y: np.ndarray) -> list[float]:
        return [y[1], -P["c"] * y[1] - P["k"] * y[0]]

    x, v = solve_ivp(law, (0.0, 8.0), [0.8, -0.4], t_eval=LONG, rtol=1e-9, atol=1e-12).y
    path = written(tmp_path / "r.csv", "t [s],x [mm],v [m/s]", LONG, 1e3 * (x + noise(0.005, 1)), v + noise(0.02, 2))
    (result,) = answers(["method=output_error", f"data={path}"], capsys)
    assert result["samples"] == 400
    assert result["estimates"]["k_over_m"]["value"] == pytest.approx(9.0, rel=0.01)
    assert result["residuals"]["rms"] == pytest.approx(5.0, rel=0.2)  # mm, the unit of the file


def test_two_masses_are_a_chain(tmp_path: Path, capsys: Capture) -> None:
    m, c, k = (1.0, 0.8), (0.2, 0.15), (12.0, 9.0)

    def law(t: float, y: np.ndarray) -> list[float]:
        x1, x2, v1, v2 = y
        link = c[1] * (v2 - v1) + k[1] * (x2 - x1)
        return [v1, v2, (link - c[0] * v1 - k[0] * x1) / m[0], -link / m[1]]

    y = solve_ivp(law, (0.0, 8.0), [1.0, 0.0, 0.0, 0.0], t_eval=LONG, rtol=1e-9, atol=1e-12).y
    path = written(tmp_path / "r.csv", "t [s],x1 [m],x2 [m]", LONG, y[0] + noise(0.005, 1), y[1] + noise(0.005, 2))
    (result,) = answers(["method=output_error", "system=chain2", f"data={path}"], capsys)
    assert result["samples"] == 400
    values = {name: estimate["value"] for name, estimate in result["estimates"].items()}
    truth = {"m2_over_m1": 0.8, "c1_over_m1": 0.2, "c2_over_m1": 0.15, "k1_over_m1": 12.0, "k2_over_m1": 9.0}
    assert {name: values[name] for name in truth} == pytest.approx(truth, rel=0.1)


def test_force_gain_reverses_the_sign_of_a_force(tmp_path: Path, capsys: Capture) -> None:
    """A mass of 2 kg moves from rest; the force in the file is in kN and has the opposite sign."""
    force = np.cumsum(np.random.default_rng(5).standard_normal(LONG.size))
    x = lsim(([1.0], [2.0, 1.0, 18.0]), force, LONG)[1]
    path = written(tmp_path / "r.csv", "t [s],x [m],force [kN]", LONG, x + noise(0.01 * np.std(x), 1), -1e-3 * force)
    (result,) = answers(["method=output_error", f"data={path}", "force_gain=-1"], capsys)
    values = {name: estimate["value"] for name, estimate in result["estimates"].items()}
    assert values["m"] == pytest.approx(2.0, rel=0.02)
    assert values["k"] == pytest.approx(18.0, rel=0.02)


def test_the_interpolation_of_the_force_can_be_specified(tmp_path: Path, capsys: Capture) -> None:
    """For a zero-order hold sampled slowly, residuals are the noise with hold=zero_order and larger with linear."""
    times = np.linspace(0.0, 8.0, 81)
    force = np.random.default_rng(6).standard_normal(81)
    fine = np.linspace(0.0, 8.0, 8001)
    steps = force[np.minimum(np.arange(8001) // 100, 80)]
    x = lsim(([1.0], [1.0, 0.5, 9.0]), steps, fine, interp=False)[1][::100]
    path = written(tmp_path / "r.csv", "t [s],x [m],f [N]", times, x + noise(0.01 * np.std(x), 1, 81), force)
    parts = {}
    for hold in ("zero_order", "linear"):
        (result,) = answers(["method=output_error", f"data={path}", f"hold={hold}"], capsys)
        parts[hold] = result["residuals"]["part_of_signal"]
    assert parts["zero_order"] == pytest.approx(0.01, rel=0.3)
    assert parts["linear"] > 3 * parts["zero_order"]


# reading by the command line


@pytest.mark.usefixtures("_exact")
def test_columns_and_units_can_be_specified(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "bare.csv"
    np.savetxt(path, np.column_stack([1e3 * T, np.arange(31.0), 1e3 * free_record(OFFSET)]), delimiter=",", fmt="%.17g")
    (result,) = answers(["method=exact", f"data={path}", "columns=t:0,x:2", "units=t:ms,x:mm"], capsys)
    assert (result["residuals"]["offset"], result["residuals"]["unit"]) == (pytest.approx(1e3 * OFFSET, abs=2.0), "mm")
    assert result["residuals"]["part_of_signal"] < 0.01


@pytest.mark.usefixtures("_exact")
def test_a_part_of_a_record_is_chosen_on_its_own_clock(tmp_path: Path, capsys: Capture) -> None:
    """Before 102 s the file has other values; the rest is a decay with the same parameters."""
    x = np.where(T < 2.0, 5.0, free_record())
    path = written(tmp_path / "r.csv", "t [s],x [m]", T + 100.0, x)
    (result,) = answers(["method=exact", f"data={path}", "from=102", "to=105"], capsys)
    assert result["samples"] == np.count_nonzero((T >= 2.0 - 1e-9) & (T <= 5.0 + 1e-9))
    assert result["residuals"]["part_of_signal"] < 0.01


# sums


@pytest.mark.slow
def test_a_known_length_converts_a_displacement_to_an_angle(tmp_path: Path, capsys: Capture) -> None:
    """``s'' + c s' + k l sin(s/l) = 0`` with l = 0.5 m, released at 1.4 rad."""
    length, k = 0.5, 9.81 / 0.5

    def law(t: float, y: np.ndarray) -> list[float]:
        return [y[1], -0.2 * y[1] - k * length * np.sin(y[0] / length)]

    s = solve_ivp(law, (0.0, 8.0), [0.7, 0.0], t_eval=LONG, rtol=1e-9, atol=1e-12).y[0] + noise(0.003, 1)
    path = written(tmp_path / "r.csv", "t [s],x [m]", LONG, s)
    (result,) = answers(["method=output_error", "system=viscous+pendulum", "fixed.l=0.5", f"data={path}"], capsys)
    assert result["estimates"]["k_over_m"]["value"] == pytest.approx(k, rel=0.01)
    assert "l" not in result["estimates"]
