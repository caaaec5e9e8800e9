"""Several modes from free decays without a search: realisations of rising order, and the poles that stay.

Samples of n channels at even steps, ``y_j = 2 Re Σ c_k z_k^j`` and a constant each, fill Hankel matrices, whose leading
singular vectors shift as the poles z do (:mod:`methods.modal.realisation`). Two methods differ in the matrix:

* matrix pencil: those of the channels side by side, a third of the samples long (Y. Hua, T. K. Sarkar, IEEE Trans.
  Acoustics, Speech and Signal Processing 38:814, 1990), so that the poles come from the shift in time alone;
* eigensystem realisation: channels below each other, square in time (J.-N. Juang, R. S. Pappa, J. Guidance, Control,
  and Dynamics 8:620, 1985), so that the shift is one of shapes as well. For one channel only the length differs.

**Modes.** The one decomposition is read at orders 2, 4, ... :data:`MOST_ORDER`. A pole stays from one order to the next
where frequency, damping ratio and shape (modal assurance criterion) agree within 1 %, 10 % and 0.95 (usual values: B.
Peeters, G. De Roeck, Mech. Syst. Signal Process. 13:855, 1999). What stays through half of the orders, and lowers the
misfit by more than its unknowns cost in Schwarz's information criterion (Ann. Stat. 6:461, 1978), is a mode; a number
that is told takes so many, the clearest first. The answer is the lowest order that has them all.

**Length.** First the whole record, then :data:`TIME_CONSTANTS` of the slowest mode: to first order that is within 2 %
of the bound for one mode, while what comes later adds noise to the matrix. Records above :data:`MOST_SAMPLES` are
thinned to means of neighbours, which leaves exponentials what they are and white noise white, as far as
:data:`LEAST_A_CYCLE` samples a cycle are left at the highest line of their spectrum; then they are cut.

**Standard errors** follow to first order. With ``Y = O X`` (columns and rows of powers of the poles), p the rows of the
pseudoinverse of O without its last block and q the columns of that of X, a small change moves a pole by
``δz = p (δY₂ - z δY₁) q``, Y₁ and Y₂ being Y without its last and first block (Hua, Sarkar, 1990), and the amplitudes
of least squares with it. The noise is that of the residuals, an autoregression in each channel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import (
    Autoregression,
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
from methods.starts.reach import unevenness

MOST_ORDER = 40
MOST_MODES = 10
MOST_SAMPLES = 1200
LEAST_SAMPLES = 20
LEAST_A_CYCLE = 4
TIME_CONSTANTS = 5.0
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
    def oscillates(self) -> np.ndarray:
        """Which are vibrations, rather than decays or alternations."""
        return np.asarray(self.z.imag > 0)

    @staticmethod
    def fitted(z: np.ndarray, values: np.ndarray) -> Realised:
        """Fit amplitudes and a constant of each channel by least squares to values (channels, n)."""
        z = z[(z.imag >= 0) & (np.abs(z) < 1)]
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

    serves: ClassVar[tuple[type, ...]] = (FreeDecays,)
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
        """Realise the whole record, then as much of it as the slowest mode lasts."""
        assert isinstance(problem.data, FreeDecays)
        step, values = step_of(problem.data.times), problem.data.values
        scale, length = np.std(values, axis=1), values.shape[1]
        for _ in range(2):
            scale = np.where(scale > 0, scale, 1.0)
            scaled = values[:, :length] / scale[:, None]
            thin = thinning(scaled)
            length = min(length // thin, MOST_SAMPLES)
            means = np.mean(scaled[:, : length * thin].reshape(len(values), length, thin), axis=2)
            band = 2.0 * np.pi * step * thin * np.array(problem.band or (0.0, np.inf))
            waves, chosen, said = stable(self._orders(means), problem.count, band)
            if not chosen.size:
                return ModalEstimate((), status=Status.DIVERGED, message=NO_MODE)
            lasts = TIME_CONSTANTS * thin / -np.log(np.max(np.abs(waves.z[chosen])))
            length = int(np.clip(lasts, LEAST_SAMPLES, values.shape[1]))
            used, scale = scale, scale * np.maximum(np.std(waves.residuals, axis=1), 1e-9)
        return self._answer(waves, chosen, step * thin, thin, used, values, said)

    def _answer(
        self,
        waves: Realised,
        chosen: np.ndarray,
        step: float,
        thin: int,
        scale: np.ndarray,
        values: np.ndarray,
        said: str,
    ) -> ModalEstimate:
        """Answer with the chosen waves, at a ``step``: of means of ``thin`` samples of values over scale."""
        n, samples = waves.residuals.shape
        rates = np.log(waves.z[chosen]) / step
        sds, shape_sds = self._deviations(waves, chosen, step)
        # the first mean stands for samples 0 to thin - 1
        gains = np.mean(np.exp(rates[:, None] * step / thin * np.arange(thin)), axis=1)
        shapes = scale[:, None] * waves.shapes[:, chosen] / gains
        shape_sds = scale[:, None] * shape_sds / np.abs(gains)
        motion = np.exp(rates * step / thin * np.arange(values.shape[1])[:, None])
        sizes = np.linalg.norm((shapes[:, None] * motion).real, axis=(0, 1))
        shares = sizes / np.linalg.norm(values - np.mean(values, axis=1, keepdims=True))
        modes = [
            Mode(
                float(abs(rate)) / (2 * np.pi), float(-rate.real / abs(rate)), float(sds[i, 0]), float(sds[i, 1]),
                shapes[:, i], shape_sds[:, i], float(shares[i]),
            )
            for i, rate in enumerate(rates)
        ]  # fmt: skip
        degrees = n * samples - 2 * waves.z.size * (n + 1) - n
        return ModalEstimate(tuple(sorted(modes, key=lambda mode: mode.frequency)), max(degrees, 1), message=said)

    def _deviations(self, waves: Realised, chosen: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Standard errors (modes, 2) of frequency (Hz) and damping ratio, and (channels, modes) of the shapes."""
        n, samples = waves.residuals.shape
        upper = waves.z.imag > 0
        z = np.concatenate([waves.z, waves.z[upper].conj()])
        parts = np.concatenate([waves.shapes, waves.shapes[:, upper].conj()], axis=1)
        parts = np.where(z.imag == 0, parts, 0.5 * parts)
        moved = pole_slopes(z, parts, self._rows(samples), samples, self.below_each_other)
        rate = np.log(z[chosen])[:, None, None]
        slope = moved[chosen] / z[chosen][:, None, None]
        size = np.abs(rate)
        sizes = (rate.conj() * slope).real / size
        ratios = (-slope.real + rate.real / size * sizes) / size
        powers = z ** np.arange(samples)[:, None]
        inverse = np.linalg.pinv(np.column_stack([powers, np.ones(samples)]))[:-1]
        turned = (inverse @ (np.arange(samples)[:, None] * powers / z))[chosen]
        shapes = -np.einsum("ml,cl,ldt->cmdt", turned, parts, moved)
        shapes[np.arange(n), :, np.arange(n)] += inverse[chosen]
        used = 2.0 * waves.z.size * (n + 1) / n + 1.0
        noises = [autoregression(residuals, used) for residuals in waves.residuals]
        poles = np.sqrt(np.stack([variance(sizes, noises) / (2 * np.pi * step) ** 2, variance(ratios, noises)], axis=1))
        both = 0.5 * (variance(2.0 * shapes.real, noises) + variance(2.0 * shapes.imag, noises))
        return poles, np.sqrt(both)

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
    chains: list[list[tuple[int, int]]] = []
    before: dict[int, list[tuple[int, int]]] = {}
    for order, waves in enumerate(orders):
        now = {}
        stays = staying(orders[order - 1], waves) if order else np.full(waves.z.size, -1)
        for index in np.flatnonzero(waves.oscillates):
            chain = before.get(int(stays[index]))
            if chain is None:
                chain = []
                chains.append(chain)
            chain.append((order, int(index)))
            now[int(index)] = chain
        before = now
    unknowns = 2 * (1 + len(orders[0].shapes))
    cost = unknowns * np.log(orders[0].residuals.size)
    clear = {i: float(np.median([orders[o].wald[k] for o, k in chain])) for i, chain in enumerate(chains)}
    inside = [
        i for i, chain in enumerate(chains) if band[0] <= abs(np.log(orders[chain[-1][0]].z[chain[-1][1]])) <= band[1]
    ]
    modes = [i for i in inside if 2 * len(chains[i]) >= len(orders) and clear[i] > cost]
    if count is None:
        chosen = sorted(modes, key=lambda i: -clear[i])[:MOST_MODES]
        said = f"{len(chosen)} poles stay over half of the orders 2 to {2 * len(orders)}"
    else:
        chosen = sorted(inside, key=lambda i: (-2 * len(chains[i]) < -len(orders), clear[i]), reverse=True)[:count]
        said = f"{count} modes told, of {len(modes)} that stay over half of the orders 2 to {2 * len(orders)}"
    members = [[k for i in chosen for o, k in chains[i] if o == order] for order in range(len(orders))]
    best = max(range(len(orders)), key=lambda order: (len(members[order]), -order))
    return orders[best], np.array(members[best], int), said


