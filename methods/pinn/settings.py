"""Common settings of the PINN and of spline collocation, and their abstract ansatz of x(t)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from bench import InputError
from methods.network.response import Function

if TYPE_CHECKING:
    from methods.network.ansatz import Ansatz
    from methods.pinn.block import Block

POINTS_A_CYCLE = 20
"""Least number of collocation points per cycle of the fastest relevant motion."""
CONVERGED = 1e-9
"""Predicted decrease of minus the log posterior below which output layer and parameters have converged: a step of a few
1e-5 standard errors."""


@dataclass(frozen=True)
class PhysicsSettings(ABC):
    """Settings of representation and training; see :mod:`methods.pinn.physics`.

    Args:
        collocation: Least number of points where the equation of motion is evaluated; at least 20 per cycle.
        slack: Effect of equation errors over the record, in noise standard deviations.
        softness: Factor of ``slack`` in the first stage.
        start: A known initial state as a residual (``penalty``) or built into the response (``exact``).
        tolerance: Decrease of minus the log posterior below which a stage ends.
        batch: Number of fits solved at once.
    """

    collocation: int = 200
    slack: float = 0.2
    softness: float = 30.0
    start: Literal["penalty", "exact"] = "penalty"
    output_iterations: int = 12
    iterations: int = 200
    tolerance: float = 1e-3
    restarts: int = 2
    uncertainty: Literal["laplace", "ensemble", "bootstrap"] = "laplace"
    members: int = 20
    batch: int = 1
    device: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        self._at_least({"collocation": 10, "restarts": 0, "members": 2})
        self._at_least(dict.fromkeys(("output_iterations", "iterations", "batch", "threads"), 1))
        for name in ("slack", "softness", "tolerance"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"method.{name}", getattr(self, name), "a positive number")

    def _at_least(self, least: Mapping[str, int]) -> None:
        for name, bound in least.items():
            if getattr(self, name) < bound:
                raise InputError(f"method.{name}", getattr(self, name), f"a whole number of at least {bound}")

    @abstractmethod
    def ansatz(self, block: Block, resolution: int) -> Ansatz:
        """Return the ansatz of the response in a record of at most ``resolution`` oscillations."""

    @abstractmethod
    def first_coefficients(
        self, n_paths: int, resolution: int, cycles: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> np.ndarray:
        """Return the initial coefficients, (B, count), for responses of ``cycles`` (B,) oscillations."""

    @abstractmethod
    def response(self, coefficients: np.ndarray, n_paths: int, resolution: int, duration: float) -> Function:
        """Return the displacements, then hidden states, as a NumPy function of time."""

    @property
    def first_order(self) -> tuple[int, float, int] | None:
        """Return steps and rate of Adam and steps of L-BFGS; None for Levenberg-Marquardt."""
        return None

    def convergence(self, resolution: int) -> float:
        """Return the predicted decrease below which the training of the output layer ends."""
        return CONVERGED

    def points(self, resolution: int) -> int:
        """Return the number of collocation points for ``resolution`` oscillations."""
        return max(self.collocation, POINTS_A_CYCLE * resolution)
