"""Several modes from free decays: stabilisation diagram of realisations of increasing order.

Samples of n channels at even steps, ``y_j = 2 Re Σ c_k z_k^j`` plus a constant each, form Hankel matrices, whose
dominant singular vectors give the poles z by shift invariance (:mod:`methods.modal.realisation`). Two methods differ in
the matrix:

* matrix pencil: the matrices of the channels are concatenated horizontally, with a third of the samples as rows (Y.
  Hua, T. K. Sarkar, IEEE Trans. Acoustics, Speech and Signal Processing 38:814, 1990);
* eigensystem realisation: the channels are stacked vertically, square in time (J.-N. Juang, R. S. Pappa, J. Guidance,
  Control, and Dynamics 8:620, 1985). For one channel only the number of rows differs.

**Modes.** One decomposition is evaluated at orders 2, 4, ... :data:`MOST_ORDER`. A pole is stable from one order to the
next where frequency and damping ratio agree within 1 % and 10 %, and the modal assurance criterion of the shapes
exceeds 0.95 (usual values: B. Peeters, G. De Roeck, Mech. Syst. Signal Process. 13:855, 1999). A mode is a pole that is
stable over :data:`STAYS` orders and improves Schwarz's information criterion (Ann. Stat. 6:461, 1978); with a given
number of modes, the most significant ones are selected. The estimate is taken from the order that contains most modes
with the largest significance.

**Length.** The first pass uses the whole record, the second :data:`TIME_CONSTANTS` time constants of the slowest mode:
for one mode this is within 2 % of the bound to first order, and later samples mainly add noise. Records longer than
:data:`MOST_SAMPLES` are averaged over neighbouring samples, which preserves exponentials and white noise, while
:data:`LEAST_A_CYCLE` samples per cycle remain at the highest line of the spectrum; then they are truncated.

**Standard errors** are of first order. With ``Y = O X`` (columns and rows of powers of the poles), p the rows of the
pseudoinverse of O without its last block and q the columns of that of X, a small change of Y changes a pole by
``δz = p (δY₂ - z δY₁) q``, where Y₁ and Y₂ are Y without its last and first block (Hua, Sarkar, 1990), and accordingly
the amplitudes. Coloured noise is whitened first: an autoregression of each channel's residuals filters the samples,
which preserves exponentials and loses as many samples as its order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import (
    FreeDecays,
    InputError,
    ModalCard,
    ModalEstimate,
    ModalIdentifier,
    ModalProblem,
    Mode,
    Status,
    autoregression,
)
from methods.modal.realisation import leading_vectors, step_of
from methods.starts.search_range import unevenness

MOST_ORDER = 40
MOST_MODES = 10
MOST_SAMPLES = 1200
LEAST_SAMPLES = 20
LEAST_A_CYCLE = 4
TIME_CONSTANTS = 5.0
STAYS = 5
FREQUENCY_STAYS, DAMPING_STAYS, SHAPE_STAYS = 0.01, 0.1, 0.95
LINE_CHANCE = 1e-3
"""Probability that noise alone causes a line above the threshold."""
FLOOR_LINES = 51
"""Number of neighbouring lines whose median is the noise floor."""
NO_MODE = "no pole is stable over the orders: a longer record, more samples per cycle or less noise are required"


@dataclass(frozen=True, eq=False)
class Realised:
    """Damped waves ``Re(b z^j)``: poles ``z`` (k,) on and above the real axis, ``shapes`` b (channels, k).

    ``wald`` (k,): squared amplitudes over their variance, for known poles and white residuals.
    """

    z: np.ndarray
    shapes: np.ndarray
    wald: np.ndarray
    residuals: np.ndarray

    @property
    def degrees(self) -> int:
        """Return the residual degrees of freedom."""
        return max(self.residuals.size - 2 * self.z.size * (1 + len(self.shapes)) - len(self.shapes), 1)

    @staticmethod
    def fitted(z: np.ndarray, values: np.ndarray) -> Realised:
        """Fit amplitudes and a constant of each channel to values (channels, n) by least squares."""
        z = z[(z.imag >= 0) & (values.shape[1] * np.log(np.abs(z)) < 1)]  # faster growth is due to noise
        powers = np.exp(np.log(z) * np.arange(values.shape[1])[:, None])
        columns = np.column_stack([powers.real, -powers.imag, np.ones(len(powers))])
        inverse = np.linalg.pinv(columns, rcond=1e-12)
        parts = inverse @ values.T
        residuals = values - (columns @ parts).T
        shapes = (parts[: z.size] + 1j * parts[z.size : -1]).T
        noise = np.sum(residuals**2, axis=1, keepdims=True) / max(values.shape[1] - 2 * z.size, 1)
        spread = np.sum(inverse[:-1] ** 2, axis=1).reshape(2, -1).mean(axis=0)
        wald = np.sum(np.abs(shapes) ** 2 / np.maximum(noise, 1e-300), axis=0) / np.maximum(spread, 1e-300)
        return Realised(z, shapes, wald, residuals)


@dataclass(frozen=True)
class _StabilisedModes(ModalIdentifier):
    """Base of both methods; ``rows``: block rows of the Hankel matrix over the number of samples."""

    rows: float = 0.5

    scope: ClassVar[tuple[type, ...]] = (FreeDecays,)
    stacked: ClassVar[bool]

    def __post_init__(self) -> None:
        if not 0 < self.rows < 1:
            raise InputError("method.rows", self.rows, "a fraction of the number of samples, such as 1/3 or 1/2")

    def objection(self, problem: ModalProblem) -> str | None:
        """Require free decays at even steps."""
        if (other := super().objection(problem)) is not None or not isinstance(problem.data, FreeDecays):
            return other
        if problem.data.times.size < LEAST_SAMPLES:
            return f"it requires at least {LEAST_SAMPLES} samples"
        return unevenness(problem.data.times)

    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Realise the whole record, then the part in which the slowest mode decays, with whitened noise."""
        assert isinstance(problem.data, FreeDecays)
        step, size = step_of(problem.data.times), np.std(problem.data.values, axis=1, keepdims=True)
        values = problem.data.values / np.where(size > 0, size, 1.0)
        n, whole = values.shape
        length = whole
        for _ in range(2):
            thin = thinning(values[:, :length])
            length = min(length // thin, MOST_SAMPLES)
            means = np.mean(values[:, : length * thin].reshape(n, length, thin), axis=2)
            band = 2.0 * np.pi * step * thin * np.array(problem.band or (0.0, np.inf))
            waves, chosen, _ = stable(self._orders(means), problem.count, band)
            if not chosen.size:
                return ModalEstimate((), status=Status.DIVERGED, message=NO_MODE)
            decay = max(-np.log(np.max(np.abs(waves.z[chosen]))), TIME_CONSTANTS / MOST_SAMPLES)
            length = int(np.clip(TIME_CONSTANTS * thin / decay, LEAST_SAMPLES, whole))
        filters = whitening(waves.residuals)
        white = np.array([np.convolve(*pair, "valid") for pair in zip(means, filters, strict=True)])
        waves, chosen, message = stable(self._orders(white), problem.count, band)
        if not chosen.size:
            return ModalEstimate((), status=Status.DIVERGED, message=NO_MODE)
        z = waves.z[chosen]
        covariances, shape_sds = self._deviations(waves, chosen)
        # undo averaging and filtering in the shapes; the filter starts at the first complete window
        gains = np.mean(z[:, None] ** (np.arange(thin) / thin), axis=1)
        gains = gains * (filters @ z ** np.arange(filters.shape[1])[::-1, None]) / size
        shapes, shape_sds = waves.shapes[:, chosen] / gains, shape_sds / np.abs(gains)
        motion = z ** (np.arange(whole)[:, None] / thin)
        shares = np.linalg.norm((shapes[:, None] * motion).real, axis=(0, 1)) / (np.linalg.norm(size) * whole**0.5)
        span = step * thin
        modes = [
            Mode.of_pole(pole, covariance, shape, shape_sd, float(share))
            for pole, covariance, shape, shape_sd, share in zip(
                np.log(z) / span, covariances / span**2, shapes.T, shape_sds.T, shares, strict=True
            )
        ]
        return ModalEstimate(tuple(sorted(modes, key=lambda mode: mode.frequency)), waves.degrees, message=message)

    def _deviations(self, waves: Realised, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return covariances (modes, 2, 2) of log z and standard errors (channels, modes) of shapes."""
        n, samples = waves.residuals.shape
        upper = waves.z.imag > 0
        z = np.concatenate([waves.z, waves.z[upper].conj()])
        parts = np.concatenate([waves.shapes, waves.shapes[:, upper].conj()], axis=1)
        parts = np.where(z.imag == 0, parts, 0.5 * parts)
        slopes = pole_slopes(z, parts, self._rows(samples), samples, self.stacked)
        powers = z ** np.arange(samples)[:, None]
        inverse = np.linalg.pinv(np.column_stack([powers, np.ones(samples)]))[:-1]
        amplitude_slopes = (inverse @ (np.arange(samples)[:, None] * powers / z))[chosen]
        shapes = -np.einsum("ml,cl,ldt->cmdt", amplitude_slopes, parts, slopes)
        shapes[np.arange(n), :, np.arange(n)] += inverse[chosen]
        noise = np.sqrt(n * np.sum(waves.residuals**2, axis=1) / waves.degrees)[:, None]
        rates = (noise * slopes[chosen] / z[chosen][:, None, None]).reshape(chosen.size, -1)
        both = np.stack([rates.real, rates.imag], axis=1)
        # mean square of real and imaginary part of 2 c
        return both @ both.swapaxes(1, 2), 2.0**0.5 * np.linalg.norm(noise * np.abs(shapes), axis=(-2, -1))

    def _orders(self, values: np.ndarray) -> list[Realised]:
        """Realise values (channels, n) at increasing orders."""
        n, samples = values.shape
        rows = self._rows(samples)
        windows = np.lib.stride_tricks.sliding_window_view(values, samples + 1 - rows, axis=1).swapaxes(0, 1)
        windows = windows - np.mean(windows, axis=2, keepdims=True)
        block = n if self.stacked else 1
        hankel = windows.reshape(rows * block, -1)
        most = min(MOST_ORDER, hankel.shape[0] - block, hankel.shape[1] - 1, samples // 4)
        main = leading_vectors(hankel[None], most)[0]
        orders = []
        for states in range(2, most + 1, 2):
            shift = np.linalg.pinv(main[:-block, :states]) @ main[block:, :states]
            orders.append(Realised.fitted(np.linalg.eigvals(shift).astype(complex), values))
        return orders

    def _rows(self, samples: int) -> int:
        return int(np.clip(round(self.rows * samples), 3, samples - 3))


@dataclass(frozen=True)
class MatrixPencilModes(_StabilisedModes):
    """Matrix pencil with parameter ``rows`` times the samples."""

    rows: float = 1.0 / 3.0

    stacked: ClassVar[bool] = False
    card: ClassVar[ModalCard] = ModalCard(
        "matrix pencil with total least squares, all channels at once; poles stable over orders 2 to 40",
        "pencil parameter N/3: Hua and Sarkar (1990); stability 1 %, 10 %, MAC 0.95: Peeters and De Roeck (1999)",
        "Matrix pencil",
        100,
    )


@dataclass(frozen=True)
class ERAModes(_StabilisedModes):
    """Eigensystem realisation with ``rows`` times the samples as block rows."""

    stacked: ClassVar[bool] = True
    card: ClassVar[ModalCard] = ModalCard(
        "eigensystem realisation, all channels at once; poles stable over orders 2 to 40",
        "square in time: Juang and Pappa (1985); stability 1 %, 10 %, MAC 0.95: Peeters and De Roeck (1999)",
        "Eigensystem realisation",
        110,
    )


def thinning(values: np.ndarray) -> int:
    """Return the number of neighbouring samples to average for values (channels, n); 1 for a short record."""
    from scipy.ndimage import median_filter

    samples = values.shape[1]
    if samples <= MOST_SAMPLES:
        return 1
    power = np.sum(np.abs(np.fft.rfft(values * np.hanning(samples), axis=1)) ** 2, axis=0)
    # the power of white noise is exponential: it exceeds x times its median with probability 2^-x
    lines = np.flatnonzero(power > np.log2(power.size / LINE_CHANCE) * median_filter(power, FLOOR_LINES))
    highest = int(lines[-1]) if lines.size else power.size
    return max(1, min(-(-samples // MOST_SAMPLES), samples // (LEAST_A_CYCLE * max(highest, 1))))


def stable(orders: list[Realised], count: int | None, band: np.ndarray) -> tuple[Realised, np.ndarray, str]:
    """Select an order and its waves that are modes, with natural frequencies (rad/sample) in a band; and a message."""
    rates = [np.log(waves.z) for waves in orders]
    chains = linked(rates, [waves.shapes for waves in orders], orders[0].residuals.shape[1])
    cost = 2 * (1 + len(orders[0].shapes)) * np.log(orders[0].residuals.size)
    clear = [float(np.median([orders[order].wald[i] for order, i in chain])) for chain in chains]
    inside = [i for i, chain in enumerate(chains) if band[0] <= abs(rates[chain[-1][0]][chain[-1][1]]) <= band[1]]
    modes = {i for i in inside if len(chains[i]) >= min(STAYS, len(orders) / 2) and clear[i] > cost}
    message = (
        f"{len(modes)} poles are stable over {STAYS} of the orders 2 to {2 * len(orders)} and improve the criterion"
    )
    chosen = sorted(modes if count is None else inside, key=lambda i: (i in modes, clear[i]), reverse=True)
    chosen = chosen[: count or MOST_MODES]
    members = [[i for chain in chosen for place, i in chains[chain] if place == order] for order in range(len(orders))]

    def merit(order: int) -> tuple[int, float]:
        return len(members[order]), float(np.sum(np.log(orders[order].wald[members[order]])))

    best = max(range(len(orders)), key=merit)
    return orders[best], np.array(members[best], int), message


def linked(
    orders: Sequence[np.ndarray],
    shapes: Sequence[np.ndarray],
    samples: float,
    frequency: float = FREQUENCY_STAYS,
    damping: float = DAMPING_STAYS,
) -> list[list[tuple[int, int]]]:
    """Link the poles of decaying vibrations that are stable from one order to the next.

    Args:
        orders: Continuous poles (1/sample) of each order.
        shapes: Their shapes, (channels, k) for each order.
        samples: Length of the record; damping is compared relative to at least one decay over this length.
        frequency: Largest relative difference of natural frequencies.
        damping: Largest relative difference of damping ratios.

    Returns:
        Chains of (order, index).
    """
    chains: list[list[tuple[int, int]]] = []
    before: dict[int, list[tuple[int, int]]] = {}
    for order, (poles, forms) in enumerate(zip(orders, shapes, strict=True)):
        now: dict[int, list[tuple[int, int]]] = {}
        places = list(before)
        vibrations = np.flatnonzero((poles.imag > 0) & (poles.real < 0))
        distance = np.full((vibrations.size, len(places)), np.inf)
        if places and vibrations.size:
            a, b = poles[vibrations][:, None], orders[order - 1][places]
            x, y = forms[:, vibrations], shapes[order - 1][:, places]
            stays = np.abs(np.abs(a) - np.abs(b)) < frequency * np.abs(b)
            ratio = np.maximum(-b.real, 1.0 / samples) / np.abs(b)
            stays &= np.abs(a.real / np.abs(a) - b.real / np.abs(b)) < damping * ratio
            norms = np.sum(np.abs(x) ** 2, axis=0)[:, None] * np.sum(np.abs(y) ** 2, axis=0)
            stays &= np.abs(x.conj().T @ y) ** 2 > SHAPE_STAYS * norms
            distance = np.where(stays, np.abs(a - b), np.inf)
        for i, row in zip(vibrations.tolist(), distance, strict=True):
            nearest = int(np.argmin(row)) if row.size else 0
            if row.size and np.isfinite(row[nearest]) and row[nearest] == np.min(distance[:, nearest]):
                now[i] = before[places[nearest]]
            else:
                now[i] = []
                chains.append(now[i])
            now[i].append((order, i))
        before = now
    return chains


def pole_slopes(z: np.ndarray, parts: np.ndarray, rows: int, samples: int, stacked: bool) -> np.ndarray:
    """Differentiate poles z (k,), closed under conjugation, by each sample of ``Σ c_k z_k^j``, (k, channels, samples).

    ``parts`` (channels, k): amplitudes c; see the module for the formula.
    """
    left, right = z[:, None, None] ** np.arange(rows), z[:, None, None] ** np.arange(samples + 1 - rows)
    if stacked:
        left = parts.T[..., None] * left
    else:
        right = parts.T[..., None] * right
    right = right - np.mean(right, axis=2, keepdims=True)
    p = np.linalg.pinv(left[..., :-1].reshape(z.size, -1).T).reshape(*left.shape[:2], -1)
    q = np.linalg.pinv(right.reshape(z.size, -1)).T.reshape(right.shape)
    product = np.fft.ifft(np.fft.fft(p, samples) * np.fft.fft(q, samples))
    return np.asarray(np.roll(product, 1, axis=2) - z[:, None, None] * product)


def whitening(residuals: np.ndarray) -> np.ndarray:
    """Return filters (channels, length) that whiten these residuals to unit variance."""
    noises = [autoregression(channel) for channel in residuals]
    filters = np.zeros((len(noises), 1 + max(noise.order for noise in noises)))
    for taps, noise in zip(filters, noises, strict=True):
        taps[: 1 + noise.order] = np.append(1.0, -noise.coefficients) / max(noise.variance**0.5, 1e-9)
    return filters