def staying(before: Realised, now: Realised) -> np.ndarray:
    """Number of the wave in the order before that each wave of this one continues, -1 for none."""
    a, b = np.log(now.z)[:, None], np.log(before.z)[None]
    with np.errstate(all="ignore"):
        frequency = np.abs(np.abs(a) / np.abs(b) - 1.0) < FREQUENCY_STAYS
        damping = np.abs((a.real / np.abs(a)) / (b.real / np.abs(b)) - 1.0) < DAMPING_STAYS
        overlap = np.abs(now.shapes.conj().T @ before.shapes) ** 2
        sizes = np.sum(np.abs(now.shapes) ** 2, axis=0)[:, None] * np.sum(np.abs(before.shapes) ** 2, axis=0)
        distance = np.where(
            frequency & damping & (overlap > SHAPE_STAYS * sizes) & before.oscillates, np.abs(a - b), np.inf
        )
    if not distance.size:
        return np.full(now.z.size, -1)
    nearest = np.argmin(distance, axis=1)
    mutual = np.argmin(distance, axis=0)[nearest] == np.arange(now.z.size)
    return np.where(mutual & np.isfinite(np.min(distance, axis=1)), nearest, -1)


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


def variance(slopes: np.ndarray, noises: Sequence[Autoregression]) -> np.ndarray:
    """Variance (...) of what moves by ``slopes`` (..., channels, samples) with noise of these colours."""
    samples = slopes.shape[-1]
    length = 4 * samples
    power = np.abs(np.fft.rfft(slopes, length)) ** 2
    power[..., 1:-1] *= 2.0
    return np.asarray(sum(power[..., i, :] @ noise.spectrum(length) for i, noise in enumerate(noises)) / length)
