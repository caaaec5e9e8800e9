"""The modes of posteriors, from the data alone: linear systems of one layout together, with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import SIGMA_FLOOR, Batch, NoEstimate, OutputError, layout
from methods.starts.candidates import candidates, screened
from methods.starts.separate import separate
from methods.trajectory.errors import NormalErrors, StudentErrors
from methods.trajectory.student import searched, student_fit
from methods.trajectory.together import MOST_AT_ONCE

MODES, ROUNDS, ITERATIONS = 3, 3, 12
"""Modes that are kept, rounds of fit and noise in turn, and steps of a fit."""

Modes = list[tuple[float, np.ndarray]]
"""Minus twice the log-posterior and theta of each mode, best first."""


def modes_of(models: Sequence[OutputError]) -> list[Modes]:
    """The best modes of each model, in order; none where no start gives a finite response."""
    groups: dict[object, list[int]] = {}
    for i, model in enumerate(models):
        groups.setdefault(layout(model.problem) if model.system.linear else i, []).append(i)
    found: list[Modes] = [[] for _ in models]
    for places in groups.values():
        first = models[places[0]]
        if not first.system.linear:
            found[places[0]] = screened(first, MODES, ROUNDS, ITERATIONS)
            continue
        size = max(1, MOST_AT_ONCE // (first.data.size * first.size))
        for at in range(0, len(places), size):
            own = places[at : at + size]
            for i, modes in zip(own, _linear_modes(Batch(tuple(models[i] for i in own))), strict=True):
                found[i] = modes
    return found


def student_modes(model: OutputError, modes: Modes) -> Modes:
    """The modes with Student t errors near those with normal ones, best first; apart, as those are."""
    fits = [student_fit(model, model.jacobian, theta) for _, theta in modes]
    values, thetas = np.array([fit.value for fit in fits]), np.stack([fit.theta for fit in fits])
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
            theta = searched(model, model.jacobian, theta, sigma, errors)
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


def _linear_modes(batch: Batch) -> list[Modes]:
    """Fit and noise in turn from every start of every problem, by the rules of :meth:`bench.OutputError.settle`."""
    vectors = [[model.vector(p) for p in candidates(model, MODES + 1)] for model in batch.models]
    cases = np.repeat(np.arange(len(vectors)), [len(own) for own in vectors])
    point = batch.point(cases, np.array([theta for own in vectors for theta in own]).reshape(-1, batch.first.size))
    good = np.flatnonzero(np.all(np.isfinite(point.predicted), axis=1))
    cases, point = cases[good], point.at(good)
    for _ in range(ROUNDS):
        sigma = batch.noise(cases, batch.data[cases] - point.predicted, np.zeros(cases.size), SIGMA_FLOOR)
        point = batch.search(cases, point, sigma, ITERATIONS).point
    values = batch.profile(cases, point.theta, batch.data[cases] - point.predicted)
    found = []
    for problem, model in enumerate(batch.models):
        own = np.flatnonzero(cases == problem)
        best = own[separate(model, values[own], point.theta[own])[:MODES]]
        found.append([(float(values[i]), point.theta[i]) for i in best])
    return found
