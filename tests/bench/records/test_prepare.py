"""Preparation of measured signals, on records simulated by closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

import bench
from bench.errors import InputError
from bench.records.prepare import prepare
from bench.records.reading import ReadOptions, Recording, Signal, of_arrays
from bench.records.saturation import at_limit

OMEGA, ZETA = 12.0, 0.02
PERIOD = 2 * np.pi / OMEGA


def decay(since: np.ndarray, omega: float = OMEGA, zeta: float = ZETA) -> np.ndarray:
    """Return the motion (n,) of a mass that is held at 1 and released when ``since`` is 0."""
    t = np.maximum(since, 0.0)
    damped = omega * np.sqrt(1 - zeta**2)
    return np.exp(-zeta * omega * t) * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t))


def noise(n: int, seed: int, size: float = 0.01) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal(n)


def runs(times: np.ndarray, values: np.ndarray, **options: object) -> tuple[Recording, ...]:
    return prepare([of_arrays(times, values)], ReadOptions(**options))  # type: ignore[arg-type]


def signal(role: str, measures: str, times: np.ndarray, values: np.ndarray, unit: str = "m") -> Signal:
    return Signal(role, measures, 0, values, unit, times)  # type: ignore[arg-type]


def notes(recordings: tuple[Recording, ...]) -> str:
    return "; ".join(note for recording in recordings for note in recording.notes)


def written(path: Path, heading: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=heading, comments="", fmt="%.7g")
    return path


# offset and drift


@pytest.mark.parametrize(("heading", "power"), [("v [m/s]", 1), ("a [m/s^2]", 2)])
def test_the_offset_of_a_sensor_is_estimated(tmp_path: Path, heading: str, power: int) -> None:
    """The offset is ten times the motion, such as gravity in an accelerometer."""
    times = np.arange(0.0, 15.0, 0.05)
    pole = complex(-0.1, np.sqrt(19.36 - 0.01))
    motion = np.real(pole**power * np.exp(pole * times))
    values = motion + np.std(motion) * (noise(times.size, power, 0.02) - 10)
    answer = bench.identify(written(tmp_path / "record.csv", f"t [s],{heading}", times, values), method="output_error")
    assert answer.values["k_over_m"] == pytest.approx(19.36, rel=0.003)
    assert answer.values["c_over_m"] == pytest.approx(0.2, rel=0.05)
    assert any("mean of -" in note for note in answer.notes)


@pytest.mark.parametrize("measures", ["displacement", "velocity", "acceleration"])
@pytest.mark.parametrize("drift", [-0.3, 0.05])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_drift_is_removed(measures: str, drift: float, seed: int) -> None:
    """The error over the record is within a tenth of the noise of a sample."""
    times = np.arange(0.0, 30 * PERIOD, PERIOD / 25)
    values = decay(times) + noise(times.size, seed) + drift * times / times[-1]
    recording = Recording((signal("s", measures, times, values),), (), "simulated", "")
    (prepared,) = prepare([recording], ReadOptions())
    taken = values - prepared.signals[0].values
    assert taken[-1] - taken[0] == pytest.approx(drift, abs=0.02 * abs(drift) + 0.003)
    assert "linear drift of" in notes((prepared,))
    (left,) = prepare([recording], ReadOptions(detrend=False))
    assert np.array_equal(left.signals[0].values, values)


def test_a_drift_is_removed_on_request_but_not_from_a_force() -> None:
    times = np.arange(0.0, 10 * PERIOD, PERIOD / 25)
    (prepared,) = prepare([of_arrays(times, decay(times), 3.0 * times)], ReadOptions(detrend=True))
    assert "linear drift of" in notes((prepared,))
    assert np.array_equal(prepared.signals[1].values, 3.0 * times)
    short = times[times < 3 * PERIOD]
    with pytest.raises(InputError, match=r"detrend=true.*at least 4 are needed"):
        runs(short, decay(short), detrend=True)


# beginning and end of the free motion


@pytest.mark.parametrize("zeta", [0.005, 0.1, 0.6, 0.95])
@pytest.mark.parametrize("wait", [1.0, 1.7, 3.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_release_after_a_rest_is_detected(zeta: float, wait: float, seed: int) -> None:
    times = np.arange(0.0, 15 * PERIOD, PERIOD / 40)
    values = 2.0 + decay(times - wait * PERIOD, zeta=zeta) + noise(times.size, seed)
    (run,) = runs(times, values)
    cut = times.size - run.signals[0].values.size
    assert 0 <= cut * PERIOD / 40 - wait * PERIOD < 0.12 * PERIOD
    assert "at rest for the first" in notes((run,))
    assert run.signals[0].times[0] == 0.0


def test_a_specified_beginning_is_not_changed() -> None:
    times = np.arange(0.0, 15 * PERIOD, PERIOD / 40)
    values = decay(times - PERIOD) + noise(times.size, 0)
    recording = of_arrays(times, values)
    assert prepare([recording], ReadOptions(start=0.0))[0].signals[0].values.size == times.size
    assert prepare([recording], ReadOptions(), known_state=True)[0].signals[0].values.size == times.size
    pushed = of_arrays(times, values, np.ones(times.size))
    assert prepare([pushed], ReadOptions())[0].signals[0].values.size == times.size


@pytest.mark.parametrize("seed", range(4))
def test_contact_by_a_hand_is_excluded(seed: int) -> None:
    """The mass is moved to and fro for 2.2 periods, unlike any free motion, and released."""
    times = np.arange(0.0, 20 * PERIOD, PERIOD / 30)
    released = 2.2 * PERIOD
    pulled = 1.0 - 1.5 * np.sin(np.pi * (released - times) / released) * np.cos(4.7 * (released - times) / PERIOD)
    values = np.where(times < released, pulled, decay(times - released)) + noise(times.size, seed)
    (run,) = runs(times, values)
    cut = times[times.size - run.signals[0].values.size]
    assert -0.3 * PERIOD < cut - released < PERIOD
    assert "are not a free motion (contact by a hand, start-up) and are excluded" in notes((run,))


@pytest.mark.parametrize("seed", range(3))
def test_a_second_release_makes_a_second_run(seed: int) -> None:
    times = np.arange(0.0, 30 * PERIOD, PERIOD / 25)
    second = 14.3 * PERIOD
    values = np.where(times < second, decay(times), 1.3 * decay(times - second)) + noise(times.size, seed)
    first, last = runs(times, values)
    assert first.source == "arrays run 1"
    assert last.source == "arrays run 2"
    assert first.signals[0].times[-1] == pytest.approx(second, abs=0.3 * PERIOD)
    assert last.signals[0].times[-1] == pytest.approx(times[-1] - second, abs=0.3 * PERIOD)
    assert "the record has 2 free motions" in notes((first, last))


def test_sticking_and_large_angles_are_no_disturbance() -> None:
    times = np.arange(0.0, 12 * PERIOD, PERIOD / 30)

    def rates(_: float, state: np.ndarray) -> list[float]:
        x, v = state
        return [v, -(OMEGA**2) * np.sin(x) - 0.05 * OMEGA**2 * np.tanh(v / 0.01)]

    path = solve_ivp(rates, (0.0, times[-1]), [1.8, 0.0], t_eval=times, rtol=1e-8, atol=1e-8, method="LSODA").y
    (run,) = runs(times, path[0] + noise(times.size, 0))
    assert run.signals[0].values.size == times.size
    assert not run.notes


@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_a_rest_at_the_end_is_reported_and_kept(offset: float) -> None:
    """Dry friction stops a mass, also away from its equilibrium; a decay into noise is not reported."""
    times = np.arange(0.0, 20 * PERIOD, PERIOD / 30)
    swinging = times < 4 * PERIOD
    motion = np.where(swinging, (1.0 - times / (4 * PERIOD)) * np.cos(OMEGA * times), offset) + noise(
        times.size, 0, 0.003
    )
    (run,) = runs(times, motion)
    assert run.signals[0].values.size == times.size
    (time,) = [float(note.split()[3]) for note in run.notes if note.startswith("at rest after")]
    assert time == pytest.approx(4 * PERIOD, abs=0.3 * PERIOD)
    (run,) = runs(times, decay(times) + noise(times.size, 0))
    assert "at rest" not in notes((run,))


# duplicates and computed signals


def test_a_duplicate_record_is_used_once() -> None:
    times = np.arange(0.0, 10 * PERIOD, PERIOD / 25)
    values = decay(times) + noise(times.size, 0)
    again = of_arrays(np.arange(2 * times.size) * PERIOD / 25, np.tile(values, 2))
    (run,) = prepare([again], ReadOptions())
    assert np.array_equal(run.signals[0].values, values)
    assert f"repeats the same {times.size} samples 2 times" in notes((run,))
    whole = np.round(np.sin(OMEGA * times), 3)
    (run,) = runs(times, whole)
    assert run.signals[0].values.size == times.size
    (single,) = prepare([of_arrays(times, values), of_arrays(times, values)], ReadOptions())
    assert "exact duplicate" in notes((single,))
    other = decay(times) + noise(times.size, 1)
    assert len(prepare([of_arrays(times, values), of_arrays(times, other)], ReadOptions())) == 2


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("by", ["gradient", "smoothed"])
def test_a_velocity_computed_from_the_displacement_is_excluded_but_not_a_measured_one(seed: int, by: str) -> None:
    times = np.arange(0.0, 20 * PERIOD, PERIOD / 30)
    x = decay(times) + noise(times.size, seed, 0.02)
    smooth = np.convolve(x, np.ones(5) / 5, "same") if by == "smoothed" else x
    computed = signal("v", "velocity", times, np.gradient(smooth, times), "m/s")
    place = signal("x", "displacement", times, x)
    (prepared,) = prepare([Recording((place, computed), (), "simulated", "")], ReadOptions())
    assert [s.role for s in prepared.signals] == ["x"]
    assert "v was computed from x" in notes((prepared,))
    clean = np.gradient(decay(times), times) + noise(times.size, 100 + seed, 0.1)
    measured = signal("v", "velocity", times, clean, "m/s")
    (prepared,) = prepare([Recording((place, measured), (), "simulated", "")], ReadOptions())
    assert len(prepared.signals) == 2
    assert not prepared.notes


# clipped sensors


@pytest.mark.parametrize("later", [0.0, 1e-4])
@pytest.mark.parametrize("limit", [0.5, 0.7])
def test_clipped_samples_are_excluded_and_the_estimate_is_right(later: float, limit: float) -> None:
    """Small noise may be added after the clipping."""
    times = np.arange(0.0, 20 * PERIOD, PERIOD / 40)
    values = np.clip(decay(times) + noise(times.size, 0, 0.003), -limit, limit) + noise(times.size, 1, later)
    answer = bench.identify(times, values, method="output_error")
    assert any("clipped" in note for note in answer.notes)
    assert answer.values["k_over_m"] == pytest.approx(OMEGA**2, rel=0.002)
    assert answer.values["c_over_m"] == pytest.approx(2 * ZETA * OMEGA, rel=0.02)


@pytest.mark.parametrize("step", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("zeta", [0.0, 0.001, 0.02])
@pytest.mark.parametrize("per_cycle", [10, 148, 999])
def test_flat_turning_points_are_not_clipped(step: float, zeta: float, per_cycle: int) -> None:
    times = np.arange(0.0, 20 * PERIOD, PERIOD / per_cycle)
    values = step * np.round((decay(times, zeta=zeta) + noise(times.size, 0)) / step)
    assert not np.any(at_limit(values))


def test_a_square_wave_and_a_rest_are_not_clipped() -> None:
    times = np.arange(1000.0)
    assert not np.any(at_limit(np.sign(np.sin(times / 7))))
    assert not np.any(at_limit(np.round(1.0 - np.exp(-times / 50), 2)))


@pytest.mark.slow
def test_a_clipped_force_sensor_is_rejected_but_not_a_bounded_force() -> None:
    """In the first case the force that acted differs from the recorded one."""
    times = np.arange(0.0, 30 * PERIOD, PERIOD / 30)
    force = np.sin(np.cumsum(np.linspace(0.3, 1.8, times.size)) * OMEGA * times[1])
    cut = np.clip(force, -0.5, 0.5)
    for acting, trust in ((force, "do not trust"), (cut, "trust")):
        motion = lsim(([1.0], [1.0, 2 * 0.05 * OMEGA, OMEGA**2]), acting, times)[1]
        values = motion + np.std(motion) * noise(times.size, 0)
        answer = bench.identify(times, values, cut, method="output_error")
        assert answer.trust == trust, answer.reasons
        assert any("force sensor is clipped" in reason for reason in answer.reasons) == (trust != "trust")
