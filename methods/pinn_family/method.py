"""The PINN family: the loss of the inverse PINN, and the ways that the literature has of training it.

Every setting but one is that of a base, so that a row of its table differs from it by one thing: the optimiser, the
weighting of the loss, the function of time, or where the equation of motion is asked for. All act on the residual
vector of :mod:`methods.pinn.residuals`, begin at the same start scan, and have the same budget of work, counted in
gradients (:mod:`methods.pinn_family.loss`). Each fit notes its path, and how far its end is from the minimum of what it
minimised. Optimisers, weightings and functions of time may be those of other packages
(:mod:`methods.pinn_family.choices`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from bench import Card, Draws, Estimate
from methods.pinn.task import Fit, Task
from methods.pinn_family.choices import ARCHITECTURES, OPTIMIZERS, SAMPLINGS, UNCERTAINTIES, WEIGHTINGS
from methods.pinn_family.settings import FamilySettings

if TYPE_CHECKING:
    from methods.pinn_family.loss import Clock


@dataclass(frozen=True)
class PINNFamily(FamilySettings):
    """The family; see the module, and :class:`methods.pinn_family.settings.FamilySettings` for what can be set."""

    extra: ClassVar[str] = "training"
    requires: ClassVar[tuple[str, ...]] = ("torch", "pytorch_optimizer")
    card: ClassVar[Card] = Card(
        summary="the PINN's loss, trained in the ways of the literature, one setting apart from a base each",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="Gauss-Newton covariance at the end of the training, network weights profiled out, Student's t",
        settings_source="the sources of each choice; what they leave open is stated in the code of each",
        tuning="learning rate, 3 trials each on dev_sparse at 20 dB, both losses: Adam 3e-3, SOAP 3e-3, Muon 1e-2; "
        "that of Adam before L-BFGS is the paper's 1e-3; the others have none to choose",
        title="PINN family",
        order=68,
        colour="#7B4173",
        marker=(11, 0, 0.0),
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
        """Fit each, and start those in a bad basin again elsewhere."""
        from methods.pinn_family.loss import Clock

        for task in tasks:
            clock, used = Clock(), 0.0
            for n in range(1 + self.restarts):
                if task.wants(n) and used < self.budget:
                    fit, work = self._fitted(task, n, clock, self.budget - used)
                    task.fits.append(fit)
                    used += work

    def _fitted(self, task: Task, n: int, clock: Clock, budget: float) -> tuple[Fit, float]:
        from methods.pinn_family.loss import TrainingPath
        from methods.pinn_family.training import fit

        settings, watch = replace(self, budget=budget), partial(self._report, [task])
        return fit(task.scaled, task.guesses[n], settings, task.rng, TrainingPath(clock), watch)

    def _resample(self, task: Task) -> None:
        """State the uncertainty in another way than the linearised (:mod:`methods.pinn_family.uncertainty`)."""
        best = task.best
        if best is None:
            return
        from methods.pinn_family import nuts, uncertainty
        from methods.pinn_family.training import TrainedFit

        if self.uncertainty in ("ensemble", "bootstrap"):
            task.members = uncertainty.members(task, best, self)
            return
        assert isinstance(best, TrainedFit)
        way = nuts.stated if self.uncertainty == "nuts" else uncertainty.WAYS[self.uncertainty]
        answer = uncertainty.stated(way, best, self, task.rng)
        task.fits = [answer if fit is best else replace(fit, loss=np.inf) for fit in task.fits]

    def _belief(self, task: Task, best: Fit) -> dict[str, Any]:
        draws = getattr(best, "draws", None)
        names = task.scaled.system.names
        if draws is None or len(best.covariance) < len(names):
            return super()._belief(task, best)
        return {"parameters": Draws(names, np.exp(draws))}

    def _estimate(self, task: Task) -> Estimate:
        estimate = super()._estimate(task)
        dimensions = [parameter.dimension for parameter in task.scaled.system.parameters]
        traces = [name for name in ("path_parameters", "minimum_parameters") if name in estimate.traces]
        return replace(estimate, dimensions=dict.fromkeys(traces, dimensions))
