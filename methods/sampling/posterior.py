"""The posterior sampled by the samplers.

The unknowns are the log-parameters, unknown initial states and offsets, and the logarithm of each channel's noise. The
likelihood has independent normal errors about the simulated response. The priors are: the problem's prior on the
log-parameters (without one, a normal of standard deviation 3, a factor of 20, about the best fit);
``log sigma ~ Normal(log(rms of the channel / 10), 3²)``, whose two standard deviations range from 70 to -30 dB,
truncated below ``NOISE_LEAST`` of a channel's size; and flat priors on initial states and offsets. The errors may be
Student's t (:mod:`methods.trajectory.student`); sigma is then their scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import LOG_LIMIT, InitialValues, OutputError, Record, compiled_path
from methods.starts.candidates import Stepped
from methods.starts.integration import integrated_readings
from methods.starts.wide_prior import PRIORLESS_SD
from methods.trajectory.student import NORMAL, NormalErrors, StudentErrors

NOISE_CENTRE = float(np.log(0.1))
NOISE_SD = 3.0
NOISE_LEAST = 1e-8
"""Least noise as a fraction of a channel's size, well above rounding errors of simulation and sampling."""
MOST_AT_ONCE = 2**16
"""Largest number of predictions computed at once, limited by the processor's cache."""
COMPILED_SETS = 8
"""Least number of parameter sets for compiled steps of a nonlinear system."""
RADIANS = 0.05
"""Default step in radians of the fastest rate, as in :func:`bench.simulate`."""


class Posterior:
    """The log-densities of problems of one layout with a linear system, or of a single problem of any system.

    They are functions of ``phi = [theta, log sigma of each channel]``; each value is independent of the batch.
    ``modes``: theta at the mode of each problem. ``calls``: number of responses of each problem.
    """

    def __init__(
        self, models: Sequence[OutputError], modes: Sequence[np.ndarray], errors: NormalErrors | StudentErrors = NORMAL
    ) -> None:
        self.model, self.mode, self.errors = models[0], modes[0], errors
        self.batch = models[0] if len(models) == 1 else OutputError.batch(models)
        self.calls = np.zeros(len(models), int)
        rms, k, prior = np.stack([model.rms for model in models]), len(self.model.free), self.model.prior
        self.data = np.stack([model.data for model in models])
        self.noise_centre, self.least = NOISE_CENTRE + np.log(rms), np.log(NOISE_LEAST * rms)
        self.centre = np.stack([mode[:k] for mode in modes] if prior is None else [m.log_mean for m in models])
        self.sds = np.full_like(self.centre, PRIORLESS_SD)
        if prior is not None:
            self.sds = 1.0 / np.stack([model.precision for model in models])

    @property
    def size(self) -> int:
        return self.model.size + len(self.model.channels)

    def __call__(self, phi: np.ndarray, which: np.ndarray | None = None) -> np.ndarray:
        """Return the log-density (n,) at phi (n, size) of the problems ``which`` (n,), by default the first.

        It is minus infinity where the response diverges.
        """
        which = np.zeros(len(phi), int) if which is None else which
        self.calls += np.bincount(which, minlength=self.calls.size)
        size = max(1, MOST_AT_ONCE // self.model.data.size)
        parts = [self._values(which[i : i + size], phi[i : i + size]) for i in range(0, len(phi), size)]
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
        """Simulate measurements (n, N); where a singular matrix or an overflow makes a batch fail, bisect it."""
        try:
            predicted = (self.batch if self.calls.size == 1 else self.batch[which]).predict(theta)
            if len(theta) == 1 or np.any(np.isfinite(predicted)):
                return predicted
        except np.linalg.LinAlgError:
            if len(theta) == 1:
                return np.full((1, self.model.data.size), np.nan)
        half = len(theta) // 2
        parts = (slice(None, half), slice(half, None))
        return np.concatenate([self._predicted(which[part], theta[part]) for part in parts])


@dataclass(frozen=True, eq=False)
class Compiled(OutputError):
    """The output error of a nonlinear system, integrated by compiled steps of at most ``radians``."""

    radians: float = RADIANS

    def readings(self, p: dict[str, np.ndarray], start: InitialValues, record: Record) -> np.ndarray:
        """Simulate the measurements; not finite where the response diverges."""
        if np.prod(np.broadcast_shapes(*(np.shape(value) for value in p.values()))) < COMPILED_SETS:
            return super().readings(p, start, record)
        return integrated_readings(self.system, p, start, record, self.radians, compiled_path)


def compiled(model: OutputError) -> OutputError:
    """Return the model, with compiled steps of the same accuracy for a nonlinear system."""
    if model.system.linear:
        return model
    return Compiled(model.problem, radians=model.radians if isinstance(model, Stepped) else RADIANS)
