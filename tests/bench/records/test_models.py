"""The models that a record is compared with, and the smoothing velocity that its speed gives."""

from __future__ import annotations

import numpy as np
import pytest

from bench.records.models import FRACTION, candidates, smoothing_velocity

T = np.linspace(0.0, 8.0, 300)
OMEGA = 2 * np.pi
RMS = OMEGA / np.sqrt(2.0)
"""The root mean square speed of ``sin(OMEGA t)``."""


@pytest.mark.parametrize("angle", [False, True])
def test_the_candidates_of_a_free_record(angle: bool) -> None:
    found = candidates(False, angle, 0.2)
    assert list(found) == [
        "viscous", "viscous + Coulomb", "viscous + quadratic", "viscous + Coulomb + quadratic", "Duffing", "softening",
        "pendulum", "pendulum + Coulomb", "pendulum + quadratic", "pendulum + Coulomb + quadratic",
    ]  # fmt: skip
    assert len(set(found.values())) == len(found)
    assert found["viscous + Coulomb"].smoothing_velocity == 0.2
    assert all(("l" in found[name].names) != angle for name in found if name.startswith("pendulum"))
    assert all(system.tells_offset and not system.needs_scale for system in found.values())


def test_a_forced_record_may_be_of_an_axis_without_a_spring() -> None:
    found = candidates(True, False)
    more = {name: found[name] for name in found if name not in candidates(False, False)}
    assert all("k" not in system.names and not system.tells_offset for system in more.values())
    assert {system.bias_sign for system in more.values() if "b" in system.names} == {1, -1}


def test_the_smoothing_velocity_is_a_part_of_the_speed() -> None:
    assert smoothing_velocity(T, np.sin(OMEGA * T)) == pytest.approx(FRACTION * RMS, rel=0.01)


def test_noise_and_an_offset_change_it_by_little() -> None:
    noisy = np.sin(OMEGA * T) + 3.0 + 0.07 * np.random.default_rng(1).standard_normal(T.size)
    assert smoothing_velocity(T, noisy) == pytest.approx(FRACTION * RMS, rel=0.1)


def test_oversampling_lets_no_noise_in() -> None:
    times = np.linspace(0.0, 8.0, 20_000)
    noisy = np.sin(OMEGA * times) + 0.1 * np.random.default_rng(1).standard_normal(times.size)
    assert smoothing_velocity(times, noisy) == pytest.approx(FRACTION * RMS, rel=0.05)


def test_uneven_times_and_other_units_give_the_same() -> None:
    times = np.sort(np.random.default_rng(2).uniform(0.0, 8.0, 300))
    assert smoothing_velocity(times, np.sin(OMEGA * times)) == pytest.approx(FRACTION * RMS, rel=0.1)
    scaled = smoothing_velocity(1000.0 * T, 0.01 * np.sin(OMEGA * T))
    assert scaled == pytest.approx(1e-5 * smoothing_velocity(T, np.sin(OMEGA * T)))


@pytest.mark.parametrize("values", [np.zeros(9), np.full(9, 2.5), np.full(9, 0.1), np.array([1.0, 0.0, -1.0])])
def test_it_is_never_zero(values: np.ndarray) -> None:
    found = smoothing_velocity(np.linspace(0.0, 1.0, values.size), values)
    assert 1e-4 < found < 1.0


def test_the_work_that_smoothing_takes_off_is_as_stated() -> None:
    """Per cycle of a sine of the speed, by the midpoint rule: ``(π²/24) (v_s/V)²`` of Coulomb's."""
    v = np.sin(2 * np.pi * (np.arange(400_000) + 0.5) / 400_000)
    short = 1.0 - np.sum(v * np.tanh(v / 0.01)) / np.sum(np.abs(v))
    assert short == pytest.approx(np.pi**2 / 24 * 0.01**2, rel=0.01)
