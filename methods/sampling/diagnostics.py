"""Whether chains of an ensemble sampler have converged: R-hat, effective sample size, autocorrelation time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import ndtri

WINDOW = 5.0
MANY = 10
"""Unknowns beyond which slow mixing is put down to their number."""


class Criteria(Protocol):
    """When chains are believed: see :class:`methods.sampling.mcmc.MCMC`."""

    @property
    def r_hat(self) -> float: ...

    @property
    def effective(self) -> float: ...

    @property
    def autocorrelations(self) -> float: ...


@dataclass(frozen=True)
class Health:
    """The worst over the unknowns: R-hat, effective sample size of all ensembles, autocorrelation time in steps."""

    r_hat: float
    effective: float
    time: float

    @staticmethod
    def of(paths: np.ndarray) -> Health:
        """Of chains of shape (ensembles, steps, walkers, size)."""
        times = np.max(autocorrelation_times(paths), axis=0)
        time = float(np.max(np.where(np.isfinite(times), np.maximum(times, 1.0), np.inf)))
        return Health(rank_r_hat(paths), paths[..., 0].size / time, time)

    def converged(self, settings: Criteria, steps: int) -> bool:
        return (
            self.r_hat <= settings.r_hat
            and self.effective >= settings.effective
            and steps >= settings.autocorrelations * self.time
        )

    def sentence(self, settings: Criteria, steps: int, unknowns: int) -> str:
        """Why chains of ``steps`` steps are not believed, and what to do."""
        said = (
            f"the chains have not converged (R-hat {self.r_hat:.3f}, effective draws {self.effective:.0f}, "
            f"autocorrelation time {self.time:.0f} of {steps} steps"
        )
        said += ", too long to be trusted)" if steps < settings.autocorrelations * self.time else ")"
        if unknowns > MANY:
            return f"{said}: walkers mix slowly among {unknowns} unknowns; take a sampler with gradients (nuts)"
        return f"{said}: raise blocks, or give more data or a narrower prior"


def autocorrelation_times(paths: np.ndarray) -> np.ndarray:
    """The integrated autocorrelation times in steps, (ensembles, size), of chains (ensembles, steps, walkers, size).

    emcee's estimate, all series at once: the autocorrelation is the mean of the walkers', summed as far as ``WINDOW``
    times the sum (A. Sokal, Monte Carlo Methods in Statistical Mechanics, 1989). NaN where a walker never moves.
    """
    steps = paths.shape[1]
    series = np.ascontiguousarray(np.moveaxis(paths, 1, -1))
    transformed = np.fft.rfft(series - series.mean(axis=-1, keepdims=True), n=2 * steps)
    power = transformed.real**2 + transformed.imag**2
    with np.errstate(invalid="ignore"):
        covariances = np.fft.irfft(power, n=2 * steps)[..., :steps]
        correlations = np.mean(covariances / covariances[..., :1], axis=1)
    sums = 2.0 * np.cumsum(correlations, axis=-1) - 1.0
    within = np.arange(steps) < WINDOW * sums
    last = np.where(np.any(within, axis=-1), np.argmin(within, axis=-1), steps - 1)
    return np.asarray(np.take_along_axis(sums, last[..., None], axis=-1)[..., 0])


def rank_r_hat(paths: np.ndarray) -> float:
    """The largest rank-normalised split R-hat over the unknowns, of chains (ensembles, steps, walkers, size).

    The sequences compared are the first and second half of each ensemble, all its walkers together: walkers of one
    ensemble move by each other and are not independent. Bulk and folded version, the larger (Vehtari et al., 2021,
    equations 1-4, 14 and section 4.2). Infinite where an unknown never moves.
    """
    from scipy.stats import rankdata  # half a second to import, which every command line would pay

    steps = paths.shape[1] // 2
    halves = [half.reshape(-1, paths.shape[-1]) for path in paths for half in (path[:steps], path[-steps:])]
    x = np.stack(halves)

    def classic(draws: np.ndarray) -> np.ndarray:
        ranks = rankdata(draws.reshape(-1, draws.shape[-1]), axis=0).reshape(draws.shape)
        z = ndtri((ranks - 0.375) / (draws[..., 0].size + 0.25))
        within = np.mean(np.var(z, axis=1, ddof=1), axis=0)
        n = draws.shape[1]
        total = (n - 1) / n * within + np.var(z.mean(axis=1), axis=0, ddof=1)
        return np.asarray(np.sqrt(total / within))

    with np.errstate(all="ignore"):
        both = np.concatenate([classic(x), classic(np.abs(x - np.median(x, axis=(0, 1))))])
    moved = np.ptp(x, axis=(0, 1)) > 0
    return float(np.max(both)) if np.all(moved) and np.all(np.isfinite(both)) else float("inf")
