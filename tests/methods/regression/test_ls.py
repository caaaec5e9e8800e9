"""Least squares: the bias of its derivatives by formula, exact data, several DOFs, and its covariance."""

from __future__ import annotations

import cmath
from dataclasses import replace

import numpy as np
import pytest

from bench import Channel, Normal, Problem, Record, Status
from bench.scenario.scenario import ForceSpec, PriorSpec, Scenario
from bench.scenario.truth import closed_form
from bench.systems import SDOF, Chain
from methods.regression.derivatives import SmoothingSpline, finite_differences, smoothing_spline
from methods.regression.ls import LS

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
PRIOR = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5})


def scenario(snr: float, **changes: object) -> Scenario:
    return replace(Scenario("sdof", PLANT, ((0.8,), (0.5,)), snr, prior=PRIOR), **changes)


def groups(problem: Problem, method: LS) -> Normal:
    estimate = method.identify(problem, np.random.default_rng(0))
    assert estimate.groups is not None, estimate.message
    return estimate.groups


def clean(p: dict[str, float], times: np.ndarray, start: tuple[float, float] = (1.0, 0.3)) -> Problem:
    return Problem(SDOF(), (Record((Channel(times, closed_form(p, *start, times)),)),))


def biased_by_sampling(p: dict[str, float], h: float) -> tuple[float, float]:
    """What least squares on exact samples of step h finds for k/m and c/m, in closed form.

    The response is a sum of ``e^{st}`` over the two roots s of ``m s² + c s + k``. The second difference multiplies
    ``e^{st}`` by ``D2 = 2 (cosh(sh) - 1)/h²`` and the central difference by ``D1 = sinh(sh)/h``, both constant in time.
    So ``D2 + C D1 + K = 0`` at both roots makes every residual zero: the real C and K that solve it (the two roots are
    conjugate, so one complex equation) are the least-squares solution.
    """
    s = (-p["c"] + cmath.sqrt(p["c"] ** 2 - 4 * p["m"] * p["k"])) / (2 * p["m"])
    second, first = 2 * (cmath.cosh(s * h) - 1) / h**2, cmath.sinh(s * h) / h
    c = -second.imag / first.imag
    return -(second.real + c * first.real), c


@pytest.mark.parametrize(
    ("p", "samples"), [(PLANT, 25), ({"m": 1.0, "c": 0.4, "k": 8.0}, 25), ({"m": 2.0, "c": 1e-9, "k": 5.0}, 40)]
)
def test_finite_differences_have_the_bias_of_their_sampling_step(p: dict[str, float], samples: int) -> None:
    times = np.linspace(0.0, 10.0, samples)
    computed = groups(clean(p, times), LS()).mean
    np.testing.assert_allclose(computed, biased_by_sampling(p, times[1]), rtol=1e-8, atol=1e-8)


def test_uneven_differences_are_exact_for_a_parabola() -> None:
    times = np.array([0.0, 0.3, 0.4, 1.1, 1.9])
    motion = finite_differences(times, 2.0 - 3.0 * times + 4.0 * times**2)
    np.testing.assert_allclose(motion.v, -3.0 + 8.0 * times[1:-1], rtol=1e-12)
    np.testing.assert_allclose(motion.a, np.full(3, 8.0), rtol=1e-12)


def test_spline_recovers_dense_and_nearly_noise_free_samples() -> None:
    """400 samples over 10 s at 120 dB: k/m to 1e-5 and c/m to 1e-4 of the truth, from the smoothing alone."""
    for problem, _ in scenario(120, samples=400, initial_state="unknown").replicates(4, 3):
        k, c = groups(problem, LS("spline")).mean
        assert k == pytest.approx(9.0 / 1.3, rel=1e-5)
        assert c == pytest.approx(0.6 / 1.3, rel=1e-4)


def test_spline_beats_finite_differences_on_few_samples() -> None:
    problems = [p for p, _ in scenario(30).replicates(9, 12)]
    error = {
        d: np.sqrt(np.mean([(groups(p, LS(d, bootstrap=8)).mean[0] / (9.0 / 1.3) - 1) ** 2 for p in problems]))
        for d in ("finite", "spline")
    }
    assert error["finite"] > 0.08
    assert error["spline"] < 0.01


@pytest.mark.parametrize("derivative", ["finite", "spline"])
def test_the_bootstrap_covariance_is_the_spread_over_replicates(derivative: str) -> None:
    fits = [groups(p, LS(derivative)) for p, _ in scenario(20).replicates(21, 60)]
    spread = np.std([fit.mean for fit in fits], axis=0)
    known = np.median([np.sqrt(np.diag(fit.covariance)) for fit in fits if fit.covariance is not None], axis=0)
    np.testing.assert_allclose(known, spread, rtol=0.4)


