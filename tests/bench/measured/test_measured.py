"""A measured record: what files may look like, what is said of bad ones, and what is reported."""

from __future__ import annotations

import json
import math
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import InputError
from bench.commands.main import main
from bench.config import choices, composition
from bench.entrants import registry
from bench.measured.record import read_record
from bench.scenario.truth import closed_form

P = {"m": 1.0, "c": 0.5, "k": 9.0}
T = np.linspace(0.0, 6.0, 31)
OFFSET = 0.3


def free_record(offset: float = 0.0) -> np.ndarray:
    return closed_form(P, 0.8, -0.4, T) + offset


def write(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(text.encode(encoding))
    return path


def rows(x: np.ndarray, separator: str = ",") -> str:
    return "\n".join(f"{t!r}{separator}{v!r}" for t, v in zip(T.tolist(), x.tolist(), strict=True)) + "\n"


GOOD = {
    "commas, no header": ("0,1\n0.5,2\n1.5,-3\n", 1.0),
    "a header": ("t,x\n0,1\n0.5,2\n1.5,-3\n", 1.0),
    "units in brackets": ("t [s], x [mm]\n0,1000\n0.5,2000\n1.5,-3000\n", 1.0),
    "units in parentheses": ("time (ms),position (cm)\n0,100\n500,200\n1500,-300\n", 1.0),
    "units as suffixes": ("time_s,x_um\n0,1e6\n0.5,2e6\n1.5,-3e6\n", 1.0),
    "micrometres in Greek": ("t [s],x [µm]\n0,1e6\n0.5,2e6\n1.5,-3e6\n", 1.0),
    "inches": ("t [s],x [in]\n0,1\n0.5,2\n1.5,-3\n", 0.0254),
    "semicolons": ("t;x\n0;1\n0.5;2\n1.5;-3\n", 1.0),
    "tabs": ("t\tx\n0\t1\n0.5\t2\n1.5\t-3\n", 1.0),
    "spaces": ("0   1\n0.5 2\n 1.5 -3\n", 1.0),
    "a byte order mark": ("\ufefft,x\n0,1\n0.5,2\n1.5,-3\n", 1.0),
    "Windows lines": ("t,x\r\n0,1\r\n0.5,2\r\n1.5,-3\r\n", 1.0),
    "comments and gaps": ("# rig 3\n% Monday\n\nt,x\n0,1\n\n0.5,2\n# pause\n1.5,-3\n\n", 1.0),
    "a quoted header": ('"t [s]","x [m]"\n0,1\n0.5,2\n1.5,-3\n', 1.0),
    "exponents": ("0,1e0\n5e-1,2.0E0\n1.5,-3\n", 1.0),
    "a clock that does not start at zero": ("t,x\n100,1\n100.5,2\n101.5,-3\n", 1.0),
}


@pytest.mark.parametrize("what", GOOD)
def test_good_files(what: str, tmp_path: Path) -> None:
    text, size = GOOD[what]
    table = read_record(write(tmp_path / "record.csv", text))
    np.testing.assert_allclose(table.times, [0.0, 0.5, 1.5], atol=1e-12)
    np.testing.assert_allclose(table.displacement, size * np.array([1.0, 2.0, -3.0]), rtol=1e-12)
    assert table.force is None
    assert table.unit == "m"


def test_an_unknown_unit_of_x_is_kept_and_a_force_is_read(tmp_path: Path) -> None:
    table = read_record(write(tmp_path / "r.csv", "t [s],angle [rad],force [kN]\n0,1,0.1\n1,2,0.2\n2,3,-0.3\n"))
    assert table.unit == "rad"
    np.testing.assert_allclose(table.displacement, [1, 2, 3])
    assert table.force is not None
    np.testing.assert_allclose(table.force, [100, 200, -300])


@pytest.mark.parametrize(("unit", "newtons"), [("N", 1.0), ("mN", 1e-3), ("MN", 1e6), ("kN", 1e3), ("KN", 1e3)])
def test_milli_and_mega_are_told_apart(unit: str, newtons: float, tmp_path: Path) -> None:
    table = read_record(write(tmp_path / "r.csv", f"t,x,force [{unit}]\n0,1,1\n1,2,2\n2,3,-3\n"))
    assert table.force is not None
    np.testing.assert_allclose(table.force, newtons * np.array([1, 2, -3]))


BAD = {
    "empty": ("", "0 samples; at least 3"),
    "a header alone": ("t,x\n", "0 samples"),
    "two samples": ("t,x\n0,1\n1,2\n", "2 samples; at least 3"),
    "four columns": ("0,1,2,3\n1,1,2,3\n2,1,2,3\n", "4 columns; write t, x"),
    "one column": ("1\n2\n3\n", "1 columns"),
    "a word": ("t,x\n0,1\n1,two\n2,3\n", "row 2: 2 numbers are needed, found 1, two"),
    "a short row": ("t,x\n0,1\n1\n2,3\n", "row 2"),
    "a long row": ("t,x\n0,1\n1,2,3\n2,3\n", "row 2"),
    "an empty cell": ("t,x\n0,1\n1,\n2,3\n", "row 2"),
    "decimal commas": ("t;x\n0,0;1,0\n0,5;2,0\n1,5;3,0\n", "row 1"),
    "NaN": ("t,x\n0,1\n1,nan\n2,3\n", "value number 2 is not finite"),
    "infinity": ("t,x\n0,1\n1,inf\n2,3\n", "value number 2 is not finite"),
    "NaN as a time": ("t,x\n0,1\nnan,2\n2,3\n", "value number 2 is not finite"),
    "NaN as the first time": ("t,x\nnan,1\n1,2\n2,3\n", "not finite"),
    "unsorted times": ("t,x\n0,1\n2,2\n1,3\n", "times must increase (at sample 3); sort them"),
    "the same time twice": ("t,x\n0,1\n1,2\n1,3\n", "times must increase"),
    "NaN in the force": ("t,x,f\n0,1,0\n1,2,nan\n2,3,0\n", "value number 2 is not finite"),
    "an unknown unit of time": ("t [fortnight],x [m]\n0,1\n1,2\n2,3\n", "known units"),
    "an unknown unit of force": ("t,x,f [lbf]\n0,1,0\n1,2,0\n2,3,0\n", "known units"),
    "binary": ("\x00\x01", "samples"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_files_are_one_line_and_status_2(what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, part = BAD[what]
    path = write(tmp_path / "record.csv", text)
    assert main(["method=ls", f"data={path}"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert err.startswith("bench: data")
    assert part in err


def test_a_file_that_is_no_text_or_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not UTF-8"):
        read_record(write(tmp_path / "latin.csv", "t,größe\n0,1\n1,2\n2,3\n", "latin-1"))
    with pytest.raises(InputError, match="No such file"):
        read_record(tmp_path / "nowhere.csv")
    with pytest.raises(InputError, match="cannot be read"):
        read_record(tmp_path)


@pytest.mark.parametrize(
    ("more", "part"),
    [
        (["method=oracle"], "method=oracle: it needs the truth"),
        (["method=ls", "system=chain2"], "one DOF"),
        (["method=ls", "prior=nominal"], "nominal={}: a prior on a measured record needs nominal values: nominal.m="),
        (["method=ls", "prior=nominal", "nominal.m=1"], "nominal.k="),
        (["method=ls", "initial_state=known"], "start=None: initial_state=known needs start="),
        (["method=ls", "initial_state=known", "start=[1]"], "start=[1.0]"),
        (["-m", "method=ls,rls"], "one record and one method"),
    ],
)
def test_what_is_missing_for_a_measured_record_is_named(
    more: list[str], part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "record.csv", rows(free_record()))
    assert main([*more, f"data={path}"]) == 2
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert part in err


@pytest.fixture
def _exact(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Register the double that answers with the groups of its settings, and those that go wrong."""
    caches = (choices.choices, composition._composed, registry.load_method)
    names = {"exact": "Exact", "wrong": "Wrong", "needy": "Needy"}
    ours = {name: EntryPoint(name, f"misbehaving:{attribute}", registry.GROUP) for name, attribute in names.items()}
    known = {**registry.registered(), **ours}
    for module in (registry, choices, composition):
        monkeypatch.setattr(module, "registered", lambda: known)
    for cached in caches:
        cached.cache_clear()
    yield
    for cached in caches:
        cached.cache_clear()


@pytest.mark.usefixtures("_exact")
def test_values_intervals_and_residuals_of_a_record_with_an_offset(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exact groups: the residual is nothing, the offset the one put in; ω = 3 rad/s, ζ = 0.5/(2·3)."""
    path = write(tmp_path / "record.csv", "t [s],x [mm]\n" + rows(1e3 * free_record(OFFSET)))
    assert main(["method=exact", f"data={path}", "format=json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["samples"], result["status"], result["message"]) == (31, "ok", "")
    estimates = result["estimates"]
    assert set(estimates) == {"k_over_m", "c_over_m", "natural_frequency", "damping_ratio"}
    k = estimates["k_over_m"]
    assert (k["value"], k["unit"]) == (9.0, "1/s²")
    assert (k["low"], k["high"]) == pytest.approx((9 - 1.959964 * 0.2, 9 + 1.959964 * 0.2), rel=1e-6)
    assert estimates["natural_frequency"]["value"] == pytest.approx(3 / (2 * math.pi))
    assert estimates["damping_ratio"]["value"] == pytest.approx(0.5 / 6)
    residuals = result["residuals"]
    assert residuals["unit"] == "m"
    assert residuals["offset"] == pytest.approx(OFFSET, abs=2e-3)
    assert len(residuals["values"]) == 31
    assert residuals["rms"] < 2e-3


@pytest.mark.usefixtures("_exact")
def test_a_prior_gives_the_scale_and_a_told_start_leaves_no_offset(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "record.csv", rows(free_record()))
    nominal = ["prior=nominal", "nominal.m=2", "nominal.c=1", "nominal.k=18"]
    start = ["initial_state=known", "start=[0.8,-0.4]"]
    assert main(["method=exact", f"data={path}", "format=json", *nominal, *start]) == 0
    result = json.loads(capsys.readouterr().out)
    estimates = result["estimates"]
    assert estimates["m"]["value"] == pytest.approx(2.0, rel=1e-3)  # the nominal ratios are the groups: nothing pulls
    assert estimates["k"]["value"] == pytest.approx(18.0, rel=1e-3)
    assert estimates["m"]["high"] / estimates["m"]["low"] == pytest.approx(math.exp(2 * 1.96 * 0.02), rel=1e-3)
    assert result["residuals"]["offset"] == 0.0
    assert result["residuals"]["rms"] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.usefixtures("_exact")
def test_wrong_groups_leave_a_residual_that_is_the_difference_of_the_responses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "record.csv", rows(free_record()))
    given = ["method.k_over_m=8.5", "initial_state=known", "start=[0.8,-0.4]"]
    assert main(["method=exact", f"data={path}", "format=json", *given]) == 0
    residuals = json.loads(capsys.readouterr().out)["residuals"]
    r = free_record() - closed_form({"m": 1.0, "c": 0.5, "k": 8.5}, 0.8, -0.4, T)
    np.testing.assert_allclose(residuals["values"], r, atol=1e-9)
    assert residuals["rms"] == pytest.approx(np.sqrt(np.mean(r**2)))
    assert residuals["part_of_signal"] == pytest.approx(np.sqrt(np.mean(r**2)) / np.std(free_record()))
    assert residuals["lag1_autocorrelation"] == pytest.approx(np.sum(r[1:] * r[:-1]) / np.sum(r**2))


@pytest.mark.usefixtures("_exact")
def test_the_table_says_that_the_scale_cannot_be_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "record.csv", rows(free_record()))
    assert main(["method=exact", f"data={path}"]) == 0
    out = capsys.readouterr().out
    assert "31 samples, ok" in out
    assert "m, c and k themselves cannot be told" in out
    assert "k/m" in out


@pytest.mark.usefixtures("_exact")
@pytest.mark.parametrize(
    ("method", "status", "part"),
    [
        (["method=wrong", "method.kind=raise"], "crashed", "two lines of reasons"),
        (["method=wrong", "method.kind=good"], "unsupported", "offset"),
        (["method=needy"], "missing_dependency", "pip install"),
    ],
)
def test_a_fit_that_fails_is_reported_not_raised(
    method: list[str], status: str, part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "record.csv", rows(free_record()))
    told = ["initial_state=known", "start=[0.8,-0.4]"] if status == "crashed" else []
    assert main([*method, f"data={path}", "format=json", *told]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["status"], result["estimates"], result["residuals"]) == (status, {}, None)
    assert part in result["message"]
