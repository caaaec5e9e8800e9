"""The likelihood of many problems at once: the same numbers as one by one, and exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from bench.config.experiment import expand
from bench.contract.problem import Problem
from bench.likelihood.batching import layout
from bench.likelihood.least_squares import degrees_used
from bench.likelihood.output_error import OutputError

SCENARIOS = (
    ("system=sdof",),
    ("system=sdof", "initial_state=unknown"),
    ("system=sdof_forced",),
    ("system=sdof_forced", "prior=handbook"),
    ("system=sdof_added_mass", "initial_state=unknown"),
    ("system=chain2", "initial_state=unknown"),
    ("system=chain2_first",),
)


def problems(arguments: Sequence[str], n: int = 3) -> list[Problem]:
    """Replicates in their natural units."""
    job = expand(["method=prior", *arguments], multirun=False)[0]
    return [p.expressed_in(p.natural_units()) for p, _ in job.scenario.replicates(job.config.seed, n)]


def batch_at(arguments: Sequence[str]) -> tuple[tuple[OutputError, ...], OutputError, np.ndarray, np.ndarray]:
    """Problems, their batch, two cases of each problem, and a vector near the nominal values for each."""
    models = tuple(OutputError(problem) for problem in problems(arguments))
    rng, cases = np.random.default_rng(5), np.repeat(np.arange(len(models)), 2)
    theta = 0.3 * rng.standard_normal((cases.size, models[0].size))
    theta[:, [i for i, name in enumerate(models[0].free) if name.startswith("k")]] += 3.0
    return models, OutputError.batch(models), cases, theta


@pytest.mark.parametrize("arguments", SCENARIOS)
def test_replicates_of_a_scenario_are_of_one_layout(arguments: Sequence[str]) -> None:
    assert len({layout(problem) for problem in problems(arguments)}) == 1


def test_other_times_forces_or_told_starts_are_another_layout() -> None:
    one, other = problems(["system=sdof"], 1)[0], problems(["system=sdof", "initial_state=unknown"], 1)[0]
    forced, noisy = problems(["system=sdof_forced"], 1)[0], problems(["system=sdof_noise"], 2)
    assert len({layout(one), layout(other), layout(forced), layout(noisy[0]), layout(noisy[1])}) == 5


@pytest.mark.parametrize("arguments", SCENARIOS)
def test_predictions_and_profiles_are_those_of_each_problem_alone(arguments: Sequence[str]) -> None:
    models, batch, cases, theta = batch_at(arguments)
    chosen = batch[cases]
    predicted, slopes = chosen.jacobian(theta)
    np.testing.assert_allclose(chosen.predict(theta), predicted, atol=1e-9 * np.max(np.abs(predicted)))
    profiles = chosen.profile(theta)
    sigma = chosen.noise(chosen.data - predicted, np.full(cases.size, 2.5))
    for i, case in enumerate(cases):
        model = models[case]
        alone, by_differences = model.predict(theta[i]), differences(model, theta[i])
        size = np.max(np.abs(alone))
        np.testing.assert_allclose(predicted[i], alone, atol=1e-9 * size)
        np.testing.assert_allclose(slopes[i], by_differences, atol=1e-6 * np.max(np.abs(by_differences)))
        assert profiles[i] == pytest.approx(model.profile(theta[i]), rel=1e-9)
        np.testing.assert_allclose(sigma[i], model.noise(model.data - alone, 2.5), rtol=1e-9)


def differences(model: OutputError, theta: np.ndarray) -> np.ndarray:
    """Derivatives of the predictions (N, size) by central differences."""
    moves = 1e-5 * np.diag(np.where(np.arange(theta.size) < len(model.free), 1.0, np.maximum(1.0, np.abs(theta))))
    both = model.predict(np.concatenate([theta + moves, theta - moves])).reshape(2, theta.size, -1)
    return np.asarray((both[0] - both[1]).T / (2 * np.diag(moves)))


def test_offsets_and_other_sensors_are_predicted_too() -> None:
    """Measured acceleration with an unknown offset: prediction and derivatives against central differences."""

    def accelerometer(problem: Problem) -> Problem:
        record = problem.records[0]
        return replace(problem, records=(replace(record, channels=(
            replace(record.channels[0], measures="acceleration", offset=True),)),))  # fmt: skip

    plain = problems(["system=sdof_forced", "initial_state=unknown"], 2)
    models = tuple(OutputError(accelerometer(problem)) for problem in plain)
    batch, theta = (
        OutputError.batch(models),
        np.array([[0.1, 0.2, 3.0, 0.5, -1.0, 0.7], [0.0, 0.1, 3.2, 0.4, 1.0, -0.2]]),
    )
    predicted, slopes = batch.jacobian(theta)
    for i, model in enumerate(models):
        alone, by_differences = model.predict(theta[i]), differences(model, theta[i])
        np.testing.assert_allclose(predicted[i], alone, rtol=1e-8)
        np.testing.assert_allclose(slopes[i], by_differences, atol=1e-5 * np.max(np.abs(by_differences)))


@pytest.mark.parametrize("arguments", SCENARIOS[:5])
def test_a_search_ends_where_the_gradient_of_the_posterior_is_nil(arguments: Sequence[str]) -> None:
    models, batch, cases, _ = batch_at(arguments)
    starts = np.array([models[i].vector(_near(models[i])) for i in cases])
    sigma, chosen = np.tile(0.05 * batch.rms[0], (cases.size, 1)), batch[cases]
    reached, end = chosen.search(chosen.point(starts), sigma, 60)
    assert np.all(end.done)
    for i, case in enumerate(cases):
        model, theta = models[case], reached.theta[i]

        def objective(own: np.ndarray, model: OutputError = model, noise: np.ndarray = sigma[i]) -> float:
            r = (model.data - model.predict(own)) / noise[model.channel_of]
            return float(r @ r + np.sum(model.penalty(own) ** 2))

        step = 1e-4
        for direction in np.eye(theta.size):
            moved = [objective(theta + sign * step * direction) for sign in (-1.0, 1.0)]
            slope, bend = (moved[1] - moved[0]) / (2 * step), (sum(moved) - 2 * objective(theta)) / step**2
            assert abs(slope) < 1e-3 * np.sqrt(bend)  # in standard errors: the minimum is no farther than this


def _near(model: OutputError) -> dict[str, float]:
    """The start that the scan of multiple shooting would take first."""
    from methods.starts.candidates import candidates

    return candidates(model, 1)[0]


def test_a_case_that_is_not_finite_stops_no_other() -> None:
    models, batch, cases, _ = batch_at(SCENARIOS[2])
    starts = np.array([models[i].vector(_near(models[i])) for i in cases])
    starts[1, 2] = 80.0  # a stiffness of e^80
    sigma = np.tile(0.05 * batch.rms[0], (cases.size, 1))
    chosen, third = batch[cases], batch[cases[2:3]]
    reached, end = chosen.search(chosen.point(starts), sigma, 60)
    alone, _ = third.search(third.point(starts[2:3]), sigma[2:3], 60)
    assert not np.isfinite(end.point.cost[1])
    np.testing.assert_allclose(reached.theta[2], alone.theta[0], atol=1e-9)


def test_degrees_of_freedom_are_the_trace_of_the_data_s_share() -> None:
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((4, 12, 3))
    data = rows[:, :9]
    expected = [np.trace(d.T @ d @ np.linalg.inv(r.T @ r)) for d, r in zip(data, rows, strict=True)]
    np.testing.assert_allclose(degrees_used(rows, 9), expected)
