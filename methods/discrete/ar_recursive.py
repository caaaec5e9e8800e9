"""Autoregression of order two by recursive least squares: the coefficients after each sample of a free decay.

The regression is that of ``ar`` (:mod:`methods.discrete.ar`), its bias included, taken one sample at a time by the
update of ``rls`` (:func:`methods.regression.rls.recursive_least_squares`). Unlike ``rls`` it differentiates nothing.
It starts from nothing: zero coefficients and a diffuse covariance, ``diffuse`` times the identity in the problem's
natural units (displacement of order one). Since the parameters do not move, the forgetting factor is 1: the last
estimate is that of ``ar``, to the diffuse start. Below 1 it follows parameters that move, and costs precision here.

Told: the samples, at even steps. The start, the prior and the noise level are not used. The uncertainty is a parametric
bootstrap's spread. The trace ``trajectory`` keeps k/m and c/m after each sample from the third (n_samples - 2, 2), NaN
where the roots are no oscillator's yet, ``trajectory_times`` its times (s).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bench import Card, Dimension, Estimate, Problem, Status
from methods.discrete.difference import NO_OSCILLATOR, equations, groups_of
from methods.discrete.sampled_decay import SampledDecay
from methods.modal.even_steps import step_of
from methods.modal.free_decay import Reading, has_offset
from methods.regression.rls import RLS, recursive_least_squares


@dataclass(frozen=True)
class ARRecursive(SampledDecay):
    """The regression of ``ar``, recursively; ``forgetting`` and ``diffuse`` as above.

    ``bootstrap`` records are drawn for the covariance, 0 for none.
    """

    forgetting: float = 1.0
    diffuse: float = 1e6

    card: ClassVar[Card] = Card(
        summary="autoregression of order two by recursive least squares, sample by sample",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only, not the bias of noisy columns",
        settings_source="forgetting 1: the parameters do not move; diffuse: large against 1, as that of RLS",
        tuning="none",
        title="AR, recursive",
        order=210,
        colour="#BD9E39",
        marker=">",
    )

    def __post_init__(self) -> None:
        RLS(self.forgetting, self.diffuse)  # which refuses what its recursion does not take
        super().__post_init__()

    def reading(self) -> Reading:
        return Reading(self._read, NO_OSCILLATOR, self.bootstrap)

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together, with the way to each answer."""
        answers = super().estimate_many(problems, rngs)
        return [self._with_trace(problem, answer) for problem, answer in zip(problems, answers, strict=True)]

    def _read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        return self._path(times, sets, offset)[-1]

    def _path(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        """k/m and c/m after each sample from the third, (n - 2, sets, 2)."""
        path = recursive_least_squares(*equations(sets, offset), self.forgetting, self.diffuse, 1)
        return groups_of(path, step_of(times))

    def _with_trace(self, problem: Problem, answer: Estimate) -> Estimate:
        """The answer with its way there, in the system's own order of its groups."""
        if answer.status is not Status.OK or answer.groups is None:
            return answer
        channel = problem.records[0].channels[0]
        path = self._path(channel.times, channel.values[None], has_offset(problem))[:, 0]
        system = problem.system
        stiffness = next(p.name for p in system.parameters if p.kind == "stiffness")
        if stiffness not in system.groups[0].exponents:
            path = path[:, ::-1]
        dimensions = {
            "trajectory": [system.dimension(group) for group in system.groups],
            "trajectory_times": [Dimension(time=1.0)],
        }
        return replace(
            answer, traces={"trajectory": path, "trajectory_times": channel.times[2:]}, dimensions=dimensions
        )
