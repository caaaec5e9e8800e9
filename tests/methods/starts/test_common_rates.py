"""Rates of damped sinusoids: gains against least squares, and sums whose rates are known."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel
from methods.starts.common_rates import _gains, _groups, common_rates, damped_columns

TIMES = np.linspace(0.0, 1.0, 80)


def left(channel: Channel, rates: list[complex]) -> float:
    """The share of a channel's squares that damped sinusoids leave, by numpy's least squares."""
    columns = damped_columns(channel.times, np.array(rates), channel.offset)
    computed = np.linalg.lstsq(columns, channel.values, rcond=None)[0]
    return float(np.sum((channel.values - columns @ computed) ** 2) / np.sum(channel.values**2))


@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("there", [[], [-1.0 + 20.0j], [-0.3 + 9.0j, -2.0 + 31.0j]])
def test_what_a_wave_takes_off_is_what_least_squares_says(offset: bool, there: list[complex]) -> None:
    rng = np.random.default_rng(3)
    irregular = np.sort(rng.uniform(0.0, 1.0, 60))
    channels = [Channel(t, rng.standard_normal(t.size), offset=offset) for t in (TIMES, TIMES, irregular)]
    groups = _groups(channels)
    assert [len(group) for group in groups] == [2, 1]
    decays, omegas = np.array([0.2, 3.0]), np.array([7.0, 25.0, 60.0])
    gains = sum(_gains(group, np.array(there, complex), decays, omegas) for group in groups)
    for i, d in enumerate(decays):
        for j, w in enumerate(omegas):
            taken = sum(left(c, there) - left(c, [*there, -d + 1j * w]) for c in channels)
            assert np.asarray(gains)[i, j] == pytest.approx(taken, rel=1e-6, abs=1e-9)


def test_a_wave_that_is_there_already_adds_nothing() -> None:
    (group,) = _groups([Channel(TIMES, np.cos(20.0 * TIMES) + TIMES)])
    again = _gains(group, np.array([-1.0 + 20.0j]), np.array([1.0]), np.array([20.0]))
    assert abs(float(again[0, 0])) < 1e-6


def test_two_waves_of_two_channels_are_found() -> None:
    """Each channel shows both, in other shares; a grid of a quarter cycle, refined twice, is within a tenth of one."""
    waves = [np.exp(-0.8 * TIMES) * np.cos(30.0 * TIMES), np.exp(-1.5 * TIMES) * np.sin(71.0 * TIMES)]
    channels = [Channel(TIMES, a * waves[0] + b * waves[1]) for a, b in ((1.0, 0.4), (0.7, -0.6))]
    computed = np.sort(common_rates(channels, 2).imag)
    np.testing.assert_allclose(computed, [30.0, 71.0], atol=0.1 * 2 * np.pi)
