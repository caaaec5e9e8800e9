"""The posterior that the samplers draw from.

Sampled together: the log-parameters, the initial states and offsets that are not told, and the logarithm of each
channel's noise. Likelihood: independent normal errors about the simulated response. Priors, all proper but one: the
problem's nominal prior on the log-parameters (without one, a normal of standard deviation 3, a factor of 20, about the
best fit to the data); ``log sigma ~ Normal(log(rms of the channel / 10), 3²)``, its two standard deviations reach from
70 dB to -30 dB, and it is nil below ``NOISE_LEAST`` of a channel's size; flat on initial states and offsets, which the
data fix. The errors may be Student's t in place of normal (:mod:`methods.trajectory.student`); sigma is then their
scale.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import LOG_LIMIT, OutputError, Start
from methods.starts.open_parameters import PRIORLESS_SD
from methods.trajectory.student import NORMAL, NormalErrors, StudentErrors

NOISE_CENTRE = float(np.log(0.1))
NOISE_SD = 3.0
NOISE_LEAST = 1e-8
"""The least noise, as a part of a channel's size: rounding errors of simulation and sampling are well below it."""
MOST_AT_ONCE = 2**16
"""Predictions that are formed at a time: more would leave the processor's cache."""


class Posterior:
    """What belongs to one posterior over ``phi = [theta, log sigma by channel]``; ``calls`` counts responses."""

    def __init__(self, model: OutputError, mode: np.ndarray, errors: NormalErrors | StudentErrors = NORMAL) -> None:
        self.model, self.mode, self.errors, self.calls = model, mode, errors, 0
        self.noise_centre = NOISE_CENTRE + np.log(model.rms)
        k = len(model.free)
        self.centre = mode[:k] if model.prior is None else model.prior.log_mean
        self.sds = np.full(k, PRIORLESS_SD) if model.prior is None else model.prior.log_sds

    @property
    def size(self) -> int:
        return self.model.size + len(self.model.channels)

    def __call__(self, phi: np.ndarray) -> np.ndarray:
        """Log-density, shape (n,), of ``phi`` of shape (n, size); minus infinity where the response diverges."""
        return Target([self])(np.zeros(len(phi), int), phi)


class Target:
    """Of posteriors of one layout and a linear system, with errors of one law, or of a single one of any system.

    A *case* is one posterior with one vector phi; a case's value does not depend on the others.
    """

    def __init__(self, posteriors: Sequence[Posterior]) -> None:
        self.posteriors, self.model, self.errors = list(posteriors), posteriors[0].model, posteriors[0].errors
        self.data = np.stack([own.model.data for own in posteriors])
        self.centre = np.stack([own.centre for own in posteriors])
        self.sds = np.stack([own.sds for own in posteriors])
        self.noise_centre = np.stack([own.noise_centre for own in posteriors])
        self.least = np.log(NOISE_LEAST) + np.log(np.stack([own.model.rms for own in posteriors]))
        self.told = [
            None if isinstance(starts[0], tuple) else np.stack([[s.displacement, s.velocity] for s in starts], -1)
            for starts in zip(*(own.model.starts(own.mode) for own in posteriors), strict=True)
        ]

    def __call__(self, which: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """Log-density, shape (n,), of cases (n,) and phi (n, size); minus infinity where the response diverges."""
        size = max(1, MOST_AT_ONCE // self.model.data.size)
        for problem, count in zip(*np.unique(which, return_counts=True), strict=True):
            self.posteriors[problem].calls += int(count)
        parts = [self._values(which[at : at + size], phi[at : at + size]) for at in range(0, len(phi), size)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _values(self, which: np.ndarray, phi: np.ndarray) -> np.ndarray:
        model, d, k = self.model, self.model.size, len(self.model.free)
        theta, log_sigma = phi[:, :d], phi[:, d:]
        inside = np.all(np.abs(theta[:, :k]) < LOG_LIMIT, axis=1) & np.all(np.abs(log_sigma) < LOG_LIMIT, axis=1)
        inside &= np.all(log_sigma >= self.least[which], axis=1)
        with np.errstate(all="ignore"):
            r = self.data[which] - self._predicted(which, np.where(inside[:, None], theta, 0.0))
            r *= np.exp(-log_sigma)[:, model.channel_of]
            value = self.errors.log_likelihood(r) - log_sigma @ model.counts
            value -= 0.5 * np.sum(((theta[:, :k] - self.centre[which]) / self.sds[which]) ** 2, axis=1)
            value -= 0.5 * np.sum(((log_sigma - self.noise_centre[which]) / NOISE_SD) ** 2, axis=1)
        return np.where(inside & np.isfinite(value), value, -np.inf)

    def _predicted(self, which: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Simulated measurements (n, N). A case whose matrices are singular or overflow fails for all: it is sought."""
        try:
            found = self._simulated(which, theta)
            if len(theta) == 1 or np.any(np.isfinite(found)):
                return found
        except np.linalg.LinAlgError:
            if len(theta) == 1:
                return np.full((1, self.model.data.size), np.nan)
        half = len(theta) // 2
        parts = (slice(None, half), slice(half, None))
        return np.concatenate([self._predicted(which[part], theta[part]) for part in parts])

    def _simulated(self, which: np.ndarray, theta: np.ndarray) -> np.ndarray:
        model = self.model
        if len(self.posteriors) == 1:
            return model.predict(theta)
        p, starts = model.parameters(theta), list[Start]()
        for told, start in zip(self.told, model.starts(theta), strict=True):
            starts.append(start if told is None else (told[0][:, which], told[1][:, which]))
        records = model.problem.records
        parts = [model.readings(p, start, record) for start, record in zip(starts, records, strict=True)]
        return np.concatenate(parts, -1) + model.offsets(theta)[..., model.channel_of]
