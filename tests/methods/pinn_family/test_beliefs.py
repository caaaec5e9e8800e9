"""Ways to state the uncertainty of a fit, against scipy, finite differences, and what is known of each."""

from __future__ import annotations

import pickle
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from bench import Channel, Draws, Estimate, Force, InitialState, Prior, Problem, Record, Status, System, simulate
from bench.systems import SDOF, Chain, Duffing
from methods.pinn_family import PINNFamily

torch = pytest.importorskip("torch")

from methods.pinn.task import Task  # noqa: E402
from methods.pinn_family import nuts, uncertainty  # noqa: E402
from methods.pinn_family.loss import TrainingPath  # noqa: E402
from methods.pinn_family.nuts import Coordinates  # noqa: E402
from methods.pinn_family.training import TrainedFit, TrainedPosterior, train  # noqa: E402
from methods.pinn_family.uncertainty import METHODS  # noqa: E402

TRUE = {"m": 1.7, "c": 0.9, "k": 14.0}
PRIOR = Prior({"m": 1.68, "c": 1.5, "k": 9.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
BEYOND = sorted(METHODS)
QUICK, NUTS = [way for way in BEYOND if way != "nuts"], pytest.param("nuts", marks=pytest.mark.slow)


def problem(noise: float = 0.05, known: bool = True, prior: Prior | None = PRIOR, seed: int = 0) -> Problem:
    times = np.linspace(0.0, 8.0, 25)
    start = InitialState(np.array([0.6]), np.array([-0.8]))
    clean = simulate(SDOF(), TRUE, start, times).displacement[0]
    values = clean + noise * np.random.default_rng(seed).standard_normal(25)
    return Problem(SDOF(), (Record((Channel(times, values),), (), start if known else None),), prior)


def trained(computed: Problem, **settings: Any) -> tuple[TrainedFit, TrainedPosterior]:
    """A fit of the problem in natural units, and the posterior at its end."""
    method = PINNFamily(**settings)
    task = Task(computed.expressed_in(computed.natural_units()), np.random.default_rng(0))
    result, _ = train(task.scaled, task.guesses[0], method, task.rng, TrainingPath(0.0), lambda results: None)
    assert result.attempt is not None
    return result, TrainedPosterior(result.attempt)


def deviation(covariance: np.ndarray, *weights: float) -> float:
    """Standard deviation of a combination of log-parameters m, c, k."""
    return float(np.sqrt(np.array(weights) @ covariance @ np.array(weights)))


K_OVER_M, C_OVER_M = (-1.0, 0.0, 1.0), (-1.0, 1.0, 0.0)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few steps and draws: what is tested is not how good they are."""
    for module, values in (
        (nuts, {"WARMUP": (4, 4), "DRAWS": 6, "DOUBLINGS": 2}),
        (uncertainty, {"VARIATIONAL_STEPS": 20, "VARIATIONAL_DRAWS": 12, "DROPOUT_STEPS": 20, "MASKS": 6}),
    ):
        for name, value in values.items():
            monkeypatch.setattr(module, name, value)
    nuts.compiled.cache_clear()


def little(way: str, **settings: Any) -> PINNFamily:
    if way == "nuts":
        pytest.importorskip("blackjax")
    architecture = {"nuts": "spline", "dropout": "fourier"}.get(way, "tanh")
    few: dict[str, Any] = {"architecture": architecture, "collocation": 60, "width": 16, "members": 3, **settings}
    return PINNFamily(uncertainty=way, **few)


def checked(estimate: Estimate) -> None:
    assert estimate.status is Status.OK, estimate.message
    distribution = estimate.distribution
    assert distribution.finite()
    for quantity in estimate.system.groups:
        marginal = estimate.marginal(quantity)
        low, high = marginal.interval(0.95)
        assert 0.0 < high - low < np.inf
    for record in (pickle.loads(pickle.dumps(estimate)),):
        band = record.bands[0](np.linspace(0.5, 7.5, 40))
        assert np.all(np.isfinite(band))
        assert np.all(band > 0)


@pytest.mark.slow
@pytest.mark.parametrize("way", [*QUICK, NUTS, "ensemble", "bootstrap"])
def test_an_answer_has_intervals_and_a_band_and_hangs_on_the_seed_alone(way: str, brief: None) -> None:
    method, computed = little(way), problem()
    first, again, other = (method.identify(computed, np.random.default_rng(seed)) for seed in (0, 0, 1))
    checked(first)
    quantity = SDOF().quantity("k_over_m")
    low, same, redrawn = (result.marginal(quantity).interval(0.8)[0] for result in (first, again, other))
    assert low == same
    assert low != redrawn
    times = np.linspace(0.0, 8.0, 30)
    np.testing.assert_array_equal(first.bands[0](times), again.bands[0](times))


@pytest.mark.parametrize("way", [*QUICK, NUTS, "ensemble"])
def test_without_prior_and_start_the_groups_are_told(way: str, brief: None) -> None:
    estimate = little(way).identify(problem(known=False, prior=None), np.random.default_rng(0))
    checked(estimate)
    assert estimate.parameters is None
    assert estimate.groups is not None


def forced_chain() -> Problem:
    system = Chain(2)
    times, rng = np.linspace(0.0, 6.0, 40), np.random.default_rng(0)
    true = {name: {"m": 1.0, "c": 0.3, "k": 9.0}[name[0]] for name in system.names}
    force = Force(np.linspace(0.0, 6.0, 200), np.sin(2.5 * np.linspace(0.0, 6.0, 200)))
    start = InitialState(np.zeros(2), np.zeros(2))
    clean = simulate(system, true, start, times, (force,)).displacement
    channels = tuple(
        Channel(times, computed + 0.005 * rng.standard_normal(40), dof=i) for i, computed in enumerate(clean)
    )
    return Problem(system, (Record(channels, (force,), start),), Prior(true, dict.fromkeys(true, 0.3)))


def duffing() -> Problem:
    system: System = Duffing()
    times = np.linspace(0.0, 6.0, 40)
    true = dict(zip(system.names, (1.0, 0.3, 6.0, 4.0), strict=True))
    start = InitialState(np.array([1.0]), np.array([0.0]))
    values = simulate(system, true, start, times).displacement[0]
    values = values + 0.01 * np.random.default_rng(0).standard_normal(40)
    return Problem(system, (Record((Channel(times, values),), (), start),), Prior(true, dict.fromkeys(true, 0.3)))


@pytest.mark.slow
@pytest.mark.parametrize("make", [forced_chain, duffing])
@pytest.mark.parametrize("way", BEYOND)
def test_other_systems_and_an_exact_start_are_served(way: str, make: Any, brief: None) -> None:
    for settings in ({}, {"start": "exact"}):
        estimate = little(way, **settings).identify(make(), np.random.default_rng(0))
        assert estimate.status is Status.OK, estimate.message
        assert estimate.distribution.finite()
        assert np.all(np.isfinite(estimate.bands[0](np.linspace(0.5, 5.5, 40))))


@pytest.mark.parametrize("settings", [{"architecture": "spline"}, {"width": 4, "architecture": "fourier"}])
def test_the_density_is_the_posterior_times_the_volume_of_the_coordinates(settings: dict[str, Any]) -> None:
    """By the Jacobian of u to z, from finite differences; and its slope by finite differences of itself."""
    _, posterior = trained(problem(), collocation=20, budget=400.0, **settings)
    with torch.no_grad():
        coordinates = Coordinates(posterior)
        u = coordinates.first.numpy() + 0.1 * np.random.default_rng(0).standard_normal(coordinates.first.numel())
        value, slope = coordinates.value_and_slope(u)
        moved = np.array([coordinates.point(u + e)[0].numpy() - coordinates.point(u - e)[0].numpy() for e in steps(u)])
        free = np.flatnonzero(np.any(moved != 0, axis=0))
        assert free.size == u.size
        z = coordinates.point(u)
        weights = z[0, free[free < posterior.n_weights]]
        state = posterior.residuals.evaluate(z, posterior.deviations)
        log_posterior = -float(state.loss[0]) - 0.5 * float(weights @ weights)
        volume = np.linalg.slogdet(moved[:, free] / (2.0 * STEP))[1]
        assert value == pytest.approx(log_posterior + volume, abs=1e-3 * max(1.0, abs(volume)))
        other = u + 1e-3 * np.random.default_rng(1).standard_normal(u.size)
        for e in steps(other)[:: max(1, u.size // 12)]:
            value, slope = coordinates.value_and_slope(other)
            rise = coordinates.value_and_slope(other + e)[0] - coordinates.value_and_slope(other - e)[0]
            computed = slope[int(np.argmax(e))]
            assert rise / (2.0 * STEP) == pytest.approx(computed, rel=1e-3, abs=1e-3 * np.abs(slope).max())


STEP = 1e-6


def steps(u: np.ndarray) -> np.ndarray:
    return STEP * np.eye(u.size)


def with_unit_prior(posterior: TrainedPosterior) -> tuple[np.ndarray, np.ndarray]:
    """scipy's mode of the log-parameters, and their covariance by its Jacobian, with a unit prior of the weights."""

    def rows(z: np.ndarray) -> np.ndarray:
        part = posterior.residuals.evaluate(torch.as_tensor(z[None]), posterior.deviations).rows[0].numpy()
        return np.concatenate([part, z[: posterior.n_weights]])

    computed = least_squares(rows, posterior.z[0].numpy(), xtol=1e-12, ftol=1e-12)
    covariance = np.linalg.inv(computed.jac.T @ computed.jac)
    return computed.x[posterior.n_weights :], covariance[posterior.n_weights :, posterior.n_weights :]


@pytest.mark.slow
def test_nuts_draws_are_those_of_the_nearly_normal_posterior_of_a_spline() -> None:
    pytest.importorskip("blackjax")
    nuts.compiled.cache_clear()
    computed, posterior = trained(problem(0.02), architecture="spline", collocation=60)
    mode, covariance = with_unit_prior(posterior)
    with torch.no_grad():
        answer = nuts.sample(posterior, computed, np.random.default_rng(0))
    assert not answer.reason  # chains that have not converged would be said here
    draws = answer.draws
    assert draws.shape == (nuts.CHAINS * nuts.DRAWS, 3)
    for weights in (K_OVER_M, C_OVER_M):
        expected, part = deviation(covariance, *weights), draws @ np.array(weights)
        # of 100 effective draws a mean is known to a tenth of the deviation, and that to 7 %; three times that
        assert abs(part.mean() - mode @ np.array(weights)) < 0.3 * expected
        assert part.std(ddof=1) == pytest.approx(expected, rel=0.22)


@pytest.mark.slow
def test_chains_that_differ_are_said_to() -> None:
    pytest.importorskip("blackjax")
    same = np.random.default_rng(0).standard_normal((2, 150, 3))
    r_hat, effective = nuts._diagnostics(same)
    assert r_hat <= nuts.R_HAT
    assert effective >= nuts.EFFECTIVE
    apart = same + np.array([0.0, 2.0])[:, None, None]
    assert nuts._diagnostics(apart)[0] > nuts.R_HAT
    slow = np.cumsum(same, axis=1)
    assert nuts._diagnostics(slow)[1] < nuts.EFFECTIVE


@pytest.mark.slow
def test_a_chain_too_short_is_not_passed_over_in_silence(brief: None) -> None:
    estimate = little("nuts").identify(problem(), np.random.default_rng(0))
    assert "have not converged" in estimate.message
    assert estimate.traces["r_hat"].shape == (3,)
    assert isinstance(estimate.parameters, Draws)
    assert estimate.parameters.samples.shape == (nuts.CHAINS * nuts.DRAWS, 3)


@pytest.mark.parametrize("known", [True, False])
def test_fixed_hidden_layers_make_no_interval_wider(known: bool) -> None:
    """To condition on some of the unknowns of a normal takes from the variance of the others."""
    computed, posterior = trained(problem(known=known))
    with torch.no_grad():
        part = uncertainty.last_layer(posterior, computed, np.random.default_rng(0))
    for weights in (K_OVER_M, C_OVER_M):
        assert deviation(part.covariance, *weights) <= 1.001 * deviation(computed.covariance, *weights)


def test_last_layer_is_the_linear_models_own() -> None:
    """Against the inverse of JᵀJ over output layer and parameters, J by finite differences of the rows."""
    computed, posterior = trained(problem(), architecture="fourier", width=8, collocation=60)
    with torch.no_grad():
        part = uncertainty.last_layer(posterior, computed, np.random.default_rng(0))
        heads, short = posterior.residuals.heads(posterior.z)

        def rows(z: np.ndarray) -> np.ndarray:
            return heads.evaluate(torch.as_tensor(z[None]), posterior.deviations).rows[0].numpy()

        j = slopes(rows, short[0].numpy())
    expected = np.linalg.inv(j.T @ j)[-3:, -3:]
    for weights in (K_OVER_M, C_OVER_M):
        assert deviation(part.covariance, *weights) == pytest.approx(deviation(expected, *weights), rel=0.01)


def slopes(rows: Any, z: np.ndarray) -> np.ndarray:
    return np.stack([(rows(z + e) - rows(z - e)) / 2e-5 for e in 1e-5 * np.eye(z.size)], 1)


def test_mean_field_has_the_deviations_of_each_unknown_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The independent normals nearest to a normal have the reciprocal roots of the diagonal of its precision: narrower.

    C. Bishop, Pattern Recognition and Machine Learning, 2006, section 10.1.2. The rows are linear in all but products.
    """
    monkeypatch.setattr(uncertainty, "VARIATIONAL_STEPS", 1000)
    computed, posterior = trained(problem(0.02), architecture="spline", collocation=60)
    mode, covariance = with_unit_prior(posterior)
    with torch.no_grad():
        part = uncertainty.variational(posterior, computed, np.random.default_rng(0))

        def rows(z: np.ndarray) -> np.ndarray:
            return posterior.residuals.evaluate(torch.as_tensor(z[None]), posterior.deviations).rows[0].numpy()

        j = slopes(rows, posterior.z[0].numpy())[:, posterior.n_weights :]
    np.testing.assert_allclose(np.sqrt(np.diag(part.covariance)), (j**2).sum(0) ** -0.5, rtol=0.15)
    np.testing.assert_array_equal(part.covariance, np.diag(np.diag(part.covariance)))
    assert part.covariance[2, 2] < 0.5 * covariance[2, 2]
    # the steps of the mean are small beside what is between the trained point and the mode
    assert np.all(np.abs(part.logs - mode) < 2.0 * np.sqrt(np.diag(covariance)))


def test_a_masked_responses_parameters_are_scipys() -> None:
    _, posterior = trained(problem(), architecture="fourier", collocation=60, width=8)
    with torch.no_grad():
        z = posterior.z * uncertainty.random_mask(posterior, np.random.default_rng(1))
        computed = uncertainty.with_best_parameters(posterior, z)[0, posterior.n_weights :].numpy()

        def rows(free: np.ndarray) -> np.ndarray:
            point = z.clone()
            point[0, posterior.n_weights :] = torch.as_tensor(free)
            return posterior.residuals.evaluate(point, posterior.deviations).rows[0].numpy()

        expected = least_squares(rows, z[0, posterior.n_weights :].numpy(), xtol=1e-12, ftol=1e-12).x
    assert np.any(np.abs(computed - z[0, posterior.n_weights :].numpy()) > 1e-3)
    np.testing.assert_allclose(computed, expected, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["last_layer", "variational"])
def test_weights_of_the_training_do_not_enter_the_posterior(way: str) -> None:
    """A training by the paper's weights to the minimum: intervals at the estimated noise all the same."""
    run = partial(PINNFamily, uncertainty=way)
    widths = []
    for method in (run(), run(weighting="paper")):
        marginal = method.identify(problem(), np.random.default_rng(0)).marginal(SDOF().quantity("k_over_m"))
        low, high = marginal.interval(0.68)
        widths.append(high - low)
    assert widths[1] == pytest.approx(widths[0], rel=0.7)
