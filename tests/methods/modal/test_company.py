"""Modal methods in company: problems of several layouts together, each answered as it would be alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench import Channel, Estimate, Identifier, Problem, Record, Status
from bench.config.experiment import expand
from bench.scenario.scenario import Scenario
from bench.systems import SDOF
from methods.modal.era import ERA
from methods.modal.log_decrement import LogDecrement
from methods.modal.matrix_pencil import MatrixPencil

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
METHODS = [MatrixPencil(bootstrap=40), LogDecrement(bootstrap=40), ERA(bootstrap=40)]
each_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: type(method).__name__)


def replicates(n: int, **fields: object) -> list[Problem]:
    scenario = replace(Scenario("sdof", PLANT, ((0.8,), (0.5,)), 20.0), **fields)  # type: ignore[arg-type]
    return [problem for problem, _ in scenario.replicates(5, n)]


def mixed() -> list[Problem]:
    """Little noise and much, an offset, other times, two masses, a record without motion and one with two levels."""
    plain, times = replicates(3), np.linspace(0.0, 10.0, 25)
    offset = [
        Problem(p.system, (Record((replace(p.records[0].channels[0], offset=True),)),))
        for p in replicates(2, snr_db=30.0)
    ]
    hard = [Channel(times, values) for values in (np.ones(25), np.where(times < 4.0, 1.0, -1.0))]
    job = expand(["method=prior", "system=chain2", "snr=30"], multirun=False)[0]
    chains = [problem for problem, _ in job.scenario.replicates(job.config.seed, 2)]
    loud, longer = replicates(3, snr_db=3.0), replicates(2, samples=60)
    return [*plain, *loud, *offset, *longer, *(Problem(SDOF(), (Record((c,)),)) for c in hard), *chains]


def numbers(estimate: Estimate) -> list[np.ndarray]:
    if estimate.groups is None:
        return []
    covariance = estimate.groups.covariance
    own = [estimate.groups.mean] if covariance is None else [estimate.groups.mean, covariance]
    return [*own, *(response(np.linspace(0.0, 5.0, 7)) for response in estimate.reconstructions)]


@each_method
def test_an_answer_is_the_same_alone_and_in_company(method: Identifier) -> None:
    problems = mixed()
    company = method.identify_many(problems, [np.random.default_rng(i) for i in range(len(problems))])
    for i, (problem, found) in enumerate(zip(problems, company, strict=True)):
        alone = method.identify(problem, np.random.default_rng(i))
        assert (found.status, found.message) == (alone.status, alone.message)
        for one, two in zip(numbers(alone), numbers(found), strict=True):
            np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-9 * np.max(np.abs(one)))
    assert company[0].status is Status.OK


@each_method
def test_parts_that_fit_into_memory_are_as_the_whole(method: Identifier, monkeypatch: pytest.MonkeyPatch) -> None:
    problems = replicates(5)
    whole = method.identify_many(problems, [np.random.default_rng(i) for i in range(5)])
    monkeypatch.setattr("methods.regression.company.MOST_AT_ONCE", 2 * 40 * 25)
    parts = method.identify_many(problems, [np.random.default_rng(i) for i in range(5)])
    for one, two in zip(whole, parts, strict=True):
        for a, b in zip(numbers(one), numbers(two), strict=True):
            np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-9 * np.max(np.abs(a)))
