"""Powers of a multisine: against every choice on a grid, the equivalence theorem, and a long simulated record."""

import itertools

import numpy as np
import pytest

from bench.planning.forced_test import ForcedTest, information
from bench.planning.free_decay import Oscillator
from bench.planning.multisine import (
    ALL,
    ENOUGH,
    best_powers,
    criterion,
    criterion_columns,
    line_information,
    sensitivities,
)
from bench.planning.search import Likely

SURE, UNSURE = Likely(2.0, 0.05), Likely(2.0, 0.05, 0.05, 0.3)
FREQUENCIES = np.arange(1, 17) / 4.0


def lines_of(likely: Likely, frequencies: np.ndarray) -> np.ndarray:
    return np.stack([line_information(own, frequencies) for own in likely.oscillators])


@pytest.mark.parametrize("likely", [SURE, UNSURE], ids=["sure", "unsure"])
@pytest.mark.parametrize("quantity", [ALL, "k_over_m", "c_over_m", "damping_ratio"])
def test_no_line_is_more_sensitive_than_the_equivalence_theorem_allows(likely: Likely, quantity: str) -> None:
    """At most p at an optimum, by variances of the response that are computed line by line, and p where power is."""
    found, columns = best_powers(likely.oscillators, FREQUENCIES, quantity), criterion_columns(quantity)
    size = columns.shape[1]
    slope = np.zeros(FREQUENCIES.size)
    for own in likely.oscillators:
        lines = line_information(own, FREQUENCIES)
        inverse = np.linalg.inv(sum(share * line for share, line in zip(found.shares, lines, strict=True)))
        block = np.linalg.inv(columns.T @ inverse @ columns)
        slope += [np.trace(block @ columns.T @ inverse @ line @ inverse @ columns) for line in lines]
    slope /= len(likely.oscillators)
    assert slope.max() <= size * (1 + 2 * ENOUGH)
    np.testing.assert_allclose(slope[found.shares > 0.02], size, rtol=0.02)
    assert found.shares.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("likely", [SURE, UNSURE], ids=["sure", "unsure"])
@pytest.mark.parametrize("quantity", [ALL, "c_over_m"])
def test_no_powers_on_a_grid_are_better(likely: Likely, quantity: str) -> None:
    frequencies = np.array([0.5, 1.8, 2.1, 2.6])
    lines, columns = lines_of(likely, frequencies), criterion_columns(quantity)
    found = criterion(lines, best_powers(likely.oscillators, frequencies, quantity).shares, columns)
    parts = 12
    every = [
        criterion(lines, np.array([*part, parts - sum(part)]) / parts, columns)
        for part in itertools.product(range(parts + 1), repeat=3)
        if sum(part) <= parts and np.count_nonzero([*part, parts - sum(part)]) > 1  # one line tells two of three
    ]
    assert found <= min(every) + 2 * ENOUGH
    assert min(every) - found < 0.1  # the grid comes near


def test_sensitivities_are_the_slopes_of_the_criterion() -> None:
    lines, columns = lines_of(UNSURE, FREQUENCIES), criterion_columns("c_over_m")
    shares, step = np.random.default_rng(0).dirichlet(np.ones(FREQUENCIES.size)), 1e-6
    slopes = [
        (criterion(lines, shares - step * one, columns) - criterion(lines, shares + step * one, columns)) / (2 * step)
        for one in np.eye(FREQUENCIES.size)
    ]
    np.testing.assert_allclose(sensitivities(lines, shares, columns), slopes, rtol=1e-5)


def test_a_long_record_tells_what_its_lines_do_in_steady_state() -> None:
    own, shares, test = Oscillator(2.0, 0.05), np.array([0.2, 0.5, 0.3]), ForcedTest(40_01, 100.0, 1.0)
    frequencies = np.array([1.5, 2.0, 2.3])
    sizes = np.sqrt(2.0 * shares)
    force = test.scale(np.cos(2 * np.pi * np.outer(test.times, frequencies)) @ sizes)
    told = information(own, test, force)
    without_start = told[:3, :3] - told[:3, 3:] @ np.linalg.solve(told[3:, 3:], told[3:, :3])
    mean_square = test.energy / test.duration
    expected = test.samples * mean_square * np.einsum("l,lij->ij", shares, line_information(own, frequencies))
    found, wanted = np.linalg.inv(without_start), np.linalg.inv(expected)
    np.testing.assert_allclose(np.diag(found), np.diag(wanted), rtol=0.05)
