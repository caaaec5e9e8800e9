"""The process of a method: plain answers out, an exception costs its own replicate only, and nothing of it leaks."""

from __future__ import annotations

import os
import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from misbehaving import misbehave

from bench import Estimate, InitialState, Problem, SimulatedResponse, Status
from bench.contract.problem import Units
from bench.scenario.scenario import Scenario
from bench.sweep.method_process import Task, perform
from bench.sweep.wire import evaluated_together, pack, rebuilt, unpack
from bench.systems import SDOF

TIMES = np.linspace(0.0, 1.0, 5)
BAD = {
    "raise": (Status.CRASHED, "ValueError: two lines of reasons"),
    "memory": (Status.OOM, "out of memory"),
    "type": (Status.CRASHED, "an Estimate was expected, not float"),
    "none": (Status.CRASHED, "an Estimate was expected, not NoneType"),
    "recursion": (Status.CRASHED, "RecursionError"),
    "misshapen": (Status.INVALID, "an array of shape (2) was expected, not (3,)"),
    "wrong_shape": (Status.INVALID, "a reconstruction of shape (1, 5) was expected, not (3,)"),
    "raising_reconstruction": (Status.INVALID, "ValueError: no reconstruction here"),
}


@dataclass(frozen=True)
class ByName:
    """A fit whose payloads are pairs: how to misbehave, and the problem."""

    def __call__(self, payloads: Sequence[tuple[str, Problem]], rngs: Sequence[np.random.Generator]) -> Any:
        return [misbehave(kind, problem) for kind, problem in payloads]


@dataclass(frozen=True)
class Drawn:
    """Fails together, and draws from its stream alone."""

    def __call__(self, payloads: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> Any:
        draws = [float(rng.standard_normal()) for rng in rngs]
        if len(payloads) > 1:
            raise RuntimeError("one at a time, please")
        return [misbehave("good", payloads[0])] if draws[0] == FIRST else None


FIRST = float(np.random.default_rng(0).standard_normal())


@pytest.fixture(scope="module")
def problem(reference: Scenario) -> Problem:
    return reference.replicates(0, 1)[0][0]


def a_task(fit: Any, payloads: Sequence[Any], seed: int | None = None) -> bytes:
    n = len(payloads)
    rngs = tuple(np.random.default_rng(i if seed is None else seed) for i in range(n))
    return pickle.dumps(Task(pickle.dumps(fit), tuple(range(n)), tuple(payloads), rngs, (TIMES,) * n, 600.0))


@pytest.mark.parametrize("kind", BAD)
def test_what_goes_wrong_has_its_status_and_the_good_one_beside_it_is_done(problem: Problem, kind: str) -> None:
    good, bad = perform(a_task(ByName(), [("good", problem), (kind, problem)]))
    status, part = BAD[kind]
    assert Status(bad["status"]) is status
    assert part in bad["message"]
    assert len(bad["message"].splitlines()) == 1
    assert "Traceback" in bad["traceback"]
    estimate = rebuilt(good["answer"], problem.system)
    assert estimate.status is Status.OK
    assert estimate.cost.evaluations == 7
    assert 0 <= good["wall_s"] < 60
    assert good["peak_memory_mb"] >= 0


@pytest.mark.parametrize("kind", ["unpicklable", "trap", "warn", "print"])
def test_what_cannot_be_pickled_or_only_talks_is_no_failure(problem: Problem, kind: str) -> None:
    """Only values of a reconstruction leave the process, whatever it is made of."""
    (outcome,) = perform(a_task(ByName(), [(kind, problem)]))
    estimate = rebuilt(unpack(pack(outcome))["answer"], problem.system)
    assert estimate.status is Status.OK
    for function in estimate.reconstructions:
        assert function(TIMES).shape == (1, 5)
        with pytest.raises(ValueError, match="asked for"):
            function(TIMES + 1.0)


def test_simulated_responses_in_units_of_their_own_are_evaluated_together() -> None:
    """Each is called by itself for comparison; one of another kind beside them leaves all as they are."""
    rng, times = np.random.default_rng(0), np.linspace(0.0, 9.0, 400)
    estimates = []
    for _ in range(3):
        p = dict(zip(("m", "c", "k"), rng.uniform(0.5, 2.0, 3), strict=True))
        response = SimulatedResponse(SDOF(), p, InitialState(rng.normal(size=1), rng.normal(size=1)))
        units = Units(*rng.uniform(0.5, 2.0, 3))
        estimates.append(Estimate(SDOF(), reconstructions=(response,)).expressed_in(units))
    for before, after in zip(estimates, evaluated_together(estimates, [times] * 3), strict=True):
        assert after is not before
        np.testing.assert_allclose(after.reconstructions[0](times), before.reconstructions[0](times), atol=1e-12)
    others = [*estimates, Estimate(SDOF(), reconstructions=(np.atleast_2d,))]
    assert evaluated_together(others, [times] * 4) is others


def test_a_second_try_has_the_random_streams_of_the_first(problem: Problem) -> None:
    """The fit draws before it fails; tried one by one, it must meet the first number of each stream again."""
    outcomes = perform(a_task(Drawn(), [problem, problem], seed=0))
    assert ["answer" in outcome for outcome in outcomes] == [True, True]


def test_only_plain_content_is_unpacked() -> None:
    content = {"a": (1, 2.5, "x", None, True), "b": np.arange(3.0)}
    same = unpack(pack(content))
    assert same["a"] == content["a"]
    assert np.array_equal(same["b"], content["b"])
    for foreign in (os.system, Problem, BAD["raise"][0]):
        with pytest.raises(pickle.UnpicklingError, match="is not plain"):
            unpack(pickle.dumps(foreign))
