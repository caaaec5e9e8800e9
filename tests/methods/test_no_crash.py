"""Data on which a method once raised: a fit that goes wrong is an estimate with a status and a sentence."""

import numpy as np
import pytest

from bench import Channel, Estimate, Problem, Record, Status
from bench.config.experiment import expand
from bench.entrants.registry import make_method
from bench.systems import SDOF
from methods.regression.equation import _shortest


def _problem(*overrides: str, replicate: int = 0) -> Problem:
    cell = expand(["method=oracle", *overrides], multirun=False)[0].cell()
    return cell.scenario.replicates(cell.seed, replicate + 1)[replicate][0]


def _fit(method: str, problem: Problem) -> Estimate:
    return make_method(method, {}).identify(problem, np.random.default_rng(0))


def test_a_step_along_a_response_too_large_to_square():
    """Of three sets one has slopes whose products overflow: no step there; ``J s = r`` gives 2 in the others."""
    jacobian = np.ones((3, 4, 1))
    jacobian[1] = 1e200
    step = _shortest(jacobian, 2.0 * np.ones((3, 4)))
    assert step[:, 0] == pytest.approx([2.0, 0.0, 2.0])


def test_sample_times_that_nearly_coincide():
    """Most samples within a millionth of the record: a spline through them is not determined, or fits; it is said."""
    times = np.sort(np.concatenate([np.linspace(0, 1e-6, 20), np.linspace(0.1, 10.0, 6)]))
    values = np.cos(2.8 * times) * np.exp(-0.2 * times)
    problem = Problem(SDOF(), (Record((Channel(times, values),)),))
    for method in ("ls", "sindy"):
        estimate = _fit(method, problem)
        assert estimate.status in (Status.OK, Status.DIVERGED, Status.UNSUPPORTED)
        assert estimate.status is Status.OK or estimate.message


def test_a_regression_objects_to_a_residual_that_is_not_affine():
    """The pendulum's length stands inside a sine."""
    problem = _problem("system=pendulum")
    for method in ("ddnn", "ls", "sindy"):
        assert "affine" in str(make_method(method, {}).objection(problem))


def test_output_error_says_that_its_search_ran_away():
    """The first of two masses, start unknown, no prior: two directions are open, and the mass matrix gets singular."""
    for replicate in range(3):
        problem = _problem("system=chain2_first", "initial_state=unknown", "prior=none", replicate=replicate)
        estimate = _fit("output_error", problem)
        assert estimate.status is Status.OK or estimate.message
