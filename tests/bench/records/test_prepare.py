"""What is done to measured signals before a fit, on records whose truth is simulated here, by closed forms."""

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
    """Return the motion (n,) of a mass released at rest from 1 when ``since`` is 0; it is held until then."""
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
    """Ten times the motion, as gravity in an accelerometer."""
    times = np.arange(0.0, 15.0, 0.05)
    pole = complex(-0.1, np.sqrt(19.36 - 0.01))
    motion = np.real(pole**power * np.exp(pole * times))
    values = motion + np.std(motion) * (noise(times.size, power, 0.02) - 10)
    answer = bench.identify(written(tmp_path / "record.csv", f"t [s],{heading}", times, values), method="output_error")
    assert answer.values["k_over_m"] == pytest.approx(19.36, rel=0.003)
    assert answer.values["c_over_m"] == pytest.approx(0.2, rel=0.05)
    assert any("its mean of -" in note for note in answer.notes)


@pytest.mark.parametrize("measures", ["displacement", "velocity", "acceleration"])
@pytest.mark.parametrize("drift", [-0.3, 0.05])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_drift_is_found_and_taken_off(measures: str, drift: float, seed: int) -> None:
    """To a tenth of the noise of a sample over the record."""
    times = np.arange(0.0, 30 * PERIOD, PERIOD / 25)
    values = decay(times) + noise(times.size, seed) + drift * times / times[-1]
    recording = Recording((signal("s", measures, times, values),), (), "simulated", "")
    (prepared,) = prepare([recording], ReadOptions())
    taken = values - prepared.signals[0].values
    assert taken[-1] - taken[0] == pytest.approx(drift, abs=0.02 * abs(drift) + 0.003)
    assert "the sensor drifts by" in notes((prepared,))
    (left,) = prepare([recording], ReadOptions(detrend=False))
    assert np.array_equal(left.signals[0].values, values)


def test_a_drift_is_taken_off_where_that_is_asked_for_and_never_off_a_force() -> None:
    times = np.arange(0.0, 10 * PERIOD, PERIOD / 25)
    (prepared,) = prepare([of_arrays(times, decay(times), 3.0 * times)], ReadOptions(detrend=True))
    assert "the sensor drifts by" in notes((prepared,))
    assert np.array_equal(prepared.signals[1].values, 3.0 * times)
    short = times[times < 3 * PERIOD]
    with pytest.raises(InputError, match=r"detrend=true.*at least 4 are needed"):
        runs(short, decay(short), detrend=True)


# where the free motion begins and ends


