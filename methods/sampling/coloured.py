"""A posterior whose errors are autoregressive: the model and its modes, whitened by what the residuals show."""

from __future__ import annotations

import numpy as np

from bench import OutputError, whitened
from methods.sampling.modes import ITERATIONS, ROUNDS, Modes, found_or_failure
from methods.starts.separate import separate

RECOLOURED = 2
"""How often the colour is told from the residuals of the best mode: of white errors, then of coloured ones."""


def coloured(model: OutputError, modes: Modes) -> tuple[OutputError, Modes]:
    """The model whitened, and its modes near those with white errors; NoEstimate where none is left."""
    for _ in range(RECOLOURED):
        white = whitened(model, modes[0][1])
        thetas = white.settle(np.stack([theta for _, theta in modes]), ROUNDS, ITERATIONS)
        values = np.array([white.profile(theta) for theta in thetas])
        modes = found_or_failure([(float(values[i]), thetas[i]) for i in separate(white, values, thetas)])
    return white, modes
