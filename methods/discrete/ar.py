"""Autoregression of order two: the difference equation of a sampled free decay, by least squares.

``x_j = a₁ x_(j-1) + a₂ x_(j-2)`` is solved for a₁ and a₂ over all samples (the least-squares form of Prony's method:
S. M. Kay, Modern Spectral Estimation, 1988, section 11.4), and its roots are turned into k/m and c/m
(:mod:`methods.discrete.difference`).

This is the plain form that textbooks give and people run, and it has their bias. The columns are measured too: their
noise (errors in variables; T. Söderström, Automatica 43:939, 2007) draws the coefficients towards zero, the more the
more samples a cycle there are, since then two neighbours differ by little else than noise. The estimate is biased
at any length of record, towards too much damping above all. ``iqml`` removes that bias.

Told: the samples, at even steps. The start, the prior and the noise level are not used. The uncertainty is a parametric
bootstrap's spread, which does not hold the bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card, Estimate, Identifier, InputError, Problem, Serves
from methods.discrete.difference import (
    NO_OSCILLATOR,
    equations,
    groups_of,
    sampling_objection,
    step_of,
    unlike_the_record,
)
from methods.modal.free_decay import SERVES, Reading, decay_estimates
from methods.regression.equation import solve


@dataclass(frozen=True)
class AR(Identifier):
    """Autoregression of order two by least squares; ``bootstrap`` records are drawn for the covariance, 0 for none."""

    bootstrap: int = 100

    card: ClassVar[Card] = Card(
        summary="autoregression of order two: least squares on the difference equation of the sampled free decay",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only, not the bias of noisy columns",
        settings_source="order 2: two exponentials of one mass",
        tuning="none",
        title="AR, least squares",
        order=200,
        colour="#8C6D31",
        marker="<",
    )
    serves: ClassVar[Serves] = SERVES
    works_in = "natural units"

    def __post_init__(self) -> None:
        if self.bootstrap < 0:
            raise InputError("method.bootstrap", self.bootstrap, "a number of records, 0 for no uncertainty")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or sampling_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the groups k/m and c/m; ``diverged`` with a sentence where the roots are no oscillator's."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together."""
        answers = decay_estimates(problems, rngs, Reading(_read, NO_OSCILLATOR, self.bootstrap))
        return [unlike_the_record(problem, answer) for problem, answer in zip(problems, answers, strict=True)]


def _read(times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
    return groups_of(solve(*equations(sets, offset)), step_of(times))
