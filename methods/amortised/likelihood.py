"""The exact likelihood of a free decay given k/m and c/m, with the noise level and an unknown start integrated out."""

from __future__ import annotations

import numpy as np

from bench import Problem
from methods.amortised.simulations import unit_responses

BATCH = 200_000
"""Samples simulated at once."""


def log_likelihood(problem: Problem, logs: np.ndarray) -> np.ndarray:
    """Of the logarithms of k/m and c/m (n, 2), up to a constant: (n,).

    Of Gaussian noise with the density 1/sigma of its level, the level integrated out is ``(N/2) log RSS``. An unknown
    start with the density that the network was trained under, uniform in phase at a given energy, is taken flat in
    displacement and in velocity over frequency: ``((N - 2)/2) log RSS + (1/2) log det(X'X)`` for its columns X.
    """
    channel, start = problem.records[0].channels[0], problem.records[0].initial_state
    parts = []
    step = max(1, BATCH // channel.n)
    for at in range(0, len(logs), step):
        r, g = np.exp(logs[at : at + step]).T
        omega = np.sqrt(r)
        even, odd = unit_responses(omega, 0.5 * g / omega, channel.times)
        if start is not None:
            left = channel.values - start.displacement[0] * even - start.velocity[0] * odd
            parts.append(-0.5 * channel.n * np.log(np.sum(left**2, axis=1)))
            continue
        columns = np.stack([even, omega[:, None] * odd], axis=2)
        q, triangle = np.linalg.qr(columns)
        left = np.sum(channel.values**2) - np.sum(np.einsum("sni,n->si", q, channel.values) ** 2, axis=1)
        dets = np.abs(triangle[:, 0, 0] * triangle[:, 1, 1])
        parts.append(-0.5 * (channel.n - 2) * np.log(np.maximum(left, 1e-300)) - np.log(dets))
    return np.concatenate(parts)
