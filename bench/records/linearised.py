"""A record's likelihood at an answer: residuals, their derivatives, and the covariance that noise of any colour gives.

With bread ``B = (J' J / s² + P)⁻¹`` and the noise's covariance ``S`` the covariance of a fit that took the noise for
white is ``B (J' S J / s⁴ + P) B`` (H. White, Econometrica 50:1, 1982; P. J. Huber, Proc. 5th Berkeley Symp. 1:221,
1967), and ``B`` itself where the noise is white. ``P``: precision of the prior. For even samples ``S`` is the mean of
an autoregression of the residuals and their own smoothed periodogram, where that is not far higher; otherwise
``J' S J`` is a sum over pairs of samples with weights that fall with their distance in time (W. K. Newey, K. D. West,
Econometrica 55:703, 1987).
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
from bench.records.strongest import strongest_frequency
from bench.scoring.score import point_parameters
from bench.systems import Quantity

ROWS = 512
LEAST = 1e-6
"""In natural units, what stands for a parameter of zero: next to no effect, and central differences still show it."""
ROUNDING = 1e-7
"""Residuals over the motion, root mean squares, below which they are rounding and have no colour."""
BEYOND = 2.0
"""The periodogram smoothed over seven frequencies over the autoregression's spectrum beyond which it alone counts: of
the same noise it is there in 2 % of cases (chi-square with 14 degrees of freedom). Else their mean does: the larger of
both would be too wide by a tenth, the periodogram alone too narrow as often as not."""
CORRELATED_CYCLES = 2.0
"""Cycles of the strongest frequency over which samples at uneven times may be correlated."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals (N,) of a problem in natural units at ``theta``, with the derivatives (N, size) of the predictions.

    ``told``: the colour of each channel's noise where a longer record tells it better than these residuals do.
    """

    model: OutputError
    theta: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    told: tuple[Autoregression | None, ...] | None = None

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
        if self.told is not None:
            return self.told
        share = self.used / self.residuals.size
        return tuple(
            autoregression(self.residuals[own], share * own.size) if even_times(channel.times) else None
            for own, (_, channel) in zip(self.channels, self.model.channels, strict=True)
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
        for i, own in enumerate(self.channels):
            middle = middle + self._middle(i, own) / self.sigma[i] ** 4
        return np.asarray(self.white @ middle @ self.white)

    def _middle(self, i: int, own: np.ndarray) -> np.ndarray:
        """``J' S J`` of one channel."""
        noise, slopes = self.noises[i], self.slopes[own]
        if noise is not None:
            length = 1 << int(np.ceil(np.log2(2 * own.size)))
            spectrum = noise.spectrum(length)
            if noise.order and self.told is None:
                local = local_spectrum(self.residuals[own], slopes, length)
                spectrum = np.where(local > BEYOND * spectrum, local, (local + spectrum) / 2.0)
            moved = np.fft.irfft(spectrum[:, None] * np.fft.rfft(slopes, length, axis=0), length, axis=0)
            return np.asarray(slopes.T @ moved[: own.size])
        times, scores = self.model.channels[i][1].times, slopes * self.residuals[own][:, None]
        reach = CORRELATED_CYCLES / max(strongest_frequency(times, self.model.channels[i][1].values), 1e-12)
        total = np.zeros((self.theta.size, self.theta.size))
        for first in range(0, own.size, ROWS):  # a matrix of all pairs would not fit into memory
            rows = slice(first, first + ROWS)
            low, high = np.searchsorted(times, [times[rows][0] - reach, times[rows][-1] + reach])
            near = np.maximum(1.0 - np.abs(times[rows][:, None] - times[low:high]) / reach, 0.0)
            total += scores[rows].T @ near @ scores[low:high]
        return total * own.size / max(own.size - self.theta.size, 1)

    def gradient(self, quantity: Quantity) -> np.ndarray:
        """The derivative of the quantity's logarithm by theta."""
        own = np.zeros(self.theta.size)
        own[: len(self.model.free)] = quantity.vector(self.model.free)
        return own


def linearised(problem: Problem, estimate: Estimate) -> Linearised | None:
    """The likelihood of the problem at an answer to it; None where the answer has no parameters or no response.

    The start and the offset are what fits the data best at the answer's parameters, or the answer's own start where
    that fits better.
    """
    units = problem.natural_units()
    own, model = estimate.expressed_in(units), compiled_output_error(problem.expressed_in(units))
    p = point_parameters(own)
    if p is None or not all(np.isfinite(value) and value >= 0 for value in p.values()):
        return None
    p = {name: max(value, LEAST) for name, value in p.items()}  # a method may end at no damping at all
    if model.system.gauge not in model.free:
        model = compiled_output_error(model.problem, p[model.system.gauge])
    with np.errstate(all="ignore"):
        trials = [model.vector(p)]
        if own.initial_states is not None:
            trials.append(_started(model, trials[0], own.initial_states))
        theta = min(trials, key=model.profile)
        return at_theta(model, _unturned(model, theta))


def at_theta(model: OutputError, theta: np.ndarray) -> Linearised | None:
    """The likelihood at a vector of unknowns; None where its response, or a neighbour's, is not finite."""
    with np.errstate(all="ignore"):
        predicted, slopes = model.jacobian(theta)
    if not (np.all(np.isfinite(predicted)) and np.all(np.isfinite(slopes))):
        return None
    return Linearised(model, theta, model.data - predicted, slopes)


def _unturned(model: OutputError, theta: np.ndarray) -> np.ndarray:
    """Theta without whole turns of a pendulum, which its start and the offset of its sensor may share out as they like.

    Of a sum, ``l`` may be told.
    """
    length = model.parameters(theta).get("l", dict(getattr(model.system, "fixed", ())).get("l"))
    if length is None or not model.offset_channels or len(model.problem.records) > 1 or not model.unknown_starts:
        return theta
    turn = 2 * np.pi * float(length)
    turns = turn * np.round(theta[len(model.free)] / turn)
    own = theta.copy()
    own[len(model.free)] -= turns
    own[-len(model.offset_channels) :] += turns
    return own


def _started(model: OutputError, theta: np.ndarray, starts: Sequence[InitialState]) -> np.ndarray:
    """Theta with the given starts, and the offsets that fit best there."""
    theta, at = theta.copy(), len(model.free)
    for i in model.unknown_starts:
        both = np.concatenate([starts[i].displacement, starts[i].velocity])
        theta[at : at + both.size] = both
        at += both.size
    if model.offset_channels:
        left = model.data - model.predict(theta) + model.offsets(theta)[model.channel_of]
        theta[at:] = [np.mean(left[model.channel_of == i]) for i in model.offset_channels]
    return theta
