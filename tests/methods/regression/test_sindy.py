"""SINDy: the terms it finds in exact data, its projection onto the system, its twin in the bootstrap."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad

from bench import Channel, Force, Problem, Record, Status
from bench.scenario.scenario import ForceSpec, Scenario
from bench.systems import SDOF
from methods.regression.derivatives import Motion
from methods.regression.sindy import SINDy, greedy
from methods.regression.weak import WeightFunctions, weak_rows

pysindy = pytest.importorskip("pysindy")

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def dense(system: str, parameters: dict[str, float], **changes: object) -> Problem:
    """400 samples over 10 s, nearly without noise."""
    scenario = Scenario(system, parameters, ((0.9,), (0.4,)), 140.0, samples=400, **changes)
    return scenario.replicates(2, 1)[0][0]


def test_it_finds_the_terms_of_a_linear_oscillator() -> None:
    estimate = SINDy(bootstrap=8).identify(dense("sdof", PLANT), rng())
    assert estimate.message == "terms kept of 9: x, v"
    np.testing.assert_allclose(estimate.groups.mean, [9.0 / 1.3, 0.6 / 1.3], rtol=1e-4)
    np.testing.assert_allclose(estimate.traces["coefficients"][0, :2], [-9.0 / 1.3, -0.6 / 1.3], rtol=1e-4)


def test_it_finds_the_cubic_of_a_hardening_spring() -> None:
    p = {"m": 1.2, "c": 0.3, "k": 5.0, "k3": 6.0}
    estimate = SINDy(bootstrap=8).identify(dense("duffing", p), rng())
    assert estimate.message == "terms kept of 9: x, v, x^3"
    np.testing.assert_allclose(estimate.groups.mean, [5.0 / 1.2, 0.3 / 1.2, 6.0 / 1.2], rtol=1e-3)


def test_it_finds_a_known_force_and_with_it_the_mass() -> None:
    problem = dense("sdof", PLANT, force=ForceSpec(3.0, 0.1, 1.0))
    estimate = SINDy(bootstrap=8).identify(problem, rng())
    assert estimate.message == "terms kept of 10: x, v, f"
    for name, value in estimate.parameters.values().items():
        assert value == pytest.approx(PLANT[name], rel=0.01)


def test_the_bootstrap_chooses_terms_as_pysindy_does() -> None:
    draw = np.random.default_rng(8)
    features = draw.standard_normal((5, 30, 9)) * np.geomspace(0.1, 30.0, 9)
    target = features[..., 0] - 0.3 * features[..., 4] + 0.5 * draw.standard_normal((5, 30))
    models = greedy(features, target, 6)
    for i in range(5):
        norms = np.linalg.norm(features[i], axis=0)
        oracle = pysindy.FROLS(alpha=0.0, max_iter=6, unbias=False).fit(features[i] / norms, target[i][:, None])
        expected = np.stack(oracle.history_[1:7])[:, 0] / norms
        np.testing.assert_allclose(models[i], expected, rtol=1e-6, atol=1e-9)


def test_terms_that_others_give_are_not_taken() -> None:
    """Three different terms, one of them twice and in a sum, and one that is zero: a fourth says nothing new."""
    draw = np.random.default_rng(3)
    computed = draw.standard_normal((4, 20, 3))
    features = np.concatenate(
        [computed, computed[..., :1], computed.sum(-1, keepdims=True), np.zeros((4, 20, 1))], axis=2
    )
    target = computed @ np.array([1.0, -2.0, 0.5])
    models = greedy(features, target, 5)
    assert np.all(np.count_nonzero(models, axis=2) == [1, 2, 3, 3, 3])
    np.testing.assert_allclose(np.einsum("srk,sk->sr", features, models[:, -1]), target, atol=1e-9)


def test_few_noisy_samples_give_a_covariance_of_the_right_size() -> None:
    scenario = Scenario("sdof", PLANT, ((0.8,), (0.5,)), 20.0)
    fits = [SINDy().identify(p, rng()).groups for p, _ in scenario.replicates(13, 16)]
    means = np.array([fit.mean for fit in fits if fit is not None])
    covariances = [fit.covariance for fit in fits if fit is not None and fit.covariance is not None]
    known = np.median([np.sqrt(np.diag(covariance)) for covariance in covariances], axis=0)
    assert means.shape == (16, 2)
    np.testing.assert_allclose(np.median(means, axis=0), [9.0 / 1.3, 0.6 / 1.3], rtol=0.1)
    np.testing.assert_allclose(known[0], np.std(means[:, 0]), rtol=0.6)


def test_too_few_samples_for_the_library_is_a_sentence() -> None:
    times = np.linspace(0, 2, 7)
    problem = Problem(SDOF(), (Record((Channel(times, np.cos(3 * times)),)),))
    estimate = SINDy().identify(problem, rng())
    assert estimate.status is Status.UNSUPPORTED
    assert "at least" in estimate.message


def test_the_weak_form_finds_the_terms_of_a_hardening_spring() -> None:
    p = {"m": 1.2, "c": 0.3, "k": 5.0, "k3": 6.0}
    estimate = SINDy(bootstrap=8, form="weak").identify(dense("duffing", p), rng())
    assert estimate.message == "terms kept of 9: x, v, x^3"
    np.testing.assert_allclose(estimate.groups.mean, [5.0 / 1.2, 0.3 / 1.2, 6.0 / 1.2], rtol=1e-3)


def test_rows_of_the_weak_form_are_integrals_by_parts() -> None:
    """Of x = sin 2t: ``∫φ'' x = ∫φ x''``, ``-∫φ' x = ∫φ v`` and ``∫φ x³``, by adaptive quadrature."""
    t = np.linspace(0.0, 3 * np.pi, 400, endpoint=False)
    x, v, a = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    motion = Motion(t, *(part[None, None] for part in (x, v, a)))
    features = np.stack([np.zeros_like(t), np.zeros_like(t), x**3], axis=-1)[None]
    rows, target = weak_rows(motion, x[None, None], features, np.array([0, 1]))
    kernels = WeightFunctions.of(t, float(np.pi / t[-1]), share=1.0)  # one period
    half = np.pi / 2
    for i in (0, 20, 59):
        centre = float(kernels.centres[i])

        def integral(of: Callable[[float], float], centre: float = centre) -> float:
            def phi(s: float) -> float:
                return max(0.0, 1.0 - ((s - centre) / half) ** 2) ** 6

            low, high = centre - half, centre + half
            return float(quad(lambda s: phi(s) * of(s), low, high)[0] / quad(phi, low, high)[0])

        assert target[0, 0, i] == pytest.approx(integral(lambda s: -4 * np.sin(2 * s)), abs=1e-4)
        assert rows[0, i, 0] == pytest.approx(integral(lambda s: np.sin(2 * s)), abs=1e-4)
        assert rows[0, i, 1] == pytest.approx(integral(lambda s: 2 * np.cos(2 * s)), abs=1e-4)
        assert rows[0, i, 2] == pytest.approx(integral(lambda s: np.sin(2 * s) ** 3), abs=1e-4)


def test_a_force_that_acts_between_the_samples_alone_is_no_crash() -> None:
    """Its column of the library is zero, as is what it could tell of the mass."""
    times = np.linspace(0.0, 10.0, 40)
    point = np.array([0.0, 0.05, 0.1, 0.15, 10.0])
    push = Force(point, np.array([0.0, 0.0, 5.0, 0.0, 0.0]))
    values = np.exp(-0.2 * times) * np.cos(2.5 * times) + 0.01 * rng().standard_normal(40)
    problem = Problem(SDOF(), (Record((Channel(times, values),), (push,)),))
    for form, reason in (("strong", "too noisy"), ("weak", "more samples or more motion")):
        estimate = SINDy(bootstrap=8, form=form).identify(problem, rng())
        assert estimate.status in (Status.DIVERGED, Status.UNSUPPORTED)
        assert reason in estimate.message
