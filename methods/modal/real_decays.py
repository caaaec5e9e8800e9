"""Fit of two real decays for an overdamped mass whose fast decay is hidden by noise.

Above a damping ratio of 1 the faster pole z is small, and noise may make its estimate negative, which is impossible for
a damped mass. Positive poles then fit the samples nearly as well, but often without a maximum of the likelihood, since
a faster decay always fits slightly better. k/m and c/m are therefore posterior means of their logarithms over a grid of
pairs of rates, with amplitudes, an offset and the noise integrated out (G. L. Bretthorst, Bayesian Spectrum Analysis
and Parameter Estimation, 1988, chapter 3). There is no estimate where a negative pole fits significantly better, or
where two decays do not fit the samples.
"""

from __future__ import annotations

import numpy as np

RATES = 64
"""Number of rates on the grid, evenly spaced in their logarithms."""
SLOWEST, FASTEST = 0.1, 4.0
"""Least rate times the record, and largest rate times the step (decay to 2 % in one step)."""
NEGATIVE = -np.linspace(0.05, 0.95, 10)
"""Negative poles compared with the positive ones."""
WORSE = 4.0
"""Largest excess of the sum of squares over that with a negative pole, in noise variances: two standard errors."""
DESCRIBES = 0.003
"""Largest residual share; with more noise than 25 dB a damped vibration could pass for two decays."""


def real_decays(times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
    """Estimate k/m and c/m, (sets, 2), of two real decays from samples (sets, n) at even times; NaN if rejected."""
    n, step = times.size, float(times[-1] - times[0]) / (times.size - 1)
    rates = np.geomspace(SLOWEST / (n * step), FASTEST / step, RATES)
    slow, fast = np.triu_indices(RATES, 1)
    pairs = np.stack([rates[slow], rates[fast]], axis=1)
    squares = _remainders(np.exp(-pairs * step), sets, offset)
    least, dof = np.min(squares, axis=1), max(n - 4 - int(offset), 1)
    energy = np.sum((sets - offset * sets.mean(axis=1, keepdims=True)) ** 2, axis=1)
    negative = _with_negative_pole(rates, sets, step, offset)
    accepted = (least < DESCRIBES * energy) & (least < negative * (1.0 + WORSE / dof))
    # amplitudes and noise are integrated out, with flat priors on the logarithms of noise and rates
    weights = (squares / least[:, None]) ** (-0.5 * (dof + 2))
    logs = np.stack([np.log(pairs[:, 0] * pairs[:, 1]), np.log(pairs.sum(axis=1))], axis=1)
    groups = np.exp(weights @ logs / np.sum(weights, axis=1, keepdims=True))
    return np.where(accepted[:, None], groups, np.nan)


def _with_negative_pole(rates: np.ndarray, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
    """Return the least residual sum of squares (sets,) with one or two negative poles."""
    poles = np.concatenate([np.exp(-rates * step), NEGATIVE])
    first, second = np.triu_indices(poles.size, 1)
    below = poles[second] < 0
    pairs = np.stack([poles[first[below]], poles[second[below]]], axis=1)
    return np.asarray(np.min(_remainders(pairs, sets, offset), axis=1))


def _remainders(poles: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
    """Return residual sums of squares (sets, pairs) after fitting powers of poles (pairs, 2), and an offset."""
    waves = poles[:, None] ** np.arange(sets.shape[1])[:, None]
    # one decay and the difference, since similar decays are nearly dependent
    difference = np.diff(waves, axis=-1) / (np.diff(poles)[:, None] + 1e-300)
    level = [np.ones_like(difference)] * offset
    basis = np.linalg.qr(np.concatenate([waves[..., :1], difference, *level], axis=-1))[0]
    caught = np.einsum("pnk,sn->spk", basis, sets, optimize=True)
    return np.asarray(np.sum(sets**2, axis=1)[:, None] - np.sum(caught**2, axis=-1))
