"""What a method is given: validated once, read-only, copied, and the same in every system of units."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bench import Channel, Force, InitialState, InputError, Prior, Problem, Record, Units
from bench.systems import SDOF, Chain, Dimension, Duffing

T = np.array([0.0, 0.5, 1.5, 2.0, 3.5])
X = np.array([1.0, -0.5, 0.2, 0.1, -0.3])
NAN, INF = float("nan"), float("inf")
FINE = {"nominal": {"m": 1.0, "c": 0.5, "k": 9.0}, "log_sd": {"m": 0.02, "c": 1.0, "k": 0.5}}


def one_record(*channels: Channel, **more: Any) -> Record:
    return Record(channels or (Channel(T, X),), **more)


def sdof(record: Record, prior: Prior | None = None) -> Problem:
    return Problem(SDOF(), (record,), prior)


def start(n: int) -> InitialState:
    return InitialState(np.zeros(n), np.zeros(n))


BAD: dict[str, tuple[Callable[[], object], str]] = {
    "NaN in the values": (lambda: Channel(T, [1, 2, NAN, 4, 5]), "value number 3"),
    "infinite value": (lambda: Channel(T, [1, 2, 3, 4, INF]), "value number 5"),
    "NaN in the times": (lambda: Channel([0, NAN, 2], [1, 2, 3]), "times=nan"),
    "unsorted times": (lambda: Channel([0.0, 2.0, 1.0], [1, 2, 3]), "increase (at sample 3)"),
    "the same time twice": (lambda: Channel([0.0, 1.0, 1.0], [1, 2, 3]), "increase"),
    "a negative time": (lambda: Channel([-1.0, 0.0, 1.0], [1, 2, 3]), "0 or later"),
    "fewer values than times": (lambda: Channel(T, X[:4]), "as many values as times"),
    "a table of values": (lambda: Channel(T, X[None]), "one dimension"),
    "a word": (lambda: Channel(T, ["a"] * 5), "numbers are needed"),
    "unknown sensor": (lambda: Channel(T, X, measures="strain"), "displacement, velocity, acceleration"),
    "two samples": (lambda: Record((Channel(T[:2], X[:2]),)), "at least 3"),
    "no channel": (lambda: Record(()), "at least 3"),
    "unknown hold": (lambda: Force(T, X, "quintic"), "zero_order, linear"),
    "force of one sample": (lambda: Force([0.0], [1.0]), "at least two"),
    "force of unequal sizes": (lambda: Force(T, X[:4]), "one per time"),
    "NaN in the force": (lambda: Force(T, [0, 0, 0, 0, NAN]), "force.values"),
    "unsorted force": (lambda: Force([0, 2, 1, 3, 4], X), "force.times"),
    "NaN in the start": (lambda: InitialState(np.array([NAN]), np.zeros(1)), "initial displacement"),
    "no record": (lambda: Problem(SDOF(), ()), "at least one record"),
    "sensor on a DOF that is not there": (lambda: sdof(one_record(Channel(T, X, dof=1))), "DOFs 0 to 0"),
    "sensor on DOF -1": (lambda: sdof(one_record(Channel(T, X, dof=-1))), "DOFs 0 to 0"),
    "force on a DOF that is not there": (lambda: sdof(one_record(forces=(Force(T, X, dof=2),))), "dof=2"),
    "start of another size": (lambda: sdof(one_record(initial_state=start(2))), "initial_state"),
    "velocity of another size": (
        lambda: sdof(one_record(initial_state=InitialState(np.zeros(1), np.zeros(2)))),
        "initial_state",
    ),
    "prior of another system": (lambda: Problem(Duffing(), (one_record(),), Prior(**FINE)), "m, c, k, k3"),
    "negative nominal value": (lambda: Prior({**FINE["nominal"], "c": -0.5}, FINE["log_sd"]), "prior.nominal.c"),
    "NaN nominal value": (lambda: Prior({**FINE["nominal"], "c": NAN}, FINE["log_sd"]), "prior.nominal.c"),
    "prior without width": (lambda: Prior(FINE["nominal"], {**FINE["log_sd"], "k": 0.0}), "prior.log_sd.k"),
    "width of another parameter": (lambda: Prior(FINE["nominal"], {"m": 0.02, "c": 1.0, "q": 0.5}), "prior.log_sd"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_one_line_with_the_field_and_the_remedy(what: str) -> None:
    make, part = BAD[what]
    with pytest.raises(InputError) as caught:
        make()
    assert part in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_input_error_survives_the_way_between_processes() -> None:
    import pickle

    error = pickle.loads(pickle.dumps(InputError("field", 3, "two\nlines")))
    assert (error.field, error.value, str(error)) == ("field", 3, "field=3: two lines")


def test_inputs_are_copied_and_read_only() -> None:
    times, values, push, x0 = T.copy(), X.copy(), X.copy(), np.array([0.4])
    nominal, log_sd = dict(FINE["nominal"]), dict(FINE["log_sd"])
    record = Record([Channel(times, values)], [Force(times, push)], InitialState(x0, x0))
    problem = Problem(SDOF(), [record], Prior(nominal, log_sd))
    for array in (times, values, push, x0):
        array[:] = 99.0
    nominal["m"] = log_sd["m"] = 99.0
    inside = problem.records[0]
    np.testing.assert_array_equal(inside.channels[0].times, T)
    np.testing.assert_array_equal(inside.channels[0].values, X)
    np.testing.assert_array_equal(inside.forces[0].values, X)
    assert inside.initial_state.displacement[0] == 0.4
    assert (problem.prior.nominal["m"], problem.prior.log_sd["m"]) == (1.0, 0.02)
    channel, force = inside.channels[0], inside.forces[0]
    for array in (channel.times, channel.values, force.times, force.values, inside.initial_state.velocity):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    assert isinstance(problem.records, tuple)
    assert isinstance(inside.channels, tuple)


def test_the_force_between_and_outside_its_samples() -> None:
    held, joined = Force([1.0, 2.0, 4.0], [1.0, 3.0, 5.0], "zero_order"), Force([1.0, 2.0, 4.0], [1.0, 3.0, 5.0])
    at = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 4.5])
    np.testing.assert_array_equal(held(at), [0.0, 1.0, 1.0, 3.0, 3.0, 5.0, 0.0])
    np.testing.assert_array_equal(joined(at), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 0.0])
    total = Record((Channel(T, X),), (Force([0.0, 4.0], [1.0, 1.0], dof=1), Force(T, X, dof=1))).force(T, 2)
    np.testing.assert_array_equal(total[0], 0.0)
    np.testing.assert_allclose(total[1], 1.0 + X)


def test_what_a_problem_says_of_itself() -> None:
    quiet = one_record(forces=(Force(T, np.zeros(5)),))
    pushed = Record((Channel(T, X), Channel(T[:3], X[:3])), (Force(T, X),), start(1))
    assert (sdof(quiet).forced, sdof(pushed).forced) == (False, True)
    assert (sdof(quiet).start_known, sdof(pushed).start_known) == (False, True)
    both = Problem(SDOF(), (quiet, pushed))
    assert (both.n, both.start_known, both.forced) == (13, False, True)
    assert pushed.duration == 3.5


def a_chain_problem(prior: bool, force: bool) -> Problem:
    """Displacement, velocity and acceleration, a force, a start, a prior: everything that has units."""
    channels = (Channel(T, X), Channel(T, 3 * X, "velocity", dof=1), Channel(T[1:], X[1:], "acceleration"))
    names = Chain(2).names
    told = Prior({n: 0.5 + i for i, n in enumerate(names)}, dict.fromkeys(names, 0.3)) if prior else None
    forces = (Force(T, X, "zero_order", dof=1),) if force else ()
    return Problem(Chain(2), (Record(channels, forces, InitialState([0.1, 0.2], [0.3, 0.4])),), told)


def numbers(problem: Problem) -> np.ndarray:
    """Everything in a problem that has a unit, in one array."""
    parts: list[Any] = []
    for record in problem.records:
        for item in (*record.channels, *record.forces):
            parts += [item.times, item.values]
        if record.initial_state is not None:
            parts += [record.initial_state.displacement, record.initial_state.velocity]
    if problem.prior is not None:
        parts += [problem.prior.log_mean, problem.prior.log_sds]
    return np.concatenate(parts)


UNITS = [Units(*10.0 ** np.random.default_rng(i).uniform(-4, 4, 3)) for i in range(6)]


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("prior", [True, False], ids=["prior", "no prior"])
@pytest.mark.parametrize("force", [True, False], ids=["forced", "free"])
def test_other_units_and_back_is_the_same_problem(units: Units, prior: bool, force: bool) -> None:
    problem = a_chain_problem(prior, force)
    there = problem.expressed_in(units)
    assert np.max(np.abs(numbers(there) - numbers(problem))) > 0.1
    np.testing.assert_allclose(numbers(there.expressed_in(units.inverse)), numbers(problem), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("prior", [True, False], ids=["prior", "no prior"])
@pytest.mark.parametrize("force", [True, False], ids=["forced", "free"])
def test_natural_units_do_not_depend_on_the_units_a_problem_came_in(units: Units, prior: bool, force: bool) -> None:
    problem = a_chain_problem(prior, force)
    other = problem.expressed_in(units)
    one, two = problem.expressed_in(problem.natural_units()), other.expressed_in(other.natural_units())
    np.testing.assert_allclose(numbers(two), numbers(one), rtol=1e-9, atol=1e-9)


def test_one_unit_by_hand_grams_millimetres_milliseconds() -> None:
    """1 N/m = 1 kg/s² is 1e3 g over (1e3 ms)² = 1e-3 g/ms²; 2 m/s is 2 mm/ms; 3 N is 3e3 g·1e3 mm/(1e6 ms²) = 3."""
    units = Units(1e-3, 1e-3, 1e-3)
    assert units.scales(SDOF()) == pytest.approx({"m": 1e-3, "c": 1.0, "k": 1e3})
    assert units.of(Dimension(1, 1, -2)) == pytest.approx(1.0)
    record = one_record(forces=(Force(T, X),), initial_state=InitialState(np.array([1.0]), np.array([2.0])))
    there = sdof(record).expressed_in(units).records[0]
    np.testing.assert_allclose(there.channels[0].values, 1e3 * X)
    np.testing.assert_allclose(there.channels[0].times, 1e3 * T)
    np.testing.assert_allclose(there.forces[0].values, X)
    assert there.initial_state.displacement[0] == pytest.approx(1e3)
    assert there.initial_state.velocity[0] == pytest.approx(2.0)


def test_the_priors_penalty_is_that_of_independent_log_normals() -> None:
    prior = Prior(**FINE)
    distance = prior.residuals(np.log([1.0 * np.exp(0.02), 0.5 * np.exp(-2.0), 9.0]))
    np.testing.assert_allclose(distance, [1.0, -2.0, 0.0], atol=1e-12)
