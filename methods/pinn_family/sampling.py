"""Where the equation of motion is asked for: fixed, drawn anew at each step, or where it is violated most."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import torch
from torch import Tensor

from methods.pinn_family.residuals import TrainingResiduals

CANDIDATES = 10
"""Points among which residual-based adaption chooses, over those it keeps."""


class Sampling(ABC):
    """Moves collocation points every so many gradients; 0: never."""

    every = 0

    def __init__(self, omega: float, rng: np.random.Generator) -> None:
        self.omega, self.rng = omega, rng

    @abstractmethod
    def moved(self, residuals: TrainingResiduals, z: Tensor) -> TrainingResiduals:
        """The residual vector at new points, for the response at z (n_z,)."""


class Uniform(Sampling):
    """Evenly spaced and fixed, as in the paper."""

    def moved(self, residuals: TrainingResiduals, z: Tensor) -> TrainingResiduals:
        return residuals


class Random(Sampling):
    """Uniformly random, drawn anew at each step; the ends of the record stay."""

    every = 1

    def moved(self, residuals: TrainingResiduals, z: Tensor) -> TrainingResiduals:
        points = []
        for block in residuals.blocks:
            duration = float(block.duration[0])
            inner = np.sort(self.rng.uniform(0.0, duration, block.collocation - 2))
            points.append(np.concatenate([[0.0], inner, [duration]]))
        return residuals.placed(points, self.omega)


class Adaptive(Sampling):
    """Drawn with a probability that grows with the residual, every hundred steps.

    Residual-based adaptive distribution with k = c = 1: C. Wu et al., Comput. Methods Appl. Mech. Eng. 403:115671,
    2023.
    """

    every = 100

    def moved(self, residuals: TrainingResiduals, z: Tensor) -> TrainingResiduals:
        fine = [np.linspace(0.0, float(b.duration[0]), CANDIDATES * b.collocation) for b in residuals.blocks]
        points = []
        for k, block in enumerate(residuals.blocks):
            size = np.zeros(fine[k].size)
            for at in range(CANDIDATES):  # as many points at a time as the vector has rows for
                own = [part[at::CANDIDATES] for part in fine]
                size[at::CANDIDATES] = _equation_sizes(residuals.placed(own, self.omega), z)[k]
            inner = size[1:-1] / size[1:-1].mean() + 1.0
            chosen = self.rng.choice(inner.size, block.collocation - 2, replace=False, p=inner / inner.sum())
            points.append(np.concatenate([fine[k][:1], fine[k][1:-1][np.sort(chosen)], fine[k][-1:]]))
        return residuals.placed(points, self.omega)


def _equation_sizes(residuals: TrainingResiduals, z: Tensor) -> list[np.ndarray]:
    """Absolute residual of the equation at each point, summed over the paths, record by record."""
    ones = torch.ones(1, residuals.n_rows, dtype=torch.float64, device=residuals.device)
    rows = np.asarray(residuals.evaluate(z[None], ones).rows[0].cpu())
    sizes, at = [], 0
    for block in residuals.blocks:
        own = rows[at : at + block.n_rows][block.slices["physics"]]
        sizes.append(np.abs(own.reshape(-1, block.collocation)).sum(0))
        at += block.n_rows
    return sizes


SAMPLINGS: dict[str, type[Sampling]] = {"uniform": Uniform, "random": Random, "adaptive": Adaptive}
