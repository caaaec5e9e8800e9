"""Common parts of the PINN and of spline collocation: from a Problem to fits and to an Estimate.

The loss is minus the log posterior for any ansatz of x(t):

- **Weights of the terms** follow from the estimated noise. The physics is a nearly hard constraint: the equation has a
  white error whose effect over the record is a fraction ``slack`` of the measurement noise (weak-constraint data
  assimilation: Tremolet, Q. J. R. Meteorol. Soc. 132:2483, 2006). For smooth motions, multipliers finally remove the
  remaining violation.
- **Optimiser**: Levenberg-Marquardt (:mod:`methods.pinn.levenberg`) with soft physics before hard, the output layer
  before all layers, and initial log-parameters of the damped wave that fits the data best.
- **A known force** adds functions to the ansatz of x(t), since steps, pulses and rough forces require an acceleration
  that no smooth function has (:mod:`methods.starts.forced_motion`).
- **Undetermined parameters**: with a known force or an added mass there may be no prior, and noise may hide a damping,
  whose likelihood then rises towards zero. Such a record is fitted again with a very wide prior, with a message.
- **Hidden states** are additional paths of the ansatz, with equations for their rates.
- **A bad basin** is detected by residuals more than twice those of damped waves. The fit is then restarted elsewhere,
  at most ``restarts`` times, and the best result kept (:mod:`methods.pinn.task`).

Uncertainty (``uncertainty=``): ``laplace``, covariance from the linearisation at the solution with the coefficients
profiled out; ``ensemble``, spread over ``members`` random initialisations, as in the paper; ``bootstrap``, spread over
fits to ``members`` records simulated from the fitted response with the estimated noise. Intervals use Student's t with
N - p degrees of freedom, those of the ensemble with ``members`` - 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from bench import (
    EVERY_PROBLEM,
    Cost,
    Estimate,
    InitialState,
    Normal,
    Problem,
    Scope,
    Status,
    report_progress,
)
from methods.network.response import Band, Function
from methods.pinn.settings import PhysicsSettings
from methods.pinn.task import Fit, Task, channels_of, cycles, degrees_of_freedom, free_parameters, resolution, simulated
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.waves import Guess

VIOLATED = 2.0
"""Violation of the equation of motion, in standard deviations of a parameter, from which an answer warns."""


@dataclass(frozen=True)
class PhysicsInformed(PhysicsSettings, SearchingIdentifier):
    """Base of methods that fit data and physics jointly; see the module."""

    parts: ClassVar[Mapping[str, int]] = {**SearchingIdentifier.parts, "forces": 2}
    scope: ClassVar[Scope] = EVERY_PROBLEM
    requires: ClassVar[tuple[str, ...]] = ("torch",)
    extra: ClassVar[str] = "torch"
    works_in = "natural units"

    @property
    def problems_at_once(self) -> int:
        """Return ``batch``, or 1 where the members of an ensemble or bootstrap fill the batch."""
        return self.batch if self.uncertainty == "laplace" else 1

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Fit one problem; status ``nonfinite`` where all fits fail."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Fit all problems in batches of the same structure; results do not depend on the batch."""
        if self.device != "cpu" and not _has_device(self.device):
            sentence = f"device={self.device} is not available; use device=cpu"
            return [Estimate.failed(problem.system, Status.INVALID, sentence) for problem in problems]
        tasks = [Task(problem, rng) for problem, rng in zip(problems, rngs, strict=True)]
        self.attempt(tasks)
        opened = [task for task in tasks if task.open]
        for task in opened:
            task.hold()
        self.attempt(opened)
        if self.uncertainty != "laplace":
            for task in tasks:
                self._resample(task)
        return [self._estimate(task) for task in tasks]

    def objection(self, problem: Problem) -> str | None:
        if problem.system.n_hidden and self.start == "exact":
            return "start=exact does not support hidden states; use start=penalty"
        return super().objection(problem)

    def attempt(self, tasks: Sequence[Task]) -> None:
        """Fit each task, and restart those in a bad basin elsewhere."""
        from methods.pinn.block import structure

        for n in range(1 + self.restarts):
            groups: dict[object, list[Task]] = {}
            for task in tasks:
                if task.wants(n):
                    key = structure(task.scaled), resolution(cycles(task.scaled, task.guesses[n]))
                    groups.setdefault(key, []).append(task)
            for group in groups.values():
                guesses = [task.guesses[n] for task in group]
                fits = self._fit([task.scaled for task in group], guesses, [task.rng for task in group], group)
                for task, fit in zip(group, fits, strict=True):
                    task.fits.append(fit)

    def _fit(
        self,
        problems: Sequence[Problem],
        guesses: Sequence[Guess],
        rngs: Sequence[np.random.Generator],
        tasks: Sequence[Task] = (),
    ) -> list[Fit]:
        """Fit problems of one structure in batches, and report the progress of ``tasks``."""
        from methods.pinn import engine

        fits: list[Fit] = []
        for first in range(0, len(problems), self.batch):
            chunk = slice(first, first + self.batch)
            report = partial(self._report, tasks[chunk])
            fits += engine.fit(problems[chunk], guesses[chunk], self, rngs[chunk], report)
        return fits

    def _report(self, tasks: Sequence[Task], results: Callable[[], list[Fit]]) -> None:
        """Report the current estimates."""
        for i, task in enumerate(tasks):
            report_progress(task.problem, lambda i=i, task=task: self._estimate(task.with_fit(results()[i])))  # type: ignore[misc]

    def _resample(self, task: Task) -> None:
        """Fit an ensemble or a bootstrap, whose spread replaces the linearised uncertainty."""
        best = task.best
        if best is None:
            return
        problems = [
            simulated(task.scaled, best, task.rng) if self.uncertainty == "bootstrap" else task.scaled
            for _ in range(self.members)
        ]
        guess = task.guesses[task.fits.index(best)]
        fits = self._fit(problems, [guess] * self.members, task.rng.spawn(self.members))
        task.members = [fit for fit in fits if np.all(np.isfinite(fit.logs))]

    def _estimate(self, task: Task) -> Estimate:
        problem, best = task.scaled, task.best
        every = [*task.given_up, *task.fits]
        cost = Cost(sum(fit.evaluations for fit in every), sum(fit.iterations for fit in every))
        if best is None:
            sentence = "no fit is finite; increase restarts, or check the record for outliers"
            return Estimate.failed(problem.system, Status.NONFINITE, sentence, cost)
        starts = [
            record.initial_state or InitialState(*start)
            for record, start in zip(problem.records, best.starts, strict=True)
        ]
        has_offset = np.array([channel.offset for channel in channels_of(problem)])
        offsets = np.zeros(has_offset.size)
        offsets[has_offset] = best.offsets
        return Estimate(
            problem.system,
            **self._distribution(task, best),
            reconstructions=best.responses,
            bands=self._bands(task, best),
            initial_states=tuple(starts),
            offsets=tuple(map(float, offsets)) if has_offset.any() else None,
            message="; ".join(filter(None, self._remarks(task, best))),
            cost=cost,
            traces=best.history,
        )

    def _remarks(self, task: Task, best: Fit) -> list[str]:
        """Return what is to be known about a fit; nothing about one that converged to a response of the system."""
        remarks, system, violation = [best.reason], task.scaled.system, task.violation(best)
        if task.given_up:
            remarks.append("the data do not determine a parameter: a very wide prior was used, a factor of 20")
        if not np.isfinite(violation):
            remarks.append("a simulation with these parameters diverges: the response violates the equation of motion")
        elif not violation < VIOLATED:
            remarks.append(
                f"a simulation with these parameters fits worse than the smooth response, as after an error of "
                f"{violation:.1f} standard deviations: the response violates the equation of motion, and intervals are "
                "too narrow"
            )
        elif system.n_hidden and not system.smooth:
            remarks.append("smooth functions cannot represent the kinks of hysteresis, so intervals may be too narrow")
        if not task.good(best):
            remarks.append("residuals exceed those of damped waves, so this may be a local minimum")
        return remarks

    def _distribution(self, task: Task, best: Fit) -> dict[str, Any]:
        """Return the distribution of all parameters, or of the groups where the data do not determine the scale."""
        system, free, dof = task.scaled.system, free_parameters(task.scaled), degrees_of_freedom(task.scaled)
        mean, covariance = best.logs, best.covariance
        if task.members:
            which = [system.names.index(name) for name in free]
            logs = np.array([fit.logs for fit in task.members])
            covariance = np.atleast_2d(np.cov(logs[:, which].T))
            if self.uncertainty == "ensemble":
                mean, dof = logs.mean(0), len(logs) - 1.0
        if len(free) == len(system.names):
            return {"parameters": Normal(system.names, mean, covariance, log=True, dof=dof)}
        parameters = dict(zip(system.names, np.exp(mean), strict=True))
        values = np.array([group.value(parameters) for group in system.groups])
        slopes = values[:, None] * np.array([group.vector(free) for group in system.groups])
        names = tuple(group.name for group in system.groups)
        return {"groups": Normal(names, values, slopes @ covariance @ slopes.T, log=False, dof=dof)}

    def _bands(self, task: Task, best: Fit) -> tuple[Function, ...]:
        if not task.members:
            return best.bands
        bands = []
        for k, band in enumerate(best.bands):
            paths = np.array([fit.responses[k](band.times) for fit in task.members])
            bands.append(Band(band.times, paths.std(0, ddof=1)))
        return tuple(bands)


def _has_device(device: str) -> bool:
    import torch

    return device.startswith("cuda") and torch.cuda.is_available()
