"""The contract, over every registered method and variant: what any method must keep, ours or anybody's."""

from __future__ import annotations

import copy
import importlib.util
import math
import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest

from bench import Channel, Estimate, Force, Identifier, InitialState, Prior, Problem, Record, Status, Units
from bench.contract.method import Card
from bench.entrants.registry import load_method, make_method, registered
from bench.scenario.truth import closed_form
from bench.scoring.combination import combine_with_prior
from bench.systems import SDOF

VARIANTS: dict[str, dict[str, Any]] = {
    "ddnn": {"name": "ddnn", "iterations": 30, "draws": 30},  # as far as needed: what is asked is not accuracy
    "ls_spline": {"name": "ls", "derivative": "spline"},
    "npe": {"name": "npe", "steps": 150, "batch": 64, "width": 48, "depth": 2},
    "rival_deepxde": {"name": "rival_deepxde", "adam_steps": 40, "second_steps": 20},
    "rival_jinns": {"name": "rival_jinns", "adam_steps": 40, "second_steps": 20},
    "rival_pina": {"name": "rival_pina", "adam_steps": 40, "second_steps": 20},
    "pinn_adam": {"name": "pinn", "optimizer": "adam_lbfgs", "slack": 0.5, "adam_steps": 200, "lbfgs_steps": 300},
}
NAMES = sorted({*registered(), *VARIANTS})
P = {"m": 1.4, "c": 0.7, "k": 11.0}  # a plant that is in no table


def make(name: str) -> Identifier:
    variant = dict(VARIANTS.get(name, {"name": name}))
    base = variant.pop("name")
    for package in load_method(base).requires:
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    return make_method(base, variant)


