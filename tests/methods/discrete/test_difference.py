"""The difference equation of a free decay: its roots from numpy, its inverse, its slopes by differences."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Problem, Record
from bench.scenario.truth import closed_form
from bench.systems import SDOF
from methods.discrete.ar import AR, coefficient_slopes, coefficients_of, equations, groups_of

PLANTS = [
    {"m": 1.3, "c": 0.6, "k": 9.0},
    {"m": 2.0, "c": 1e-6, "k": 5.0},
    {"m": 1.0, "c": 9.0, "k": 9.0},  # two decays without a turn
    {"m": 1.0, "c": 6.0, "k": 9.0},  # critical
]
TIMES = np.linspace(0.0, 6.0, 31)


def ratios(p: dict[str, float]) -> np.ndarray:
    return np.array([p["k"] / p["m"], p["c"] / p["m"]])


@pytest.mark.parametrize("p", PLANTS)
@pytest.mark.parametrize("offset", [False, True])
def test_the_coefficients_carry_exact_samples_on(p: dict[str, float], offset: bool) -> None:
    """Samples of the closed form, an offset among them, obey the equation."""
    a = coefficients_of(ratios(p), TIMES[1])
    x = closed_form(p, 0.8, 0.5, TIMES) + 0.7 * offset
    columns, target = equations(x[None], offset)
    unknowns = np.append(a, [0.7 * (1.0 - a.sum())] * offset)
    np.testing.assert_allclose(columns[0] @ unknowns, target[0], atol=1e-9)


@pytest.mark.parametrize("p", PLANTS[:3])
def test_groups_are_those_of_numpys_roots(p: dict[str, float]) -> None:
    a, step = coefficients_of(ratios(p), 0.2), 0.2
    s = np.log(np.roots([1.0, -a[0], -a[1]]).astype(complex)) / step
    np.testing.assert_allclose(groups_of(a, step), [np.prod(s).real, -np.sum(s).real], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(groups_of(a, step), ratios(p), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("p", PLANTS)
def test_slopes_are_central_differences(p: dict[str, float]) -> None:
    groups, step, small = ratios(p), 0.2, 1e-6
    expected = [
        (coefficients_of(groups + move, step) - coefficients_of(groups - move, step)) / (2 * small)
        for move in small * np.eye(2)
    ]
    np.testing.assert_allclose(coefficient_slopes(groups, step), np.transpose(expected), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("roots", [(-0.5, 0.5), (-0.5, -0.4), (1.2, 0.5), (0.0, 0.5)])
def test_roots_of_no_oscillator_have_no_groups(roots: tuple[float, float]) -> None:
    _, minus_a1, minus_a2 = np.poly(roots)
    assert np.all(np.isnan(groups_of(np.array([-minus_a1, -minus_a2]), 0.1)))


def problem(times: np.ndarray, offset: bool = False) -> Problem:
    values = closed_form(PLANTS[0], 0.8, 0.5, times)
    return Problem(SDOF(), (Record((Channel(times, values, offset=offset),)),))


def test_uneven_and_too_few_samples_are_declined_in_a_sentence() -> None:
    uneven = problem(np.sort(np.random.default_rng(3).uniform(0.0, 8.0, 25)))
    assert "even" in (AR().objection(uneven) or "")
    assert "at least 5" in (AR().objection(problem(TIMES[:4])) or "")
    assert "at least 7" in (AR().objection(problem(TIMES[:6], offset=True)) or "")
    assert AR().objection(problem(TIMES[:5])) is None
    # times printed to a ten-thousandth are even enough
    assert AR().objection(problem(np.round(np.linspace(0.0, 10.0, 25), 4))) is None
