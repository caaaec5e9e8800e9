"""Coverage of intervals that were corrected by simulated replicas."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np

from bench.commands.declaration import OneOf, Within
from bench.config.schema import Job
from bench.contract.estimate import Status
from bench.contract.problem import Channel, Problem, Record
from bench.entrants.registry import make_method
from bench.likelihood.autoregression import Autoregression
from bench.records.finding import Finding
from bench.records.identification import assess
from bench.records.problem import Measured
from bench.records.replicas import coverage_of, fit_replicas, true_values, widened
from bench.records.request import request_of
from bench.reporting.tables.render import markdown_table
from bench.scenario.truth import closed_form
from bench.scoring.statistics import wilson_interval
from bench.systems.linear import SDOF
from tests.studies.common import Count, study, tracked

METHOD = "output_error"
RATE, RATIO = 2 * math.pi, 0.02
TRUTH = {"m": 1.0, "c": 2 * RATIO * RATE, "k": RATE**2}
SHOWN = ("natural_frequency", "damping_ratio")
KINDS = ("white", "stated", "corrected", "always")


@dataclass(frozen=True)
class Case:
    """A kind of record: its samples a cycle, cycles, signal to noise and the noise's correlation at one sample."""

    title: str
    samples_a_cycle: float
    cycles: float
    snr_db: float
    rho: float = 0.0

    def problem(self, rng: np.random.Generator) -> Problem:
        """Draw a record."""
        times = np.arange(round(self.samples_a_cycle * self.cycles)) / self.samples_a_cycle
        phase = rng.uniform(0, 2 * np.pi)
        motion = closed_form(TRUTH, float(np.cos(phase)), float(RATE * np.sin(phase)), times)
        sigma = float(np.sqrt(np.mean(motion**2))) * 10 ** (-self.snr_db / 20)
        noise = Autoregression(np.array([self.rho]), sigma**2 * (1 - self.rho**2)).drawn(times.size, rng)
        return Problem(SDOF(), (Record((Channel(times, motion + noise, offset=True),)),))


CASES = {
    "few": Case("5 samples a cycle, 20 dB", 5.0, 16.0, 20.0),
    "loud": Case("5 dB", 10.0, 10.0, 5.0),
    "coloured": Case("AR(1) 0.8, 20 dB", 20.0, 8.0, 20.0, 0.8),
}


def found(problem: Problem, seed: int) -> Finding | None:
    """Return the finding of a record, without reasons so that no interval is withdrawn; None without an answer."""
    estimate = make_method(METHOD, {}).identify(problem, np.random.default_rng(seed))
    if estimate.status is not Status.OK:
        return None
    return replace(assess(METHOD, Measured((), problem, ()), estimate), reasons=())


def covers(finding: Finding, replicas: int, job: Job) -> dict[tuple[str, str], bool]:
    """Decide whether the intervals cover the true value, by quantity and kind."""
    assert finding.fit is not None
    answers, truth = (
        fit_replicas(job, finding.fit, finding.problem, range(replicas)),
        true_values(finding.fit, finding.problem),
    )
    covered: dict[tuple[str, str], bool] = {}
    for name in SHOWN:
        quantity, own = finding.problem.system.quantity(name), finding.intervals[name]
        line = coverage_of(quantity, float(quantity.value(truth)), answers, finding)
        stated = (own.record_low, own.record_high)
        kinds = {"white": (own.white_low, own.white_high), "stated": stated, "corrected": stated, "always": stated}
        if line is not None:
            kinds["corrected"] = line.corrected or stated
            kinds["always"] = widened(own.value, *stated, line.widening)
        covered |= {(name, kind): low <= quantity.value(TRUTH) <= high for kind, (low, high) in kinds.items()}
    return covered


def coverage(name: str, records: int, replicas: int, seed: int) -> list[list[str]]:
    """Return the rows of a case."""
    case, told = CASES[name], list[dict[tuple[str, str], bool]]()
    for i in tracked(range(records), "record"):
        rng = np.random.default_rng([seed, *name.encode(), i])
        finding = found(case.problem(rng), i)
        if finding is not None and finding.fit is not None:
            job = request_of({"data": ["x"], "method": [METHOD], "seed": [int(rng.integers(2**31))]}).job
            told.append(covers(finding, replicas, job))
    return rows(case.title, told)


def rows(title: str, told: Sequence[Mapping[tuple[str, str], bool]]) -> list[list[str]]:
    """Coverage with its 95 % interval (Wilson's)."""
    return [[title, name, str(len(told)), *(_share([t[name, kind] for t in told]) for kind in KINDS)] for name in SHOWN]


def _share(held: Sequence[bool]) -> str:
    if not held:
        return "-"
    low, high = wilson_interval(sum(held), len(held))
    return f"{100 * sum(held) / len(held):.0f} % ({100 * low:.0f}-{100 * high:.0f})"


def replicas(
    records: Annotated[Count, "records of each case"] = 100,
    replicas: Annotated[int, Within(ge=20, le=10**6), "replicas of each record"] = 60,
    cases: Annotated[tuple[str, ...], OneOf(tuple(CASES)), "kinds of records"] = tuple(CASES),
    seed: Annotated[int, Within(ge=0), "seed of all records"] = 1,
) -> int:
    """Measure whether intervals that were corrected by simulated replicas cover the true value.

    Free vibrations of 1 Hz with 2 % damping, start and offset unknown, in three hard records: 5 samples a cycle, 5 dB,
    and coloured noise (first order, rho = 0.8) at 20 dB. Of each case many records are made and fitted by output error,
    and of each record replicas. The table shows how often 95 % intervals cover the true value: the method's own, which
    assumes white noise; that of the record; the one that the replicas correct where they show that it is wrong; and the
    one that is always multiplied by the replicas' widening factor.
    """
    table = [row for name in cases for row in coverage(name, records, replicas, seed)]
    print(markdown_table(table, ["record", "quantity", "records", *KINDS]))
    return 0


main = partial(study, replicas, "tests.studies.replicas")

if __name__ == "__main__":
    sys.exit(main())
