"""Problems solved together: as alone, as by shooting, and left to shooting where no maximum is found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from bench import OutputError, Problem
from bench.config.experiment import expand
from bench.contract.estimate import Status

pytest.importorskip("casadi")
from methods.trajectory import shooting
from methods.trajectory.shooting import Shooting


def problems(arguments: Sequence[str], n: int) -> list[Problem]:
    """Replicates, in SI units."""
    job = expand(["method=prior", *arguments], multirun=False)[0]
    return [problem for problem, _ in job.scenario.replicates(job.config.seed, n)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "n"),
    [(["system=chain2_forced", "snr=20"], 6), (["system=pendulum", "snr=5"], 3), (["system=coulomb", "snr=40"], 3)],
)
def test_the_maximum_is_at_least_as_high_as_shooting_s(arguments: Sequence[str], n: int) -> None:
    """Two masses under a force, where searches go astray, and others: the log-posteriors of both, at their ends."""
    given = problems(arguments, n)
    models = [OutputError(problem.expressed_in(problem.natural_units())) for problem in given]
    computed = Shooting().maxima(models)
    method = Shooting()
    for model, solution in zip(models, computed, strict=True):
        other = method.estimate(model.problem, np.random.default_rng(0))
        reference = model.profile(model.vector(dict(zip(model.free, np.exp(other.parameters.mean), strict=True))))
        assert model.profile(solution.theta) < reference + 0.01


def test_a_search_that_does_not_end_is_left_to_shooting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shooting, "MOST_ITERATIONS", 0)
    given = problems(["snr=20", "prior=none", "initial_state=unknown"], 2)
    models = [OutputError(problem.expressed_in(problem.natural_units())) for problem in given]
    assert Shooting(screen_iterations=1).maxima(models) == [None, None]
    answers = Shooting(screen_iterations=1).identify_many(given, [np.random.default_rng(0) for _ in given])
    assert [answer.status for answer in answers] == [Status.OK, Status.OK]


def test_a_long_record_of_a_nonlinear_system_is_left_to_shooting() -> None:
    """A single trajectory from a start that is a little off loses count of the cycles."""
    problem = problems(["system=duffing", "system.samples=301"], 1)[0]
    assert Shooting().maxima([OutputError(problem.expressed_in(problem.natural_units()))]) == [None]


def test_a_critically_damped_oscillator_is_solved() -> None:
    """A repeated pole: modes would be defective."""
    given = problems(["snr=40", "system.parameters.c=5.656854249492381"], 3)  # 2 sqrt(k m), k = 8 N/m and m = 1 kg
    models = [OutputError(problem.expressed_in(problem.natural_units())) for problem in given]
    assert all(solution is not None for solution in Shooting().maxima(models))
    answers = Shooting().identify_many(given, [np.random.default_rng(0) for _ in given])
    for problem, answer in zip(given, answers, strict=True):
        marginal = answer.marginal(problem.system.quantity("k_over_m"))
        assert marginal.value == pytest.approx(8.0, rel=0.05)


def test_full_matrices_are_identified() -> None:
    """A scan begins with equal entries of the mass matrix, which are singular: the regression must do."""
    given = problems(["system=matrices", "snr=60"], 2)
    true_values = (1.0, 0.2, 0.8, 0.6, 0.1, 0.3, 20.0, 8.0, 9.0)
    for problem, answer in zip(given, Shooting().identify_many(given, [np.random.default_rng(0)] * 2), strict=True):
        assert answer.status is Status.OK, answer.message
        for name, true in zip(problem.system.names, true_values, strict=True):
            marginal = answer.marginal(problem.system.quantity(name))
            assert marginal.value == pytest.approx(true, rel=0.02)