def test_a_smoothing_spline_goes_from_the_samples_to_a_parabola() -> None:
    times = np.sort(np.random.default_rng(2).uniform(0, 7, 30))
    y = np.sin(2 * times) + 0.1 * np.random.default_rng(3).standard_normal(30)
    spline = SmoothingSpline(times, 3)
    close = spline.motion(spline.fit(y, 1e-12), times).x
    np.testing.assert_allclose(close, y, atol=1e-5)
    stiff = spline.motion(spline.fit(y, 1e14), times)
    np.testing.assert_allclose(stiff.x, np.polyval(np.polyfit(times, y, 2), times), atol=1e-4)
    middle = spline.motion(spline.fit(y, 1.0), times)
    step = 1e-4
    ahead, back = (spline.motion(spline.fit(y, 1.0), times + d).x for d in (step, -step))
    np.testing.assert_allclose(middle.v[1:-1], ((ahead - back) / (2 * step))[1:-1], atol=1e-5)


def test_the_spline_minimises_its_own_objective() -> None:
    """No other natural smoother: the objective (misfit + weight * roughness) is higher at every step aside."""
    times = np.cumsum(np.array([0.0, 1.0, 0.7, 1.3, 1.0, 0.9, 1.1, 1.0]))
    y, spline, weight = np.cos(times), SmoothingSpline(times, 3), 0.7
    coefficients = spline.fit(y, weight)
    grid = np.linspace(times[0], times[-1], 20001)

    def objective(c: np.ndarray) -> float:
        misfit = np.sum((y - spline.motion(c, times).x) ** 2)
        # time counts in mean steps
        third = np.gradient(spline.motion(c, grid).a, grid) * spline.step**3
        return float(misfit + weight * np.trapezoid(third**2, grid / spline.step))

    rng, best = np.random.default_rng(0), objective(coefficients)
    for _ in range(20):
        assert objective(coefficients + 1e-2 * rng.standard_normal(coefficients.size)) > best


def test_likelihood_finds_the_noise_of_a_well_sampled_vibration() -> None:
    times, rng = np.linspace(0, 10, 120), np.random.default_rng(1)
    y = np.cos(3 * times) + 0.05 * rng.standard_normal((40, 120))
    _, noise = smoothing_spline(times, 3).likely_weights(y)
    assert np.mean(noise) == pytest.approx(0.05, rel=0.05)


@pytest.mark.parametrize("derivative", ["finite", "spline"])
def test_with_a_force_all_parameters_come_out(derivative: str) -> None:
    forced = scenario(50, samples=120, prior=None, force=ForceSpec(3.0, 0.1, 1.0))
    problem, _ = forced.replicates(5, 1)[0]
    distribution = LS(derivative).identify(problem, np.random.default_rng(0)).parameters
    assert isinstance(distribution, Normal)
    assert distribution.log
    tolerance = {"finite": 0.3, "spline": 0.03}[derivative]
    for name, value in distribution.values().items():
        assert value == pytest.approx(PLANT[name], rel=tolerance)


def test_two_masses_and_a_hardening_spring() -> None:
    chain = Scenario(
        "chain",
        {"m1": 1.2, "m2": 0.8, "c1": 0.3, "c2": 0.2, "k1": 9.0, "k2": 6.0},
        ((0.5, -0.3), (0.0, 0.4)),
        60,
        samples=200,
        initial_state="unknown",
    )
    duffing = Scenario("duffing", {"m": 1.2, "c": 0.3, "k": 5.0, "k3": 6.0}, ((1.0,), (0.2,)), 60, samples=150)
    for case in (chain, duffing):
        problem, truth = case.replicates(1, 1)[0]
        computed = groups(problem, LS("spline"))
        for name, value in computed.values().items():
            assert value == pytest.approx(problem.system.quantity(name).value(truth.parameters), rel=0.02), name


def test_an_unknown_offset_changes_nothing() -> None:
    problem, _ = scenario(30, initial_state="unknown").replicates(3, 1)[0]
    channel = problem.records[0].channels[0]

    def shifted(by: float) -> Problem:
        return Problem(SDOF(), (Record((replace(channel, values=channel.values + by, offset=True),)),))

    for derivative in ("finite", "spline"):
        here, there = (groups(shifted(by), LS(derivative)) for by in (0.0, 0.7))
        np.testing.assert_allclose(there.mean, here.mean, rtol=1e-6)


def test_records_it_cannot_use_are_refused_in_a_sentence() -> None:
    chain = Scenario(
        "chain",
        {"m1": 1.0, "m2": 1.0, "c1": 0.3, "c2": 0.2, "k1": 9.0, "k2": 6.0},
        ((0.5, 0.0), (0.0, 0.0)),
        40,
    )
    problem, _ = chain.replicates(1, 1)[0]
    first = Problem(problem.system, (Record(problem.records[0].channels[:1]),))
    assert "every DOF" in (LS().objection(first) or "")
    refused = LS().identify(first, np.random.default_rng(0))
    assert refused.status is Status.UNSUPPORTED
    second = problem.records[0].channels[1]
    late = Channel(second.times + 0.01, second.values, dof=1)
    apart = Problem(problem.system, (Record((problem.records[0].channels[0], late)),))
    assert "same sample times" in (LS().objection(apart) or "")


def test_a_dead_channel_beside_a_live_one_is_named() -> None:
    times = np.linspace(0, 5, 20)
    channels = (Channel(times, np.cos(3.0 * times)), Channel(times, np.zeros(20), dof=1))
    estimate = LS().identify(Problem(Chain(2), (Record(channels),)), np.random.default_rng(0))
    assert estimate.status is Status.INVALID
    assert "DOF 2" in estimate.message
