"""Output error with coloured noise: data and predictions filtered so that the noise is white.

With noise of covariance ``S`` minus twice the log-likelihood is ``r' S⁻¹ r`` (generalised least squares, A. C. Aitken,
Proc. R. Soc. Edinburgh 55:42, 1936). For an autoregression ``S⁻¹ = W' W`` with ``W`` its prediction errors, so it is
the sum of squares of ``W y - W h``, and all that is made for white noise serves.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bench.likelihood.autoregression import Autoregression, autoregression, even_times
from bench.likelihood.output_error import OutputError


@dataclass(frozen=True, eq=False)
class Whitened(OutputError):
    """The output error of a ``model``, whitened by the noise of each channel; None: that channel stays as it is.

    A channel keeps its scale: whitened noise has the standard deviation of the noise itself.
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
        found = values.copy()
        for i, noise in enumerate(self.noises):
            if noise is not None and noise.order:
                own = self.channel_of == i
                found[..., own] = noise.whitened(values[..., own]) * np.sqrt(noise.autocovariance(1)[0])
        return found


def whitened(model: OutputError, theta: np.ndarray) -> Whitened:
    """A model whitened by what its residuals at ``theta`` show; channels at uneven times stay as they are."""
    residuals, share = model.data - model.predict(theta), min(theta.size / model.data.size, 1.0)
    noises = []
    for i, (_, channel) in enumerate(model.channels):
        own = residuals[model.channel_of == i]
        known = even_times(channel.times) and bool(np.all(np.isfinite(own)))
        noises.append(autoregression(own, share * own.size) if known else None)
    return Whitened(model.problem, model.gauge, model=model, noises=tuple(noises))
