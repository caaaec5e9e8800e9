"""The settings of the family, and what represents the response under each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from bench import InputError
from methods.network.response import Function
from methods.pinn.collocation import Collocation
from methods.pinn.method import PINN
from methods.pinn.physics import PhysicsInformed
from methods.pinn.settings import PhysicsSettings
from methods.pinn_family.choices import ARCHITECTURES, OPTIMIZERS, WEIGHTINGS, component

if TYPE_CHECKING:
    from methods.network.ansatz import Ansatz
    from methods.pinn.block import Block
    from methods.pinn_family.architectures import Features

Uncertainty = Literal["laplace", "ensemble", "bootstrap", "nuts", "variational", "last_layer", "dropout"]


@dataclass(frozen=True)
class FamilySettings(PhysicsInformed):
    """The settings are those of :class:`methods.pinn.settings.PhysicsSettings`, and what a row of the table changes.

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

    def _engine_settings(self) -> PhysicsSettings | None:
        """Return the settings of the tanh network or the spline, which are the engine's own."""
        if self.architecture == "tanh":
            # with the paper's training, since that always has one network
            return PINN(width=self.width, depth=self.depth, collocation=self.collocation, optimizer="adam_lbfgs")
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
