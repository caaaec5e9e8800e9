"""Importance sampling: draws of a network weighted by the exact likelihood of a free decay."""

from __future__ import annotations

import numpy as np

from bench import NoEstimate, Problem
from methods.amortised.simulations import unit_responses

SAMPLES_AT_ONCE = 200_000
LEAST_EFFECTIVE = 50.0
"""Least effective number of draws."""


def log_likelihood(problem: Problem, logs: np.ndarray) -> np.ndarray:
    """Return the log-likelihood (n,), up to a constant, of the logarithms of k/m and c/m (n, 2).

    Integrating out the level of Gaussian noise with prior density 1/sigma gives ``-(N/2) log RSS``. An unknown initial
    state has a flat prior in displacement and in velocity over frequency, which gives ``-((N - 2)/2) log RSS -
    (1/2) log det(X'X)`` for its columns X.
    """
    channel, start = problem.records[0].channels[0], problem.records[0].initial_state
    parts = []
    step = max(1, SAMPLES_AT_ONCE // channel.n)
    for first in range(0, len(logs), step):
        r, g = np.exp(logs[first : first + step]).T
        omega = np.sqrt(r)
        even, odd = unit_responses(omega, 0.5 * g / omega, channel.times)
        if start is not None:
            residual = channel.values - start.displacement[0] * even - start.velocity[0] * odd
            parts.append(-0.5 * channel.n * np.log(np.sum(residual**2, axis=1)))
            continue
        q, triangle = np.linalg.qr(np.stack([even, omega[:, None] * odd], axis=2))
        residual = np.sum(channel.values**2) - np.sum(np.einsum("sni,n->si", q, channel.values) ** 2, axis=1)
        dets = np.abs(triangle[:, 0, 0] * triangle[:, 1, 1])
        parts.append(-0.5 * (channel.n - 2) * np.log(np.maximum(residual, 1e-300)) - np.log(dets))
    return np.concatenate(parts)


def resampled(logs: np.ndarray, log_weights: np.ndarray, n: int, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Resample ``n`` draws by weights; return them and the effective sample size.

    Raises NoEstimate where that is small.
    """
    weights = np.exp(log_weights - np.max(log_weights))
    weights /= weights.sum()
    effective = float(1.0 / np.sum(weights**2))
    if effective < LEAST_EFFECTIVE:
        raise NoEstimate(
            f"the effective sample size is {effective:.0f} of {len(logs)} draws, so the network is not accurate for "
            "such a record: use another method, or a longer training"
        )
    return logs[rng.choice(len(logs), n, p=weights)], effective
