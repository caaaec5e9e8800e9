"""Stated intervals: comparison of their components with closed forms, and coverage on simulated records."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2
from scipy.stats import t as student

from bench.contract.estimate import Cost
from bench.contract.problem import Channel, Problem, Record
from bench.likelihood.autoregression import Autoregression, autoregression, log_likelihoods
from bench.likelihood.output_error import OutputError, estimate_at
from bench.records.colour import criterion_error, information_criterion, local_spectrum
from bench.records.diagnostics import natural_frequency
from bench.records.intervals import (
    PRIOR_DOF,
    StatedInterval,
    between_parts,
    limited,
    paule_mandel,
    stated_intervals,
)
from bench.records.linearised_fit import LinearisedFit, at_theta, linearise
from bench.records.model_error import missing_forces
from bench.records.parts import parts_of
from bench.systems.sums import sum_from

OMEGA, ZETA = 6.0, 0.04
TRUE = {"k_over_m": OMEGA**2, "c_over_m": 2 * ZETA * OMEGA}
T = np.linspace(0.0, 10.0, 300)
MOTION = np.exp(-ZETA * OMEGA * T) * np.cos(OMEGA * np.sqrt(1 - ZETA**2) * T)


def fitted(x: np.ndarray, times: np.ndarray = T) -> tuple[Problem, LinearisedFit, dict[str, StatedInterval]]:
    """Fit a record by least squares, starting at the true parameters, and state the intervals."""
    problem = Problem(sum_from("sdof"), (Record((Channel(times, x, offset=True),)),))
    model = OutputError(problem)
    theta = model.settle(model.vector({"m": 1.0, "c": TRUE["c_over_m"], "k": TRUE["k_over_m"]})[None])[0]
    initial = at_theta(model, theta)
    assert initial is not None
    estimate = estimate_at(model, theta, initial.white, initial.used, Cost())
    fit = linearise(problem, estimate)
    assert fit is not None
    return problem, fit, stated_intervals(estimate, fit, parts_of(fit, natural_frequency(fit) or 1.0))


# noise of any colour


@pytest.mark.parametrize("coefficients", [(1.2, -0.5), (-0.4, 0.3), (0.9, -0.81)])
def test_an_autoregression_of_known_coefficients_is_recovered(coefficients: tuple[float, float]) -> None:
    """For 20 000 samples the standard errors of the coefficients are below 0.007, sqrt((1 - a2²)/n)."""
    errors = 0.5 * np.random.default_rng(1).standard_normal(21_000)
    noise = autoregression(lfilter([1.0], [1.0, *(-np.array(coefficients))], errors)[1000:])
    assert noise.order >= 2
    np.testing.assert_allclose(noise.coefficients[:2], coefficients, atol=0.03)
    np.testing.assert_allclose(noise.coefficients[2:], 0.0, atol=0.03)
    assert noise.variance == pytest.approx(0.25, rel=0.05)


def test_the_variance_is_corrected_for_the_degrees_of_freedom() -> None:
    r = np.random.default_rng(2).standard_normal(400)
    assert autoregression(r, 40.0).variance == pytest.approx(autoregression(r).variance / 0.9)


def test_white_noise_is_seldom_identified_as_coloured() -> None:
    """By BIC the probability of a first order alone is P(chi² > log n), here 1.7 %; of any order a few per cent."""
    orders = [autoregression(np.random.default_rng(seed).standard_normal(300)).order for seed in range(300)]
    assert np.mean(np.array(orders) > 0) < 3 * chi2.sf(np.log(300), 1)


@pytest.mark.parametrize("rho", [0.8, -0.6, 0.99])
def test_the_autocovariance_of_a_first_order_is_its_closed_form(rho: float) -> None:
    covariances = Autoregression(np.array([rho]), 0.3).autocovariance(500)
    np.testing.assert_allclose(covariances, 0.3 * rho ** np.arange(500) / (1 - rho**2), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 40])
def test_whitened_values_have_the_likelihood_of_the_dense_covariance(n: int) -> None:
    """It equals ``r' S⁻¹ r`` with the full Toeplitz matrix, including the first values."""
    noise = Autoregression(np.array([1.2, -0.5, 0.1]), 0.7)
    values = np.random.default_rng(4).standard_normal((2, n))
    dense = toeplitz(noise.autocovariance(n))
    expected = np.einsum("bi,ij,bj->b", values, np.linalg.inv(dense), values)
    np.testing.assert_allclose(np.sum(noise.whiten(values) ** 2, axis=-1), expected, rtol=1e-9)


