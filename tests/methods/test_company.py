"""Methods in company: problems of several layouts together, each answered as it would be alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench import Channel, Estimate, Identifier, Normal, Problem, Record, Status
from bench.config.experiment import expand
from bench.scenario.scenario import Scenario
from bench.systems import SDOF
from methods.modal.era import ERA
from methods.modal.log_decrement import LogDecrement
from methods.modal.matrix_pencil import MatrixPencil
from methods.regression.ls import LS
from methods.regression.rls import RLS
from methods.trajectory.output_error import SingleShooting
from methods.trajectory.shooting import Shooting

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
METHODS = {
    "matrix_pencil": MatrixPencil(bootstrap=40),
    "log_decrement": LogDecrement(bootstrap=40),
    "era": ERA(bootstrap=40),
    "ls": LS(bootstrap=40),
    "ls_spline": LS(derivative="spline", bootstrap=40),
    "rls": RLS(bootstrap=40),
    "output_error": SingleShooting(),
    "shooting": Shooting(),
}
ALIKE = ("ls_spline", "rls", "shooting")
"""Methods whose tests are slow, since others with the same code are tested quickly."""
SEARCHES = ("output_error", "shooting")
"""Their fits take long: fewer problems."""


def replicates(n: int, **fields: object) -> list[Problem]:
    scenario = replace(Scenario("sdof", PLANT, ((0.8,), (0.5,)), 20.0), **fields)
    return [problem for problem, _ in scenario.replicates(5, n)]


def configured(*arguments: str) -> list[Problem]:
    job = expand(["method=prior", "snr=30", *arguments], multirun=False)[0]
    return [problem for problem, _ in job.scenario.replicates(job.config.seed, 2)]


def mixed() -> list[Problem]:
    """Little noise and much, unknown starts, other times, offsets, records without motion or of two levels, forces, two
    masses, a system that is not linear.
    """
    times = np.linspace(0.0, 10.0, 25)
    offset = [
        Problem(p.system, (Record((replace(p.records[0].channels[0], offset=True),)),))
        for p in replicates(2, snr_db=30.0)
    ]
    hard = [Channel(times, values) for values in (np.ones(25), np.where(times < 4.0, 1.0, -1.0))]
    names = ("chain2", "chain2_forced", "sdof_forced", "duffing")
    return [
        *replicates(3),
        *replicates(3, snr_db=3.0),
        *replicates(2, initial_state="unknown"),
        *replicates(2, samples=60),
        *offset,
        *(Problem(SDOF(), (Record((channel,)),)) for channel in hard),
        *(problem for name in names for problem in configured(f"system={name}")),
    ]


def numbers(estimate: Estimate) -> list[np.ndarray]:
    """Mean, covariance, reconstructions and traces."""
    distribution = estimate.distribution
    if distribution is None:
        return []
    assert isinstance(distribution, Normal)
    computed = [distribution.mean] if distribution.covariance is None else [distribution.mean, distribution.covariance]
    responses = [response(np.linspace(0.0, 5.0, 7)) for response in estimate.reconstructions]
    return [*computed, *responses, *estimate.traces.values()]


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in ALIKE)) for name in METHODS])
def test_an_answer_is_the_same_alone_and_in_company(name: str) -> None:
    method: Identifier = METHODS[name]
    problems = mixed()[2:8:2] + configured("system=duffing") if name in SEARCHES else mixed()
    company = method.identify_many(problems, [np.random.default_rng(i) for i in range(len(problems))])
    for i, (problem, computed) in enumerate(zip(problems, company, strict=True)):
        alone = method.identify(problem, np.random.default_rng(i))
        assert (computed.status, computed.message) == (alone.status, alone.message)
        for first, two in zip(numbers(alone), numbers(computed), strict=True):
            np.testing.assert_allclose(two, first, rtol=1e-9, atol=1e-9 * np.max(np.abs(first)))
    assert company[0].status is Status.OK
