"""A record's likelihood at an answer: residuals, their derivatives, and the covariance that noise of any colour gives.

With bread ``B = (J' J / s² + P)⁻¹`` and the noise's covariance ``S`` the covariance of a fit that took the noise for
white is ``B (J' S J / s⁴ + P) B`` (H. White, Econometrica 50:1, 1982; P. J. Huber, Proc. 5th Berkeley Symp. 1:221,
1967), and ``B`` itself where the noise is white. ``P``: precision of the prior. For even samples ``S`` is that of the
smoothed periodogram of the residuals, where an autoregression of these has any order; otherwise ``J' S J`` is a sum
over pairs of samples with weights that fall with their distance in time (W. K. Newey, K. D. West, Econometrica 55:703,
1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.contract.estimate import Estimate
from bench.contract.problem import InitialState, Problem
from bench.likelihood.autoregression import Autoregression, autoregression, even_times
from bench.likelihood.compiled import compiled_output_error
from bench.likelihood.least_squares import degrees_used
from bench.likelihood.output_error import OutputError
from bench.records.colour import local_spectrum
from bench.records.dominant_frequency import dominant_frequency
from bench.scoring.score import point_parameters
from bench.systems import Quantity

ROWS = 512
LEAST = 1e-6
"""In natural units, what stands for a parameter of zero: next to no effect, and central differences still show it."""
ROUNDING = 1e-7
"""Residuals over the motion, root mean squares, below which they are rounding and have no colour."""
CORRELATED_CYCLES = 2.0
"""Cycles of the strongest frequency over which samples at uneven times may be correlated."""


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """Residuals (N,) of a problem in natural units at ``theta``, with the derivatives (N, size) of the predictions.

    ``known_noises``: the colour of each channel's noise, where these residuals are not what shows it.
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
        """Degrees of freedom that the data have spent."""
        sigma = np.maximum(self.model.noise(self.residuals, self.theta.size, floor=0.0), 1e-12 * self.model.rms)
        rows = np.concatenate([self.slopes / sigma[self.model.channel_of][:, None], self._prior_rows])
        return float(degrees_used(rows[None], self.residuals.size)[0])

    @cached_property
    def sigma(self) -> np.ndarray:
        """Noise by channel."""
        return np.maximum(self.model.noise(self.residuals, self.used, floor=0.0), 1e-12 * self.model.rms)

    @cached_property
    def channels(self) -> tuple[np.ndarray, ...]:
        """Numbers of the samples of each channel."""
        return tuple(np.flatnonzero(self.model.channel_of == i) for i in range(len(self.model.channels)))

    @cached_property
    def noises(self) -> tuple[Autoregression | None, ...]:
        """The colour of each channel's noise; None at uneven times."""
        if self.known_noises is not None:
            return self.known_noises
        share = self.used / self.residuals.size
        return tuple(
            autoregression(self.residuals[rows], share * rows.size) if even_times(channel.times) else None
            for rows, (_, channel) in zip(self.channels, self.model.channels, strict=True)
        )

    @cached_property
    def white(self) -> np.ndarray | None:
        """Covariance of theta (size, size) if the noise were white; None where a direction is open."""
        return self.model.covariance(self.slopes, self.sigma)

    @cached_property
    def coloured(self) -> np.ndarray | None:
        """Covariance of theta (size, size) with the noise as its residuals are; None where a direction is open."""
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
        """Return the derivative of the quantity's logarithm by theta."""
        by_theta = np.zeros(self.theta.size)
        by_theta[: len(self.model.free)] = quantity.vector(self.model.free)
        return by_theta


def even_scores(slopes: np.ndarray, residuals: np.ndarray | None, noise: Autoregression) -> np.ndarray:
    """Compute ``J' S J`` of one channel at even times, of slopes (n, p); without residuals (n,) the noise is known."""
    n = len(slopes)
    length = 1 << int(np.ceil(np.log2(2 * n)))
    spectrum = noise.spectrum(length)
    if residuals is not None and noise.order:
        spectrum = local_spectrum(residuals, slopes, length)
    moved = np.fft.irfft(spectrum[:, None] * np.fft.rfft(slopes, length, axis=0), length, axis=0)
    return np.asarray(slopes.T @ moved[:n])


def uneven_scores(slopes: np.ndarray, residuals: np.ndarray, times: np.ndarray, reach: float) -> np.ndarray:
    """Compute ``J' S J`` of one channel at any times, of slopes (n, p), correlated over a time of ``reach``."""
    n, p = slopes.shape
    scores, total = slopes * residuals[:, None], np.zeros((p, p))
    for first in range(0, n, ROWS):  # a matrix of all pairs would not fit into memory
        rows = slice(first, first + ROWS)
        low, high = np.searchsorted(times, [times[rows][0] - reach, times[rows][-1] + reach])
        near = np.maximum(1.0 - np.abs(times[rows][:, None] - times[low:high]) / reach, 0.0)
        total += scores[rows].T @ near @ scores[low:high]
    return total * n / max(n - p, 1)


def linearise(problem: Problem, estimate: Estimate) -> LinearisedFit | None:
    """Compute the likelihood of the problem at an answer; None where the answer has no parameters or no response.

    The initial state and the offset are those that fit the data best at the answer's parameters, or the answer's own
    initial state where that fits better.
    """
    units = problem.natural_units()
    answer, model = estimate.expressed_in(units), compiled_output_error(problem.expressed_in(units))
    p = point_parameters(answer)
    if p is None or not all(np.isfinite(value) and value >= 0 for value in p.values()):
        return None
    p = {name: max(value, LEAST) for name, value in p.items()}  # a method may end at no damping at all
    if model.system.gauge not in model.free:
        model = compiled_output_error(model.problem, p[model.system.gauge])
    with np.errstate(all="ignore"):
        trials = [model.vector(p)]
        if answer.initial_states is not None:
            trials.append(_with_initial_states(model, trials[0], answer.initial_states))
        theta = min(trials, key=model.profile)
        return at_theta(model, _without_turns(model, theta))


def at_theta(model: OutputError, theta: np.ndarray) -> LinearisedFit | None:
    """Compute the likelihood at a vector of unknowns; None where its response, or a neighbour's, is not finite."""
    with np.errstate(all="ignore"):
        predicted, slopes = model.jacobian(theta)
    if not (np.all(np.isfinite(predicted)) and np.all(np.isfinite(slopes))):
        return None
    return LinearisedFit(model, theta, model.data - predicted, slopes)


def _without_turns(model: OutputError, theta: np.ndarray) -> np.ndarray:
    """Take whole turns of a pendulum out of its initial state, which the offset of its sensor may stand for."""
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
    """Put given initial states into theta, and the offsets that fit best there."""
    theta, place = theta.copy(), len(model.free)
    for i in model.unknown_starts:
        state = np.concatenate([states[i].displacement, states[i].velocity])
        theta[place : place + state.size] = state
        place += state.size
    if model.offset_channels:
        left = model.data - model.predict(theta) + model.offsets(theta)[model.channel_of]
        theta[place:] = [np.mean(left[model.channel_of == i]) for i in model.offset_channels]
    return theta
