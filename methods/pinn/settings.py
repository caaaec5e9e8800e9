"""The settings that the PINN and spline collocation share, and what each of them brings: what represents x(t)."""

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
"""Collocation points a cycle of the fastest motion that matters, where ``collocation`` would give fewer."""
CONVERGED = 1e-9
"""Promised decrease of minus the log posterior below which the output layer and the parameters have converged: a step
of a few hundred-thousandths of a standard error, which costs two or three cheap iterations more."""


@dataclass(frozen=True)
class PhysicsSettings(ABC):
    """Set how the response is represented and trained; see :mod:`methods.pinn.physics`.

    Args:
        collocation: Points where the equation of motion is evaluated (more where a cycle would have fewer than 20).
        slack: How far the physics may drift over the record, in noise standard deviations.
        softness: How many times that in the first stage.
        start: A known initial state as a residual (``penalty``) or built into the response (``exact``).
        tolerance: Decrease of minus the log posterior below which a stage ends.
        batch: Fits solved together.
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
        """Return what represents the response in a record of at most ``resolution`` oscillations."""

    @abstractmethod
    def first_coefficients(
        self, n_paths: int, resolution: int, cycles: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> np.ndarray:
        """Return the coefficients to start from, (B, count), for responses of ``cycles`` (B,) oscillations."""

    @abstractmethod
    def response(self, coefficients: np.ndarray, n_paths: int, resolution: int, duration: float) -> Function:
        """Return the paths by time, in numpy: displacements, then hidden states."""

    @property
    def first_order(self) -> tuple[int, float, int] | None:
        """Steps and rate of Adam and steps of L-BFGS, in place of Levenberg-Marquardt."""
        return None

    def convergence(self, resolution: int) -> float:
        """Return the promised decrease at which the output layer's training ends."""
        return CONVERGED

    def points(self, resolution: int) -> int:
        """Return how many collocation points so many oscillations get."""
        return max(self.collocation, POINTS_A_CYCLE * resolution)
