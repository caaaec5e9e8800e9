"""What the three methods share: their settings and the order of a fit."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Estimate, InputError, Problem, Serves
from methods.rivals.decay import Decay, decay_of, objection
from methods.rivals.guests import quiet
from methods.rivals.path import Path
from methods.starts.ambiguity import SearchingIdentifier

ADAM_SHARE = 0.3
"""Of the processor time of the training; the second optimiser has the rest."""


@dataclass(frozen=True)
class Rival(SearchingIdentifier):
    """Train by ``adam_steps`` of Adam, then ``second_steps`` of a second optimiser (0: as many as there is time for).

    Neither stage takes more than its part of ``seconds`` of processor time, 30 % for Adam; a stage that the clock ends
    is not the same twice.
    """

    seconds: float = 120.0
    adam_steps: int = 3000
    second_steps: int = 3000

    serves: ClassVar[Serves] = Serves(forced=False, nonlinear=False)
    extra: ClassVar[str] = "rivals"
    works_in = "natural units"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.seconds) and self.seconds > 0):
            raise InputError("method.seconds", self.seconds, "a positive number of seconds")
        for name in ("adam_steps", "second_steps"):
            if getattr(self, name) < 0:
                raise InputError(f"method.{name}", getattr(self, name), "a number of steps, 0 for no limit")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the groups k/m and c/m, without uncertainty.

        Raises NoEstimate where the training runs to numbers that are not finite.
        """
        path = Path(problem)
        with quiet():
            return self.train(decay_of(problem), path, int(rng.integers(2**31)))

    @property
    def stages(self) -> tuple[float, float]:
        """Seconds of the two stages."""
        return ADAM_SHARE * self.seconds, (1.0 - ADAM_SHARE) * self.seconds

    @abstractmethod
    def train(self, decay: Decay, path: Path, seed: int) -> Estimate:
        """Drive the package from the start to the answer."""


@dataclass(frozen=True)
class TorchRival(Rival):
    """One whose package computes with torch, on so many ``threads``."""

    threads: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.threads < 1:
            raise InputError("method.threads", self.threads, "at least 1")
