"""What the errors of the samples are taken to be: normal, or Student's t, which expects outliers.

Student's t with few, fixed degrees of freedom is the standard robust likelihood (K. L. Lange, R. J. A. Little,
J. M. G. Taylor, J. Am. Stat. Assoc. 84:881, 1989): a sample counts by ``w = (v + 1) / (v + (r / s)²)``, so one far off
counts for next to nothing. ``s`` is the scale of each channel, which is estimated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench import OutputError

Likelihood = Literal["normal", "student"]
SCALE_ROUNDS, SCALE_TOLERANCE = 200, 1e-8
"""Of the fixed point that the scale is."""


@dataclass(frozen=True)
class NormalErrors:
    """Independent normal errors; ``location`` and ``scale``: Fisher information of a sample, in units of its scale."""

    location: float = 1.0
    scale: float = 2.0

    def log_likelihood(self, z: np.ndarray) -> np.ndarray:
        """Of errors (n, N) over their scales, shape (n,), without the scales' own term, up to a constant."""
        return np.asarray(-0.5 * np.einsum("ni,ni->n", z, z))

    def weights(self, z: np.ndarray) -> np.ndarray:
        """All samples count the same."""
        return np.ones_like(z)

    def scales(self, model: OutputError, residuals: np.ndarray, used: float) -> np.ndarray:
        """The scale of each channel that residuals (N,) tell, with ``used`` degrees of freedom spent."""
        return model.noise(residuals, used, floor=0.0)


@dataclass(frozen=True)
class StudentErrors:
    """Independent errors of Student's t with ``dof`` degrees of freedom; the information: Lange et al., appendix B."""

    dof: float = 4.0

    @property
    def location(self) -> float:
        return (self.dof + 1.0) / (self.dof + 3.0)

    @property
    def scale(self) -> float:
        return 2.0 * self.dof / (self.dof + 3.0)

    def log_likelihood(self, z: np.ndarray) -> np.ndarray:
        """As for normal errors."""
        return np.asarray(-0.5 * (self.dof + 1.0) * np.sum(np.log1p(z**2 / self.dof), axis=-1))

    def weights(self, z: np.ndarray) -> np.ndarray:
        """How much samples count that are off by z scales."""
        return np.asarray((self.dof + 1.0) / (self.dof + z**2))

    def scales(self, model: OutputError, residuals: np.ndarray, used: float) -> np.ndarray:
        """As for normal errors: ``s² = sum w r² / (N - used)``, with the weights at s itself."""
        squares, channel_of = residuals**2, model.channel_of
        sizes = model.noise(residuals, used, floor=0.0)
        least = 1e-12 * model.rms
        for _ in range(SCALE_ROUNDS):
            sizes = np.maximum(sizes, least)
            weights = self.weights(residuals / sizes[channel_of])
            before, sizes = sizes, model.noise(np.sqrt(weights * squares), used, floor=0.0)
            if np.all(np.abs(sizes - before) <= SCALE_TOLERANCE * before):
                break
        return sizes


NORMAL, STUDENT = NormalErrors(), StudentErrors()
ERRORS: dict[Likelihood, NormalErrors | StudentErrors] = {"normal": NORMAL, "student": STUDENT}
