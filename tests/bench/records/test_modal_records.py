"""Modes of measured records: command, Python interface, verdict and errors, on records in closed form."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

import bench
from bench import FreeDecays, Mode
from bench.commands.main import main
from bench.records.modal import ShapedMode, compare, motion
from bench.records.modal_data import ModalRecord

RATE, FIRST, SECOND = 200.0, (12.0, 0.01), (31.0, 0.02)
T = np.arange(600) / RATE
Waves = Sequence[tuple[float, float, float, float]]
"""Natural frequency (Hz), damping ratio, amplitude and phase of each mode."""


def wave(frequency: float, ratio: float, amplitude: float, phase: float = 0.0) -> np.ndarray:
    rate = 2 * np.pi * frequency
    return amplitude * np.exp(-ratio * rate * T) * np.cos(rate * np.sqrt(1 - ratio**2) * T + phase)


def noise(size: float, seed: int) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal(T.size)


def write(name: str, *channels: np.ndarray, heads: str = "x [mm]") -> None:
    rows = "\n".join(",".join(f"{value:.7g}" for value in row) for row in zip(T, *channels, strict=True))
    Path(name).write_text(f"t [s],{heads}\n{rows}\n")


@pytest.fixture(autouse=True)
def records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write records of one sensor, of two sensors with the second mode in antiphase, and of noise alone."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    write("one.csv", 0.5 + wave(*FIRST, 3.0) + wave(*SECOND, 1.0, 1.0) + noise(0.02, 0))
    left = wave(*FIRST, 2.0) + wave(*SECOND, 2.0) + noise(0.02, 1)
    right = wave(*FIRST, 1.0) - wave(*SECOND, 0.5) + noise(0.02, 2)
    write("two.csv", left, right, heads="left [g],right [g]")
    write("noise.csv", noise(1.0, 3))


def answer(capsys: pytest.CaptureFixture[str], *fields: str, status: int = 0) -> dict[str, object]:
    assert main([*fields, "format=json"]) == status
    document: dict[str, object] = json.loads(capsys.readouterr().out)
    return document


@pytest.mark.parametrize("count", ["auto", "2"])
def test_two_modes_with_intervals_amplitudes_and_trust(count: str, capsys: pytest.CaptureFixture[str]) -> None:
    result = answer(capsys, "data=one.csv", f"modes={count}")
    assert result["trust"] == "trust"
    for mode, (frequency, ratio), amplitude in zip(result["modes"], (FIRST, SECOND), (3.0, 1.0), strict=True):  # type: ignore[call-overload]
        for name, true in (("frequency", frequency), ("damping_ratio", ratio), ("amplitude", amplitude)):
            width = mode[f"{name}_high"] - mode[f"{name}_low"]
            assert abs(mode[name] - true) < width  # within about 4 standard errors
            assert width < 0.1 * true
    residuals = result["residuals"]
    assert isinstance(residuals, dict)
    assert residuals["rms"] == pytest.approx(0.02, rel=0.1)
    assert residuals["offset"] == pytest.approx(0.5, abs=0.01)


def test_the_page_names_modes_number_and_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data=one.csv", "modes=auto", "picture=modes.svg", "plot=always"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("2 modes: 12.0")
    assert "waves: trust" in out
    assert "Bayesian information criterion" in out
    assert "measured" in out
    assert Path("modes.svg").read_text(encoding="utf-8").count(">frequency (Hz)<") == 1


def test_columns_of_one_quantity_are_sensors_and_shapes_have_signs() -> None:
    result = bench.identify("two.csv", modes="auto")
    first, second = (mode.shape for mode in result.modes)
    assert [part.sensor for part in first] == ["a1", "a2"]
    for shape, true in ((first, 0.5), (second, -0.25)):
        assert shape[0].ratio == 1.0
        assert shape[1].ratio == pytest.approx(true, abs=2 * shape[1].half)
        assert shape[1].half < 0.05
    assert "-0.2" in repr(result)


def test_modes_are_identified_within_a_band() -> None:
    result = bench.identify("one.csv", modes=1, band=(5, 20))
    (mode,) = result.modes
    assert mode.frequency == pytest.approx(12.0, rel=1e-3)


def test_a_missing_mode_is_reported_and_noise_is_not_trusted(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data=one.csv", "modes=1"]) in (0, 1)
    assert "line at 31" in (out := capsys.readouterr().out)
    assert "modes=2" in out
    assert answer(capsys, "data=noise.csv", "modes=1", status=1)["trust"] == "do not trust"


def test_a_push_before_the_free_motion_is_excluded() -> None:
    """The motion is pushed for half a second, and then a free decay; from= specifies its beginning."""
    free, pushed = T >= 0.5, np.sin(np.pi * np.minimum(T, 0.5) / 0.5) * np.sin(2 * np.pi * 17.0 * T**1.2)
    motion_then = np.where(free, wave(*FIRST, 3.0) + wave(*SECOND, 1.0, 1.0), 4.0 * pushed)
    write("pushed.csv", motion_then + noise(0.02, 6))
    result = bench.identify("pushed.csv", modes="auto")
    assert result.trust == "use with caution"
    assert "the modes describe only the last 2." in result.reasons[0]
    for mode, (frequency, ratio) in zip(result.modes, (FIRST, SECOND), strict=True):
        assert abs(mode.frequency - frequency) < mode.frequency_high - mode.frequency_low
        assert abs(mode.damping_ratio - ratio) < mode.damping_ratio_high - mode.damping_ratio_low
    assert bench.identify("pushed.csv", modes="auto", span=(0.5, T[-1])).trust == "trust"


def test_a_decay_by_dry_friction_is_a_single_mode() -> None:
    """A linear decay is no sum of exponentials, and an information criterion alone would add modes endlessly."""
    write("friction.csv", np.maximum(1.0 - T / 3.2, 0.0) * np.cos(2 * np.pi * 12.0 * T) + noise(0.01, 7))
    result = bench.identify("friction.csv", modes="auto")
    assert len(result.modes) == 1
    assert result.trust != "trust"
    assert "near 1" in " ".join(result.reasons)
    assert abs(result.modes[0].frequency - 12.0) < result.modes[0].frequency_high - result.modes[0].frequency_low


def test_motion_and_its_spectrum_are_those_of_the_closed_form() -> None:
    mode = Mode(*FIRST, 0.0, 0.0, np.array([3.0 * np.exp(0.4j)]), np.zeros(1))
    data = FreeDecays(T + 7.0, (wave(*FIRST, 3.0, 0.4) + 2.0)[None])
    assert motion(data, [mode], data.times)[0] == pytest.approx(wave(*FIRST, 3.0, 0.4))
    comparison = compare(ModalRecord("", data, ("x",), ("m",), ()), [mode], (5.0, 50.0))
    assert comparison.frequencies[[0, -1]] == pytest.approx([16 / 3, 50.0])  # the spacing of lines is 1/3 Hz
    assert np.max(comparison.power) < 1e-20


@pytest.mark.slow
def test_a_certificate_compares_modes_with_other_methods(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["certify", "data=two.csv", "modes=auto", "out=out"]) == 0
    stated = json.loads(Path("out/certificate.json").read_text(encoding="utf-8"))
    for mode, (frequency, ratio) in zip(stated["modes"], (FIRST, SECOND), strict=True):
        assert abs(mode["frequency"] - frequency) < mode["frequency_high"] - mode["frequency_low"]
        assert abs(mode["damping_ratio"] - ratio) < mode["damping_ratio_high"] - mode["damping_ratio_low"]
    methods = {method["method"]: method["agreement"] for method in stated["methods"]}
    assert set(methods) == {"waves", "era", "matrix_pencil"}
    assert "off" not in {agreement for of_modes in methods.values() for agreement in of_modes.values()}
    page = Path("out/certificate.html").read_text(encoding="utf-8")
    assert page.count("data:image/svg") == 3
    assert "Mode shapes, relative to the sensor" in page
    assert main(["certify", "data=noise.csv", "modes=auto", "out=none"]) == 1
    assert "Do not trust" in Path("none/certificate.html").read_text(encoding="utf-8")
    assert main(["certify", "data=one.csv", "modes=2", "system=duffing"]) == 2
    assert "cannot be combined with modes=" in capsys.readouterr().err


def test_a_single_channel_may_have_any_unit() -> None:
    write("sound.csv", wave(*FIRST, 3.0) + noise(0.02, 5), heads="mic [Pa]")
    (mode,) = bench.identify("sound.csv", modes="auto").modes
    assert (mode.amplitude_unit, mode.shape) == ("Pa", ())
    write("known.csv", wave(*FIRST, 3.0) + noise(0.02, 5))
    (mode,) = bench.identify("known.csv", modes="auto", units={"x": "furlong"}).modes
    assert round(mode.amplitude) == 3


def test_a_blow_on_a_known_mass_gives_its_modal_mass_damping_and_stiffness(tmp_path: Path) -> None:
    """A mass of 2 kg on a spring is struck by a sine-squared pulse; scipy simulates the response."""
    fs, m, f, z = 512.0, 2.0, 20.0, 0.02
    t, w = np.arange(2048) / fs, 2.0 * np.pi * f
    fine = np.arange(2048 * 8) / (8.0 * fs)
    force = np.where((fine > 0.1) & (fine < 0.12), 50.0 * np.sin(np.pi * (fine - 0.1) / 0.02) ** 2, 0.0)
    _, x, _ = lsim(([[0, 1], [-(w**2), -2 * z * w]], [[0], [1 / m]], [[1, 0]], [[0]]), force, fine)
    noisy = x[::8] + 1e-3 * np.std(x) * np.random.default_rng(3).standard_normal(t.size)
    path = tmp_path / "blow.csv"
    np.savetxt(
        path, np.column_stack([t, force[::8], noisy]), delimiter=",", header="t (s),force (N),position (m)", comments=""
    )
    (mode,) = bench.identify(path, modes=1, band=(5.0, 60.0)).modes
    assert isinstance(mode, ShapedMode)
    by_name = {part.name: part for part in mode.parameters}
    for name, true in (("m", m), ("c", 2 * z * w * m), ("k", w**2 * m)):
        assert by_name[name].value == pytest.approx(true, rel=0.01), name
        assert 0.0 < by_name[name].half < 0.1 * true


def test_a_fit_beyond_its_time_limit_is_ended_and_reported(capsys: pytest.CaptureFixture[str]) -> None:
    """The fit of many modes takes much longer than the interval at which processes are checked."""
    channels = [sum(wave(7.0 + 11.0 * i, 0.01, 1.0, i * k) for i in range(8)) + noise(0.02, k) for k in range(3)]
    write("busy.csv", *channels, heads="a [g],b [g],c [g]")
    assert main(["data=busy.csv", "modes=auto", "timeout_s=0.02"]) == 1
    assert "no estimate (timeout)" in capsys.readouterr().out


def test_a_long_record_without_a_band_is_decimated_or_a_band_is_suggested(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Two records of 24,000 samples have 12 Hz, and 400 Hz, which decimation would remove."""
    t, drawn = np.arange(24_000) / 1000.0, np.random.default_rng(8).standard_normal(24_000)
    for name, frequency, rate in (("slow.csv", 12.0, 0.5), ("fast.csv", 400.0, 5.0)):
        decay = np.exp(-rate * t) * np.cos(2 * np.pi * frequency * t) + 0.001 * drawn
        np.savetxt(name, np.column_stack([t, decay]), delimiter=",", header="t [s],x [mm]", comments="", fmt="%.6g")
    result = bench.identify("slow.csv", modes=1)
    assert any("decimated by 3 from 24000 samples" in note for note in result.notes)
    assert result.modes[0].frequency == pytest.approx(12.0, rel=1e-4)
    assert main(["data=fast.csv", "modes=1"]) == 2
    assert "add band=200:800" in capsys.readouterr().err