# covariances


def test_the_white_covariance_is_that_of_a_linear_regression() -> None:
    """It is ``s² (J'J)⁻¹`` with ``s² = r'r / (n - p)``, with derivatives by finite differences."""
    _, at, _ = fitted(MOTION + 0.02 * np.random.default_rng(5).standard_normal(300))
    steps = 1e-6 * np.eye(at.theta.size)
    slopes = [(at.model.predict(at.theta + s) - at.model.predict(at.theta - s)) / 2e-6 for s in steps]
    j = np.array(slopes).T
    assert at.used == pytest.approx(5.0)
    variance = at.residuals @ at.residuals / (300 - 5)
    assert at.white is not None
    np.testing.assert_allclose(at.white, variance * np.linalg.inv(j.T @ j), rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(at.sigma, np.sqrt(variance))


@pytest.mark.parametrize("seed", [0, 1])
def test_the_coloured_covariance_is_the_sandwich_of_a_dense_matrix(seed: int) -> None:
    """It is ``(J'J)⁻¹ J'SJ (J'J)⁻¹`` with a full Toeplitz matrix ``S``."""
    noise = lfilter([0.6], [1.0, -0.8], np.random.default_rng(seed).standard_normal(500))[200:]
    _, at, _ = fitted(MOTION + 0.05 * noise)
    (estimated,) = at.noises
    assert estimated is not None
    assert estimated.order > 0
    # covariances by the impulse response of the autoregression: c_k = s² sum_j psi_j psi_(j+k)
    psi = lfilter([1.0], [1.0, *-estimated.coefficients], np.eye(1, 5000)[0])
    covariances = estimated.variance * np.array([psi[: 5000 - k] @ psi[k:] for k in range(300)])
    bread = np.linalg.inv(at.slopes.T @ at.slopes)
    dense = bread @ at.slopes.T @ toeplitz(covariances) @ at.slopes @ bread
    known = replace(at, known_noises=at.noises).coloured
    assert known is not None
    np.testing.assert_allclose(known, dense, rtol=1e-4, atol=1e-9 * np.max(np.abs(dense)))
    assert at.coloured is not None  # by the periodogram, so only approximately equal
    assert 0.3 < np.trace(at.coloured[:2, :2]) / np.trace(known[:2, :2]) < 3.0


def test_the_spectrum_of_residuals_is_unbiased() -> None:
    """Sines near a frequency are removed from white noise of variance 4; the estimate is 4 at every frequency."""
    t, rng = np.arange(300), np.random.default_rng(0)
    slopes = np.stack([f(2 * np.pi * 30.4 * t / 300) * g for f in (np.sin, np.cos) for g in (1.0, t / 300.0)], axis=1)
    basis = np.linalg.qr(slopes)[0]
    noise = 2.0 * rng.standard_normal((2000, 300))
    left = noise - noise @ basis @ basis.T
    spectrum = np.mean([local_spectrum(residuals, slopes, 1024) for residuals in left], axis=0)
    np.testing.assert_allclose(spectrum, 4.0, rtol=0.06)


# parts


def test_paule_mandel_in_closed_form() -> None:
    """The estimate is ``s² - v`` with the sample variance s², which is 2.5 for 0, 1, 2, 3, 4."""
    y = np.arange(5.0)
    assert paule_mandel(y, np.full(5, 0.1)).variance == pytest.approx(2.5 - 0.1, rel=1e-6)
    assert paule_mandel(y, np.full(5, 2.6)).variance == 0.0
    pair = paule_mandel(np.array([1.0, 4.0]), np.array([0.5, 1.5]))  # (y1 - y2)² / (v1 + v2 + 2 u) = 1
    assert pair.variance == pytest.approx((9 - 2) / 2, rel=1e-6)


def test_the_variance_between_parts_is_shrunk_towards_the_prior() -> None:
    """For 0, 1, 2, 3, 4 with errors of variance 0.1 the estimate is 2.4, with four degrees of freedom."""
    shrunk = between_parts(np.arange(5.0), np.full(5, 0.1), 0.5, np.zeros(5), 1.0).variance
    assert shrunk == pytest.approx((4 * 2.4 + PRIOR_DOF * 0.5) / (4 + PRIOR_DOF), rel=1e-6)


def test_a_dependence_on_the_amplitude_is_not_scatter_between_parts() -> None:
    """For values on a line with small errors the variance is below that of the prior."""
    sizes = np.linspace(0.0, -2.0, 6)
    variance, slope, _ = between_parts(1.0 + 0.4 * sizes, np.full(6, 1e-8), 1e-4, sizes, 0.09)
    assert variance < 1e-4
    assert slope == pytest.approx(0.4, rel=0.01)


def test_scatter_at_equal_amplitudes_is_the_mean_square() -> None:
    """Six values alternate between 0.1 and -0.1."""
    values = 0.1 * np.array([1.0, -1.0] * 3)
    variance, slope, chance = between_parts(values, np.full(6, 1e-10), 1e-6, np.linspace(0.0, -1e-3, 6), 1e-4)
    assert variance == pytest.approx((5 * 0.06 / 5 + PRIOR_DOF * 1e-6) / (5 + PRIOR_DOF), rel=0.01)
    assert slope == pytest.approx(0.0, abs=1e-3)
    assert chance < 1e-10


def test_p_values_of_homogeneous_parts_are_uniform() -> None:
    """The values lie about a line whose slope is drawn from its prior."""
    rng = np.random.default_rng(0)
    sizes, errors = np.linspace(0.0, -2.0, 6), np.geomspace(1e-4, 1e-2, 6)
    chances = [
        paule_mandel(
            rng.normal(0.0, 0.3) * sizes + np.sqrt(errors) * rng.standard_normal(6), errors, sizes, 0.09
        ).chance
        for _ in range(2000)
    ]
    assert np.mean(np.array(chances) < 0.1) == pytest.approx(0.1, abs=0.02)


def test_a_gauss_newton_step_fits_a_part_as_a_separate_record() -> None:
    """The first part of the record is its first two cycles, which are also fitted separately."""
    x = MOTION + 0.05 * np.random.default_rng(3).standard_normal(300)
    _, at, whole = fitted(x)
    first = parts_of(at, natural_frequency(at) or 1.0)[0]
    n = int(np.searchsorted(T, 2.0 * 2 * np.pi / OMEGA))
    _, separate, part = fitted(x[:n], T[:n])
    assert separate.white is not None
    change = [np.log(part[name].value / whole[name].value) for name in ("c_over_m", "k_over_m")]
    error = np.sqrt(np.diag(separate.white)[:2])
    np.testing.assert_array_less(np.abs(first.logs - at.theta[:2] - change), 0.5 * error)
    np.testing.assert_allclose(np.sqrt(np.diag(first.covariance)), error, rtol=0.3)


def test_a_changing_frequency_widens_the_interval_of_a_repeat() -> None:
    """In ``cos(6 t + 0.06 t²)`` the frequency rises from 6 to 7.2 rad/s, so ln k/m changes by ``2 ln(1.2)``."""
    x = np.cos(6.0 * T + 0.06 * T**2) + 0.005 * np.random.default_rng(6).standard_normal(300)
    _, at, intervals = fitted(x)
    k = intervals["k_over_m"]
    assert len(parts_of(at, natural_frequency(at) or 1.0)) >= 3
    assert k.unevenness > 5
    assert np.log(k.high / k.low) > 2 * np.log(k.record_high / k.record_low)
    assert np.log(k.high / k.low) / 2 < 2 * np.log(1.2)


def test_the_interval_of_several_records_includes_their_spread() -> None:
    """The k/m of two records differ by 4 %; each is a part, and another record may differ as much."""
    rng = np.random.default_rng(9)
    x = [np.exp(-0.24 * T) * np.cos(OMEGA * factor * T) + 0.01 * rng.standard_normal(300) for factor in (0.99, 1.01)]
    problem = Problem(sum_from("sdof"), tuple(Record((Channel(T, values, offset=True),)) for values in x))
    model = OutputError(problem)
    at = at_theta(model, model.settle(model.vector({"m": 1.0, "c": TRUE["c_over_m"], "k": TRUE["k_over_m"]})[None])[0])
    assert at is not None
    parts = parts_of(at, OMEGA / (2 * np.pi))
    assert [float(np.exp(part.logs[1])) for part in parts] == pytest.approx([35.3, 36.8], rel=0.01)
    fit = linearise(problem, estimate_at(model, at.theta, at.white, at.used, Cost()))
    assert fit is not None
    k = stated_intervals(estimate_at(model, at.theta, at.white, at.used, Cost()), fit, parts)["k_over_m"]
    assert k.low < 35.3 < 36.8 < k.high < 40.0


# joint distribution


def test_intervals_are_consistent() -> None:
    """As ``f = (k/m)^(1/2) / 2 pi``, its relative width is half that of k/m, for a repeat and for this record."""
    _, _, intervals = fitted(MOTION + 0.05 * np.random.default_rng(7).standard_normal(300))
    k, f = intervals["k_over_m"], intervals["natural_frequency"]
    for kind in ("", "record_"):
        widths = [np.log(getattr(i, f"{kind}high") / getattr(i, f"{kind}low")) for i in (k, f)]
        assert widths[0] == pytest.approx(2 * widths[1], rel=1e-6)


def test_an_error_of_the_sampling_rate_widens_intervals() -> None:
    """A relative error r of the sampling rate gives errors of 2 r in ln k/m, r in ln c/m, none in the damping ratio."""
    problem, at, _ = fitted(MOTION + 1e-4 * np.random.default_rng(8).standard_normal(300))
    theta = np.log([TRUE["c_over_m"], TRUE["k_over_m"]])
    model = OutputError(problem)
    estimate = estimate_at(model, np.append(theta, np.zeros(3)), 1e-12 * np.eye(5), at.used, Cost())
    intervals = stated_intervals(estimate, at, [], 0.01)
    halves = {n: np.log(i.record_high / i.record_low) / 2 / 1.968 for n, i in intervals.items()}
    assert halves["k_over_m"] == pytest.approx(0.02, rel=0.02)
    assert halves["c_over_m"] == pytest.approx(0.01, rel=0.02)
    assert halves["damping_ratio"] < 0.002


def test_tied_classes_widen_both_intervals() -> None:
    """Equal weights and values that differ by 20 % add a variance of ``ln(1.2)² / 2``."""
    problem, at, before = fitted(MOTION + 1e-3 * np.random.default_rng(8).standard_normal(300))
    variance = np.log(1.2) ** 2 / 2
    model = OutputError(problem)
    theta = np.append(np.log([TRUE["c_over_m"], TRUE["k_over_m"]]), np.zeros(3))
    estimate = estimate_at(model, theta, 1e-12 * np.eye(5), at.used, Cost())
    classes = SimpleNamespace(variance=lambda name: variance if name == "c_over_m" else 0.0)
    after = stated_intervals(estimate, at, [], 0.0, classes)  # type: ignore[arg-type]
    c, k = after["c_over_m"], after["k_over_m"]
    assert np.log(c.record_high / c.record_low) / 2 == pytest.approx(1.968 * np.sqrt(variance), rel=0.02)
    assert np.log(c.high / c.low) > np.log(c.record_high / c.record_low)
    assert k.record_high - k.record_low < 2 * (before["k_over_m"].record_high - before["k_over_m"].record_low)


def test_an_undetermined_damping_has_a_limit_and_does_not_affect_the_stiffness() -> None:
    """The motion is undamped."""
    undamped = np.cos(OMEGA * T)
    limits = []
    for seed in range(8):
        _, _, intervals = fitted(undamped + 0.05 * np.random.default_rng(seed).standard_normal(300))
        c, k = intervals["c_over_m"], intervals["k_over_m"]
        assert np.log(k.high / k.low) < 0.1
        if c.limit:
            assert c.limit == "at most"
            assert c.low == c.record_low == 0.0
            assert 0.0 < c.high < 0.1
            limits.append(c.high)
    assert limits


# the interval


def test_the_interval_for_white_noise_is_that_of_least_squares() -> None:
    """It is that of Student's t with n - p degrees of freedom."""
    stretches = []
    for seed in range(8):
        _, fit, intervals = fitted(MOTION + 0.02 * np.random.default_rng(20 + seed).standard_normal(300))
        k, gradient = intervals["k_over_m"], fit.gradient(fit.model.system.groups[0])
        assert fit.white is not None
        half = student.ppf(0.975, 295) * np.sqrt(gradient @ fit.white @ gradient)
        assert (k.white_high - k.white_low) / 2 / k.value == pytest.approx(half, rel=1e-3)
        stretches.append((k.record_high - k.record_low) / (k.white_high - k.white_low))
    assert np.median(stretches) == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "records", "record", "white"),
    [
        ("white", 400, (0.92, 0.98), (0.92, 0.98)),
        ("first order", 200, (0.92, 1.0), (0.0, 0.75)),  # too narrow by the root of the spectrum at OMEGA over its mean
        ("drift", 150, (0.92, 1.0), (0.0, 0.85)),
    ],
)
def test_intervals_cover_for_noise_of_any_colour(
    kind: str, records: int, record: tuple[float, float], white: tuple[float, float]
) -> None:
    """The coverage of both ratios has a standard error of about 1 %; a drift reaches three times the noise."""
    covered = []
    for seed in range(records):
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal(300)
        if kind == "first order":
            noise = lfilter([0.6], [1.0, -0.8], rng.standard_normal(500))[200:]
        if kind == "drift":
            noise = noise + 3.0 * np.linspace(-1.0, 1.0, 300)
        _, _, intervals = fitted(MOTION + 0.1 * np.std(MOTION) * noise)
        stated = [(intervals[name], truth) for name, truth in TRUE.items()]
        covered += [(i.record_low < true < i.record_high, i.white_low < true < i.white_high) for i, true in stated]
    for share, (least, most) in zip(np.mean(covered, axis=0), (record, white), strict=True):
        assert least <= share <= most


