"""Separate fits of the parts of a record, whose differences indicate how much a repeat of the test may differ.

An approximate model has different parameters in each part, such as damping that decreases with the amplitude, or a
stiffness that drifts. Parts have equal energy of the fitted motion, so that they determine the parameters about equally
well; the weight of a part decreases with its variance. A part is fitted by a Gauss-Newton step from the estimate of the
whole record. The initial state of a part is a function of that of the record, so the derivatives by either span the
same space, and the fit of a part is as free as that of a separate record.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bench.likelihood.autoregression import autoregression, even_times
from bench.likelihood.least_squares import covariances
from bench.records.linearised_fit import CORRELATED_CYCLES, LinearisedFit, even_scores, uneven_scores

MOST_PARTS = 6
CYCLES, MEAN_CYCLES = 2.0, 3.0
"""Least cycles of a part, and of the parts on average; fewer do not determine the damping."""
SAMPLES_PER_UNKNOWN = 4
LARGEST_CHANGE = 0.7
"""Largest change of the log of a stiffness (a factor of two); beyond it the fit of a part is discarded."""
LARGEST_SPREAD = 1.0
"""Prior standard deviation of a part's log-parameter about that of the record; keeps parameters that a part does not
determine where the linearisation holds."""


@dataclass(frozen=True, eq=False)
class PartFit:
    """Logarithms (k,) of the free parameters of a part, their covariance (k, k), and the amplitude of the motion."""

    logs: np.ndarray
    covariance: np.ndarray
    amplitude: float


def parts_of(whole: LinearisedFit, frequency: float) -> list[PartFit]:
    """Fit the parts of a record, or each of several records, separately.

    Args:
        whole: Fit of all samples.
        frequency: Natural frequency, in cycles per natural unit of time.

    Returns:
        The fits; empty if fewer than two succeed.
    """
    model = whole.model
    times = np.concatenate([channel.times for _, channel in model.channels])
    motion = model.data - whole.residuals - model.offsets(whole.theta)[model.channel_of]
    if len(model.problem.records) > 1:
        record_of = np.array([record for record, _ in model.channels])[model.channel_of]
        samples = [np.flatnonzero(record_of == i) for i in range(len(model.problem.records))]
    else:
        edges = _edges(whole, motion, frequency)
        samples = [np.flatnonzero((times >= low) & (times < high)) for low, high in pairwise(edges)]
    fits = [_part_fit(whole, rows, times[rows], motion[rows], frequency) for rows in samples]
    parts = [part for part in fits if part is not None]
    return parts if len(parts) > 1 else []


def _part_fit(
    whole: LinearisedFit, rows: np.ndarray, times: np.ndarray, motion: np.ndarray, frequency: float
) -> PartFit | None:
    """Fit the samples in ``rows``; None if the fit is singular or too far from that of the whole record."""
    model, k, n = whole.model, len(whole.model.free), rows.size
    slopes, channel_of = whole.slopes[rows], model.channel_of[rows]
    unknowns = np.any(slopes != 0, axis=0)
    if not np.all(unknowns[:k]) or n <= np.count_nonzero(unknowns):
        return None
    slopes, p = slopes[:, unknowns], int(np.count_nonzero(unknowns))
    weights = 1.0 / whole.sigma[channel_of]
    prior = np.eye(k, p) / LARGEST_SPREAD
    matrix = np.concatenate([slopes * weights[:, None], prior])
    norms, left = np.linalg.norm(matrix, axis=0), np.append(whole.residuals[rows] * weights, np.zeros(k))
    change = np.linalg.lstsq(matrix / norms, left, rcond=None)[0] / norms
    left = whole.residuals[rows] - slopes @ change
    middle, sigma = prior.T @ prior, np.zeros(n)
    for i in np.unique(channel_of):
        inside = channel_of == i
        r, j, t = left[inside], slopes[inside], times[inside]
        variance = max(float(r @ r) / (r.size * (1.0 - p / n)), (1e-9 * float(model.rms[i])) ** 2)
        sigma[inside] = np.sqrt(variance)
        even = even_times(t)
        noise = autoregression(r, p / n * r.size) if even else None
        scores = uneven_scores(j, r, t, CORRELATED_CYCLES / frequency) if noise is None else even_scores(j, r, noise)
        middle += scores / variance**2
    white = covariances(np.concatenate([slopes / sigma[:, None], prior])[None])[0]
    kinds = {parameter.name: parameter.kind for parameter in model.system.parameters}
    stiffness = [i for i, name in enumerate(model.free) if kinds[name] == "stiffness"]
    if white is None or np.any(np.abs(change[stiffness]) > LARGEST_CHANGE):
        return None
    amplitude = float(np.std(motion[channel_of == channel_of[0]])) or 1.0
    return PartFit(whole.theta[:k] + change[:k], (white @ middle @ white)[:k, :k], amplitude)


def _edges(whole: LinearisedFit, motion: np.ndarray, frequency: float) -> list[float]:
    """Return the times that divide a record into parts of equal energy and of at least ``CYCLES`` cycles."""
    record = whole.model.problem.records[0]
    times = record.channels[0].times
    samples = min(c.n for c in record.channels)
    unknowns, duration = SAMPLES_PER_UNKNOWN * whole.model.size, record.duration
    count = int(min(MOST_PARTS, duration * frequency / MEAN_CYCLES, samples / unknowns))
    energy = np.cumsum(motion[: times.size] ** 2 * np.gradient(times))
    least = max(CYCLES / frequency, unknowns * duration / samples)
    edges = [0.0]
    for share in range(1, count):
        edges.append(max(float(np.interp(share / count, energy / (energy[-1] or 1.0), times)), edges[-1] + least))
    while len(edges) > 1 and edges[-1] + least > duration:
        edges.pop()
    return [*edges, np.inf]
