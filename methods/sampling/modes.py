"""The modes of posteriors, from the data alone: linear systems of one layout together, with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import SIGMA_FLOOR, NoEstimate, OutputError, batches, whitened
from methods.starts.candidates import candidates, screened
from methods.starts.separate import separate
from methods.trajectory.student import NormalErrors, StudentErrors, searched, student_fits

MODES, ROUNDS, ITERATIONS = 3, 3, 12
"""Modes that are kept, rounds of fit and noise in turn, and steps of a fit."""

RECOLOURED = 2
"""How often the colour is told from the residuals of the best mode: of white errors, then of coloured ones."""

Modes = list[tuple[float, np.ndarray]]
"""Minus twice the log-posterior and theta of each mode, best first."""


def modes_of(models: Sequence[OutputError]) -> list[Modes]:
    """The best modes of each model, in order; none where no start gives a finite response."""
    found: list[Modes] = [[] for _ in models]
    for places in batches(models, [not model.system.linear for model in models]):
        batch = [models[i] for i in places]
        linear = batch[0].system.linear
        modes = _linear_modes(batch) if linear else [screened(batch[0], MODES, ROUNDS, ITERATIONS)]
        for i, best in zip(places, modes, strict=True):
            found[i] = best
    return found


def student_modes(model: OutputError, modes: Modes) -> Modes:
    """The modes with Student t errors near those with normal ones, best first; apart, as those are."""
    fits = student_fits(model, np.stack([theta for _, theta in modes]))
    values, thetas = fits.profile, fits.point.theta
    return [(float(values[i]), thetas[i]) for i in separate(model, values, thetas)]


def sharpened(model: OutputError, modes: Modes, errors: NormalErrors | StudentErrors, least: float) -> Modes:
    """Where data fit better than the noise that a search assumes: the modes at the noise that the residuals show.

    That is at least the part ``least`` of a channel's size. The prior pulls a mode aside by less there.
    """
    found = []
    for value, theta in modes:
        residuals = model.data - model.predict(theta)
        sigma = np.maximum(errors.scales(model, residuals, float(theta.size)), least * model.rms)
        if np.any(sigma < SIGMA_FLOOR * model.rms):
            theta = searched(model, theta, sigma, errors)
        found.append((value, theta))
    return found


def modes_or_failure(model: OutputError) -> Modes:
    """The modes of one model; NoEstimate where there is none."""
    return found_or_failure(modes_of([model])[0])


def found_or_failure(modes: Modes) -> Modes:
    """The modes, or NoEstimate where there is none."""
    if not modes:
        raise NoEstimate("no start gave a finite response; give a prior nearer to the system")
    return modes


def _linear_modes(models: Sequence[OutputError]) -> list[Modes]:
    """Fit and noise in turn from every initial guess of every problem of a batch."""
    vectors = [[model.vector(p) for p in candidates(model, MODES + 1)] for model in models]
    cases = np.repeat(np.arange(len(vectors)), [len(own) for own in vectors])
    batch = OutputError.batch(models)[cases]
    thetas = batch.settle(np.array([theta for own in vectors for theta in own]), ROUNDS, ITERATIONS)
    values = batch.profile(thetas)
    found = []
    for problem, model in enumerate(models):
        own = np.flatnonzero(cases == problem)
        best = own[separate(model, values[own], thetas[own])[:MODES]]
        found.append([(float(values[i]), thetas[i]) for i in best])
    return found


def coloured(model: OutputError, modes: Modes) -> tuple[OutputError, Modes]:
    """The model whitened, and its modes near those with white errors; NoEstimate where none is left."""
    for _ in range(RECOLOURED):
        white = whitened(model, modes[0][1])
        thetas = white.settle(np.stack([theta for _, theta in modes]), ROUNDS, ITERATIONS)
        values = np.array([white.profile(theta) for theta in thetas])
        modes = found_or_failure([(float(values[i]), thetas[i]) for i in separate(white, values, thetas)])
    return white, modes
