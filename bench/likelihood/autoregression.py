"""Coloured noise: autoregression fitted to uniformly sampled residuals, and the whitened likelihood.

G. E. P. Box, G. M. Jenkins, Time Series Analysis, 1970, section 6.3; order by the Bayesian information criterion, G.
Schwarz, Ann. Stat. 6:461, 1978. With noise of covariance ``S`` minus twice the log-likelihood is ``r' S⁻¹ r``
(generalised least squares, A. C. Aitken, Proc. R. Soc. Edinburgh 55:42, 1936). For an autoregression ``S⁻¹ = W' W``
with ``W`` its prediction errors, so it is the sum of squares of ``W y - W h``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bench.likelihood.output_error import OutputError

MOST_ORDER = 30
"""Largest order of an autoregression."""
SAMPLES_PER_ORDER = 10
"""Smallest number of samples per order."""
EVEN = 0.25
"""Largest relative deviation of a sampling interval from the median for times that count as uniform."""


@dataclass(frozen=True, eq=False)
class Autoregression:
    """``r_t = a_1 r_(t-1) + ... + a_p r_(t-p) + e_t`` with ``e`` white of the given variance; of order 0: white."""

    coefficients: np.ndarray
    variance: float

    @property
    def order(self) -> int:
        return int(self.coefficients.size)

    def spectrum(self, n: int) -> np.ndarray:
        """Return the power spectrum, up to a constant, at the n // 2 + 1 frequencies of a transform of length n."""
        return np.asarray(self.variance / np.abs(np.fft.rfft(np.append(1.0, -self.coefficients), n)) ** 2)

    def autocovariance(self, n: int) -> np.ndarray:
        """Return the autocovariance at lags 0 to n - 1."""
        length = 1 << max(13, int(np.ceil(np.log2(4 * n))))
        return np.fft.irfft(self.spectrum(length), length)[:n]

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Return standardised prediction errors of values (..., n), which are white for values of this process.

        The first values are predicted from the available predecessors, so that the errors are the factors of the exact
        likelihood (Durbin's recursion in reverse: G. E. P. Box, G. M. Jenkins, 1970, appendix A3.2).
        """
        errors = values.copy()
        for lag, coefficient in enumerate(self.coefficients, 1):
            errors[..., lag:] -= coefficient * values[..., :-lag]
        errors /= np.sqrt(self.variance)
        coefficients, variance = self.coefficients, self.variance
        for order in range(self.order - 1, -1, -1):
            reflection = coefficients[-1]
            variance /= 1.0 - reflection**2
            coefficients = (coefficients[:-1] + reflection * coefficients[-2::-1]) / (1.0 - reflection**2)
            if order < values.shape[-1]:
                known = values[..., :order] @ coefficients[::-1]
                errors[..., order] = (values[..., order] - known) / np.sqrt(variance)
        return errors

    def drawn(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw noise of shape (n,) from the spectrum of the process; it is periodic over eight times the length."""
        length = 1 << int(np.ceil(np.log2(8 * max(n, 64))))
        white = np.fft.rfft(rng.standard_normal(length))
        return np.fft.irfft(white * np.sqrt(self.spectrum(length)), length)[:n]


def even_times(times: np.ndarray) -> bool:
    """Return True for uniform sampling."""
    steps = np.diff(times)
    middle = float(np.median(steps)) if steps.size else 0.0
    return steps.size > 1 and bool(np.max(np.abs(steps - middle)) <= EVEN * middle)


def autoregression(residuals: np.ndarray, used: float = 0.0) -> Autoregression:
    """Fit an autoregression by the Levinson-Durbin recursion, with the order of the smallest BIC.

    Args:
        residuals: Uniformly sampled residuals, shape (n,).
        used: Degrees of freedom of the fit that left the residuals, for which the variance is corrected.

    Returns:
        The autoregression.
    """
    n = residuals.size
    centred = residuals - np.mean(residuals)
    most = max(0, min(MOST_ORDER, n // SAMPLES_PER_ORDER))
    lagged = np.array([centred[k:] @ centred[: n - k] / n for k in range(most + 1)])
    share = max(1.0 - used / n, 1.0 / n)
    variance, coefficients = float(lagged[0]), np.zeros(0)
    if variance <= 0:
        return Autoregression(coefficients, np.finfo(float).tiny)
    best, least = Autoregression(coefficients, variance / share), n * np.log(variance)
    for order in range(1, most + 1):
        reflection = (lagged[order] - coefficients @ lagged[order - 1 : 0 : -1]) / variance
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        variance *= 1.0 - reflection**2
        if variance <= 0:
            break
        criterion = n * np.log(variance) + order * np.log(n)
        if criterion < least:
            best, least = Autoregression(coefficients.copy(), variance / share), criterion
    return best


def log_likelihoods(noise: Autoregression, residuals: np.ndarray) -> np.ndarray:
    """Compute the conditional log-likelihood of each residual after the first, at the best variance of the noise.

    The number of skipped residuals does not depend on the order, so that orders can be compared.
    """
    errors = noise.whiten(residuals - np.mean(residuals))[min(MOST_ORDER, residuals.size // SAMPLES_PER_ORDER) :]
    scale = np.mean(errors**2)
    return np.asarray(-0.5 * (np.log(2 * np.pi * scale * noise.variance) + errors**2 / scale))


@dataclass(frozen=True, eq=False)
class Whitened(OutputError):
    """Output error of a ``model``, whitened by the noise of each channel (None: not whitened).

    Whitened noise has the standard deviation of the noise itself.
    """

    model: OutputError = field(kw_only=True)
    noises: tuple[Autoregression | None, ...] = field(kw_only=True)

    @cached_property
    def data(self) -> np.ndarray:
        return self._whitened(self.model.data)

    def predict(self, theta: np.ndarray) -> np.ndarray:
        """Whitened predictions, shape (..., N); not finite where the response diverges."""
        return self._whitened(self.model.predict(theta))

    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whitened predictions, shape (..., N), and their derivatives (..., N, size)."""
        predicted, slopes = self.model.jacobian(theta)
        return self._whitened(predicted), np.swapaxes(self._whitened(np.swapaxes(slopes, -1, -2)), -1, -2)

    def _whitened(self, values: np.ndarray) -> np.ndarray:
        values = values.copy()
        for i, noise in enumerate(self.noises):
            if noise is not None and noise.order:
                channel = self.channel_of == i
                values[..., channel] = noise.whiten(values[..., channel]) * np.sqrt(noise.autocovariance(1)[0])
        return values


def whiten_model(model: OutputError, theta: np.ndarray) -> Whitened:
    """Whiten a model by autoregressions fitted to its residuals; non-uniform channels are not whitened.

    Args:
        model: The model.
        theta: Unknowns at which residuals are computed, shape (size,).

    Returns:
        The whitened model.
    """
    residuals, share = model.data - model.predict(theta), min(theta.size / model.data.size, 1.0)
    noises = []
    for i, (_, channel) in enumerate(model.channels):
        left = residuals[model.channel_of == i]
        known = even_times(channel.times) and bool(np.all(np.isfinite(left)))
        noises.append(autoregression(left, share * left.size) if known else None)
    return Whitened(model.problem, model.gauge, model=model, noises=tuple(noises))
