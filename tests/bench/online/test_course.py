"""Courses of parameters, and the motion that follows them, against sources of their own."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench.errors import InputError
from bench.online.course import Course
from bench.online.forces import HeldForce
from bench.online.scenario import OnlineScenario

SDOF = {"m": 1.3, "c": 0.6, "k": 25.0}


def scenario(**changes) -> OnlineScenario:
    stated = {
        "label": "x",
        "system": "sdof",
        "parameters": SDOF,
        "rate": 10.0,
        "samples": 120,
        "forces": (HeldForce(),),
    }
    return OnlineScenario(**(stated | changes))


def test_a_step_moves_at_its_instant_and_nowhere_else() -> None:
    course = Course("step", change=-0.3, at=0.5)
    factors = course.factors(101, np.random.default_rng(0))
    assert factors[49] == 1.0
    assert factors[50] == pytest.approx(0.7)
    moved = course.increment_variances(101)
    assert np.flatnonzero(moved).tolist() == [49]
    assert moved[49] == pytest.approx(np.log(0.7) ** 2)


def test_a_random_walk_has_its_spread_over_the_record() -> None:
    ends = [Course("random_walk", spread=0.2).factors(400, np.random.default_rng(i))[-1] for i in range(2000)]
    assert np.std(np.log(ends)) == pytest.approx(0.2, rel=0.06)


@pytest.mark.parametrize("kind", ["multisine", "white", "coloured"])
def test_the_amplitude_of_a_force_is_its_root_mean_square(kind) -> None:
    drawn = HeldForce(kind, amplitude=3.0).draw(np.arange(200_000) / 10.0, np.random.default_rng(0))
    assert np.sqrt(np.mean(drawn**2)) == pytest.approx(3.0, rel=0.03)


def test_the_motion_obeys_the_equation_with_the_parameters_of_each_interval() -> None:
    varying = {"k": Course("ramp", change=-0.5, at=0.2, until=0.9), "c": Course("step", change=1.0)}
    made = scenario(varying=varying)
    stream = made.stream(0, 0)
    p, state = stream.truth.parameters, np.zeros(2)
    for i in range(made.samples - 1):
        m, c, k, f = p["m"][i], p["c"][i], p["k"][i], stream.truth.known[i, 0]
        found = solve_ivp(lambda _, s: [s[1], (f - c * s[1] - k * s[0]) / m], (0, 0.1), state, rtol=1e-10, atol=1e-13)  # noqa: B023
        state = found.y[:, -1]
        assert stream.truth.motion[i + 1] == pytest.approx(state, abs=1e-7)


def test_the_noise_has_the_level_that_is_asked_for() -> None:
    stream = scenario(samples=5000, snr_db=12.0).stream(0, 0)
    noise = stream.values - stream.truth.clean
    snr = 10 * np.log10(np.mean(stream.truth.clean**2) / np.mean(noise**2))
    assert snr == pytest.approx(12.0, abs=0.3)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"varying": {"q": Course("step")}}, "system.varying.q"),
        ({"forces": ()}, "online.forces"),
        ({"parameters": {"m": 1.0}}, "system.parameters"),
    ],
)
def test_what_makes_no_sense_is_said_by_its_field(changes, said) -> None:
    with pytest.raises(InputError, match=said):
        scenario(**changes)
