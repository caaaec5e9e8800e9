"""Joint Kalman filters: least squares in closed form, another library, another method, and the bound."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from bench import (
    Channel,
    Estimate,
    Force,
    Identifier,
    InitialState,
    Normal,
    OutputError,
    Prior,
    Problem,
    Record,
)
from bench.dynamics.simulate import simulate
from bench.information.fisher import compute_bound
from bench.scenario.scenario import PriorSpec, Scenario
from bench.scenario.truth import closed_form
from bench.scoring.combination import combine_with_prior
from bench.systems import SDOF, Chain, Dimension, Duffing, Parameter
from methods.kalman import joint as joint_model
from methods.kalman.core import Affine, predict_root, regression, tangent, update, update_root
from methods.kalman.ekf import EKF
from methods.kalman.iteration import FilterBatch, _combined, first_distribution
from methods.kalman.joint import Joint, Nodes
from methods.kalman.smoother import smooth
from methods.kalman.ukf import UKF
from methods.trajectory.output_error import SingleShooting


@dataclass(frozen=True)
class Slipping(SDOF):
    """``m x'' + c x' + k z = f`` with a hidden state, ``z' = v - b |v| z``: hysteresis, in any units of length."""

    name: ClassVar[str] = "slipping"
    linear: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*SDOF().parameters, Parameter("b", "1/m", "other", Dimension(0, -1, 0)))

    @property
    def n_hidden(self) -> int:
        return 1

    def residual(self, p, x, v, a, f, z, ops):
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * z[0] - f[0]]

    def hidden_rates(self, p, x, v, f, z, ops):
        return [v[0] - p["b"] * ops.abs(v[0]) * z[0]]


PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
NOMINAL = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})
BOTH = pytest.mark.parametrize("method", [EKF(), UKF()], ids=["ekf", "ukf"])
UKF_SLOW = pytest.mark.parametrize("method", [EKF(), pytest.param(UKF(), marks=pytest.mark.slow)], ids=["ekf", "ukf"])
"""For long tests of code that both have."""


def scenario(snr: float, **changes: object) -> Scenario:
    given = {"system": "sdof", "parameters": PLANT, "initial": ((0.8,), (0.5,)), "prior": NOMINAL, **changes}
    return Scenario(snr_db=snr, **given)


def fit(method: Identifier, problem: Problem) -> Estimate:
    return method.identify(problem, np.random.default_rng(0))


def value(estimate: Estimate, name: str) -> float:
    marginal = estimate.marginal(estimate.system.quantity(name))
    assert marginal is not None, estimate.message
    return marginal.value


def distribution(problem: Problem, p: dict[str, float]) -> Joint:
    return first_distribution(OutputError(problem), p, np.log(list(p.values())), 0.0, 1.0)


@pytest.mark.parametrize("rule", [tangent, regression], ids=["ekf", "ukf"])
@pytest.mark.parametrize("times", [np.linspace(0.0, 1.0, 12), np.array([0.03, 0.11, 0.12, 0.5, 0.72, 1.0])])
def test_with_known_parameters_it_is_least_squares(rule, times: np.ndarray) -> None:
    """A linear system at known parameters is affine in its start, ``y = B s0 + e``, so the smoothed start must be
    ``(B'B / sigma² + P0^-1)^-1 B'y / sigma²`` and its covariance that inverse: the closed form, in one pass.
    """
    p = {"m": 1.0, "c": 4.0, "k": 900.0}
    y = closed_form(p, 1.0, 3.0, times) + 0.2 * np.random.default_rng(2).standard_normal(times.size)
    sure = Prior(p, dict.fromkeys(p, 1e-9))
    joint = distribution(Problem(SDOF(), (Record((Channel(times, y),)),), sure), p)
    nodes = Nodes.of(joint.model, 0.002)
    about = joint.trajectories(np.array([[*np.log(list(p.values())), 0.3, -2.0]]), nodes)  # any other start
    computed = smooth(joint, nodes, rule, np.array([[0.2]]), about, np.zeros((*about.shape, joint.size)))
    columns = np.stack([closed_form(p, 1.0, 0.0, times), closed_form(p, 0.0, 1.0, times)], axis=1)
    inverse = np.linalg.inv(columns.T @ columns / 0.2**2 + np.diag(1.0 / np.diag(joint.first()[1])[:2]))
    expected, sd = inverse @ columns.T @ y / 0.2**2, np.sqrt(np.diag(inverse))
    np.testing.assert_allclose(computed.means[0, 0, :2] / sd, expected / sd, atol=1e-3)
    np.testing.assert_allclose(
        computed.covariances[0, 0, :2, :2] / np.outer(sd, sd), inverse / np.outer(sd, sd), atol=1e-3
    )


def bend(points: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(points[..., 0]) * points[..., 1], points[..., 2] ** 2 - points[..., 0]], axis=-1)


MEAN = np.array([0.4, -1.2, 0.7])
COVARIANCE = np.array([[0.2, 0.05, 0.0], [0.05, 0.3, -0.1], [0.0, -0.1, 0.15]])


@pytest.mark.parametrize("kappa", [0.0, 1.5])
def test_the_regression_is_the_unscented_transform_of_filterpy(kappa: float) -> None:
    kalman = pytest.importorskip("filterpy.kalman")

    def root(matrix: np.ndarray) -> np.ndarray:
        values, axes = np.linalg.eigh(matrix)
        return np.asarray((axes * np.sqrt(values)).T)

    points = kalman.MerweScaledSigmaPoints(3, alpha=1.0, beta=0.0, kappa=kappa, sqrt_method=root)
    mapped = bend(points.sigma_points(MEAN, COVARIANCE))
    mean, covariance = kalman.unscented_transform(mapped, points.Wm, points.Wc)
    slopes, constant, scatter = (part[0] for part in regression(bend, MEAN[None], COVARIANCE[None], kappa))
    np.testing.assert_allclose(slopes @ MEAN + constant, mean, atol=1e-12)
    np.testing.assert_allclose(slopes @ COVARIANCE @ slopes.T + scatter.T @ scatter, covariance, atol=1e-12)


def test_the_mean_of_a_square_is_exact_and_a_line_has_no_error() -> None:
    """``E x² = m² + P`` for any spread; ``A s + b`` is its own regression."""
    slopes, constant, _ = regression(lambda s: s**2, MEAN[None, :1], COVARIANCE[None, :1, :1])
    assert (slopes[0] @ MEAN[:1] + constant[0])[0] == pytest.approx(MEAN[0] ** 2 + COVARIANCE[0, 0], rel=1e-12)
    a = np.array([[1.0, 2.0, -3.0], [0.5, 0.0, 4.0]])
    slopes, constant, scatter = regression(lambda s: s @ a.T + 7.0, MEAN[None], COVARIANCE[None])
    np.testing.assert_allclose(slopes[0], a, atol=1e-9)
    np.testing.assert_allclose(constant[0], 7.0, atol=1e-9)
    np.testing.assert_allclose(scatter[0], 0.0, atol=1e-9)


def test_the_tangent_is_the_derivative() -> None:
    slopes, _, scatter = tangent(bend, MEAN[None], COVARIANCE[None])
    expected = [[np.cos(0.4) * -1.2, np.sin(0.4), 0.0], [-1.0, 0.0, 1.4]]
    np.testing.assert_allclose(slopes[0], expected, atol=1e-9)
    assert not scatter.any()


@BOTH
@pytest.mark.parametrize("initial_state", ["known", "unknown"])
def test_it_agrees_with_output_error(method: Identifier, initial_state: str) -> None:
    """At 30 dB both are the most probable parameters of the same model, found by code that shares only the physics."""
    for problem, _ in scenario(30.0, initial_state=initial_state).replicates(3, 3):
        mine, other = fit(method, problem), fit(SingleShooting(), problem)
        assert isinstance(mine.parameters, Normal)
        assert isinstance(other.parameters, Normal)
        sd = np.sqrt(np.diag(other.parameters.covariance))
        np.testing.assert_allclose(mine.parameters.mean / sd, other.parameters.mean / sd, atol=0.1)
        np.testing.assert_allclose(np.sqrt(np.diag(mine.parameters.covariance)), sd, rtol=0.1)


@BOTH
def test_it_comes_near_the_bound(method: Identifier) -> None:
    made = scenario(20.0)
    bound = compute_bound(made).relative_sd
    fits = [fit(method, problem) for problem, _ in made.replicates(5, 40)]
    for name in ("k_over_m", "c_over_m"):
        true = made.make_system().quantity(name).value(PLANT)
        errors = [value(estimate, name) / true - 1 for estimate in fits]
        assert 0.7 < np.sqrt(np.mean(np.square(errors))) / bound[name] < 1.4


@BOTH
@pytest.mark.parametrize(
    ("system", "parameters", "start"),
    [
        (Chain(2), {"m1": 1.2, "m2": 0.9, "c1": 0.25, "c2": 0.2, "k1": 7.0, "k2": 11.0}, ((0.5, -0.4), (0.0, 1.0))),
        (Duffing(), {"m": 1.2, "c": 0.5, "k": 6.0, "k3": 4.0}, ((0.9,), (0.0,))),
    ],
    ids=["chain", "duffing"],
)
def test_other_systems_at_different_times_by_channel(
    method: Identifier, system, parameters: dict[str, float], start
) -> None:
    """Each sensor has times of its own; the truth lies in the 99.9 % intervals of the groups."""
    rng, state = np.random.default_rng(1), InitialState(np.array(start[0]), np.array(start[1]))
    channels = []
    for dof in range(system.n_dof):
        times = np.sort(rng.uniform(0.0, 10.0, 35))
        clean = simulate(system, parameters, state, times).displacement[dof]
        noise = 0.03 * np.sqrt(np.mean(clean**2)) * rng.standard_normal(times.size)
        channels.append(Channel(times, clean + noise, dof=dof))
    nominal = {name: true * 1.2 for name, true in parameters.items()}
    prior = Prior(nominal, {p.name: 0.2 if p.kind == "mass" else 0.5 for p in system.parameters})
    estimate = fit(method, Problem(system, (Record(tuple(channels)),), prior))
    for group in system.groups:
        marginal = estimate.marginal(group)
        assert marginal is not None, estimate.message
        low, high = marginal.interval(0.999)
        assert low < group.value(parameters) < high


@BOTH
def test_the_filter_carries_hidden_states(method: Identifier) -> None:
    """Hysteresis under a force, its truth by scipy's integrator."""
    from scipy.integrate import solve_ivp

    times, knots, p = np.linspace(0.0, 8.0, 50), np.linspace(0.0, 8.0, 161), {"m": 1.2, "c": 0.5, "k": 8.0, "b": 0.5}
    push = Force(knots, 4.0 * np.sin(1.9 * knots) + 2.0 * np.cos(4.3 * knots))

    def rate(t: float, s: np.ndarray) -> list[float]:
        force = float(push(np.array([t]))[0])
        return [s[1], (force - p["c"] * s[1] - p["k"] * s[2]) / p["m"], s[1] - p["b"] * abs(s[1]) * s[2]]

    clean = solve_ivp(rate, (0, 8), [0.3, 0.0, 0.0], t_eval=times, rtol=1e-9, atol=1e-10, max_step=0.05).y[0]
    noisy = clean + 0.01 * np.random.default_rng(0).standard_normal(times.size)
    record = Record((Channel(times, noisy),), (push,), InitialState(np.array([0.3]), np.array([0.0])))
    prior = Prior({"m": 1.4, "c": 0.3, "k": 6.0, "b": 0.7}, dict.fromkeys(p, 0.5))
    estimate = fit(method, Problem(Slipping(), (record,), prior))
    assert isinstance(estimate.parameters, Normal), estimate.message
    sd = np.sqrt(np.diag(estimate.parameters.covariance))
    assert np.all(np.abs(estimate.parameters.mean - np.log(list(p.values()))) < 3.5 * sd)
    assert np.all(sd < 0.2)


@BOTH
@pytest.mark.parametrize("initial_state", ["known", "unknown"])
def test_a_prior_cycles_away_does_not_lose_the_motion(method: Identifier, initial_state: str) -> None:
    """Ten cycles, and stiffness stated four times too high: ten cycles too many. The truth lies in the interval."""
    p = {"m": 1.3, "c": 0.2, "k": 51.0}
    made = scenario(20.0, parameters=p, samples=60, initial_state=initial_state)
    for problem, _ in made.replicates(1, 2):
        assert problem.prior is not None
        stated = Prior({"m": 1.3, "c": 0.6, "k": 204.0}, {"m": 0.02, "c": 1.0, "k": 1.0})
        estimate = fit(method, Problem(problem.system, problem.records, stated))
        alone = replace(estimate, alternatives=(), weight=1.0)  # its aliases are tested elsewhere
        marginal = alone.marginal(problem.system.quantity("k_over_m"))
        assert marginal is not None, estimate.message
        low, high = marginal.interval(0.999)
        assert low < 51.0 / 1.3 < high
        assert high / low < 1.1


@BOTH
@pytest.mark.parametrize("snr", [90.0, 150.0, 250.0])
def test_data_without_noise_give_intervals_that_hold_the_truth(method: Identifier, snr: float) -> None:
    """An interval is never thinner than the integration and the rounding allow, and the answer says where it ends."""
    made = scenario(snr)
    for problem, _ in made.replicates(2, 2):
        estimate = combine_with_prior(fit(method, problem), problem.prior)
        assert "least that the filter resolves" in estimate.message
        for name in ("k_over_m", "c_over_m"):
            marginal = estimate.marginal(problem.system.quantity(name))
            low, high = marginal.interval(0.95)
            assert low < problem.system.quantity(name).value(PLANT) < high
            assert high / low < 1.01


def test_a_rival_widens_the_interval_as_a_mixture_of_two() -> None:
    """Two ends at odds of one to one: variance about the first is the mean of the variances and half their distance
    squared; an end at odds of one to a hundred, or one next to the first, changes nothing.
    """
    problem, _ = scenario(20.0).replicates(0, 1)[0]
    joint = distribution(problem, PLANT)
    means, covariances = np.zeros((2, 1, 5)), np.tile(np.eye(5), (2, 1, 1, 1))
    covariances[1] *= 3.0

    def combined(away: float, odds: float) -> tuple[np.ndarray, list[str]]:
        means[1, 0, 4] = away
        none = np.zeros(2)
        flat = none[:, None]
        bank = FilterBatch(means, covariances, means, covariances, flat, none, flat, none)
        return _combined(joint, bank, np.log([1.0, odds]), 0)

    covariance, message = combined(6.0, 1.0)
    np.testing.assert_allclose(np.diag(covariance), [2.0, 2.0, 2.0 + 0.5 * 36.0])
    assert "50%" in message[0]
    for away, odds in ((6.0, 0.01), (0.5, 1.0)):
        covariance, message = combined(away, odds)
        np.testing.assert_allclose(covariance, np.eye(3))
        assert not message


@BOTH
def test_process_noise_widens_the_answer(method: Identifier) -> None:
    problem, _ = scenario(30.0).replicates(1, 1)[0]
    still, walking = fit(method, problem), fit(type(method)(drift=0.1), problem)
    for estimate in (still, walking):
        assert isinstance(estimate.parameters, Normal)
    wide, narrow = (e.marginal(problem.system.quantity("k_over_m")) for e in (walking, still))
    assert np.diff(wide.interval(0.95)) > 2 * np.diff(narrow.interval(0.95))


def test_values_one_by_one_are_the_update_by_all_of_them() -> None:
    """Against ``P H' (H P H' + R)^-1`` written out, for both forms; a channel without a value changes nothing."""
    slopes = np.array([[1.0, 0.3, 0.0], [0.2, -1.0, 0.5], [9.0, 9.0, 9.0]])
    constants, variances, values = np.array([0.1, -0.2, 0.0]), np.array([0.02, 0.3, 1.0]), np.array([0.5, 1.0, 7.0])
    used = np.array([True, True, False])
    h, r = slopes[:2], np.diag(variances[:2])
    gain = COVARIANCE @ h.T @ np.linalg.inv(h @ COVARIANCE @ h.T + r)
    left = values[:2] - constants[:2] - h @ MEAN
    total = h @ COVARIANCE @ h.T + r
    likelihood = -0.5 * (left @ np.linalg.solve(total, left) + np.linalg.slogdet(total)[1])
    updated = update(MEAN, COVARIANCE, slopes, constants, variances, values, used)
    np.testing.assert_allclose(updated.mean, MEAN + gain @ left, rtol=1e-12)
    np.testing.assert_allclose(updated.spread, COVARIANCE - gain @ h @ COVARIANCE, atol=1e-14)
    assert updated.likelihood == pytest.approx(likelihood, rel=1e-12)
    root = np.linalg.cholesky(COVARIANCE)
    mean, root, by_root = update_root(MEAN, root, slopes, constants, variances, values, used)
    np.testing.assert_allclose(mean, updated.mean, rtol=1e-12)
    np.testing.assert_allclose(root @ root.T, updated.spread, atol=1e-14)
    assert by_root == pytest.approx(likelihood, rel=1e-12)
    a = np.array([[1.0, 0.1, 0.0], [-0.2, 0.9, 0.3], [0.0, 0.0, 1.0]])
    walk = np.array([0.0, 0.1, 0.2])
    moved = predict_root(Affine(a, np.ones(3), np.zeros((1, 3))), walk, mean, root)
    np.testing.assert_allclose(moved[0], a @ mean + 1.0, rtol=1e-12)
    np.testing.assert_allclose(moved[1] @ moved[1].T, a @ root @ root.T @ a.T + np.diag(walk), atol=1e-14)


def test_a_value_without_noise_leaves_no_negative_variance() -> None:
    """Joseph's form, where ``P - K H P`` is all rounding: a value with a part in 1e10 of the distribution's spread."""
    slopes, nothing = np.array([[0.0, 2.0, 0.0]]), np.zeros(1)
    computed = update(MEAN, COVARIANCE, slopes, nothing, np.array([1e-20]), nothing, np.array([True])).spread
    assert (slopes @ computed @ slopes.T)[0, 0] == pytest.approx(1e-20, rel=1e-6)
    assert np.all(np.linalg.eigvalsh(computed) > -1e-17)


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize("system", ["sdof", "duffing"])
def test_nodes_with_several_samples_give_the_same_answer(
    method: Identifier, system: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Long records have fewer nodes than samples; here one in three, of two records of which neither is a multiple."""
    p = PLANT | ({"k3": 4.0} if system == "duffing" else {})
    parts = [
        scenario(20.0, system=system, parameters=p, initial_state="unknown", samples=n).replicates(1, 1)[0][0]
        for n in (25, 31)
    ]
    problem = replace(parts[0], records=(*parts[0].records, *parts[1].records))
    short = fit(method, problem)
    monkeypatch.setattr(joint_model, "LONG", 20)
    monkeypatch.setattr(joint_model, "NODES", 10)
    long = fit(method, problem)
    assert isinstance(short.distribution, Normal)
    assert isinstance(long.distribution, Normal)
    sd = np.sqrt(np.diag(short.distribution.covariance))
    np.testing.assert_allclose(long.distribution.mean / sd, short.distribution.mean / sd, atol=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(long.distribution.covariance)), sd, rtol=0.01)


@UKF_SLOW
def test_a_motion_that_dies_at_once_is_not_preferred_to_the_one_that_the_data_show(method: Identifier) -> None:
    """At 0 dB, of two ends that explain the data the more probable one is kept; both methods had the other."""
    made = Scenario("sdof", {"m": 1.0, "c": 0.6, "k": 50.0}, ((0.5,), (0.0,)), 0.0, duration=8.0, samples=29,
                    initial_state="unknown", prior=NOMINAL)  # fmt: skip
    true, bound = 50.0, compute_bound(made).relative_sd["k_over_m"]
    errors = [value(fit(method, problem), "k_over_m") / true - 1 for problem, _ in made.replicates(7, 20)]
    assert np.sqrt(np.mean(np.square(errors))) < 1.6 * bound


@pytest.mark.slow
@BOTH
def test_a_long_record_takes_memory_in_proportion(method: Identifier) -> None:
    """60 000 samples of 600 cycles: an answer within its interval, from a little memory."""
    made = scenario(20.0, parameters={"m": 1.3, "c": 0.02, "k": 9.0}, samples=60_000, duration=600 * 2.388,
                    initial_state="unknown")  # fmt: skip
    problem, _ = made.replicates(1, 1)[0]
    marginal = fit(method, problem).marginal(problem.system.quantity("k_over_m"))
    low, high = marginal.interval(0.9999)
    assert low < 9.0 / 1.3 < high
    assert high / low < 1.0001