# missing forces


def test_a_cubic_spring_is_not_added_to_a_softening_one() -> None:
    """They are the same force with opposite signs; the record is of a pendulum with quadratic damping."""

    def law(t, y):  # type: ignore[no-untyped-def]
        return [y[1], -(OMEGA**2) * np.sin(y[0]) - 0.2 * y[1] - 0.1 * abs(y[1]) * y[1]]

    x = solve_ivp(law, (0.0, T[-1]), [1.2, 0.0], t_eval=T, rtol=1e-9, atol=1e-11).y[0]
    x = x + 0.002 * np.random.default_rng(0).standard_normal(T.size)
    model = OutputError(Problem(sum_from("viscous+spring+softening"), (Record((Channel(T, x, offset=True),)),)))
    guess = {"m": 1.0, "c": 0.3, "k": OMEGA**2, "k3s": OMEGA**2 / 6}
    at = at_theta(model, model.settle(model.vector(guess)[None], iterations=40)[0])
    assert at is not None
    assert missing_forces(at) == ("quadratic damping",)


def test_the_friction_that_a_linear_model_lacks_is_detected() -> None:
    """Friction is 1 % of the initial spring force, in white noise of 40 dB; a record without friction is compared."""

    def law(t, y):  # type: ignore[no-untyped-def]
        return [y[1], -(OMEGA**2) * y[0] - 0.2 * y[1] - 0.01 * OMEGA**2 * np.tanh(y[1] / 1e-3)]

    dry = solve_ivp(law, (0.0, T[-1]), [1.0, 0.0], t_eval=T, rtol=1e-8, atol=1e-10, method="LSODA").y[0]
    noise = 0.003 * np.random.default_rng(1).standard_normal(T.size)
    _, with_friction, _ = fitted(dry + noise)
    _, without, _ = fitted(MOTION + noise)
    assert "dry friction" in missing_forces(with_friction)
    assert missing_forces(without) == ()


