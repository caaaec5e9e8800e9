"""The modes of posteriors, from the data alone: linear systems of one layout together, with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import SIGMA_FLOOR, NoEstimate, OutputError, batches, whiten_model
from methods.starts.candidates import candidates, screened
from methods.starts.distinct_minima import distinct_minima
from methods.trajectory.student import NormalErrors, StudentErrors, searched, student_fits

MODES, ROUNDS, ITERATIONS = 3, 3, 12
"""Modes that are kept, rounds of fit and noise in turn, and steps of a fit."""
RECOLOURED = 2
"""Rounds in which the colour is estimated from the residuals of the best mode."""

Modes = list[tuple[float, np.ndarray]]
"""Minus twice the log-posterior and theta of each mode, best first."""


def modes_of(models: Sequence[OutputError]) -> list[Modes]:
    """The best modes of each model, in order; none where no initial guess gives a finite response."""
    modes: list[Modes] = [[] for _ in models]
    for places in batches(models, [not model.system.linear for model in models]):
        batch = [models[i] for i in places]
        linear = batch[0].system.linear
        of_batch = _linear_modes(batch) if linear else [screened(batch[0], MODES, ROUNDS, ITERATIONS)]
        for i, best in zip(places, of_batch, strict=True):
            modes[i] = best
    return modes


def _linear_modes(models: Sequence[OutputError]) -> list[Modes]:
    """Fit and noise in turn from every initial guess of every problem of a batch."""
    vectors = [[model.vector(p) for p in candidates(model, MODES + 1)] for model in models]
    cases = np.repeat(np.arange(len(vectors)), [len(guesses) for guesses in vectors])
    batch = OutputError.batch(models)[cases]
    thetas = batch.settle(np.concatenate(vectors), ROUNDS, ITERATIONS)
    values = batch.profile(thetas)
    members = [np.flatnonzero(cases == problem) for problem in range(len(models))]
    return [_apart(model, values[i], thetas[i])[:MODES] for model, i in zip(models, members, strict=True)]


def _apart(model: OutputError, values: np.ndarray, thetas: np.ndarray) -> Modes:
    return [(float(values[i]), thetas[i]) for i in distinct_minima(model, values, thetas)]


def student_modes(model: OutputError, modes: Modes) -> Modes:
    """The modes with Student t errors near those with normal ones, best first; apart, as those are."""
    fits = student_fits(model, np.stack([theta for _, theta in modes]))
    return _apart(model, fits.profile, fits.point.theta)


def coloured(model: OutputError, modes: Modes) -> tuple[OutputError, Modes]:
    """The model whiten_model, and its modes near those with white errors; NoEstimate where none is left."""
    for _ in range(RECOLOURED):
        white = whiten_model(model, modes[0][1])
        thetas = white.settle(np.stack([theta for _, theta in modes]), ROUNDS, ITERATIONS)
        modes = require(_apart(white, np.array([white.profile(theta) for theta in thetas]), thetas))
    return white, modes


def sharpened(model: OutputError, modes: Modes, errors: NormalErrors | StudentErrors, least: float) -> Modes:
    """Where data fit better than the noise that a search assumes: the modes at the noise that the residuals show.

    That is at least the part ``least`` of a channel's size. The prior pulls a mode aside by less there.
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
    """The modes, or NoEstimate where there is none."""
    if not modes:
        raise NoEstimate("no start gave a finite response; give a prior nearer to the system")
    return modes
