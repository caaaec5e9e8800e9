"""Starts by equation error, on motion whose parameters are known from elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench import Channel, Force, InitialState, OutputError, Prior, Problem, Record, System, simulate
from bench.systems import SDOF, BoucWen, Chain, Coulomb, Duffing, Pendulum, VanDerPol
from methods.starts.candidates import Stepped, as_fine_as_noise, candidates
from methods.starts.equation_error import regression_starts
from methods.starts.integration import integrated_readings, radians_a_step

TIMES = np.linspace(0.0, 10.0, 60)


def swing(amplitude: float, noise: float = 0.0) -> Channel:
    """A pendulum of 0.8 m, ``x'' + 0.2 x' + 9.81 sin(x / 0.8) = 0``, by scipy's integrator."""
    computed = solve_ivp(
        lambda _, s: [s[1], -0.2 * s[1] - 9.81 * np.sin(s[0] / 0.8)],
        (0.0, 10.0),
        [amplitude, 0.0],
        t_eval=TIMES,
        rtol=1e-10,
        atol=1e-12,
    ).y[0]
    return Channel(TIMES, computed + noise * np.random.default_rng(0).standard_normal(TIMES.size))


def in_si(problem: Problem) -> list[dict[str, float]]:
    """The starts of a problem, in SI units."""
    units = problem.natural_units()
    scales = units.scales(problem.system)
    computed = regression_starts(problem.expressed_in(units))
    return [{name: value * scales[name] for name, value in p.items()} for p in computed]


@pytest.mark.parametrize("wrong", [None, 0.5, 2.0])
def test_a_pendulum_is_started_near_its_parameters(wrong: float | None) -> None:
    """``k / m = 12.3 1/s²`` within a fifth, l within a factor of two, with no prior or one off by a factor of two.

    Four damped waves give a swing of 1.5 rad with its first harmonics; the prior is as wide as it is wrong.
    """
    true = {"m": 1.0, "c": 0.2, "k": 9.81 / 0.8, "l": 0.8}
    prior = Prior({n: v * (wrong or 1.0) for n, v in true.items()}, dict.fromkeys(true, 0.7)) if wrong else None
    record = Record((swing(1.2),), (), InitialState([1.2], [0.0]))
    starts = in_si(Problem(Pendulum(), (record,), prior))
    best = min(starts, key=lambda p: abs(p["k"] / p["m"] / true["k"] - 1.0))
    assert best["k"] / best["m"] == pytest.approx(true["k"], rel=0.2)
    assert 0.4 < best["l"] < 1.6


def test_the_nonlinear_regression_gives_what_the_linear_one_gives() -> None:
    """On a system that both can take, told that it is not affine; the curves are the same, and so is the mass."""

    class Curved(SDOF):
        affine_in_parameters = False

    times = np.linspace(0.0, 8.0, 80)
    values = np.exp(-0.1 * times) * np.cos(3.0 * times)
    problems = [Problem(system, (Record((Channel(times, values),)),)) for system in (SDOF(), Curved())]
    affine, curved = (regression_starts(p.expressed_in(p.natural_units()))[0] for p in problems)
    assert curved == pytest.approx(affine, rel=1e-4)


def test_hidden_states_and_unmeasured_masses_have_no_start() -> None:
    channel = Channel(TIMES, np.cos(TIMES))
    assert regression_starts(Problem(BoucWen(), (Record((channel,)),))) == []
    assert regression_starts(Problem(Chain(2), (Record((channel,)),))) == []


@pytest.mark.slow
def test_starts_searched_together_end_where_each_ends_alone() -> None:
    """Duffing under a force; each start has its own noise and damping, whoever is beside it."""
    force = Force(TIMES, np.cos(2.0 * TIMES), "cubic")
    problem = Problem(Duffing(), (Record((swing(1.0, 0.05),), (force,), InitialState([1.0], [0.0])),))
    model = Stepped(problem.expressed_in(problem.natural_units()))
    thetas = np.stack([model.vector(p) for p in candidates(model, 3)])
    together = model.settle(thetas, rounds=1, iterations=6)
    for start, end in zip(thetas, together, strict=True):
        alone = model.settle(start[None], rounds=1, iterations=6)[0]
        assert np.allclose(alone, end, atol=0.02)  # steps are as fine as the fastest of them needs


def test_a_search_ends_at_the_least_squares_solution() -> None:
    """A model that is linear in its start: from rest a straight line fitted by ``numpy.polyfit``."""
    times = np.linspace(0.0, 1.0, 20)
    values = 0.3 + 0.5 * times + 0.1 * np.random.default_rng(3).standard_normal(20)
    system, given = SDOF(), Record((Channel(times, values),))
    prior = Prior({"m": 1.0, "c": 1e-9, "k": 1e-9}, dict.fromkeys("mck", 1e-6))  # nothing pulls: a straight line
    model = OutputError(Problem(system, (given,), prior))
    theta = np.concatenate([prior.log_mean, [0.0, 0.0]])
    reached, _ = model.search(model.point(theta[None]), np.array([[0.1]]), 20)
    slope, level = np.polyfit(times, values, 1)
    assert reached.theta[0, 3:] == pytest.approx([level, slope], rel=1e-5)


def test_steps_keep_the_error_that_they_are_asked_for() -> None:
    """Undamped Duffing with a spring that hardens little: the error of the record is near what the law allows."""
    p = {"m": np.array(1.0), "c": np.array(1e-12), "k": np.array(1.0), "k3": np.array(1e-9)}
    times = np.linspace(0.0, 40.0, 81)
    record = Record((Channel(times, np.zeros(81)),), (), InitialState([1.0], [0.0]))
    for allowed in (1e-3, 1e-5):
        computed = integrated_readings(Duffing(), p, record.initial_state, record, radians_a_step(allowed, 40.0))
        assert 0.05 * allowed < float(np.max(np.abs(computed - np.cos(times)))) < 1.5 * allowed


@pytest.mark.parametrize("system", [Coulomb(), VanDerPol(), Duffing()])
def test_an_answer_is_integrated_as_finely_as_the_noise_asks_for(system: System) -> None:
    """Against :func:`bench.dynamics.simulate`: off by at most a tenth of the standard error of 60 samples at 40 dB."""
    p = {"m": 1.0, "c": 0.2, "k": 9.0} | {name: 0.5 for name in system.names[3:]}
    start = InitialState([1.0], [0.0])
    clean = simulate(system, p, start, TIMES).displacement[0]
    sigma = 0.01 * float(np.sqrt(np.mean(clean**2)))
    values = clean + sigma * np.random.default_rng(2).standard_normal(TIMES.size)
    model = OutputError(
        Problem(system, (Record((Channel(TIMES, values),), (), start),), Prior(p, dict.fromkeys(p, 0.1)))
    )
    theta = np.log([p[name] for name in system.names])
    error = as_fine_as_noise(model, theta).predict(theta) - clean
    assert float(np.max(np.abs(error))) < 0.1 * sigma / np.sqrt(TIMES.size)


def test_a_sensors_offset_does_not_bend_a_forced_start() -> None:
    """The same data, two metres up, with an offset to estimate: the spline's start is the same."""
    force = Force(TIMES, 5.0 * np.cos(2.0 * TIMES), "cubic")
    start = InitialState([0.0], [0.0])
    x = simulate(Duffing(), {"m": 1.0, "c": 0.4, "k": 9.0, "k3": 2.0}, start, TIMES, (force,)).displacement[0]
    x = x - np.mean(x)
    channels = [Channel(TIMES, x), Channel(TIMES, x + 2.0, offset=True)]
    plain, lifted = (in_si(Problem(Duffing(), (Record((c,), (force,), start),)))[2] for c in channels)
    assert lifted == pytest.approx(plain, rel=1e-6)