# limits


def test_a_limit_is_on_the_scale_of_the_undetermined_parameter() -> None:
    """For 2 with a relative standard error of 1.5 the upper limit is ``2 (1 + 1.645 * 1.5)``.

    For a reciprocal the lower limit is ``2 / (1 + 1.645 * 1.5)``, and for a square root the limit is the root.
    """
    interval = StatedInterval(2.0, *[math.nan] * 6, "")
    most, least = limited(interval, 1.5, 1.0), limited(interval, 1.5, -1.0)
    assert (most.low, most.high, most.limit) == (0.0, pytest.approx(2 * (1 + 1.644854 * 1.5)), "at most")
    assert (least.low, least.high, least.limit) == (pytest.approx(2 / (1 + 1.644854 * 1.5)), math.inf, "at least")
    assert limited(interval, 0.75, 0.5).high == pytest.approx(2 * math.sqrt(1 + 1.644854 * 1.5))


# differences of criteria


def test_the_error_of_a_difference_of_criteria_is_its_standard_deviation_over_records() -> None:
    """The residuals of two fits to each record have a common part."""
    differences, errors = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        common = rng.standard_normal(400)
        first, second = (common + 0.3 * rng.standard_normal(400) for _ in range(2))
        differences.append(information_criterion(first, 3) - information_criterion(second, 3))
        logs = [log_likelihoods(autoregression(residuals, 3), residuals) for residuals in (first, second)]
        errors.append(criterion_error(*logs))
    assert np.median(errors) == pytest.approx(np.std(differences), rel=0.25)
