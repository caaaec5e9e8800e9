"""The threshold, against the likelihood of simulated records on a grid that is written here."""

import math

import numpy as np
import pytest

from bench.atlas.point import FreeDecay
from bench.atlas.threshold import wrong_basin

RATIOS = (1e-4, 0.003, 0.01, 0.03, 0.1, 0.3, 0.7)
RECORDS = 400


def modes(times: np.ndarray, omega: float, ratio: float) -> np.ndarray:
    damped = omega * math.sqrt(1 - ratio**2)
    decay = np.exp(-ratio * omega * times)
    return np.stack([decay * np.cos(damped * times), decay * np.sin(damped * times)], axis=1)


def path(times: np.ndarray, omega: float, ratio: float, phase: float) -> np.ndarray:
    """From ``cos(phase)`` with velocity ``-sin(phase)``."""
    x0, v0, damped = math.cos(phase), -math.sin(phase), omega * math.sqrt(1 - ratio**2)
    return modes(times, omega, ratio) @ [x0, (v0 + ratio * omega * x0) / damped]


def counted(point: FreeDecay) -> float:
    """The share of records whose largest likelihood is far from the truth's basin, by a grid of all motions."""
    times = np.linspace(0.0, 2 * math.pi * point.cycles, point.samples)
    motion = path(times, 1.0, point.damping_ratio, point.phase)
    size = math.sqrt(point.samples * 10 ** (point.snr_db / 10) / np.sum(motion**2))
    motion = size * motion
    records = motion[:, None] + np.random.default_rng(11).standard_normal((point.samples, RECORDS))
    found = []
    omegas = np.arange(1, 4 * (point.samples - 1)) / (8 * point.cycles)
    for omega in omegas:
        if point.start_known:
            paths = [size * path(times, omega, ratio, point.phase) for ratio in RATIOS]
            found.append(np.max([2 * (own @ records) - own @ own for own in paths], axis=0))
        else:
            bases = [np.linalg.qr(modes(times, omega, ratio))[0] for ratio in RATIOS]
            found.append(np.max([np.sum((basis.T @ records) ** 2, axis=0) for basis in bases], axis=0))
    best = omegas[np.argmax(found, axis=0)]
    return float(np.mean(np.abs(best - 1.0) > 0.75 / point.cycles))  # the main lobe


@pytest.mark.parametrize(
    "point",
    [FreeDecay(28, 5.0, 0.012, -5.0, 0.7, False), FreeDecay(31, 2.3, 0.0015, -4.0, 0.2, False),
     FreeDecay(33, 13.1, 0.0025, -5.0, 1.1, False), FreeDecay(20, 2.8, 0.001, -3.0, 2.0, False),
     FreeDecay(28, 5.0, 0.012, -5.0, 0.7, True), FreeDecay(20, 6.0, 0.02, -4.0, 0.7, True)],
)  # fmt: skip
def test_below_the_threshold_it_is_the_share_that_is_counted(point: FreeDecay) -> None:
    share = counted(point)
    assert 0.05 < share < 0.5
    assert wrong_basin(point) == pytest.approx(share, abs=0.07)


def test_well_above_the_threshold_no_basin_is_wrong() -> None:
    assert counted(FreeDecay(60, 6.0, 0.02, 10.0, 0.7, False)) == 0.0
    assert wrong_basin(FreeDecay(60, 6.0, 0.02, 10.0, 0.7, False)) < 1e-3
