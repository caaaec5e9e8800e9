"""Comparisons on errors whose relation is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.errors import InputError
from bench.scoring.comparison import (
    Errors,
    compare,
    differences,
    log_ratios,
    standing,
)
from bench.scoring.statistics import LEVEL, holm, more_often

ONE = np.zeros(100, int)


def lognormal(rng: np.random.Generator, n: int = 100) -> np.ndarray:
    return np.exp(rng.standard_normal(n))


def test_a_method_against_itself_with_other_seeds_is_a_tie() -> None:
    """The same law on the same data, with own noise: told apart in one case of twenty at the 5 % level."""
    ties = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        base = lognormal(rng)
        a, b = (base * np.exp(0.3 * rng.standard_normal(100)) for _ in range(2))
        ties += compare(Errors({"a": a, "b": b}, ONE))[0].tie
    assert ties >= 184


def test_a_paired_difference_is_found_that_the_spread_would_hide() -> None:
    """a is 20 % worse on every data set, while errors differ by factors of ten between them."""
    rng = np.random.default_rng(0)
    base = 10.0 ** rng.uniform(-1, 1, 100)
    found = compare(Errors({"a": 1.2 * base * np.exp(0.1 * rng.standard_normal(100)), "b": base}, ONE))[0]
    assert not found.tie
    assert found.low < 1.2 < found.high
    assert found.low > 1.1
    assert 1.0 < found.resolved < 1.1  # the median's error is 1.25 * 0.1 / 10, times 2.8


def test_less_than_two_percent_is_a_tie_however_sure() -> None:
    base = lognormal(np.random.default_rng(0))
    found = compare(Errors({"a": 1.01 * base, "b": base}, ONE))[0]
    assert found.adjusted < 1e-6
    assert found.tie


def test_failures_are_worst_and_both_failing_is_equal() -> None:
    a, b = np.array([1.0, np.inf, np.inf, 2.0]), np.array([1.0, 1.0, np.inf, np.inf])
    np.testing.assert_array_equal(log_ratios(a, b), [0.0, np.inf, 0.0, -np.inf])
    rng = np.random.default_rng(0)
    good = lognormal(rng)
    failing = np.where(np.arange(100) < 60, np.inf, good)
    found = compare(Errors({"good": good, "failing": failing}, ONE))[0]
    assert not found.tie
    assert found.ratio == 0.0


def test_the_best_and_its_ties_with_unequal_replicates() -> None:
    """b is the same as the best up to noise, c four times worse on the twenty replicates it was given."""
    rng = np.random.default_rng(0)
    base = lognormal(rng)
    b = 1.05 * base * np.exp(0.5 * rng.standard_normal(100))
    found = standing({"a": base, "b": b, "c": 4.0 * base[:20]}, {}, math.nan)
    assert found is not None
    assert found.best == "a"
    assert {c.a: c.tie for c in found.comparisons} == {"b": True, "c": False}


def test_a_method_that_runs_away_now_and_then_is_neither_best_nor_level() -> None:
    """Bound 1, errors half-normal; one method is 10 % better but for eight answers in a hundred, 20 bounds off."""
    rng = np.random.default_rng(0)
    base = np.abs(rng.standard_normal(100))
    wild = np.where(np.arange(100) % 12 == 0, 20.0, 0.9 * base)
    values = {"wild": wild, "sound": base, "also": base * (1.0 + 1e-3 * rng.standard_normal(100))}
    excess = {name: float(np.sqrt(np.mean(own**2))) for name, own in values.items()}
    found = standing(values, excess, 1.0)
    assert found is not None
    assert np.median(wild) < np.median(base)
    assert found.best != "wild"
    assert found.level == {"sound", "also"}
    assert found.p_gross["wild"] == pytest.approx(0.5**9)  # nine pairs differ, all one way
    assert found.p_gross["also"] == 1.0
    unbounded = standing({**values, "wild": np.where(wild > 5, np.inf, wild)}, {}, math.nan)
    assert unbounded is not None
    assert unbounded.best != "wild"  # failures are gross errors, whatever the bound


def test_the_gross_errors_of_equal_methods_are_said_to_differ_at_the_level_of_the_test_at_most() -> None:
    rng = np.random.default_rng(1)
    said = [more_often(rng.random(50) < 0.1, rng.random(50) < 0.1) <= LEVEL for _ in range(2000)]
    assert np.mean(said) <= LEVEL + 3 * math.sqrt(LEVEL / 2000)


def test_differences_are_in_units_of_their_scenario() -> None:
    """Median errors 2 and 20; both failing is no difference, one failing an infinite one."""
    a, b = np.array([3.0, 2.0, 30.0, 20.0, np.inf, np.inf]), np.array([1.0, 2.0, 10.0, 20.0, np.inf, 4.0])
    found = differences(a, b, np.array([0, 0, 1, 1, 2, 2]))
    np.testing.assert_allclose(found[:5], [1.0, 0.0, 1.0, 0.0, 0.0])
    assert found[5] == np.inf


def test_clusters_widen_the_interval() -> None:
    """Where scenarios differ more than replicates, 5 scenarios of 20 tell less than 100 replicates of one would."""
    rng = np.random.default_rng(0)
    scenario = np.repeat(np.arange(5), 20)
    ratio = np.exp(0.5 * rng.standard_normal(5)[scenario] + 0.05 * rng.standard_normal(100))
    values = {"a": ratio, "b": np.ones(100)}
    clustered, plain = (compare(Errors(values, labels))[0] for labels in (scenario, ONE))
    assert np.log(clustered.high / clustered.low) > 2.0 * np.log(plain.high / plain.low)


def test_holm_by_hand() -> None:
    """Sorted 0.01, 0.02, 0.03, 0.04 times 4, 3, 2, 1, made monotone: 0.04, 0.06, 0.06, 0.06."""
    np.testing.assert_allclose(holm([0.03, 0.01, 0.04, 0.02]), [0.06, 0.04, 0.06, 0.06])
    np.testing.assert_allclose(holm([0.9, 0.8]), [1.0, 1.0])


def test_scenarios_of_unequal_sizes_are_refused() -> None:
    with pytest.raises(InputError, match="as many of every scenario"):
        compare(Errors({"a": np.ones(3), "b": np.ones(3)}, np.array([0, 0, 1])))
