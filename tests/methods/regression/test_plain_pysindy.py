"""pysindy as it ships, against what central differences do to a damped sine."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Status
from bench.scenario.scenario import ForceSpec, Scenario
from methods.regression.plain_pysindy import PlainPySINDy

pytest.importorskip("pysindy")

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table


def estimated(samples: int, system: str = "sdof", parameters: dict[str, float] = PLANT, **changes: object):
    scenario = Scenario(system, parameters, ((0.9,), (0.4,)), 140.0, samples=samples, **changes)
    return PlainPySINDy().identify(scenario.replicates(2, 1)[0][0], np.random.default_rng(0))


@pytest.mark.parametrize("samples", [60, 400])
def test_without_noise_it_has_the_bias_of_differentiating_twice(samples: int) -> None:
    """The differences of ``exp(s t)`` are ``d = sinh(s h)/h`` times it: the roots come out as d, of product k/m."""
    groups, h = estimated(samples).groups, 10.0 / (samples - 1)
    root = np.roots([PLANT["m"], PLANT["c"], PLANT["k"]])[0]
    expected = abs(np.sinh(root * h) / h) ** 2, -2.0 * (np.sinh(root * h) / h).real
    np.testing.assert_allclose(groups.mean, expected, rtol=0.02)  # one-sided at the ends of the record
    assert groups.covariance is None


def test_a_known_force_is_its_input_and_gives_the_mass() -> None:
    estimate = estimated(2000, force=ForceSpec(3.0, 0.1, 1.0))
    assert estimate.message.endswith("x, v, f")
    for name, value in estimate.parameters.values().items():
        assert value == pytest.approx(PLANT[name], rel=0.02)


def test_it_takes_a_single_linear_mass_alone() -> None:
    assert estimated(60, "duffing", {**PLANT, "k3": 5.0}).status is Status.UNSUPPORTED
