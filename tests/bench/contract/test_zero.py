"""Jumps of a sensor's zero, found in samples that were made without the code."""

import numpy as np
import pytest

from bench.contract.zero import largest_jump

TIME = np.arange(150) / 12.0
MOTION = np.sin(4.0 * TIME) + 0.3 * np.cos(2.5 * TIME)


def noisy(seed: int) -> np.ndarray:
    return MOTION + 0.05 * np.random.default_rng(seed).standard_normal(TIME.size)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("at", [20, 75, 140])
def test_a_jump_is_found_where_it_is_with_its_size(at: int, seed: int) -> None:
    values = noisy(seed)
    values[at:] += 1.5
    found = largest_jump(values)
    assert found.first == at
    assert found.size == pytest.approx(1.5, abs=0.4)


@pytest.mark.parametrize("seed", range(5))
def test_a_spike_is_none(seed: int) -> None:
    values = noisy(seed)
    values[75] += 0.5
    assert largest_jump(values) is None


def test_missing_samples_are_passed_over() -> None:
    values = noisy(0)
    values[10:60] = np.nan
    values[90:] -= 2.0
    found = largest_jump(values)
    assert found.first == 90
