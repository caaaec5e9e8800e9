"""Frequency responses averaged over records of force and response, with coherence and variance.

``F`` and ``Y`` are the spectra of force and response of a record, ``mean`` is over records.
``H1 = mean(conj(F) Y) / mean(|F|²)`` is right where only the response is noisy, ``H2 = mean(|Y|²) / mean(conj(Y) F)``
where only the force is (J. S. Bendat, A. G. Piersol, Random Data, 4th ed., chapters 6 and 9). Noise of the force with
the spectrum N biases H1 by the factor ``1 / (1 + N / S)``, S that of the true force: H1 is too low, and noise of the
response makes H2 too high. Of few records n it is less, as the noise is in the numerator, too: to second order the
relative bias is ``-(1 - 1/n) N / S``, none of a single record. ``Hv`` is total least squares for one signal-to-noise
ratio in both: its magnitude is the geometric mean of the two (G. T. Rocklin, J. Crowley, H. Vold, A comparison of H1,
H2, and Hv frequency response functions, IMAC 3, 1985).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import csd

from bench.contract.modal import Blows, FrequencyResponses, Response
from bench.modal.blows import force_windowed, touched

SEGMENTS, FEWEST_SAMPLES = 8, 16
"""Segments of a shaker's record, without their overlap; samples of one at least."""
OVERLAP = 1.0 / 6.0
"""Correlation of neighbouring segments under Hann's window that overlap by half (P. D. Welch, IEEE Transactions on
Audio and Electroacoustics 15, 1967)."""
REACH = 0.01
"""Least power of the force over its largest in lines that are excited."""
ENDED = 0.01
"""Root mean square in the last tenth of a record over that in its first from which the motion has not ended."""


@dataclass(frozen=True, eq=False)
class Averages:
    """Estimates of the response per unit of force at ``frequencies`` (lines,), each (outputs, lines).

    ``variances``: mean square of the complex error of H1, NaN of a single record; ``bias`` (lines,): relative bias of
    H1 by the noise of the force, NaN where that is not known: between ``coherence - 1`` and 0; ``count``: independent
    records; ``window``: decay rate (1/s) of the exponential window that is in all of them; ``reach``: whether the force
    has a hundredth of its largest power, the usual end (-20 dB) of what a hammer excites.
    """

    frequencies: np.ndarray
    h1: np.ndarray
    h2: np.ndarray
    hv: np.ndarray
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
        """Return coherence and bias in a sentence, medians over the lines that the force excites."""
        if self.count == 1.0:
            return "a single blow tells nothing of its errors; with several there are coherence and scatter"
        coherence, bias = float(np.median(self.coherence[:, self.reach])), float(np.median(self.bias[self.reach]))
        size = f"by {100.0 * bias:.2g} %" if np.isfinite(bias) else f"by at most {100.0 * (coherence - 1.0):.2g} %"
        last = float(np.max(self.frequencies[self.reach]))
        lines = f"{self.count:.3g} averages up to {last:.4g} Hz, where the force has fallen by 20 dB"
        return f"{lines}: coherence {coherence:.4g} in the median, noise of the force biases H1 {size}"


def averages(blows: Blows, decay: float = 0.0, force_window: bool = True) -> Averages:
    """Average H1, H2 and Hv, with coherence, variance and bias.

    The single record of a shaker is cut into segments under Hann's window, half of which the next overlaps.

    With ``n`` records the error of H1 has the mean square ``(1 - coherence) / (coherence (n - 1)) |H1|²``, the scatter
    of the records about ``Y = H1 F``. Bendat and Piersol (chapter 9) have ``n`` for ``n - 1``, for many records, and
    half of it for the magnitude.

    Args:
        blows: Records of force and response.
        decay: Rate (1/s) of an exponential window for force and response, exact for a force at any time:
            ``exp(-a t) (h * f) = (exp(-a t) h) * (exp(-a t) f)``. It comes to that of ``blows.window``, which the force
            does not have yet. A pole of these averages is that of the mode less their ``window``.
        force_window: Whether the force of a hammer is set to zero where it does not touch.
    """
    n, hammer = blows.forces.shape[1], touched(blows.forces)
    cut = hammer is None and len(blows.forces) == 1
    size = max(n // SEGMENTS, FEWEST_SAMPLES) if cut else n
    count = float(len(blows.forces))
    if cut:
        count = float(1 + (n - size) // (size - size // 2))
        count /= 1.0 + 2.0 * OVERLAP**2 * (count - 1.0) / count

    def power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the mean of ``conj(A) B`` without the lines of 0 and Nyquist."""
        spectra = csd(a, b, 1.0 / blows.step, "hann" if cut else "boxcar", size)[1]
        return np.asarray(np.mean(spectra, axis=0)[..., 1 : (size + 1) // 2])

    times, window = blows.step * np.arange(n), blows.window + decay
    fade, responses = np.exp(-window * times), blows.responses * np.exp(-decay * times)
    forces = (force_windowed(blows).forces if force_window else blows.forces) * fade
    s_ff, s_yy, s_fy = power(forces, forces).real, power(responses, responses).real, power(forces[:, None], responses)
    with np.errstate(divide="ignore", invalid="ignore"):
        h1, h2 = s_fy / s_ff, s_yy / np.conj(s_fy)
        hv = s_fy / np.abs(s_fy) * np.sqrt(s_yy / s_ff)
        coherence = np.minimum(np.abs(s_fy) ** 2 / (s_ff * s_yy), 1.0)
        variances = (1.0 - coherence) * s_yy / s_ff / (count - 1.0) if count > 1.0 else np.full(h1.shape, np.nan)
    noise = np.full(s_ff.shape, np.nan)
    if hammer is not None:
        quiet = np.where(hammer, 0.0, blows.forces - np.median(blows.forces, axis=1, keepdims=True)) * fade
        taken = np.mean((hammer if force_window else np.ones_like(hammer)) @ fade**2) / np.mean(~hammer @ fade**2)
        noise = np.minimum(power(quiet, quiet).real * taken / s_ff, 1.0)
    true = s_ff * (1.0 - np.nan_to_num(noise))
    return Averages(
        np.fft.rfftfreq(size, blows.step)[1 : (size + 1) // 2], h1, h2, hv, coherence, variances,
        -(1.0 - 1.0 / count) * noise, count, blows.response, window, true >= REACH * np.max(true),
    )  # fmt: skip


def decay_needed(blows: Blows) -> float:
    """Return the rate (1/s) of an exponential window by which the motion ends with the record, 0 where it has ended.

    Where it has not, the spectra leak: lines near a natural frequency are biased.
    """
    n = blows.responses.shape[-1]
    squares = np.mean(blows.responses**2, axis=0)
    start, end = np.mean(squares[:, : n // 10], axis=1), np.mean(squares[:, -(n // 10) :], axis=1)
    left = np.sqrt(np.max(end[start > 0] / start[start > 0], initial=0.0))
    return float(np.log(max(left / ENDED, 1.0)) / (n * blows.step))
