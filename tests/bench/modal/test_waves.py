"""Damped waves by maximum likelihood: exact without noise, efficient with noise, and the number of modes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from bench.config.modal import modal_scenario
from bench.contract.estimate import Status
from bench.contract.modal import FreeDecays, ModalEstimate, ModalProblem
from bench.entrants.modal import make_modal

RATE = 200.0
T = np.arange(1000) / RATE
SEPARATE = ((7.3, 0.012), (19.1, 0.02), (33.0, 0.008))
CLOSE = ((10.0, 0.01), (10.2, 0.012))
"""The distance of these modes is a half-power bandwidth."""
SHAPES = np.array([[1.0, 0.6, 0.4], [-0.7, 0.9j, 0.5 - 0.2j], [0.3, -1.0, 0.8j]])


def decays(modes: tuple[tuple[float, float], ...], shapes: np.ndarray, times: np.ndarray = T) -> np.ndarray:
    """Return the free motion (channels, n) of natural frequencies (Hz) and damping ratios, with an offset of 0.2."""
    rates = 2 * np.pi * np.array([f for f, _ in modes])
    ratios = np.array([ratio for _, ratio in modes])
    poles = -ratios * rates + 1j * rates * np.sqrt(1 - ratios**2)
    return np.asarray((shapes[:, : len(modes)] @ np.exp(poles[:, None] * times)).real + 0.2)


def noise(size: float, seed: int, channels: int = 1, n: int = T.size) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal((channels, n))


def answer(values: np.ndarray, times: np.ndarray = T, **of: object) -> ModalEstimate:
    return make_modal("waves").identify_modes(ModalProblem(FreeDecays(times, values), **of))


def frequencies(estimate: ModalEstimate) -> list[float]:
    return [mode.frequency for mode in estimate.modes]


def bound(modes: tuple[tuple[float, float], ...], shapes: np.ndarray, size: float) -> np.ndarray:
    """Return standard errors of frequencies and damping ratios by finite differences of all unknowns."""

    def motion(x: np.ndarray) -> np.ndarray:
        pairs, rest = x[: 2 * m].reshape(m, 2), x[2 * m :]
        parts = rest[:-channels].reshape(2, channels, m)
        moving = decays(tuple(map(tuple, pairs)), parts[0] + 1j * parts[1])
        return np.ravel(moving + rest[-channels:, None])

    m, channels = len(modes), len(shapes)
    x = np.concatenate([np.ravel(modes), shapes[:, :m].real.ravel(), shapes[:, :m].imag.ravel(), np.zeros(channels)])
    steps = 1e-6 * np.maximum(np.abs(x), 1e-2)
    slopes = [(motion(x + h) - motion(x - h)) / (2 * step) for step, h in zip(steps, np.diag(steps), strict=True)]
    covariance = np.linalg.inv(np.array(slopes) @ np.transpose(slopes)) * size**2
    return np.sqrt(np.diag(covariance)[: 2 * m]).reshape(m, 2)


@pytest.mark.parametrize("modes", [SEPARATE, CLOSE])
@pytest.mark.parametrize("channels", [1, 3])
def test_without_noise_they_are_exact(modes: tuple[tuple[float, float], ...], channels: int) -> None:
    estimate = answer(decays(modes, SHAPES[:channels]), count=len(modes))
    for i, (mode, (frequency, ratio)) in enumerate(zip(estimate.modes, modes, strict=True)):
        assert mode.frequency == pytest.approx(frequency, rel=1e-8)
        assert mode.damping_ratio == pytest.approx(ratio, rel=1e-6)
        assert mode.shape == pytest.approx(SHAPES[:channels, i], rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("modes", "channels"), [(SEPARATE, 1), (SEPARATE, 3), (CLOSE, 1)])
def test_errors_are_at_the_bound_and_intervals_are_calibrated(
    modes: tuple[tuple[float, float], ...], channels: int
) -> None:
    size, errors, stated = 0.03, [], []
    for seed in range(25):
        estimate = answer(decays(modes, SHAPES[:channels]) + noise(size, seed, channels))
        assert len(estimate.modes) == len(modes)
        errors.append([(m.frequency - f, m.damping_ratio - r) for m, (f, r) in zip(estimate.modes, modes, strict=True)])
        stated.append([(m.frequency_sd, m.damping_ratio_sd) for m in estimate.modes])
    limit = bound(modes, SHAPES[:channels], size)
    assert np.mean(stated, axis=0) == pytest.approx(limit, rel=0.15)
    # of 100 to 150 independent errors
    assert np.sqrt(np.mean((np.array(errors) / limit) ** 2)) < 1.2
    assert np.mean(np.abs(errors) < 1.96 * np.array(stated)) > 0.88


def test_channels_are_weighted_by_their_noise() -> None:
    clean, loud = decays(SEPARATE, SHAPES[:1]) + noise(0.01, 0), decays(SEPARATE, SHAPES[1:2]) + noise(3.0, 1)
    single, both = answer(clean, count=3), answer(np.vstack([clean, loud]), count=3)
    for first, second in zip(single.modes, both.modes, strict=True):
        assert second.frequency == pytest.approx(first.frequency, abs=first.frequency_sd)
        assert second.frequency_sd < 1.02 * first.frequency_sd


@pytest.mark.slow
def test_peaks_of_coloured_noise_are_no_modes() -> None:
    for seed in range(5):
        coloured = lfilter([1.0], [1.0, -1.6, 0.85], noise(0.02, seed))
        assert frequencies(answer(decays(SEPARATE[:2], SHAPES[:1]) + coloured)) == pytest.approx([7.3, 19.1], rel=0.01)


@pytest.mark.parametrize("seed", [1002, 1003, 1011])
def test_resonant_noise_is_no_mode(seed: int) -> None:
    """With variances by Levinson and Durbin, the ends of these records would be fitted by modes."""
    resonant = lfilter([1.0], [1.0, -1.6, 0.85], noise(1.0, seed))
    assert answer(resonant).status is Status.DIVERGED
    estimate = answer(decays(((7.3, 0.012), (19.1, 0.02)), SHAPES[:1]) + 0.05 * resonant)
    assert frequencies(estimate) == pytest.approx([7.3, 19.1], rel=0.02)


def test_a_mode_with_friction_or_a_nonlinear_spring_is_a_single_mode() -> None:
    times = np.arange(1500) / 100.0
    size = np.exp(-0.13 * times)
    drag, spring = np.log1p(0.5 * (1 - size)), 0.8 * (1 - size**2)
    friction = np.maximum(1.13 * size - 0.13, 0.0)
    for amplitude, phase in ((size * np.exp(-drag), 0.0), (size, spring), (friction, 0.0)):
        motion = amplitude * np.cos(4 * np.pi * times + phase)
        estimate = answer(motion + noise(0.01, 3, n=times.size), times)
        assert frequencies(estimate) == pytest.approx([2.0], rel=0.01)
        assert "amplitude" in estimate.message or amplitude is friction


def test_only_modes_in_the_band_are_returned() -> None:
    estimate = answer(decays(SEPARATE, SHAPES) + noise(0.02, 0, 3), band=(15.0, 25.0))
    assert frequencies(estimate) == pytest.approx([19.1], rel=1e-3)
    counted = answer(decays(SEPARATE, SHAPES) + noise(0.02, 0, 3), band=(15.0, 40.0), count=2)
    assert frequencies(counted) == pytest.approx([19.1, 33.0], rel=1e-3)


def test_poles_that_come_close_during_the_search_are_two_modes() -> None:
    problem, _ = modal_scenario("half_a_bandwidth_apart").draw(0, 23)
    assert frequencies(make_modal("waves").identify_modes(problem)) == pytest.approx([15.0, 15.15], rel=1e-3)


def test_uneven_times_and_a_heavily_damped_mode() -> None:
    times = np.sort(np.random.default_rng(0).uniform(0.0, 5.0, 1000))
    modes = ((7.3, 0.012), (40.0, 0.08))
    estimate = answer(decays(modes, np.array([[1.0, 1.0]]), times) + noise(0.02, 1), times)
    for mode, (frequency, ratio) in zip(estimate.modes, modes, strict=True):
        assert mode.frequency == pytest.approx(frequency, abs=4 * mode.frequency_sd)
        assert mode.damping_ratio == pytest.approx(ratio, abs=4 * mode.damping_ratio_sd)
