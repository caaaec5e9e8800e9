"""Several modes from free decays without a search: realisations of rising order, and the poles that stay.

Samples of n channels at even steps, ``y_j = 2 Re Σ c_k z_k^j`` and a constant each, fill Hankel matrices, whose leading
singular vectors shift as the poles z do (:mod:`methods.modal.realisation`). Two methods differ in the matrix:

* matrix pencil: those of the channels side by side, a third of the samples long (Y. Hua, T. K. Sarkar, IEEE Trans.
  Acoustics, Speech and Signal Processing 38:814, 1990), so that the poles come from the shift in time alone;
* eigensystem realisation: channels below each other, square in time (J.-N. Juang, R. S. Pappa, J. Guidance, Control,
  and Dynamics 8:620, 1985), so that the shift is one of shapes as well. For one channel only the length differs.

**Modes.** The one decomposition is read at orders 2, 4, ... :data:`MOST_ORDER`. A pole stays from one order to the next
where frequency, damping ratio and shape (modal assurance criterion) agree within 1 %, 10 % and 0.95 (usual values: B.
Peeters, G. De Roeck, Mech. Syst. Signal Process. 13:855, 1999). What stays over :data:`STAYS` orders, and lowers the
misfit by more than its unknowns cost in Schwarz's information criterion (Ann. Stat. 6:461, 1978), is a mode; a number
that is told takes so many, the clearest first. The answer is the order that has most of them, and has them clearest.

**Length.** First the whole record, then :data:`TIME_CONSTANTS` of the slowest mode: to first order that is within 2 %
of the bound for one mode, while what comes later adds noise to the matrix. Records above :data:`MOST_SAMPLES` are
thinned to means of neighbours, which leaves exponentials what they are and white noise white, as far as
:data:`LEAST_A_CYCLE` samples a cycle are left at the highest line of their spectrum; then they are cut.

**Standard errors** follow to first order. With ``Y = O X`` (columns and rows of powers of the poles), p the rows of the
pseudoinverse of O without its last block and q the columns of that of X, a small change moves a pole by
``δz = p (δY₂ - z δY₁) q``, Y₁ and Y₂ being Y without its last and first block (Hua, Sarkar, 1990), and the amplitudes
of least squares with it. Coloured noise is made white before: an autoregression of each channel's residuals filters the
samples, which leaves exponentials what they are; as many samples as its order has are lost.
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
"""Of a line as high as one that counts, in noise alone."""
FLOOR_LINES = 51
"""Neighbours of a line whose median power is its floor."""
NO_MODE = "no pole stays from order to order: take a longer record, more samples a cycle or less noise"


@dataclass(frozen=True, eq=False)
class Realised:
    """Damped waves in even samples: ``z`` (k,) on and above the real axis, ``shapes`` (channels, k) of ``Re(b z^j)``.

    ``wald`` (k,): amplitudes squared over their variance, were the poles known and the residuals white.
    """

    z: np.ndarray
    shapes: np.ndarray
    wald: np.ndarray
    residuals: np.ndarray

    @property
    def degrees(self) -> int:
        """Samples less unknowns."""
        return max(self.residuals.size - 2 * self.z.size * (1 + len(self.shapes)) - len(self.shapes), 1)

    @staticmethod
    def fitted(z: np.ndarray, values: np.ndarray) -> Realised:
        """Fit amplitudes and a constant of each channel by least squares to values (channels, n)."""
        z = z[(z.imag >= 0) & (values.shape[1] * np.log(np.abs(z)) < 1)]  # what grows more is noise
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
    """Block rows of the Hankel matrix: ``rows`` of the samples."""

    rows: float = 0.5

    scope: ClassVar[tuple[type, ...]] = (FreeDecays,)
    below_each_other: ClassVar[bool]

    def __post_init__(self) -> None:
        if not 0 < self.rows < 1:
            raise InputError("method.rows", self.rows, "a part of the number of samples, a third or a half say")

    def objection(self, problem: ModalProblem) -> str | None:
        """It needs free decays at even steps."""
        if (other := super().objection(problem)) is not None or not isinstance(problem.data, FreeDecays):
            return other
        if problem.data.times.size < LEAST_SAMPLES:
            return f"it needs at least {LEAST_SAMPLES} samples"
        return unevenness(problem.data.times)

    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Realise the whole record; then as much of it as the slowest mode lasts, with its noise made white."""
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
        waves, chosen, said = stable(self._orders(white), problem.count, band)
        if not chosen.size:
            return ModalEstimate((), status=Status.DIVERGED, message=NO_MODE)
        z = waves.z[chosen]
        covariances, shape_sds = self._deviations(waves, chosen)
        # of the means of the first samples, and of their filter, which begins where it has all it needs
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
        return ModalEstimate(tuple(sorted(modes, key=lambda mode: mode.frequency)), waves.degrees, message=said)

    def _deviations(self, waves: Realised, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Covariances (modes, 2, 2) of log z, real and imaginary, and standard errors (channels, modes) of shapes."""
        n, samples = waves.residuals.shape
        upper = waves.z.imag > 0
        z = np.concatenate([waves.z, waves.z[upper].conj()])
        parts = np.concatenate([waves.shapes, waves.shapes[:, upper].conj()], axis=1)
        parts = np.where(z.imag == 0, parts, 0.5 * parts)
        moved = pole_slopes(z, parts, self._rows(samples), samples, self.below_each_other)
        powers = z ** np.arange(samples)[:, None]
        inverse = np.linalg.pinv(np.column_stack([powers, np.ones(samples)]))[:-1]
        turned = (inverse @ (np.arange(samples)[:, None] * powers / z))[chosen]
        shapes = -np.einsum("ml,cl,ldt->cmdt", turned, parts, moved)
        shapes[np.arange(n), :, np.arange(n)] += inverse[chosen]
        noise = np.sqrt(n * np.sum(waves.residuals**2, axis=1) / waves.degrees)[:, None]
        rates = (noise * moved[chosen] / z[chosen][:, None, None]).reshape(chosen.size, -1)
        both = np.stack([rates.real, rates.imag], axis=1)
        # the mean square of real and imaginary part of 2 c
        return both @ both.swapaxes(1, 2), 2.0**0.5 * np.linalg.norm(noise * np.abs(shapes), axis=(-2, -1))

    def _orders(self, values: np.ndarray) -> list[Realised]:
        """Realise values (channels, n) at rising orders."""
        n, samples = values.shape
        rows = self._rows(samples)
        windows = np.lib.stride_tricks.sliding_window_view(values, samples + 1 - rows, axis=1).swapaxes(0, 1)
        windows = windows - np.mean(windows, axis=2, keepdims=True)
        block = n if self.below_each_other else 1
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
    """Pencil parameter ``rows`` times the samples."""

    rows: float = 1.0 / 3.0

    below_each_other: ClassVar[bool] = False
    card: ClassVar[ModalCard] = ModalCard(
        "matrix pencil with total least squares, all channels at once; poles that stay over orders 2 to 40",
        "pencil parameter N/3: Hua and Sarkar (1990); stability 1 %, 10 %, MAC 0.95: Peeters and De Roeck (1999)",
        "Matrix pencil",
        100,
    )


@dataclass(frozen=True)
class ERAModes(_StabilisedModes):
    """Block rows ``rows`` times the samples."""

    below_each_other: ClassVar[bool] = True
    card: ClassVar[ModalCard] = ModalCard(
        "eigensystem realisation, all channels at once; poles that stay over orders 2 to 40",
        "square in time: Juang and Pappa (1985); stability 1 %, 10 %, MAC 0.95: Peeters and De Roeck (1999)",
        "Eigensystem realisation",
        110,
    )


def thinning(values: np.ndarray) -> int:
    """Decide of how many neighbours of values (channels, n) a mean is taken: 1 of a short record."""
    from scipy.ndimage import median_filter

    samples = values.shape[1]
    if samples <= MOST_SAMPLES:
        return 1
    power = np.sum(np.abs(np.fft.rfft(values * np.hanning(samples), axis=1)) ** 2, axis=0)
    # white noise's power is exponential: chance 2^-x of x times its median
    lines = np.flatnonzero(power > np.log2(power.size / LINE_CHANCE) * median_filter(power, FLOOR_LINES))
    highest = int(lines[-1]) if lines.size else power.size
    return max(1, min(-(-samples // MOST_SAMPLES), samples // (LEAST_A_CYCLE * max(highest, 1))))


def stable(orders: list[Realised], count: int | None, band: np.ndarray) -> tuple[Realised, np.ndarray, str]:
    """Choose an order and the waves that are modes there, with natural rates (1/sample) in a band; say why so many."""
    rates = [np.log(waves.z) for waves in orders]
    chains = linked(rates, [waves.shapes for waves in orders], orders[0].residuals.shape[1])
    cost = 2 * (1 + len(orders[0].shapes)) * np.log(orders[0].residuals.size)
    clear = [float(np.median([orders[order].wald[i] for order, i in chain])) for chain in chains]
    inside = [i for i, chain in enumerate(chains) if band[0] <= abs(rates[chain[-1][0]][chain[-1][1]]) <= band[1]]
    modes = {i for i in inside if len(chains[i]) >= min(STAYS, len(orders) / 2) and clear[i] > cost}
    said = f"{len(modes)} poles stay over {STAYS} of the orders 2 to {2 * len(orders)} and lower the criterion"
    chosen = sorted(modes if count is None else inside, key=lambda i: (i in modes, clear[i]), reverse=True)
    chosen = chosen[: count or MOST_MODES]
    members = [[i for chain in chosen for at, i in chains[chain] if at == order] for order in range(len(orders))]

    def merit(order: int) -> tuple[int, float]:
        return len(members[order]), float(np.sum(np.log(orders[order].wald[members[order]])))

    best = max(range(len(orders)), key=merit)
    return orders[best], np.array(members[best], int), said


def linked(
    orders: Sequence[np.ndarray],
    shapes: Sequence[np.ndarray],
    samples: float,
    frequency: float = FREQUENCY_STAYS,
    damping: float = DAMPING_STAYS,
) -> list[list[tuple[int, int]]]:
    """Link poles (1/sample) that stay from one order to the next: order and index of each.

    Only those of decaying vibrations are; ``shapes`` (channels, k) of each order. A damping ratio is compared to no
    less than one decay over all ``samples``.
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


def pole_slopes(z: np.ndarray, parts: np.ndarray, rows: int, samples: int, below_each_other: bool) -> np.ndarray:
    """Differentiate poles z (k,), closed under conjugation, by each sample of ``Σ c_k z_k^j``: (k, channels, samples).

    ``parts`` (channels, k) are the c; see the module on the formula.
    """
    left, right = z[:, None, None] ** np.arange(rows), z[:, None, None] ** np.arange(samples + 1 - rows)
    if below_each_other:
        left = parts.T[..., None] * left
    else:
        right = parts.T[..., None] * right
    right = right - np.mean(right, axis=2, keepdims=True)
    p = np.linalg.pinv(left[..., :-1].reshape(z.size, -1).T).reshape(*left.shape[:2], -1)
    q = np.linalg.pinv(right.reshape(z.size, -1)).T.reshape(right.shape)
    product = np.fft.ifft(np.fft.fft(p, samples) * np.fft.fft(q, samples))
    return np.asarray(np.roll(product, 1, axis=2) - z[:, None, None] * product)


def whitening(residuals: np.ndarray) -> np.ndarray:
    """Filters (channels, length) that make noise as in these residuals white and of size 1."""
    noises = [autoregression(channel) for channel in residuals]
    filters = np.zeros((len(noises), 1 + max(noise.order for noise in noises)))
    for taps, noise in zip(filters, noises, strict=True):
        taps[: 1 + noise.order] = np.append(1.0, -noise.coefficients) / max(noise.variance**0.5, 1e-9)
    return filters
