"""Decimation: what passes the filter is as it was, what does not is gone, and the answer stays what it was."""

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
def test_what_passes_is_as_it_was_at_its_own_times(hertz: float) -> None:
    """Of 50 Hz that are left, 20 Hz pass: the kept samples are those of the sine, to 1 %."""
    signal = only(decimated(of_arrays(TIMES, 3.0 + sine(hertz)), 20))
    assert signal.times[0] == 0.0
    np.testing.assert_allclose(np.diff(signal.times), 0.02, rtol=1e-9)
    meant = 3.0 + np.sin(2 * np.pi * hertz * (signal.times + 0.2))  # ten new samples are left out
    np.testing.assert_allclose(signal.values, meant, atol=0.01)


@pytest.mark.parametrize("hertz", [30.0, 47.0, 50.0, 99.0, 433.0])
def test_what_would_alias_is_gone_and_said(hertz: float) -> None:
    """Thinned alone, 47 Hz would be 3 Hz."""
    recording = decimated(of_arrays(TIMES, sine(2.0) + 0.5 * sine(hertz)), 20)
    np.testing.assert_allclose(only(recording).values, np.sin(4 * np.pi * (only(recording).times + 0.2)), atol=0.01)
    assert "one in 20 of 12000 samples" in recording.notes[-1]
    assert "20 % of its power was above the 20 Hz" in recording.notes[-1]


def free_record() -> np.ndarray:
    noise = 0.1 * np.random.default_rng(3).standard_normal(TIMES.size)
    return closed_form(P, 1.0, 0.0, TIMES) + noise + 0.1 * sine(98.0)


def test_the_answer_of_a_decay_is_as_good_as_of_all_samples() -> None:
    """The intervals overlap and are as wide; thinned alone they are wider by about the root of the factor."""
    x = free_record()
    whole = bench.identify(TIMES, x, method="output_error").estimates["c_over_m"]
    few = bench.identify(TIMES, x, method="output_error", decimate=20).estimates["c_over_m"]
    thin = bench.identify(TIMES[::20], x[::20], method="output_error").estimates["c_over_m"]
    assert whole.low < few.value < whole.high
    assert few.white_high - few.white_low == pytest.approx(whole.white_high - whole.white_low, rel=0.15)
    assert thin.white_high - thin.white_low > 3.0 * (few.white_high - few.white_low)


def test_motion_and_force_pass_the_same_filter() -> None:
    """So the mass, stiffness and damping that relate them stay, though the force holds much that is filtered out."""
    force = np.repeat(np.random.default_rng(5).standard_normal(TIMES.size // 40), 40)
    x = lsim(([1.0], [2.0, 1.0, 320.0]), force, TIMES)[1]
    x = x + 0.02 * np.std(x) * np.random.default_rng(6).standard_normal(TIMES.size)
    found = bench.identify(TIMES, x, force, method="output_error", decimate=10).values
    assert found["m"] == pytest.approx(2.0, rel=0.02)
    assert found["k"] == pytest.approx(320.0, rel=0.02)
    assert found["c"] == pytest.approx(1.0, rel=0.1)


def test_what_cannot_be_decimated_is_refused_in_one_line(tmp_path: Path) -> None:
    swing = of_arrays(TIMES, sine(2.0))
    gap = np.delete(np.arange(TIMES.size), slice(700, 800))
    signal = only(swing)
    holed = replace(swing, signals=(replace(signal, times=signal.times[gap], values=signal.values[gap]),))
    for recording, factor, part in [
        (holed, 10, "gaps or uneven times"),
        (swing, 600, "12000 samples of x: at most 521"),
        (swing, 240, "strongest at 2 Hz and only 1.667 Hz would pass"),
    ]:
        with pytest.raises(InputError, match=f"decimate={factor}") as error:
            decimated(recording, factor)
        assert part in str(error.value)
        assert "\n" not in str(error.value)
    path = tmp_path / "r.csv"
    np.savetxt(path, np.column_stack([TIMES, sine(2.0)]), delimiter=",", header="t [s],x [m]", comments="", fmt="%.6f")
    with pytest.raises(InputError, match=r"start=.*decimate= leaves the first samples out"):
        bench.identify(path, method="output_error", decimate=10, start=(0.0, 1.0))
    (prepared,) = prepare([read_recording(path)], ReadOptions(decimate=10))
    assert only(prepared).values.size == 1180


def test_a_fit_that_reaches_its_limit_is_told_which_decimation_would_do() -> None:
    """500 samples a cycle: every 50th leaves 10 (49 where the cycle is taken for a little shorter)."""
    found = bench.identify(TIMES, free_record(), method="mcmc", timeout_s=0.5)
    assert found.status == "timeout"
    assert re.search(r"; decimate=(49|50) keeps one sample in (49|50), filtered$", found.reasons[0])
