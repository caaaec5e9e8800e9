"""Frequency responses averaged over records of force and response, with coherence and variance.

``F`` and ``Y`` are the spectra of force and response of a record, ``mean`` is over records.
``H1 = mean(conj(F) Y) / mean(|F|²)`` is unbiased if only the response is noisy (J. S. Bendat, A. G. Piersol, Random
Data, 4th ed., chapters 6 and 9). Noise of the force with the spectrum N biases H1 downwards, by the factor
``1 / (1 + N / S)`` with the spectrum S of the true force. For few records n the bias is smaller, as the noise is in the
numerator as well: to second order the relative bias is ``-(1 - 1/n) N / S``, zero for a single record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import csd

from bench.contract.modal import Blows, FrequencyResponses, Response
from bench.modal.blows import force_windowed, touched

SEGMENTS, FEWEST_SAMPLES = 8, 16
"""Number of segments of a shaker record, not counting their overlap; least samples of a segment."""
OVERLAP = 1.0 / 6.0
"""Correlation of neighbouring segments with a Hann window and an overlap of half (P. D. Welch, IEEE Transactions on
Audio and Electroacoustics 15, 1967)."""
REACH = 0.01
"""Least power of the force in excited lines over its largest."""
ENDED = 0.01
"""Ratio of the root mean squares of the last and first tenth of a record below which the motion has decayed."""


@dataclass(frozen=True, eq=False)
class Averages:
    """Estimates of frequency responses.

    Attributes:
        frequencies: Frequencies (Hz), shape (lines,).
        h1: H1, shape (outputs, lines).
        coherence: Coherence, shape (outputs, lines).
        variances: Mean square of the complex error of H1, shape (outputs, lines); NaN for a single record.
        bias: Relative bias of H1 due to the noise of the force, shape (lines,); if unknown (NaN), it is between
            ``coherence - 1`` and 0.
        count: Number of independent records.
        response: Kind of the response.
        window: Decay rate (1/s) of the exponential window on the responses.
        reach: Mask of the lines in which the force has at least a hundredth (-20 dB) of its largest power.
    """

    frequencies: np.ndarray
    h1: np.ndarray
    coherence: np.ndarray
    variances: np.ndarray
    bias: np.ndarray
    count: float
    response: Response
    window: float
    reach: np.ndarray

    def frequency_responses(self) -> FrequencyResponses:
        """Return H1 with its variances."""
        variances = self.variances if np.all(np.isfinite(self.variances)) else None
        return FrequencyResponses(self.frequencies, self.h1, self.response, variances, self.window)

    def summary(self) -> str:
        """Return a sentence with the medians of coherence and bias over the excited lines."""
        if self.count == 1.0:
            return "a single blow: errors of the frequency responses are unknown; use several blows"
        coherence, bias = float(np.median(self.coherence[:, self.reach])), float(np.median(self.bias[self.reach]))
        size = f"by {100.0 * bias:.2g} %" if np.isfinite(bias) else f"by at most {100.0 * (coherence - 1.0):.2g} %"
        last = float(np.max(self.frequencies[self.reach]))
        lines = f"{self.count:.3g} averages up to {last:.4g} Hz, where the force has fallen by 20 dB"
        return f"{lines}: median coherence {coherence:.4g}, noise of the force biases H1 {size}"


def averages(blows: Blows, decay: float = 0.0) -> Averages:
    """Average H1, with coherence, variance and bias; the force of a hammer is zero outside of the contact.

    A single shaker record is cut into segments with a Hann window and an overlap of half. For ``n`` records the error
    of H1 has the mean square ``(1 - coherence) / (coherence (n - 1)) |H1|²``, by the scatter of the records about
    ``Y = H1 F``. Bendat and Piersol (chapter 9) have ``n`` in place of ``n - 1``, and half of it for the magnitude.

    Args:
        blows: Records of force and response.
        decay: Rate (1/s) of an exponential window that is applied to force and response, in addition to
            ``blows.window``, which is then applied to the force as well. It is exact for any force: ``exp(-a t) (h * f)
            = (exp(-a t) h) * (exp(-a t) f)``. The poles of the averages are those of the modes minus ``window``.
    """
    n, hammer = blows.forces.shape[1], touched(blows.forces)
    cut = hammer is None and len(blows.forces) == 1
    size = max(n // SEGMENTS, FEWEST_SAMPLES) if cut else n
    count = float(len(blows.forces))
    if cut:
        count = float(1 + (n - size) // (size - size // 2))
        count /= 1.0 + 2.0 * OVERLAP**2 * (count - 1.0) / count

    def power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the mean of ``conj(A) B`` without the lines at 0 and the Nyquist frequency."""
        spectra = csd(a, b, 1.0 / blows.step, "hann" if cut else "boxcar", size)[1]
        return np.asarray(np.mean(spectra, axis=0)[..., 1 : (size + 1) // 2])

    times, window = blows.step * np.arange(n), blows.window + decay
    fade, responses = np.exp(-window * times), blows.responses * np.exp(-decay * times)
    forces = force_windowed(blows).forces * fade
    s_ff, s_yy, s_fy = power(forces, forces).real, power(responses, responses).real, power(forces[:, None], responses)
    with np.errstate(divide="ignore", invalid="ignore"):
        h1 = s_fy / s_ff
        coherence = np.minimum(np.abs(s_fy) ** 2 / (s_ff * s_yy), 1.0)
        variances = (1.0 - coherence) * s_yy / s_ff / (count - 1.0) if count > 1.0 else np.full(h1.shape, np.nan)
    noise = np.full(s_ff.shape, np.nan)
    if hammer is not None:
        quiet = np.where(hammer, 0.0, blows.forces - np.median(blows.forces, axis=1, keepdims=True)) * fade
        ratio = np.mean(hammer @ fade**2) / np.mean(~hammer @ fade**2)
        noise = np.minimum(power(quiet, quiet).real * ratio / s_ff, 1.0)
    true = s_ff * (1.0 - np.nan_to_num(noise))
    return Averages(
        np.fft.rfftfreq(size, blows.step)[1 : (size + 1) // 2], h1, coherence, variances,
        -(1.0 - 1.0 / count) * noise, count, blows.response, window, true >= REACH * np.max(true),
    )  # fmt: skip


def decay_needed(blows: Blows) -> float:
    """Return the rate (1/s) of an exponential window with which the motion decays within the record; 0 if it does.

    Otherwise lines near a natural frequency are biased by leakage.
    """
    n = blows.responses.shape[-1]
    squares = np.mean(blows.responses**2, axis=0)
    start, end = np.mean(squares[:, : n // 10], axis=1), np.mean(squares[:, -(n // 10) :], axis=1)
    left = np.sqrt(np.max(end[start > 0] / start[start > 0], initial=0.0))
    return float(np.log(max(left / ENDED, 1.0)) / (n * blows.step))
