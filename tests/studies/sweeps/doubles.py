"""Methods that stand in for real ones where only the harness is measured."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card, Estimate, Identifier, Normal, Problem, Serves

CARD = Card("a stand-in", "not used", "groups", "simulated", "none", "studies")


def answer(problem: Problem) -> Estimate:
    """Ones, without uncertainty."""
    names = tuple(group.name for group in problem.system.groups)
    return Estimate(problem.system, groups=Normal(names, np.ones(len(names)), None, log=False))


@dataclass(frozen=True)
class Empty(Identifier):
    """Takes no time at all."""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return answer(problem)


def burn(seconds: float) -> None:
    """Use so much processor time."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        sum(range(1000))


@dataclass(frozen=True)
class Busy(Identifier):
    """Takes a stated processor time, and answers with a number from its random stream."""

    seconds: float = 0.5

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        burn(self.seconds)
        found = answer(problem)
        assert found.groups is not None
        found.groups.mean[:] = np.exp(rng.normal(2.0, 0.1, found.groups.mean.size))
        return found
