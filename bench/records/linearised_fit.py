"""Linearised likelihood of records at an estimate: residuals, derivatives, and covariance for coloured noise.

With ``B = (J' J / s² + P)⁻¹``, the noise covariance ``S`` and the prior precision ``P``, the covariance of a fit that
assumes white noise is ``B (J' S J / s⁴ + P) B`` (H. White, Econometrica 50:1, 1982; P. J. Huber, Proc. 5th Berkeley
Symp. 1:221, 1967), which is ``B`` for white noise. At even times ``S`` is that of the smoothed periodogram of the
residuals, unless their autoregression has order 0; otherwise ``J' S J`` is a sum over pairs of samples with weights
that decrease with their distance in time (W. K. Newey, K. D. West, Econometrica 55:703, 1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.contract.estimate import Estimate
from bench.contract.problem import InitialState, Problem
from bench.likelihood.autoregression import Autoregression, autoregression, even_times
from bench.likelihood.compiled_model import compiled_output_error
from bench.likelihood.least_squares import degrees_used
from bench.likelihood.output_error import OutputError
from bench.records.colour import local_spectrum
from bench.records.dominant_frequency import dominant_frequency
from bench.scoring.score import point_parameters
from bench.systems import Quantity

ROWS = 512
"""Samples processed together, which bounds the memory."""
LEAST = 1e-6
"""Value (natural units) that replaces a parameter of zero: negligible, but large enough for finite differences."""
ROUNDING = 1e-7
"""Ratio of residuals to motion (root mean square) below which they are due to rounding, and white."""
CORRELATED_CYCLES = 2.0
"""Periods of the dominant frequency over which noise at uneven times may be correlated."""


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """Linearisation of a problem in natural units.

    Attributes:
        model: Output-error likelihood.
        theta: Unknowns, shape (size,).
        residuals: Measured minus predicted samples, shape (N,).
        slopes: Derivatives of the predictions, shape (N, size).
        known_noises: Noise model of each channel; estimated from the residuals if None.
    """

    model: OutputError
    theta: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    known_noises: tuple[Autoregression | None, ...] | None = None

    @cached_property
    def _prior_rows(self) -> np.ndarray:
        prior, k = self.model.prior, len(self.model.free)
        return np.zeros((0, self.theta.size)) if prior is None else np.eye(k, self.theta.size) / prior.log_sds[:, None]

    @cached_property
    def used(self) -> float:
        """Degrees of freedom used by the fit."""
        sigma = np.maximum(self.model.noise(self.residuals, self.theta.size, floor=0.0), 1e-12 * self.model.rms)
        rows = np.concatenate([self.slopes / sigma[self.model.channel_of][:, None], self._prior_rows])
        return float(degrees_used(rows[None], self.residuals.size)[0])

    @cached_property
    def sigma(self) -> np.ndarray:
        """Standard deviation of the noise of each channel."""
        return np.maximum(self.model.noise(self.residuals, self.used, floor=0.0), 1e-12 * self.model.rms)

    @cached_property
    def channels(self) -> tuple[np.ndarray, ...]:
        """Indices of the samples of each channel."""
        return tuple(np.flatnonzero(self.model.channel_of == i) for i in range(len(self.model.channels)))

    @cached_property
    def noises(self) -> tuple[Autoregression | None, ...]:
        """Noise model of each channel; None at uneven times."""
        if self.known_noises is not None:
            return self.known_noises
        share = self.used / self.residuals.size
        return tuple(
            autoregression(self.residuals[rows], share * rows.size) if even_times(channel.times) else None
            for rows, (_, channel) in zip(self.channels, self.model.channels, strict=True)
        )

    @cached_property
    def white(self) -> np.ndarray | None:
        """Covariance of theta (size, size) assuming white noise; None if the fit is singular."""
        return self.model.covariance(self.slopes, self.sigma)

    @cached_property
    def coloured(self) -> np.ndarray | None:
        """Covariance of theta (size, size) for noise of the colour of the residuals; None if the fit is singular."""
        if self.white is None or np.all(self.sigma <= ROUNDING * self.model.rms):
            return self.white
        middle = self._prior_rows.T @ self._prior_rows
        for rows, (_, channel), noise, sigma in zip(
            self.channels, self.model.channels, self.noises, self.sigma, strict=True
        ):
            slopes, residuals = self.slopes[rows], self.residuals[rows]
            if noise is None:
                reach = CORRELATED_CYCLES / max(dominant_frequency(channel.times, channel.values), 1e-12)
                scores = uneven_scores(slopes, residuals, channel.times, reach)
            else:
                scores = even_scores(slopes, None if self.known_noises else residuals, noise)
            middle = middle + scores / sigma**4
        return np.asarray(self.white @ middle @ self.white)

    def gradient(self, quantity: Quantity) -> np.ndarray:
        """Return the derivative of a quantity's logarithm by theta, shape (size,)."""
        by_theta = np.zeros(self.theta.size)
        by_theta[: len(self.model.free)] = quantity.vector(self.model.free)
        return by_theta


