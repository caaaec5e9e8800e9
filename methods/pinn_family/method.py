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
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from bench import Card, Draws, Estimate, InputError
from methods.network.response import Function
from methods.pinn.collocation import Collocation
from methods.pinn.method import PINN
from methods.pinn.physics import PhysicsInformed
from methods.pinn.settings import Settings, Trainable
from methods.pinn.task import Task
from methods.pinn_family.choices import ARCHITECTURES, OPTIMIZERS, SAMPLINGS, UNCERTAINTIES, WEIGHTINGS, component

if TYPE_CHECKING:
    from methods.network.ansatz import Ansatz
    from methods.pinn.block import Block
    from methods.pinn.engine import Fit
    from methods.pinn_family.architectures import Features
    from methods.pinn_family.loss import Clock

Uncertainty = Literal["laplace", "ensemble", "bootstrap", "nuts", "variational", "last_layer", "dropout"]


@dataclass(frozen=True)
class PINNFamily(PhysicsInformed):
    """The settings are those of :class:`methods.pinn.settings.Settings`, and what a row of the table changes.

    ``budget``: work of a fit, all its starts together, in gradients. ``rate``: first learning rate of an optimiser that
    has one (None: that of its class). ``width``, ``depth``: of the network.
    """

    optimizer: str = "lm"
    weighting: str = "noise"
    architecture: str = "tanh"
    sampling: Literal["uniform", "random", "adaptive"] = "uniform"
    uncertainty: Uncertainty = "laplace"  # type: ignore[assignment] # more ways than the base has
    budget: float = 10_000.0
    rate: float | None = None
    width: int = 64
    depth: int = 2

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

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least({"width": 4, "depth": 1})
        for name, value in (("budget", self.budget), ("rate", self.rate)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError(f"method.{name}", value, "a positive number")
        if self.batch != 1:
            raise InputError("method.batch", self.batch, "1: each fit of the family goes its own way")
        for choices in (OPTIMIZERS, WEIGHTINGS, ARCHITECTURES):
            choices.check(getattr(self, choices.setting))
        if self.optimizer == "variable_projection" and self.weighting not in ("noise", "paper"):
            remedy = "noise or paper: variable_projection holds weights fixed"
            raise InputError("method.weighting", self.weighting, remedy)

    # ---- what represents the response

    def _engine_settings(self) -> Settings | None:
        """Return the settings of the tanh network or the spline, which are the engine's own."""
        if self.architecture == "tanh":
            return PINN(width=self.width, depth=self.depth, collocation=self.collocation)
        return Collocation(collocation=self.collocation) if self.architecture == "spline" else None

    def _features(self, resolution: int) -> tuple[Features, tuple[tuple[int, ...], ...]]:
        """Return the features of any other architecture, and the shapes of their coefficients."""
        features: Features = component("architecture", self.architecture)(self.width, self.depth)
        return features, tuple(part.shape for part in features.start(resolution, np.random.default_rng(0)))

    def ansatz(self, block: Block, resolution: int) -> Ansatz:
        if engine := self._engine_settings():
            return engine.ansatz(block, resolution)
        import torch

        from methods.pinn_family.architectures import FeatureAnsatz

        device = block.values.device
        tau = torch.as_tensor(2.0 * block.times / block.duration[:, None] - 1.0, device=device)
        rate = torch.as_tensor(2.0 / block.duration, device=device)
        return FeatureAnsatz(*self._features(resolution), tau, rate, block.n_paths)

    def first_coefficients(
        self, n_paths: int, resolution: int, cycles: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> np.ndarray:
        if engine := self._engine_settings():
            return engine.first_coefficients(n_paths, resolution, cycles, rngs)
        features, _ = self._features(resolution)
        head = np.zeros(n_paths * (features.n_features() + 1))
        return np.stack(
            [np.concatenate([*(part.ravel() for part in features.start(resolution, rng)), head]) for rng in rngs]
        )

    def response(self, coefficients: np.ndarray, n_paths: int, resolution: int, duration: float) -> Function:
        if engine := self._engine_settings():
            return engine.response(coefficients, n_paths, resolution, duration)
        from methods.pinn_family.architectures import FeatureResponse

        return FeatureResponse(*self._features(resolution), coefficients, n_paths, duration)

    # ---- fits

    def train(self, attempt: Trainable) -> None:
        """Not called: a fit of the family trains itself."""
        raise NotImplementedError

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
        from methods.pinn_family.loss import Path
        from methods.pinn_family.training import fit

        settings, watch = replace(self, budget=budget), partial(self._report, [task])
        return fit(task.scaled, task.guesses[n], settings, task.rng, Path(clock), watch)

    # ---- answers

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
