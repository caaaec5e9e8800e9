"""Data of another system than the fitted one, against what mechanics says of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipk

from bench.errors import InputError
from bench.scenario.disturbance import Disturbance
from bench.scenario.force import ForceSpec
from bench.scenario.model_error import FREQUENCY_RATIO, AddedFriction, CubicSpring, SecondMode
from bench.scenario.scenario import Scenario
from bench.systems import make_system

SDOF = make_system("sdof", {})


def motion(scenario: Scenario, kind: Disturbance, times: np.ndarray, c: float = 1e-9) -> np.ndarray:
    p = {**scenario.parameters, "c": c}
    return kind.response(SDOF, p, scenario.start, times, ())[0]


def test_friction_takes_four_times_its_size_in_each_period(reference: Scenario) -> None:
    """Amplitude falls by 4 F/k a period under dry friction F alone (Inman, Engineering Vibration, section 1.10)."""
    period = 2 * np.pi * np.sqrt(1.0 / 8.0)
    peaks = motion(reference, AddedFriction(0.03), period * np.array([0.0, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(peaks, 1 - 0.12 * np.arange(4), atol=5e-3)


def test_a_cubic_spring_swings_faster_by_the_elliptic_integral(reference: Scenario) -> None:
    """The undamped period of ``x'' + w² x (1 + s x²) = 0`` from 1: ``4 K(mu) / (w sqrt(1 + s))``, mu = s/(2 (1 + s)).

    Nayfeh and Mook, Nonlinear Oscillations, section 2.1; scipy's parameter is mu.
    """
    s = 0.5
    period = 4 * ellipk(s / (2 * (1 + s))) / np.sqrt(8 * (1 + s))
    after = motion(reference, CubicSpring(s), np.array([0.0, period / 2, period]))
    np.testing.assert_allclose(after, [1.0, -1.0, 1.0], atol=1e-6)


def test_a_second_mode_is_a_second_cosine(reference: Scenario) -> None:
    times, w = np.linspace(0, 5, 50), np.sqrt(8.0)
    expected = np.cos(w * times) + 0.2 * np.cos(FREQUENCY_RATIO * w * times)
    np.testing.assert_allclose(motion(reference, SecondMode(0.2), times), expected, atol=1e-7)


@pytest.mark.parametrize("kind", [AddedFriction(0.02), CubicSpring(0.2), SecondMode(0.1)])
def test_the_true_start_is_where_the_motion_starts(reference: Scenario, kind: Disturbance) -> None:
    _, truth = replace(reference, disturbance=kind).replicates(0, 1)[0]
    assert truth.dense_displacement[0, 0] == pytest.approx(truth.initial_state.displacement[0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"system": "duffing", "parameters": {"m": 1.0, "c": 0.4, "k": 8.0, "k3": 1.0}}, "one mass"),
        ({"force": ForceSpec(1.0, 0.1, 1.0)}, "free vibration"),
    ],
)
def test_a_system_that_it_does_not_go_with_is_refused(reference: Scenario, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        replace(reference, disturbance=CubicSpring(0.2), **changes)
