"""Candidate modes of a free vibration, their intervals and aliases, on closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from bench.records.modes import alias_of, modes_of

T = np.arange(0.0, 2.0, 1 / 800)
TRUE = ((22.7, 0.012), (198.0, 0.008))


def decay(times: np.ndarray, frequency: float, ratio: float, phase: float = 0.4) -> np.ndarray:
    """Return a damped cosine of a natural frequency (Hz) and a damping ratio."""
    rate = 2 * np.pi * frequency
    return np.exp(-ratio * rate * times) * np.cos(rate * np.sqrt(1 - ratio**2) * times + phase)


def noise(size: float, seed: int, times: np.ndarray = T) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal(times.size)


def test_frequency_and_damping_of_two_modes() -> None:
    values = decay(T, *TRUE[0]) + 4 * decay(T, *TRUE[1]) + noise(0.02, 0) + 0.1
    strong, weak = modes_of(T, values)
    for mode, (frequency, ratio) in zip((weak, strong), TRUE, strict=True):
        assert mode.frequency == pytest.approx(frequency, rel=1e-3)
        assert mode.damping_ratio == pytest.approx(ratio, rel=0.02)
    assert strong.share > weak.share > 0.2


@pytest.mark.slow
def test_the_coverage_of_their_intervals_is_95_percent() -> None:
    covered = []
    for seed in range(100):
        values = decay(T, *TRUE[0]) + decay(T, *TRUE[1], phase=seed) + noise(0.1, seed)
        modes = sorted(modes_of(T, values), key=lambda mode: mode.frequency)
        assert len(modes) == 2
        for mode, (frequency, ratio) in zip(modes, TRUE, strict=True):
            covered.append(mode.frequency_low <= frequency <= mode.frequency_high)
            covered.append(mode.damping_ratio_low <= ratio <= mode.damping_ratio_high)
    assert 0.92 < np.mean(covered) < 0.98


def test_one_mode_in_noise_is_one_mode() -> None:
    assert [len(modes_of(T, decay(T, *TRUE[0]) + noise(0.3, seed))) for seed in range(5)] == [1] * 5


def test_the_alias_gives_the_same_samples() -> None:
    times = np.arange(0.0, 12.0, 1 / 3)
    (mode,) = modes_of(times, decay(times, 1.9, 0.01), count=1)
    alias = alias_of(mode, times)
    assert alias is not None
    assert alias.frequency == pytest.approx(1.9, rel=1e-4)
    assert alias.damping_ratio == pytest.approx(0.01, rel=1e-3)


def test_uneven_samples_have_no_alias() -> None:
    times = np.sort(np.random.default_rng(0).uniform(0.0, 12.0, 60))
    (mode,) = modes_of(times, decay(times, 1.1, 0.02), count=1)
    assert alias_of(mode, times) is None
