"""Two real decays where a reading of poles ends outside of them: an overdamped mass whose fast decay noise hides.

Above a damping ratio of 1 the faster pole is small after one step, and noise may turn its sign: a pole that no damped
mass has. The samples then determine positive poles nearly as well, and often have no best ones among them, since a
still faster decay fits a little better. So k/m and c/m are means of their logarithms over all pairs of rates on a grid,
weighed by their likelihood; amplitudes, an offset and the noise are integrated out (G. L. Bretthorst, Bayesian Spectrum
Analysis and Parameter Estimation, 1988, chapter 3). There is no answer where a negative pole explains the samples
better than noise accounts for, or where two decays do not describe them.
"""

from __future__ import annotations

import numpy as np

RATES = 64
"""Of the grid, evenly spaced in their logarithms."""
SLOWEST, FASTEST = 0.1, 4.0
"""Least rate times the record, and largest rate times the step: then 2 % of an amplitude are left after a step."""
NEGATIVE = -np.linspace(0.05, 0.95, 10)
"""Negative poles that are compared."""
WORSE = 4.0
"""Two standard errors, squared: what positive poles may lose against a negative one, in variances of the noise."""
DESCRIBES = 0.003
"""Largest part of the mean square that may be left: noisier than 25 dB, a damped vibration passes for two decays."""


def real_decays(times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
    """k/m and c/m, (sets, 2), of two real decays at even times (n,) in samples (sets, n); NaN where there are none."""
    n, step = times.size, float(times[-1] - times[0]) / (times.size - 1)
    rates = np.geomspace(SLOWEST / (n * step), FASTEST / step, RATES)
    slow, fast = np.triu_indices(RATES, 1)
    pairs = np.stack([rates[slow], rates[fast]], axis=1)
    squares = _remainders(np.exp(-pairs * step), sets, offset)
    least, dof = np.min(squares, axis=1), max(n - 4 - int(offset), 1)
    energy = np.sum((sets - offset * sets.mean(axis=1, keepdims=True)) ** 2, axis=1)
    negative = _with_negative_pole(rates, sets, step, offset)
    accepted = (least < DESCRIBES * energy) & (least < negative * (1.0 + WORSE / dof))
    # amplitudes and noise are integrated out, with flat priors of the logarithms of noise and rates
    weights = (squares / least[:, None]) ** (-0.5 * (dof + 2))
    logs = np.stack([np.log(pairs[:, 0] * pairs[:, 1]), np.log(pairs.sum(axis=1))], axis=1)
    groups = np.exp(weights @ logs / np.sum(weights, axis=1, keepdims=True))
    return np.where(accepted[:, None], groups, np.nan)


def _with_negative_pole(rates: np.ndarray, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
    """Least sum of squares (sets,) that a positive and a negative pole, or two negative ones, leave."""
    poles = np.concatenate([np.exp(-rates * step), NEGATIVE])
    first, second = np.triu_indices(poles.size, 1)
    below = poles[second] < 0
    pairs = np.stack([poles[first[below]], poles[second[below]]], axis=1)
    return np.asarray(np.min(_remainders(pairs, sets, offset), axis=1))


def _remainders(poles: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
    """Sum of squares (sets, pairs) that powers of ``poles`` (pairs, 2), and a constant, leave of ``sets`` (sets, n)."""
    waves = poles[:, None] ** np.arange(sets.shape[1])[:, None]
    # the first and their difference: two like decays are nearly one
    difference = np.diff(waves, axis=-1) / (np.diff(poles)[:, None] + 1e-300)
    level = [np.ones_like(difference)] * offset
    basis = np.linalg.qr(np.concatenate([waves[..., :1], difference, *level], axis=-1))[0]
    caught = np.einsum("pnk,sn->spk", basis, sets, optimize=True)
    return np.asarray(np.sum(sets**2, axis=1)[:, None] - np.sum(caught**2, axis=-1))
