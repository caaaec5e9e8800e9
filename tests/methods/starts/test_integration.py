"""The quick integration of starts against scipy's at tight tolerance."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench import Channel, Force, InitialState, Record
from bench.systems import Duffing, Pendulum
from methods.starts.integration import fastest_rate, integrated_readings

DUFFING = {"m": 1.2, "c": 0.3, "k": 9.0, "k3": 4.0}


def _record(*channels: Channel, force: Force | None = None) -> Record:
    return Record(channels, (force,) if force else ())


def test_forced_duffing_at_every_kind_of_sensor():
    """``x'' = (f - c x' - k x - k3 x³) / m``, by an eighth-order method."""
    times = np.linspace(0.0, 8.0, 33)
    force = Force(np.linspace(0, 8, 41), np.sin(np.linspace(0, 8, 41)) * 3, "linear")
    channels = [Channel(times, times * 0, kind) for kind in ("displacement", "velocity", "acceleration")]
    p = {name: np.array([value, 1.1 * value]) for name, value in DUFFING.items()}
    computed = integrated_readings(Duffing(), p, InitialState([0.7], [0.2]), _record(*channels, force=force))
    for i in range(2):
        q = {name: value[i] for name, value in p.items()}

        def rate(t, s, q=q):
            return [s[1], (float(force(np.array(t))) - q["c"] * s[1] - q["k"] * s[0] - q["k3"] * s[0] ** 3) / q["m"]]

        exact = solve_ivp(rate, (0, 8), [0.7, 0.2], "DOP853", times, rtol=1e-10, atol=1e-12, max_step=0.05).y
        accelerations = [rate(t, s)[1] for t, s in zip(times, exact.T, strict=True)]
        np.testing.assert_allclose(computed[i], np.concatenate([*exact, accelerations]), atol=2e-3)


def test_the_fastest_rate_of_a_pendulum_is_that_of_small_swings():
    """``sqrt(k/m)`` at rest, slower at 1 rad: the larger is at rest. No damping to speak of."""
    rate = fastest_rate(Pendulum(), {"m": 2.0, "c": 1e-9, "k": 18.0, "l": 1.0}, InitialState([1.0], [0.0]))
    assert rate == pytest.approx(3.0, rel=1e-5)
