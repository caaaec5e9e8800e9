"""The modes of posteriors, found in batches of linear systems of one layout."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import SIGMA_FLOOR, NoEstimate, OutputError, batches, whiten_model
from methods.starts.candidates import candidates, screened
from methods.starts.distinct_minima import distinct_minima
from methods.trajectory.student import NormalErrors, StudentErrors, searched, student_fits

MODES, ROUNDS, ITERATIONS = 3, 3, 12
"""Number of modes kept, alternations of fit and noise, and iterations of a fit."""
RECOLOURED = 2
"""Rounds of estimating the error model from the residuals at the best mode."""

Modes = list[tuple[float, np.ndarray]]
"""Minus twice the log-posterior and theta of each mode, best first."""


def modes_of(models: Sequence[OutputError]) -> list[Modes]:
    """Return the best modes of each model; none where no initial guess gives a finite response."""
    modes: list[Modes] = [[] for _ in models]
    for places in batches(models, [not model.system.linear for model in models]):
        batch = [models[i] for i in places]
        linear = batch[0].system.linear
        of_batch = _linear_modes(batch) if linear else [screened(batch[0], MODES, ROUNDS, ITERATIONS)]
        for i, best in zip(places, of_batch, strict=True):
            modes[i] = best
    return modes


def _linear_modes(models: Sequence[OutputError]) -> list[Modes]:
    """Alternate fit and noise from every initial guess of every problem of a batch."""
    vectors = [[model.vector(p) for p in candidates(model, MODES + 1)] for model in models]
    cases = np.repeat(np.arange(len(vectors)), [len(guesses) for guesses in vectors])
    batch = OutputError.batch(models)[cases]
    thetas = batch.settle(np.concatenate(vectors), ROUNDS, ITERATIONS)
    values = batch.profile(thetas)
    members = [np.flatnonzero(cases == problem) for problem in range(len(models))]
    return [_distinct(model, values[i], thetas[i])[:MODES] for model, i in zip(models, members, strict=True)]


def _distinct(model: OutputError, values: np.ndarray, thetas: np.ndarray) -> Modes:
    return [(float(values[i]), thetas[i]) for i in distinct_minima(model, values, thetas)]


def student_modes(model: OutputError, modes: Modes) -> Modes:
    """Return the distinct modes with Student t errors near those with normal errors, best first."""
    fits = student_fits(model, np.stack([theta for _, theta in modes]))
    return _distinct(model, fits.profile, fits.point.theta)


def coloured(model: OutputError, modes: Modes) -> tuple[OutputError, Modes]:
    """Return the whitened model, and its modes near those with white errors; raises NoEstimate without any."""
    for _ in range(RECOLOURED):
        white = whiten_model(model, modes[0][1])
        thetas = white.settle(np.stack([theta for _, theta in modes]), ROUNDS, ITERATIONS)
        modes = require(_distinct(white, np.array([white.profile(theta) for theta in thetas]), thetas))
    return white, modes


def sharpened(model: OutputError, modes: Modes, errors: NormalErrors | StudentErrors, least: float) -> Modes:
    """Search the modes again at the noise of their residuals, where it is below the lower limit of the first search.

    The noise is at least ``least`` of a channel's size. The smaller noise reduces the shift of a mode by the prior.
    """
    sharp = []
    for value, theta in modes:
        residuals = model.data - model.predict(theta)
        sigma = np.maximum(errors.scales(model, residuals, float(theta.size)), least * model.rms)
        if np.any(sigma < SIGMA_FLOOR * model.rms):
            theta = searched(model, theta, sigma, errors)
        sharp.append((value, theta))
    return sharp


def require(modes: Modes) -> Modes:
    """Return the modes; raises NoEstimate without any."""
    if not modes:
        raise NoEstimate("no initial guess gave a finite response; give a prior closer to the system")
    return modes
