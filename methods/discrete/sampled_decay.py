"""What the methods on the difference equation of one free decay share: their problems, bootstrap and last check."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Estimate, InputError, Problem, Serves
from methods.discrete.difference import unlike_the_record
from methods.modal.even_steps import unevenness
from methods.modal.free_decay import SERVES, Reading, decay_estimates, decay_objection, has_offset
from methods.starts.ambiguity import BandIdentifier

LEAST, LEAST_WITH_OFFSET = 5, 7
"""Samples: amplitude and rate of each exponential, an offset, and one or two for the noise."""


@dataclass(frozen=True)
class SampledDecay(BandIdentifier):
    """A free decay at even steps; ``bootstrap`` records are drawn for the covariance, 0 for none."""

    bootstrap: int = 100

    version: ClassVar[int] = 2
    """2: where noise turns the fast pole of an overdamped decay, two real poles are fitted."""
    serves: ClassVar[Serves] = SERVES
    works_in = "natural units"

    def __post_init__(self) -> None:
        if self.bootstrap < 0:
            raise InputError("method.bootstrap", self.bootstrap, "a number of records, 0 for no uncertainty")

    @abstractmethod
    def reading(self) -> Reading:
        """How k/m and c/m are read from samples."""

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or decay_objection(problem) or _sampling_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the groups k/m and c/m; ``diverged`` with a sentence where there is no oscillator to read."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together."""
        answers = decay_estimates(problems, rngs, self.reading())
        return [unlike_the_record(problem, answer) for problem, answer in zip(problems, answers, strict=True)]


def _sampling_objection(problem: Problem) -> str | None:
    times = problem.records[0].channels[0].times
    least = LEAST_WITH_OFFSET if has_offset(problem) else LEAST
    if times.size < least:
        return f"it needs at least {least} samples a record; sample it faster"
    return unevenness(times)
