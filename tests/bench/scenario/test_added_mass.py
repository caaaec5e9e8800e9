"""Two records of a rig, the second with a known mass on it: free vibration then has a scale."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bench import Channel, Estimate, InitialState, InputError, Normal, Problem, Record, Units, measurements, simulate
from bench.contract.method import Card, Identifier, Scope
from bench.entrants.reference import oracle_estimate
from bench.information.fisher import compute_bound
from bench.information.structural import structure_of
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form
from bench.systems import SDOF, BoucWen, Chain, LoadedSystem

P = {"m": 1.2, "c": 0.4, "k": 8.0}
PLAIN = Scenario("sdof", P, ((1.0,), (0.2,)), 20.0, dense=25, forecast=0.5)
TWO = replace(PLAIN, added_mass=(0.5,))
CHAIN = {"m1": 1.1, "m2": 0.7, "c1": 0.3, "c2": 0.2, "k1": 13.0, "k2": 8.0}


def gradient(t: np.ndarray, added: float) -> np.ndarray:
    """Derivatives of the free response by log m, log c, log k, x0, v0 with ``added`` on the mass, by complex steps."""
    theta = np.array([math.log(1.2), math.log(0.4), math.log(8.0), 1.0, 0.2])
    columns = []
    for i in range(5):
        logs_m, logs_c, logs_k, x0, v0 = theta + 1e-30j * (np.arange(5) == i)
        m, c, k = np.exp(logs_m) + added, np.exp(logs_c), np.exp(logs_k)
        a = c / (2 * m)
        wd = np.sqrt(k / m - a * a)
        x = np.exp(-a * t) * (x0 * np.cos(wd * t) + (v0 + a * x0) / wd * np.sin(wd * t))
        columns.append(np.imag(x) / 1e-30)
    return np.stack(columns, axis=1)


def test_the_first_record_is_as_it_is_alone_and_the_second_is_of_the_heavier_mass() -> None:
    problem, truth = TWO.replicates(0, 1)[0]
    (alone, _), (first, second) = PLAIN.replicates(0, 1)[0], problem.records
    np.testing.assert_array_equal(first.channels[0].values, alone.records[0].channels[0].values)
    assert first.added_mass is None
    np.testing.assert_array_equal(second.added_mass, [0.5])
    pairs = TWO.replicates(0, 200)
    clean = closed_form({**P, "m": 1.7}, 1.0, 0.2, TWO.times)
    z = np.array([p.records[1].channels[0].values - clean for p, _ in pairs]) / truth.sigma[1]
    other = np.array([p.records[0].channels[0].values - closed_form(P, 1.0, 0.2, TWO.times) for p, _ in pairs])
    assert np.var(z) == pytest.approx(1.0, abs=5 * math.sqrt(2 / z.size))
    assert abs(np.corrcoef(z.ravel(), other.ravel())[0, 1]) < 5 / math.sqrt(z.size)
    assert truth.sigma[1] == pytest.approx(math.sqrt(np.mean(clean**2) / 100))
    assert problem.scale_known
    assert TWO.data_identity() != PLAIN.data_identity()


@pytest.mark.parametrize("told", ["known", "unknown"])
def test_the_bound_is_that_of_both_closed_forms_together(told: str) -> None:
    """The information of the records adds up over m, c, k; a start that is not told is each record's own."""
    blocks, n = [], 3 if told == "known" else 7
    for record, added in enumerate((0.0, 0.5)):
        g = gradient(TWO.times, added)
        clean = closed_form({**P, "m": 1.2 + added}, 1.0, 0.2, TWO.times)
        rows = np.zeros((TWO.samples, n))
        rows[:, :3] = g[:, :3]
        if told == "unknown":
            rows[:, 3 + 2 * record : 5 + 2 * record] = g[:, 3:]
        blocks.append(rows / math.sqrt(np.mean(clean**2) / 100))
    stacked = np.concatenate(blocks)
    sd = np.sqrt(np.diag(np.linalg.inv(stacked.T @ stacked)))
    bound = compute_bound(replace(TWO, initial_state=told))
    assert [bound.relative_sd[name] for name in "mck"] == pytest.approx(list(sd[:3]), rel=1e-6)
    assert bound.null_space == ()
    assert compute_bound(replace(PLAIN, initial_state=told)).relative_sd["m"] == math.inf


def test_a_perfect_optimiser_finds_mass_damping_and_stiffness_without_a_prior() -> None:
    """Over 30 replicates the mean square standardised error of log m is 1, to five of its standard deviations."""
    scenario = replace(TWO, initial_state="unknown")
    bound = compute_bound(scenario)
    errors = []
    for problem, truth in scenario.replicates(0, 30):
        estimate = oracle_estimate(problem, truth)
        assert isinstance(estimate.parameters, Normal)
        errors.append(math.log(estimate.parameters.values()["m"] / 1.2) / bound.relative_sd["m"])
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=5 * math.sqrt(2 / 30))


def test_a_loaded_system_is_the_system_with_a_larger_mass_hidden_states_and_units_included() -> None:
    p = {"m": 1.4, "c": 0.3, "k": 5.0, "kz": 6.0, "beta": 1.2, "gamma": 0.8}
    start, times = InitialState(np.array([0.9]), np.array([-0.4])), np.linspace(0.0, 5.0, 21)
    heavy = simulate(BoucWen(), {**p, "m": 2.0}, start, times).displacement
    record = Record((Channel(times, np.zeros(21)),), (), start, np.array([0.6]))
    np.testing.assert_allclose(measurements(BoucWen(), p, start, record), heavy[0], atol=1e-8)
    units = Units(2.0, 0.1, 3.0)
    there, scales = Problem(BoucWen(), (record,)).expressed_in(units), units.scales(BoucWen())
    own = there.records[0].initial_state
    assert own is not None
    scaled = measurements(there.system, {k: v / scales[k] for k, v in p.items()}, own, there.records[0])
    np.testing.assert_allclose(0.1 * scaled, heavy[0], atol=1e-7)
    loaded, state = LoadedSystem(Chain(2), (0.0, 0.4)), InitialState(np.array([0.5, -0.2]), np.zeros(2))
    expected = simulate(Chain(2), {**CHAIN, "m2": 1.1}, state, times).displacement
    np.testing.assert_allclose(simulate(loaded, CHAIN, state, times).displacement, expected, atol=1e-12)


class Naive(Identifier):
    """A method that takes several records, and knows nothing of added masses."""

    card = Card("", "not used", "native", "simulated", "", "")
    scope = Scope(several_records=True)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        raise AssertionError("it is never asked")


def test_a_method_that_does_not_know_of_added_masses_objects() -> None:
    problem, _ = TWO.replicates(0, 1)[0]
    assert Naive().objection(problem) == "it cannot use a known added mass"
    assert Naive().objection(Problem(SDOF(), (problem.records[0],) * 2)) is None


def test_what_cannot_be_said_of_two_records_is_not_said() -> None:
    with pytest.raises(InputError, match="one record"):
        structure_of(TWO)
    settings: dict[str, Any] = {"added_mass": np.array([0.1, 0.2])}
    with pytest.raises(InputError, match="one mass per DOF"):
        Problem(SDOF(), (Record((Channel([0.0, 1.0, 2.0], [0.0, 1.0, 0.0]),), **settings),))
