"""What crosses between the processes: plain answers out, several replicates that fail together, units, pickles."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pickle import UnpicklingError, dumps
from typing import Any

import numpy as np
import pytest
from misbehaving import misbehave

from bench import Estimate, InitialState, Normal, Problem, SimulatedResponse, Status
from bench.contract.problem import Units
from bench.engine.method_process import FitTask, outcomes, perform
from bench.engine.wire import evaluated_together, pack, plain, unpack
from bench.scenario.scenario import Scenario
from bench.systems import SDOF

TIMES = np.linspace(0.0, 1.0, 5)


@dataclass(frozen=True)
class ByName:
    """A fit whose payloads are pairs: how to misbehave, and the problem."""

    def __call__(self, payloads: Sequence[tuple[str, Problem]], rngs: Sequence[np.random.Generator]) -> Any:
        return [misbehave(kind, problem) for kind, problem in payloads]


@pytest.fixture(scope="module")
def problem(reference: Scenario) -> Problem:
    return reference.replicates(0, 1)[0][0]


def performed(problem: Problem, *kinds: str) -> list[dict[str, Any]] | None:
    n = len(kinds)
    rngs = tuple(np.random.default_rng(i) for i in range(n))
    payloads = tuple((kind, problem) for kind in kinds)
    packed = perform(FitTask(dumps(ByName()), tuple(range(n)), payloads, rngs, (TIMES,) * n, 600.0))
    return None if packed is None else unpack(packed)  # type: ignore[no-any-return]


@pytest.mark.parametrize("kind", ["raise", "none"])
def test_replicates_that_fail_together_have_no_answer_and_one_alone_says_why(problem: Problem, kind: str) -> None:
    assert performed(problem, "good", kind) is None
    (outcome,) = performed(problem, kind) or []
    assert outcome["status"] == Status.CRASHED
    assert "Traceback" in outcome["traceback"]


def test_an_answer_against_the_contract_costs_its_own_replicate_alone(problem: Problem) -> None:
    good, bad = performed(problem, "good", "wrong_shape") or []
    assert (bad["status"], bad["message"].partition(":")[0]) == ("invalid", "the estimate cannot be scored")
    assert (good["answer"].status, good["answer"].cost.evaluations) == (Status.OK, 7)
    assert 0 <= good["wall_s"] < 60
    assert good["peak_memory_mb"] >= 0


@pytest.mark.parametrize("kind", ["unpicklable", "trap", "warn", "print"])
def test_only_values_of_a_reconstruction_leave_the_process(problem: Problem, kind: str) -> None:
    (outcome,) = performed(problem, kind) or []
    assert outcome["answer"].status is Status.OK
    for function in outcome["answer"].reconstructions:
        assert function(TIMES).shape == (1, 5)
        with pytest.raises(ValueError, match="requested times"):
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


def test_only_plain_content_is_unpacked(problem: Problem) -> None:
    content: dict[str, Any] = {"a": (1, 2.5, "x", None, True), "b": np.arange(3.0)}
    same = unpack(pack(content))
    assert same["a"] == content["a"]
    assert np.array_equal(same["b"], content["b"])
    for foreign in (os.system, Problem, SDOF(), replace(Estimate(SDOF()), reconstructions=(np.sin,))):
        with pytest.raises(UnpicklingError, match="is not plain"):
            unpack(dumps(foreign))


def test_times_lie_within_those_that_were_seen() -> None:
    """A report within what was seen is kept; one below, above, or no number gives way to the share of what was seen."""
    reports = [(-0.4, 0.0), (float("nan"), -1e9), (7.0, float("inf")), (0.55, 0.26)]
    said = [{"replicate": i, "wall_s": wall, "cpu_s": cpu} for i, (wall, cpu) in enumerate(reports)]
    together = outcomes(pack((2.0, 1.0, 2.5, pack(said))))
    assert [outcome["wall_s"] for outcome in together] == [0.5, 0.5, 0.5, 0.55]
    assert [outcome["cpu_s"] for outcome in together] == [0.25, 0.25, 0.25, 0.26]
    assert outcomes(pack((0.0, 0.0, 9.0, pack([{"replicate": 0}])))) == [{"replicate": 0}]


def test_alternatives_pass_between_the_processes_and_their_weights_must_add_up(problem: Problem) -> None:
    logs = Normal(("m", "c", "k"), np.zeros(3), np.eye(3), log=True)
    other = Estimate(problem.system, parameters=replace(logs, mean=np.ones(3)), weight=0.25)
    estimate = Estimate(problem.system, parameters=logs, alternatives=(other,), weight=0.75)
    passed = unpack(pack(plain(estimate, TIMES)))
    assert [part.weight for part in (passed, *passed.alternatives)] == [0.75, 0.25]
    np.testing.assert_array_equal(passed.alternatives[0].parameters.mean, np.ones(3))
    with pytest.raises(ValueError, match="add up to 1"):
        plain(replace(estimate, weight=1.0), TIMES)
