"""The settings of the family, and the ansatz of each architecture."""

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
from methods.pinn_family.choices import ARCHITECTURES, OPTIMIZERS, WEIGHTINGS

if TYPE_CHECKING:
    from methods.network.ansatz import Ansatz
    from methods.pinn.block import Block
    from methods.pinn_family.architectures import FeatureFunction

Uncertainty = Literal["laplace", "ensemble", "bootstrap", "nuts", "variational", "last_layer", "dropout"]


@dataclass(frozen=True)
class FamilySettings(PhysicsInformed):
    """Settings of :class:`methods.pinn.settings.PhysicsSettings`, and those compared in the table.

    ``budget``: work of a fit including restarts, in gradients. ``rate``: initial learning rate of an optimiser that has
    one (None: that of its class). ``width``, ``depth``: of the network.
    """

    optimizer: str = "lm"
    weighting: str = "noise"
    architecture: str = "tanh"
    sampling: Literal["uniform", "random", "adaptive"] = "uniform"
    uncertainty: Uncertainty = "laplace"  # type: ignore[assignment] # more values than the base
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
            raise InputError("method.batch", self.batch, "1: fits of the family are not batched")
        for choices in (OPTIMIZERS, WEIGHTINGS, ARCHITECTURES):
            choices.check(getattr(self, choices.setting))
        if self.optimizer == "variable_projection" and self.weighting not in ("noise", "paper"):
            remedy = "noise or paper: variable_projection requires fixed weights"
            raise InputError("method.weighting", self.weighting, remedy)

    def _function_of_time(self) -> PhysicsSettings | FeatureFunction:
        """Return the representation of the response: the PINN's tanh network, the spline, or features of the family."""
        if self.architecture == "tanh":
            # with the paper's training, which uses no windows
            return PINN(width=self.width, depth=self.depth, collocation=self.collocation, optimizer="adam_lbfgs")
        if self.architecture == "spline":
            return Collocation(collocation=self.collocation)
        from methods.pinn_family.architectures import FeatureFunction

        return FeatureFunction(ARCHITECTURES.load(self.architecture)(self.width, self.depth))

    def ansatz(self, block: Block, resolution: int) -> Ansatz:
        return self._function_of_time().ansatz(block, resolution)

    def first_coefficients(
        self, n_paths: int, resolution: int, cycles: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> np.ndarray:
        return self._function_of_time().first_coefficients(n_paths, resolution, cycles, rngs)

    def response(self, coefficients: np.ndarray, n_paths: int, resolution: int, duration: float) -> Function:
        return self._function_of_time().response(coefficients, n_paths, resolution, duration)
