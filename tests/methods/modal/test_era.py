"""Eigensystem realisation: exact data, the poles of the matrices, the matrix pencil, its covariance and the bound."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from bench import Channel, Estimate, InitialState, Normal, Problem, Record, state_matrix
from bench.information.fisher import compute_bound
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form, reference_response
from bench.systems import SDOF, Chain, System
from methods.modal.era import ERA, state_rows
from methods.modal.matrix_pencil import MatrixPencil
from methods.modal.realisation import realise

# plants that are in no table
ONE = {"m": 1.3, "c": 0.6, "k": 9.0}
TWO = {"m1": 1.2, "m2": 0.9, "c1": 0.25, "c2": 0.2, "k1": 7.0, "k2": 11.0}
THREE = {"m1": 1.0, "m2": 0.7, "m3": 1.4, "c1": 0.2, "c2": 0.1, "c3": 0.3, "k1": 9.0, "k2": 6.0, "k3": 12.0}
START = {1: ((0.8,), (0.5,)), 2: ((0.5, -0.4), (0.0, 1.0)), 3: ((0.5, -0.4, 0.9), (0.0, 1.0, -0.5))}


def record(system: System, p: dict[str, float], noise: float = 0.0, times: np.ndarray | None = None) -> Problem:
    """The free decay from ``START``; truth by matrix exponentials, noise (m) from a fixed seed."""

    times = np.linspace(0.0, 10.0, 41) if times is None else times
    start = InitialState(*map(np.array, START[system.n_dof]))
    clean = reference_response(system, p, start, times, ())
    values = clean + noise * np.random.default_rng(4).standard_normal(clean.shape)
    return Problem(system, (Record(tuple(Channel(times, y, dof=i) for i, y in enumerate(values))),))


def fit(problem: Problem, **settings: float) -> Estimate:
    return ERA(**settings).identify(problem, np.random.default_rng(0))


def groups(problem: Problem, **settings: float) -> Normal:
    estimate = fit(problem, **settings)
    assert estimate.groups is not None, estimate.message
    return estimate.groups


CASES = [
    (SDOF(), ONE),
    (SDOF(), {"m": 1.0, "c": 9.0, "k": 9.0}),
    (SDOF(), {"m": 2.0, "c": 1e-6, "k": 5.0}),
    (Chain(2), TWO),
    (Chain(3), THREE),
]


@pytest.mark.parametrize(("system", "p"), CASES, ids=["one", "overdamped", "undamped", "two", "three"])
@pytest.mark.parametrize("settings", [{}, {"bootstrap": 0}, {"rows": 0.3}], ids=["default", "plain", "wide"])
def test_exact_samples_give_the_groups_exactly(system: System, p: dict[str, float], settings: dict[str, float]) -> None:
    problem = record(system, p, times=np.linspace(0.0, 4.0, 41) if p.get("c") == 9.0 else None)
    computed = groups(problem, **settings).mean
    np.testing.assert_allclose(computed, [group.value(p) for group in system.groups], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(("system", "p"), [(SDOF(), ONE), (Chain(2), TWO)], ids=["one", "two"])
def test_realised_poles_and_rows_are_those_of_the_matrices(system: System, p: dict[str, float]) -> None:
    values = np.stack([c.values for c in record(system, p).records[0].channels])
    z, shapes = realise(values[None], 20, 2 * system.n_dof)
    a, _ = state_matrix(system, p)
    np.testing.assert_allclose(np.sort_complex(np.log(z[0]) / 0.25), np.sort_complex(np.linalg.eigvals(a)), rtol=1e-8)
    np.testing.assert_allclose(state_rows(z, shapes, 0.25)[0], a[system.n_dof :], rtol=1e-6, atol=1e-8)


def test_on_one_mass_it_agrees_with_the_matrix_pencil_within_noise() -> None:
    for seed in range(5):
        times = np.linspace(0.0, 10.0, 25)
        y = closed_form(ONE, 0.8, 0.5, times) + 0.02 * np.random.default_rng(seed).standard_normal(25)
        problem = Problem(SDOF(), (Record((Channel(times, y),)),))
        mine, other = groups(problem), MatrixPencil().identify(problem, np.random.default_rng(0)).groups
        assert np.all(np.abs(mine.mean - other.mean) < 0.7 * np.sqrt(np.diag(other.covariance)))
        assert mine.dof == other.dof


def test_its_own_response_goes_on_after_the_record() -> None:
    estimate = fit(record(Chain(2), TWO))
    times = np.linspace(0.0, 20.0, 77)

    expected = reference_response(Chain(2), TWO, InitialState(*map(np.array, START[2])), times, ())
    curve = pickle.loads(pickle.dumps(estimate.reconstructions[0]))
    np.testing.assert_allclose(curve(times), expected, atol=1e-7)


def test_two_masses_come_near_the_bound_and_the_covariance_is_the_spread() -> None:
    """Root mean square error over the bound of the unknown start at 30 dB, 40 replicates, each group."""
    scenario = Scenario("chain", TWO, START[2], 30.0, initial_state="unknown", samples=40, options={"n": 2})
    bound = compute_bound(scenario).relative_sd
    fits = [groups(problem) for problem, _ in scenario.replicates(5, 40)]
    truth = np.array([group.value(TWO) for group in Chain(2).groups])
    errors = np.array([computed.mean for computed in fits]) / truth - 1
    excess = np.sqrt(np.mean(errors**2, axis=0)) / [bound[group.name] for group in Chain(2).groups]
    assert np.all(excess > 0.7), excess
    assert np.all(excess < 1.8), excess
    known = np.median(
        [np.sqrt(np.diag(computed.covariance)) for computed in fits if computed.covariance is not None], axis=0
    )
    np.testing.assert_allclose(known / truth, np.sqrt(np.mean(errors**2, axis=0)), rtol=0.4)


def test_weights_pay() -> None:
    """The equations of two masses are known with very different errors: unweighted they lose."""
    scenario = Scenario("chain", TWO, START[2], 30.0, initial_state="unknown", samples=40, options={"n": 2})
    truth = np.array([group.value(TWO) for group in Chain(2).groups])
    problems = [problem for problem, _ in scenario.replicates(6, 30)]
    error = {n: np.array([groups(p, bootstrap=n).mean / truth - 1 for p in problems]) for n in (0, 200)}
    plain, weighted = (np.sqrt(np.mean(error[n] ** 2, axis=0)) for n in (0, 200))
    assert np.prod(weighted / plain) < 0.8
