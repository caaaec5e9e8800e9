"""The PINN family: training methods of the literature for the loss of the inverse PINN.

Each row of the table differs from a base by one setting: the optimiser, the weighting of the loss, the architecture, or
the collocation points. All use the residual vector of :mod:`methods.pinn.residuals`, the same initial guesses, and the
same budget of work, counted in gradients (:mod:`methods.pinn_family.loss`). Each fit records its path, and the distance
of its end from a minimum of its loss. Other packages can add optimisers, weightings and architectures
(:mod:`methods.pinn_family.choices`).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from bench import Card, Draws, Estimate, Problem
from methods.pinn.task import Fit, Task
from methods.pinn_family.choices import ARCHITECTURES, OPTIMIZERS, SAMPLINGS, UNCERTAINTIES, WEIGHTINGS
from methods.pinn_family.settings import FamilySettings
from methods.starts.waves import Guess


@dataclass(frozen=True)
class PINNFamily(FamilySettings):
    """A PINN with selectable training; settings: :class:`methods.pinn_family.settings.FamilySettings`."""

    extra: ClassVar[str] = "training"
    requires: ClassVar[tuple[str, ...]] = ("torch", "pytorch_optimizer")
    card: ClassVar[Card] = Card(
        summary="the PINN's loss with training methods of the literature, each differing from a base by one setting",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="Gauss-Newton covariance at the end of the training, network weights profiled out, Student's t",
        settings_source="the sources of each choice; values not given there are documented in the code",
        tuning="learning rate, 3 trials each on dev_sparse at 20 dB, both losses: Adam 3e-3, SOAP 3e-3, Muon 1e-2; "
        "that of Adam before L-BFGS is the paper's 1e-3; the others have none",
        title="PINN family",
        order=68,
        remarks=True,
        choices={
            "optimizer": OPTIMIZERS,
            "weighting": WEIGHTINGS,
            "architecture": ARCHITECTURES,
            "sampling": SAMPLINGS,
            "uncertainty": UNCERTAINTIES,
        },
    )

    def attempt(self, tasks: Sequence[Task]) -> None:
        """Fit each task, and restart those in a bad basin with the rest of the budget."""
        from methods.pinn_family.training import TrainingPath, train

        for task in tasks:
            path, remaining = TrainingPath(time.process_time()), self.budget
            for n in range(1 + self.restarts):
                if task.wants(n) and remaining > 0:
                    settings, watch = replace(self, budget=remaining), partial(self._report, [task])
                    fit, work = train(task.scaled, task.guesses[n], settings, task.rng, path, watch)
                    task.fits.append(fit)
                    path, remaining = TrainingPath(path.begun), remaining - work

    def _fit(
        self,
        problems: Sequence[Problem],
        guesses: Sequence[Guess],
        rngs: Sequence[np.random.Generator],
        tasks: Sequence[Task] = (),
    ) -> list[Fit]:
        """Train the members of an ensemble or a bootstrap, each with the full budget."""
        from methods.pinn_family.training import TrainingPath, train

        fits: list[Fit] = []
        for problem, guess, rng in zip(problems, guesses, rngs, strict=True):
            fit, _ = train(problem, guess, self, rng, TrainingPath(time.process_time()), lambda results: None)
            fit.attempt = None  # large, and used of the best fit only
            fits.append(fit)
        return fits

    def _resample(self, task: Task) -> None:
        """Replace the linearised uncertainty (:mod:`methods.pinn_family.uncertainty`)."""
        best = task.best
        if best is None or self.uncertainty in ("ensemble", "bootstrap"):
            return super()._resample(task)
        from methods.pinn_family import uncertainty

        answer = uncertainty.with_uncertainty(best, self, task.rng)
        task.fits = [answer if fit is best else replace(fit, loss=np.inf) for fit in task.fits]
        return None

    def _distribution(self, task: Task, best: Fit) -> dict[str, Any]:
        draws = getattr(best, "draws", None)
        names = task.scaled.system.names
        if draws is None or len(best.covariance) < len(names):
            return super()._distribution(task, best)
        return {"parameters": Draws(names, np.exp(draws))}

    def _estimate(self, task: Task) -> Estimate:
        estimate = super()._estimate(task)
        dimensions = [parameter.dimension for parameter in task.scaled.system.parameters]
        traces = [name for name in ("path_parameters", "minimum_parameters") if name in estimate.traces]
        return replace(estimate, dimensions=dict.fromkeys(traces, dimensions))
