"""Decimation: the passband is unchanged, aliases are removed, and estimates remain the same."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

import bench
from bench.errors import InputError
from bench.records.decimation import decimated
from bench.records.prepare import prepare
from bench.records.reading import ReadOptions, Recording, Signal, of_arrays, read_recording
from bench.scenario.truth import closed_form

RATE = 1000.0
TIMES = np.arange(12_000) / RATE
P = {"m": 1.0, "c": 0.25, "k": 160.0}
"""2 Hz and 1 % of damping."""


def sine(hertz: float) -> np.ndarray:
    return np.sin(2 * np.pi * hertz * TIMES)


def only(recording: Recording) -> Signal:
    (signal,) = recording.signals
    return signal


@pytest.mark.parametrize("hertz", [2.0, 11.3, 19.9])
def test_the_passband_is_unchanged(hertz: float) -> None:
    """The passband is 20 Hz at a new sampling rate of 50 Hz: the kept samples are those of the sine, to 1 %."""
    signal = only(decimated(of_arrays(TIMES, 3.0 + sine(hertz)), 20))
    assert signal.times[0] == 0.0
    np.testing.assert_allclose(np.diff(signal.times), 0.02, rtol=1e-9)
    expected = 3.0 + np.sin(2 * np.pi * hertz * (signal.times + 0.2))  # ten new samples are dropped
    np.testing.assert_allclose(signal.values, expected, atol=0.01)


@pytest.mark.parametrize("hertz", [30.0, 47.0, 50.0, 99.0, 433.0])
def test_aliases_are_removed_and_reported(hertz: float) -> None:
    """Without a filter, 47 Hz would alias to 3 Hz."""
    recording = decimated(of_arrays(TIMES, sine(2.0) + 0.5 * sine(hertz)), 20)
    np.testing.assert_allclose(only(recording).values, np.sin(4 * np.pi * (only(recording).times + 0.2)), atol=0.01)
    assert "decimated by 20 from 12000 to 580 samples" in recording.notes[-1]
    assert "20 % of its power was above the passband of 20 Hz" in recording.notes[-1]


def free_record() -> np.ndarray:
    noise = 0.1 * np.random.default_rng(3).standard_normal(TIMES.size)
    return closed_form(P, 1.0, 0.0, TIMES) + noise + 0.1 * sine(98.0)


@pytest.mark.slow
def test_the_estimate_is_as_accurate_as_that_of_all_samples() -> None:
    """The intervals overlap and have equal widths; without a filter they are wider by the root of the factor."""
    x = free_record()
    whole = bench.identify(TIMES, x, method="output_error").estimates["c_over_m"]
    few = bench.identify(TIMES, x, method="output_error", decimate=20).estimates["c_over_m"]
    thin = bench.identify(TIMES[::20], x[::20], method="output_error").estimates["c_over_m"]
    assert whole.low < few.value < whole.high
    assert few.white_high - few.white_low == pytest.approx(whole.white_high - whole.white_low, rel=0.15)
    assert thin.white_high - thin.white_low > 3.0 * (few.white_high - few.white_low)


@pytest.mark.slow
def test_motion_and_force_pass_the_same_filter() -> None:
    """Mass, stiffness and damping are unchanged, although much of the force is removed."""
    force = np.repeat(np.random.default_rng(5).standard_normal(TIMES.size // 40), 40)
    x = lsim(([1.0], [2.0, 1.0, 320.0]), force, TIMES)[1]
    x = x + 0.02 * np.std(x) * np.random.default_rng(6).standard_normal(TIMES.size)
    values = bench.identify(TIMES, x, force, method="output_error", decimate=10).values
    assert values["m"] == pytest.approx(2.0, rel=0.02)
    assert values["k"] == pytest.approx(320.0, rel=0.02)
    assert values["c"] == pytest.approx(1.0, rel=0.1)


def test_impossible_decimations_are_rejected_in_one_line(tmp_path: Path) -> None:
    swing = of_arrays(TIMES, sine(2.0))
    gap = np.delete(np.arange(TIMES.size), slice(700, 800))
    signal = only(swing)
    holed = replace(swing, signals=(replace(signal, times=signal.times[gap], values=signal.values[gap]),))
    for recording, factor, part in [
        (holed, 10, "gaps or uneven times"),
        (swing, 600, "12000 samples of x: at most 521"),
        (swing, 240, "the motion at 2 Hz is above the passband of 1.667 Hz"),
    ]:
        with pytest.raises(InputError, match=f"decimate={factor}") as error:
            decimated(recording, factor)
        assert part in str(error.value)
        assert "\n" not in str(error.value)
    path = tmp_path / "r.csv"
    np.savetxt(path, np.column_stack([TIMES, sine(2.0)]), delimiter=",", header="t [s],x [m]", comments="", fmt="%.6f")
    with pytest.raises(InputError, match=r"start=.*decimate= drops the first samples"):
        bench.identify(path, method="output_error", decimate=10, start=(0.0, 1.0))
    (prepared,) = prepare([read_recording(path)], ReadOptions(decimate=10))
    assert only(prepared).values.size == 1180


def test_a_decimation_is_suggested_for_a_fit_that_exceeds_its_time_limit() -> None:
    """Of 500 samples per cycle every 50th leaves 10 (or 49th, depending on the estimated frequency)."""
    result = bench.identify(TIMES, free_record(), method="mcmc", timeout_s=0.5)
    assert result.status == "timeout"
    assert re.search(r"; try decimate=(49|50), which keeps every (49|50)th sample", result.reasons[0])
