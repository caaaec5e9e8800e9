"""Model classes and the smoothing velocity."""

from __future__ import annotations

import numpy as np
import pytest

from bench.records.models import FRACTION, ClassComparison, ModelClass, smoothing_velocity, without
from bench.systems.sums import sum_from

T = np.linspace(0.0, 8.0, 300)
OMEGA = 2 * np.pi
RMS = OMEGA / np.sqrt(2.0)
"""The root mean square speed of ``sin(OMEGA t)``."""


def test_the_smoothing_velocity_is_a_fraction_of_the_speed() -> None:
    assert smoothing_velocity(T, np.sin(OMEGA * T)) == pytest.approx(FRACTION * RMS, rel=0.01)


def test_oversampling_does_not_increase_the_effect_of_noise() -> None:
    times = np.linspace(0.0, 8.0, 20_000)
    noisy = np.sin(OMEGA * times) + 0.1 * np.random.default_rng(1).standard_normal(times.size)
    assert smoothing_velocity(times, noisy) == pytest.approx(FRACTION * RMS, rel=0.05)


@pytest.mark.parametrize(
    ("measures", "values"), [("velocity", OMEGA * np.cos(OMEGA * T)), ("acceleration", -(OMEGA**2) * np.sin(OMEGA * T))]
)
def test_sensors_of_other_kinds_give_the_same(measures: str, values: np.ndarray) -> None:
    assert smoothing_velocity(T, values + 9.81, measures) == pytest.approx(FRACTION * RMS, rel=0.02)


def test_terms_of_a_sum_are_removed_but_never_all() -> None:
    assert without(sum_from("sdof+coulomb+quadratic"), {"mu"}).terms == ("viscous", "spring", "quadratic")
    assert without(sum_from("viscous"), {"c"}).terms == ("viscous",)


def test_tied_classes_are_weighted_by_their_scores() -> None:
    """Scores that differ by 2 ln 3 give weights of 3 to 1; a distinguishable class has no weight."""

    def model(text: str, c: float, score: float, told_apart: bool = False) -> ModelClass:
        system = sum_from(text)
        parameters = {name: {"k": 9.0, "c": c}.get(name, 0.1) for name in system.names if name != "m"}
        return ModelClass(text, system, parameters, (1.0, 0.0), 0.0, 0.0, score, 0.1, {}, told_apart)

    other = model("sdof+coulomb", 0.2, 2 * np.log(3.0))
    classes = ClassComparison([model("sdof", 0.3, 0.0), other, model("sdof+quadratic", 0.5, 40.0, True)])
    assert classes.tied == [other]
    assert classes.variance("c_over_m") == pytest.approx(0.25 * np.log(1.5) ** 2)
    assert classes.variance("mu_over_m") == 0.0


@pytest.mark.parametrize("values", [np.zeros(9), np.full(9, 2.5), np.full(9, 0.1), np.array([1.0, 0.0, -1.0])])
def test_it_is_never_zero(values: np.ndarray) -> None:
    assert 1e-4 < smoothing_velocity(np.linspace(0.0, 1.0, values.size), values) < 1.0


def test_the_energy_lost_by_smoothing_is_as_stated() -> None:
    """For a sine of the speed, by the midpoint rule, it is ``(π²/24) (v_s/V)²`` of that of Coulomb friction."""
    v = np.sin(2 * np.pi * (np.arange(400_000) + 0.5) / 400_000)
    short = 1.0 - np.sum(v * np.tanh(v / 0.01)) / np.sum(np.abs(v))
    assert short == pytest.approx(np.pi**2 / 24 * 0.01**2, rel=0.01)