def even_scores(slopes: np.ndarray, residuals: np.ndarray | None, noise: Autoregression) -> np.ndarray:
    """Compute ``J' S J`` of a channel at even times.

    Args:
        slopes: Derivatives, shape (n, p).
        residuals: Residuals, shape (n,), from which the spectrum is estimated; None to use that of ``noise``.
        noise: Noise model; a model of order 0 is white.
    """
    n = len(slopes)
    length = 1 << int(np.ceil(np.log2(2 * n)))
    spectrum = noise.spectrum(length)
    if residuals is not None and noise.order:
        spectrum = local_spectrum(residuals, slopes, length)
    moved = np.fft.irfft(spectrum[:, None] * np.fft.rfft(slopes, length, axis=0), length, axis=0)
    return np.asarray(slopes.T @ moved[:n])


def uneven_scores(slopes: np.ndarray, residuals: np.ndarray, times: np.ndarray, reach: float) -> np.ndarray:
    """Compute ``J' S J`` of a channel at any times.

    Args:
        slopes: Derivatives, shape (n, p).
        residuals: Residuals, shape (n,).
        times: Times, shape (n,).
        reach: Time over which the noise is correlated.
    """
    n, p = slopes.shape
    scores, total = slopes * residuals[:, None], np.zeros((p, p))
    for first in range(0, n, ROWS):  # the matrix of all pairs may not fit into memory
        rows = slice(first, first + ROWS)
        low, high = np.searchsorted(times, [times[rows][0] - reach, times[rows][-1] + reach])
        near = np.maximum(1.0 - np.abs(times[rows][:, None] - times[low:high]) / reach, 0.0)
        total += scores[rows].T @ near @ scores[low:high]
    return total * n / max(n - p, 1)


def linearise(problem: Problem, estimate: Estimate) -> LinearisedFit | None:
    """Linearise the likelihood of a problem at an estimate; None if it has no parameters or no finite response.

    The initial state and the offset are the best fit for the estimated parameters, or the estimated initial state if
    that fits better.
    """
    units = problem.natural_units()
    scaled, model = estimate.expressed_in(units), compiled_output_error(problem.expressed_in(units))
    p = point_parameters(scaled)
    if p is None or not all(np.isfinite(value) and value >= 0 for value in p.values()):
        return None
    p = {name: max(value, LEAST) for name, value in p.items()}  # the logarithm of an estimate of zero is infinite
    if model.system.gauge not in model.free:
        model = compiled_output_error(model.problem, p[model.system.gauge])
    with np.errstate(all="ignore"):
        trials = [model.vector(p)]
        if scaled.initial_states is not None:
            trials.append(_with_initial_states(model, trials[0], scaled.initial_states))
        theta = min(trials, key=model.profile)
        return at_theta(model, _without_turns(model, theta))


def at_theta(model: OutputError, theta: np.ndarray) -> LinearisedFit | None:
    """Linearise the likelihood at theta (size,); None if the response or a derivative is not finite."""
    with np.errstate(all="ignore"):
        predicted, slopes = model.jacobian(theta)
    if not (np.all(np.isfinite(predicted)) and np.all(np.isfinite(slopes))):
        return None
    return LinearisedFit(model, theta, model.data - predicted, slopes)


def _without_turns(model: OutputError, theta: np.ndarray) -> np.ndarray:
    """Move whole turns of a pendulum from its initial displacement to the offset of its sensor."""
    length = model.parameters(theta).get("l", dict(getattr(model.system, "fixed", ())).get("l"))
    if length is None or not model.offset_channels or len(model.problem.records) > 1 or not model.unknown_starts:
        return theta
    turn = 2 * np.pi * float(length)
    turns = turn * np.round(theta[len(model.free)] / turn)
    theta = theta.copy()
    theta[len(model.free)] -= turns
    theta[-len(model.offset_channels) :] += turns
    return theta


def _with_initial_states(model: OutputError, theta: np.ndarray, states: Sequence[InitialState]) -> np.ndarray:
    """Return theta with the given initial states and the offsets that fit best."""
    theta, place = theta.copy(), len(model.free)
    for i in model.unknown_starts:
        state = np.concatenate([states[i].displacement, states[i].velocity])
        theta[place : place + state.size] = state
        place += state.size
    if model.offset_channels:
        left = model.data - model.predict(theta) + model.offsets(theta)[model.channel_of]
        theta[place:] = [np.mean(left[model.channel_of == i]) for i in model.offset_channels]
    return theta