@pytest.mark.parametrize("zeta", [0.005, 0.1, 0.6, 0.95])
@pytest.mark.parametrize("wait", [1.0, 1.7, 3.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_release_is_found_after_silence(zeta: float, wait: float, seed: int) -> None:
    times = np.arange(0.0, 15 * PERIOD, PERIOD / 40)
    values = 2.0 + decay(times - wait * PERIOD, zeta=zeta) + noise(times.size, seed)
    (run,) = runs(times, values)
    cut = times.size - run.signals[0].values.size
    assert 0 <= cut * PERIOD / 40 - wait * PERIOD < 0.12 * PERIOD
    assert "nothing moves in the first" in notes((run,))
    assert run.signals[0].times[0] == 0.0


def test_what_the_user_says_of_the_beginning_is_not_changed() -> None:
    times = np.arange(0.0, 15 * PERIOD, PERIOD / 40)
    values = decay(times - PERIOD) + noise(times.size, 0)
    recording = of_arrays(times, values)
    assert prepare([recording], ReadOptions(start=0.0))[0].signals[0].values.size == times.size
    assert prepare([recording], ReadOptions(), known_state=True)[0].signals[0].values.size == times.size
    pushed = of_arrays(times, values, np.ones(times.size))
    assert prepare([pushed], ReadOptions())[0].signals[0].values.size == times.size


@pytest.mark.parametrize("seed", range(4))
def test_the_hand_at_the_start_is_left_out(seed: int) -> None:
    """Drawn aside to and fro for 2.2 periods, unlike any free motion, and let go."""
    times = np.arange(0.0, 20 * PERIOD, PERIOD / 30)
    released = 2.2 * PERIOD
    pulled = 1.0 - 1.5 * np.sin(np.pi * (released - times) / released) * np.cos(4.7 * (released - times) / PERIOD)
    values = np.where(times < released, pulled, decay(times - released)) + noise(times.size, seed)
    (run,) = runs(times, values)
    cut = times[times.size - run.signals[0].values.size]
    assert -0.3 * PERIOD < cut - released < PERIOD
    assert "do not belong to the free motion that follows" in notes((run,))


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
    assert "starts again within the record: 2 runs" in notes((first, last))


def test_a_stop_by_friction_and_a_pendulum_at_large_angles_are_no_change() -> None:
    times = np.arange(0.0, 12 * PERIOD, PERIOD / 30)

    def rates(_: float, state: np.ndarray) -> list[float]:
        x, v = state
        return [v, -(OMEGA**2) * np.sin(x) - 0.05 * OMEGA**2 * np.tanh(v / 0.01)]

    path = solve_ivp(rates, (0.0, times[-1]), [1.8, 0.0], t_eval=times, rtol=1e-8, atol=1e-8, method="LSODA").y
    (run,) = runs(times, path[0] + noise(times.size, 0))
    assert run.signals[0].values.size == times.size
    assert not run.notes


@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_a_standstill_is_said_and_kept(offset: float) -> None:
    """Where dry friction holds a mass, away from its rest too; a decay into noise is said only where it is long."""
    times = np.arange(0.0, 20 * PERIOD, PERIOD / 30)
    swinging = times < 4 * PERIOD
    motion = np.where(swinging, (1.0 - times / (4 * PERIOD)) * np.cos(OMEGA * times), offset) + noise(
        times.size, 0, 0.003
    )
    (run,) = runs(times, motion)
    assert run.signals[0].values.size == times.size
    (said,) = [float(note.split()[3]) for note in run.notes if note.startswith("nothing moves after")]
    assert said == pytest.approx(4 * PERIOD, abs=0.3 * PERIOD)
    (run,) = runs(times, decay(times) + noise(times.size, 0))
    assert "nothing moves" not in notes((run,))


# what is no second measurement


def test_a_record_that_is_there_twice_counts_once() -> None:
    times = np.arange(0.0, 10 * PERIOD, PERIOD / 25)
    values = decay(times) + noise(times.size, 0)
    again = of_arrays(np.arange(2 * times.size) * PERIOD / 25, np.tile(values, 2))
    (run,) = prepare([again], ReadOptions())
    assert np.array_equal(run.signals[0].values, values)
    assert f"there 2 times, value for value: its first {times.size} samples" in notes((run,))
    whole = np.round(np.sin(OMEGA * times), 3)
    (run,) = runs(times, whole)
    assert run.signals[0].values.size == times.size
    (one,) = prepare([of_arrays(times, values), of_arrays(times, values)], ReadOptions())
    assert "repeats every value" in notes((one,))
    other = decay(times) + noise(times.size, 1)
    assert len(prepare([of_arrays(times, values), of_arrays(times, other)], ReadOptions())) == 2


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("by", ["gradient", "smoothed"])
def test_a_velocity_computed_from_the_displacement_is_left_out_and_a_measured_one_is_not(seed: int, by: str) -> None:
    times = np.arange(0.0, 20 * PERIOD, PERIOD / 30)
    x = decay(times) + noise(times.size, seed, 0.02)
    smooth = np.convolve(x, np.ones(5) / 5, "same") if by == "smoothed" else x
    computed = signal("v", "velocity", times, np.gradient(smooth, times), "m/s")
    place = signal("x", "displacement", times, x)
    (prepared,) = prepare([Recording((place, computed), (), "simulated", "")], ReadOptions())
    assert [s.role for s in prepared.signals] == ["x"]
    assert "v is computed from x" in notes((prepared,))
    clean = np.gradient(decay(times), times) + noise(times.size, 100 + seed, 0.1)
    measured = signal("v", "velocity", times, clean, "m/s")
    (prepared,) = prepare([Recording((place, measured), (), "simulated", "")], ReadOptions())
    assert len(prepared.signals) == 2
    assert not prepared.notes


# sensors at their limit


@pytest.mark.parametrize("behind", [0.0, 1e-4])
@pytest.mark.parametrize("limit", [0.5, 0.7])
def test_clipped_samples_are_left_out_and_the_answer_is_right(behind: float, limit: float) -> None:
    """With small noise behind the limit, too."""
    times = np.arange(0.0, 20 * PERIOD, PERIOD / 40)
    values = np.clip(decay(times) + noise(times.size, 0, 0.003), -limit, limit) + noise(times.size, 1, behind)
    answer = bench.identify(times, values, method="output_error")
    assert any("clipped" in note for note in answer.notes)
    assert answer.values["k_over_m"] == pytest.approx(OMEGA**2, rel=0.002)
    assert answer.values["c_over_m"] == pytest.approx(2 * ZETA * OMEGA, rel=0.02)


@pytest.mark.parametrize("step", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("zeta", [0.0, 0.001, 0.02])
@pytest.mark.parametrize("a_cycle", [10, 148, 999])
def test_flat_turning_points_are_not_clipped(step: float, zeta: float, a_cycle: int) -> None:
    times = np.arange(0.0, 20 * PERIOD, PERIOD / a_cycle)
    values = step * np.round((decay(times, zeta=zeta) + noise(times.size, 0)) / step)
    assert not np.any(at_limit(values))


def test_a_square_wave_and_a_rest_are_no_limit_of_a_sensor() -> None:
    times = np.arange(1000.0)
    assert not np.any(at_limit(np.sign(np.sin(times / 7))))
    assert not np.any(at_limit(np.round(1.0 - np.exp(-times / 50), 2)))


def test_a_saturated_force_is_refused_and_a_bounded_one_is_not() -> None:
    """The force that acted is not the recorded one; where it is, its own limit does no harm."""
    times = np.arange(0.0, 30 * PERIOD, PERIOD / 30)
    force = np.sin(np.cumsum(np.linspace(0.3, 1.8, times.size)) * OMEGA * times[1])
    cut = np.clip(force, -0.5, 0.5)
    for acting, trust in ((force, "do not trust"), (cut, "trust")):
        motion = lsim(([1.0], [1.0, 2 * 0.05 * OMEGA, OMEGA**2]), acting, times)[1]
        values = motion + np.std(motion) * noise(times.size, 0)
        answer = bench.identify(times, values, cut, method="output_error")
        assert answer.trust == trust, answer.reasons
        assert any("force sensor is saturated" in reason for reason in answer.reasons) == (trust != "trust")