def problem(
    times: np.ndarray | None = None, noise: float = 0.03, seed: int = 5, start: bool = True, dead: bool = False
) -> Problem:
    """Free vibration of the plant ``P`` from 0.9 m, 0.4 m/s, with Gaussian noise (m)."""
    times = np.linspace(0.0, 8.0, 25) if times is None else times
    rng = np.random.default_rng(seed)
    values = closed_form(P, 0.9, 0.4, times) + noise * rng.standard_normal(times.size)
    channel = Channel(times, np.zeros(times.size) if dead else values)
    state = InitialState(np.array([0.9]), np.array([0.4])) if start else None
    prior = Prior({"m": 1.41, "c": 0.4, "k": 14.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
    return Problem(SDOF(), (Record((channel,), (), state),), prior)


def rng(seed: int = 11) -> np.random.Generator:
    return np.random.default_rng(seed)


def values(estimate: Estimate, prior: Prior | None) -> tuple[np.ndarray, np.ndarray]:
    """Values of k/m and c/m with their standard errors (half the 68 % interval)."""
    combined = combine_with_prior(estimate, prior)
    points, errors = [], []
    for name in ("k_over_m", "c_over_m"):
        marginal = combined.marginal(combined.system.quantity(name))
        assert marginal is not None
        low, high = marginal.interval(0.6827)
        points.append(marginal.value)
        errors.append((high - low) / 2)
    return np.array(points), np.array(errors)


@pytest.fixture(params=NAMES, scope="module")
def method(request: pytest.FixtureRequest) -> Identifier:
    return make(request.param)


LONG = ("nuts", "pinn_adam")
quick_methods_first = pytest.mark.parametrize(
    "method",
    [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in NAMES],
    indirect=True,
    scope="module",
)
"""For data other than ``problem()``: the gradient sampler compiles anew for each layout, the descent is long."""


@cache
def fitted(method: Identifier, start: bool = True) -> Estimate:
    """The estimate for ``problem()``, made once for all tests that only look at it."""
    return method.identify(problem(start=start), rng())


def test_it_has_a_card_and_says_what_it_serves(method: Identifier) -> None:
    assert isinstance(method.card, Card)
    for text in (method.card.summary, method.card.uncertainty, method.card.settings_source, method.card.tuning):
        assert text.strip()
    assert (type(method).__doc__ or "").strip()
    assert not method.requires or method.extra


class Trap:
    """A truth that must not be touched: any use of it fails the test."""

    def __getattribute__(self, name: str) -> Any:
        raise AssertionError(f"the method reached for the truth ({name})")


def test_same_seed_same_answer_the_input_is_untouched_and_no_trap_where_the_truth_would_be_is_sprung(
    method: Identifier,
) -> None:
    given = problem()
    before = copy.deepcopy(given)
    for place in (given, given.records[0], given.records[0].channels[0], given.prior):
        for name in ("truth", "_truth", "parameters_true", "scenario"):
            object.__setattr__(place, name, Trap())
    first, second = fitted(method), method.identify(given, rng())
    assert first.status is Status.OK, first.message
    np.testing.assert_array_equal(values(first, before.prior)[0], values(second, before.prior)[0])
    np.testing.assert_array_equal(given.records[0].channels[0].values, before.records[0].channels[0].values)
    np.testing.assert_array_equal(given.records[0].channels[0].times, before.records[0].channels[0].times)
    assert given.prior == before.prior


def test_alone_or_in_company_the_answer_is_the_same(method: Identifier) -> None:
    a, b = problem(), problem(seed=2)
    together = method.identify_many([b, a], [rng(2), rng()])[1]
    # to rounding: a matrix product sums in another order with more rows, on some processors
    np.testing.assert_allclose(values(together, a.prior)[0], values(fitted(method), a.prior)[0], rtol=1e-12)


@pytest.mark.parametrize("units", [Units(length=1e-3), Units(time=0.1)], ids=["displacement x1000", "time x10"])
def test_other_units_change_nothing_but_units(method: Identifier, units: Units) -> None:
    same_in_other_units(method, units, start=True)


@quick_methods_first
def test_other_units_change_nothing_but_units_where_the_start_is_untold(method: Identifier) -> None:
    same_in_other_units(method, Units(length=1e-3, time=0.1), start=False)


def same_in_other_units(method: Identifier, units: Units, start: bool) -> None:
    """The same data in other units (prior and start converted) must agree within a thousandth of a standard error."""
    given = problem(start=start)
    other = given.expressed_in(units)
    here, error = values(fitted(method, start), given.prior)
    there, _ = values(method.identify(other, rng()).expressed_in(units.inverse), given.prior)
    error = np.where(np.isfinite(error), error, 0.01 * np.abs(here))
    assert np.all(np.abs(there - here) <= 1e-3 * error), (here, there, error)


HARD = {
    "five samples": lambda: problem(np.linspace(0.0, 8.0, 5)),
    "irregular times": lambda: problem(np.sort(np.random.default_rng(3).uniform(0.0, 8.0, 25)), start=False),
    "dead channel": lambda: problem(dead=True),
    "dead channel, unknown start": lambda: problem(dead=True, start=False),
    "huge noise": lambda: problem(noise=3.0, start=False),
    "one cycle only": lambda: problem(np.linspace(0.0, 2.0, 25), start=False),
}


def answers_or_says_why_not(method: Identifier, case: str) -> None:
    given = HARD[case]()
    estimate = combine_with_prior(method.identify(given, rng()), given.prior)
    if estimate.status is Status.OK:
        assert np.all(np.isfinite(values(estimate, given.prior)[0]))
        for reconstruction in estimate.reconstructions:
            assert np.all(np.isfinite(reconstruction(np.linspace(0, 2, 7))))
    else:
        assert len(estimate.message.split()) >= 4


@pytest.mark.parametrize("case", [case for case in HARD if "dead" in case])
def test_a_dead_channel_gives_a_finite_answer_or_a_status_with_a_sentence(method: Identifier, case: str) -> None:
    answers_or_says_why_not(method, case)


@quick_methods_first
@pytest.mark.parametrize("case", [case for case in HARD if "dead" not in case])
def test_hard_data_give_a_finite_answer_or_a_status_with_a_sentence(method: Identifier, case: str) -> None:
    answers_or_says_why_not(method, case)


def test_an_estimate_travels_between_processes(method: Identifier) -> None:
    estimate = fitted(method)
    copied = pickle.loads(pickle.dumps(estimate))
    times = np.linspace(0.0, 8.0, 9)
    for mine, theirs in zip(estimate.reconstructions, copied.reconstructions, strict=True):
        assert mine(times).shape == (1, 9)
        np.testing.assert_array_equal(mine(times), theirs(times))


@quick_methods_first
def test_without_a_prior_only_ratios_are_claimed(method: Identifier) -> None:
    given = problem()
    given = Problem(given.system, given.records, None)
    estimate = method.identify(given, rng())
    assert estimate.status is Status.OK, estimate.message
    assert estimate.marginal(given.system.quantity("m")) is None
    ratio = estimate.marginal(given.system.quantity("k_over_m"))
    assert ratio is not None
    assert math.isfinite(ratio.value)


@quick_methods_first
def test_with_a_known_force_and_no_prior_the_mass_is_claimed_or_the_case_is_declined(method: Identifier) -> None:
    times = np.linspace(0.0, 8.0, 40)
    force = Force(np.linspace(0.0, 8.0, 161), 3.0 * np.sin(np.linspace(0.0, 8.0, 161) * 2.0))
    from bench.scenario.truth import matrix_exponential_response

    start = InitialState(np.array([0.5]), np.array([0.0]))
    clean = matrix_exponential_response(SDOF(), P, start, times, (force,))[0]
    channel = Channel(times, clean + 1e-3 * rng(1).standard_normal(40))
    given = Problem(SDOF(), (Record((channel,), (force,), start),))
    if method.objection(given):
        return
    estimate = method.identify(given, rng())
    if estimate.status is Status.OK:
        mass = estimate.marginal(given.system.quantity("m"))
        assert mass is not None
        # equation-error methods are biased by their sampling step: the factor is loose, the scale is not arbitrary
        assert 0.4 < mass.value / P["m"] < 2.5
    else:
        assert estimate.message
