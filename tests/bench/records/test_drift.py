"""A drift of the sensor: the line is found under a vibration, and the answer is then that of the record without it."""

from __future__ import annotations

import numpy as np
import pytest

import bench
from bench.errors import InputError
from bench.records.reading import Recording, of_arrays
from bench.records.reading.drift import detrended
from bench.scenario.truth import closed_form

T = np.linspace(0.0, 10.0, 300)
P = {"m": 1.0, "c": 0.48, "k": 36.0}


def record(drift: float, seed: int, seconds: float = 10.0) -> Recording:
    times = T[seconds >= T]
    noise = 0.02 * np.random.default_rng(seed).standard_normal(times.size)
    return of_arrays(times, closed_form(P, 1.0, float(seed), times) + noise + drift * times)


@pytest.mark.parametrize("drift", [-0.5, -0.01, 0.0, 0.08])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_line_is_found(drift: float, seed: int) -> None:
    """To 2 % of the motion over the record: ten cycles at 4 % damping."""
    before, after = record(drift, seed), detrended(record(drift, seed))
    taken = before.signals[0].values - after.signals[0].values
    np.testing.assert_allclose(np.diff(taken), taken[1] - taken[0], atol=1e-12)
    assert (taken[-1] - taken[0]) / 10.0 == pytest.approx(drift, abs=0.002)
    assert "drift of" in after.notes[-1]


def test_the_answer_is_that_of_a_record_without_it() -> None:
    x = record(0.08, 1).signals[0].values
    drifting = bench.identify(T, x, method="output_error")
    assert drifting.trust != "trust"
    assert any("detrend=true" in reason for reason in drifting.reasons)
    mended = bench.identify(T, x, method="output_error", detrend=True)
    clean = bench.identify(T, record(0.0, 1).signals[0].values, method="output_error")
    for name in ("k_over_m", "c_over_m"):
        one, other = mended.estimates[name], clean.estimates[name]
        assert abs(one.value - other.value) < 0.3 * (other.high - other.low)
        assert one.high - one.low == pytest.approx(other.high - other.low, rel=0.3)


def test_a_force_and_a_velocity_stay_as_they_are() -> None:
    recording = of_arrays(T, record(0.5, 0).signals[0].values, 3.0 * T)
    assert np.array_equal(detrended(recording).signals[1].values, 3.0 * T)


def test_few_cycles_are_refused() -> None:
    with pytest.raises(InputError, match=r"detrend=true.*at least 4 are needed"):
        detrended(record(0.0, 0, seconds=3.0))
