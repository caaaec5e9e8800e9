"""The way that a training takes: where the parameters and the residuals were, after how much processor time."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from methods.pinn.residuals import Residuals

GROWTH = 1.15
"""Work from one record to the next, as a factor: moments are evenly spaced in its logarithm."""


class Clock:
    """Processor seconds since a fit began, less those that were spent on noting where it is."""

    def __init__(self) -> None:
        self.started, self.apart = time.process_time(), 0.0

    def seconds(self) -> float:
        """How many by now."""
        return time.process_time() - self.started - self.apart


class Path:
    """Moments of a training: processor seconds, log-parameters, and the plain residual vector on the first grid.

    Each start of a fit has one of its own, by one clock.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.seconds: list[float] = []
        self.logs: list[np.ndarray] = []
        self.rows: list[np.ndarray] = []
        self.next = 0.0

    def due(self, work: float) -> bool:
        """Whether so much work is a moment to note."""
        return work >= self.next

    def note(self, residuals: Residuals, z: Tensor, work: float) -> None:
        """Note where z (1, n_z) is."""
        begun = time.process_time()
        self.seconds.append(self.clock.seconds())
        ones = torch.ones(1, residuals.n_rows, dtype=torch.float64, device=residuals.device)
        self.rows.append(np.asarray(residuals.evaluate(z, ones).rows[0].cpu()))
        self.logs.append(np.asarray(residuals.split(z)[1][0].cpu()))
        self.next = GROWTH * max(work, 1.0)
        self.clock.apart += time.process_time() - begun

    def traces(self, deviations: Tensor) -> Mapping[str, np.ndarray]:
        """As arrays; the loss is at the weights that ``deviations`` (1, n_rows) state."""
        scaled = np.array(self.rows) / np.asarray(deviations[0].cpu())
        return {
            "path_cpu_s": np.array(self.seconds),
            "path_parameters": np.exp(np.array(self.logs)),
            "path_loss": 0.5 * np.sum(scaled**2, 1),
        }
