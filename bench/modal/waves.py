"""Modes of free vibrations: maximum likelihood of damped waves in all channels together.

A channel is ``Re sum_m shape_m exp(pole_m (t - t0))``, a constant and noise. Poles are common; shapes and constants are
linear and are eliminated by variable projection (G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973; Jacobian
of L. Kaufman, BIT 15:49, 1975). The noise of each channel has a size of its own and, at even times, a colour: an
autoregression of the residuals, by which all is whitened.

Their number is that of the least Bayesian information criterion (G. Schwarz, Ann. Stat. 6:461, 1978). Modes are added
one by one while that of white noise falls, as the autoregression of a fit that lacks strong modes would stand for them;
then the number is judged with the noise's coefficients counted, so that a hump in the noise does not pass for a mode.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bench.contract.estimate import Status
from bench.contract.modal import MOST_MODES, FreeDecays, ModalCard, ModalEstimate, ModalIdentifier, ModalProblem, Mode
from bench.likelihood.autoregression import Autoregression, autoregression, even_times
from bench.likelihood.least_squares import Linearisation, minimise

ITERATIONS, FIRST_ITERATIONS = 60, 12
"""Steps of a search at most, and of one whose outcome is only compared with others."""
ROUNDING = 1e-7
"""Least noise, over the size of a channel: less is rounding of the numbers."""
MOST_GROWTH = 3.0
"""Largest exponent of a wave: a search may try more on its way."""
POWERS = (1, 2, -1)
"""Powers of the amplitude by which frequency and damping may change: those of a spring, a drag and dry friction."""
CLEAR = 10.0
"""Difference of the criterion that is very strong evidence (R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90:773,
1995): by so much two modes must be better than one whose frequency and damping change with its amplitude."""
HARMONICS, HARMONIC = (2, 3), 0.05
"""Multiples of a changing frequency, and distance from one, relative, within which a wave is its harmonic."""
RESOLVED, BESIDE = 0.25, 0.25
"""Least distance of two modes, in cycles over the record; and least distance from a bent one, over its frequency."""

DECAYS = 8
"""Decay rates of the search for a further mode, in equal ratios."""


@dataclass(frozen=True, eq=False)
class WaveFit:
    """Damped waves beside samples ``values`` (channels, n) at ``times`` (n,) from 0 on, with shapes of least squares.

    ``noises``: by which the misfit is whitened, one a channel; ``poles`` (m,): complex, in 1/s. One mode may be
    ``bent``, its frequency and damping changing with its amplitude: the exponent has the terms ``bends`` (2,) beside.
    """

    times: np.ndarray
    values: np.ndarray
    noises: tuple[Autoregression, ...]
    poles: np.ndarray
    bent: int | None = None
    bends: np.ndarray = field(default_factory=lambda: np.zeros(0, complex))
    curves: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @staticmethod
    def empty(times: np.ndarray, values: np.ndarray) -> WaveFit:
        """Return the fit of constants alone, with white noise of the size of the samples."""
        noises = tuple(Autoregression(np.zeros(0), max(float(np.var(channel)), 1e-300)) for channel in values)
        return WaveFit(times - times[0], values, noises, np.zeros(0, complex))

    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (k, n) whitened by every channel's noise, or (channels, k, n) each by its own."""
        rows = np.broadcast_to(rows, (len(self.noises), *rows.shape[-2:]))
        return np.stack([noise.whitened(part) for noise, part in zip(self.noises, rows, strict=True)])

    @cached_property
    def waves(self) -> np.ndarray:
        """``exp(pole t)``, shape (m, n)."""
        exponents = self.poles[:, None] * self.times
        if self.bent is not None:
            exponents[self.bent] += self.bends @ self.curves
        return np.exp(np.minimum(exponents.real, MOST_GROWTH) + 1j * exponents.imag)

    @cached_property
    def basis(self) -> np.ndarray:
        """Waves of unit real and of unit imaginary shape, and ones: shape (2 m + 1, n)."""
        return np.vstack([self.waves.real, -self.waves.imag, np.ones(self.times.size)])

    @cached_property
    def projection(self) -> tuple[np.ndarray, np.ndarray]:
        """Orthonormal columns and triangle of the whitened basis, for each channel."""
        q, r = np.linalg.qr(np.swapaxes(self.whitened(self.basis), 1, 2))
        return q, r

    @cached_property
    def amplitudes(self) -> np.ndarray:
        """Real parts of the shapes, imaginary parts, and the constant: shape (channels, 2 m + 1)."""
        q, r = self.projection
        data = np.swapaxes(q, 1, 2) @ np.swapaxes(self.whitened(self.values[:, None]), 1, 2)
        return np.asarray((np.linalg.pinv(r) @ data)[..., 0])

    @property
    def shapes(self) -> np.ndarray:
        """Complex amplitudes at the first time, shape (channels, m)."""
        m = self.poles.size
        return np.asarray(self.amplitudes[:, :m] + 1j * self.amplitudes[:, m : 2 * m])

    @cached_property
    def residuals(self) -> np.ndarray:
        """Shape (channels, n), in the channels' units."""
        return np.asarray(self.values - self.amplitudes @ self.basis)

    @property
    def slopes(self) -> np.ndarray:
        """Whitened derivatives (channels, n, size) of the motion by real and imaginary parts of poles and bends."""
        waves = self.shapes[:, :, None] * self.waves
        moving = waves * self.times
        if self.bent is not None:
            moving = np.concatenate([moving, waves[:, self.bent, None] * self.curves], axis=1)
        return np.swapaxes(self.whitened(np.concatenate([moving.real, -moving.imag], axis=1)), 1, 2)

    def criterion(self, coloured: bool = True) -> float:
        """Return the Bayesian information criterion with the best noise of these residuals."""
        n = self.times.size
        floors = (ROUNDING * np.std(self.values, axis=1)) ** 2 + 1e-300
        noises = self._noises(used=False) if coloured else self.white().noises
        sizes = [n * np.log(noise.variance + floor) for noise, floor in zip(noises, floors, strict=True)]
        return float(sum(sizes) + (self.unknowns + sum(noise.order for noise in noises)) * np.log(n))

    def _noises(self, used: bool = True) -> tuple[Autoregression, ...]:
        """Return the noises of the residuals; ``used``: they are smaller than the noise by what the fit has spent."""
        channels, n = self.values.shape
        spent = used * (self.basis.shape[0] + 2 * self.poles.size / channels)
        if even_times(self.times):
            return tuple(autoregression(channel, spent) for channel in self.residuals)
        scale = 1.0 / max(n - spent, 1.0)
        return tuple(Autoregression(np.zeros(0), float(scale * r @ r) or 1e-300) for r in self.residuals)

    def refined(self, iterations: int = ITERATIONS) -> WaveFit:
        """Return the fit of all poles, searched for from these, with the noise as it is."""
        m = self.poles.size
        if not m:
            return self
        fastest = np.pi * (self.times.size - 1) / self.times[-1]
        slowest = 0.5 * np.pi / self.times[-1]

        count = m + self.bends.size

        def evaluate(_: np.ndarray, unknowns: np.ndarray) -> Linearisation:
            real, imaginary = unknowns[0].reshape(2, count)
            poles = np.clip(real[:m], -fastest, 0.0) + 1j * np.clip(imaginary[:m], slowest, fastest)
            fit = replace(self, poles=poles, bends=real[m:] + 1j * imaginary[m:])
            q, slopes = fit.projection[0], fit.slopes
            left = fit.whitened(fit.residuals[:, None])[:, 0]
            slopes = q @ (np.swapaxes(q, 1, 2) @ slopes) - slopes
            x = np.concatenate([poles.real, real[m:], poles.imag, imaginary[m:]])[None]
            return Linearisation.of(x, left.reshape(1, -1), slopes.reshape(1, -1, 2 * count))

        first = np.append(self.poles, self.bends)
        start = evaluate(np.zeros(1), np.concatenate([first.real, first.imag])[None])
        real, imaginary = minimise(evaluate, start, iterations).at.unknowns[0].reshape(2, count)
        return replace(
            self,
            poles=real[:m] + 1j * imaginary[:m],
            bends=real[m:] + 1j * imaginary[m:],
        )

    def settled(self) -> WaveFit:
        """Return the fit with noise and poles to each other's liking."""
        fit = self
        for _ in range(2):
            fit = replace(fit, noises=fit._noises()).refined()
        return fit

    def white(self) -> WaveFit:
        """Return the same poles with noise that is white."""
        return replace(self, noises=WaveFit.empty(self.times, self.residuals).noises)

    def longer(self, coloured: bool, bend: bool = False) -> WaveFit:
        """Return the best fit with one more mode.

        It starts at the largest wave in the residuals, or from one mode split in two, as a line between two close ones
        leaves no line beside it.
        """
        fit = self if coloured else self.white()
        starts = [replace(fit, poles=np.append(self.poles, fit.largest_wave()))]
        for i, pole in enumerate(self.poles):
            if i != self.bent:
                apart = 1j * max(-pole.real, 2.0 / self.times[-1])
                poles = np.append(self.poles, pole + apart)
                poles[i] = pole - apart
                starts.append(replace(fit, poles=poles))
        if bend and self.bent is None and self.poles.size:
            starts.append(fit.with_bend())
        fits = [start.refined(FIRST_ITERATIONS) for start in starts]
        best = min(fits, key=lambda fit: (not fit.plausible, fit.criterion(coloured) - (fit.bent is not None) * CLEAR))
        return best.settled() if coloured else best.refined()

    @property
    def plausible(self) -> bool:
        """Return whether no two modes are at one frequency, as friction would show them, nor one beside a bent one."""
        rates = self.poles.imag
        apart = np.abs(rates[:, None] - rates) + np.diag(np.full(rates.size, np.inf))
        beside = np.inf if self.bent is None else np.min(apart[self.bent]) / rates[self.bent]
        return bool(np.min(apart, initial=np.inf) > 2 * np.pi * RESOLVED / self.times[-1] and beside > BESIDE)

    def with_bend(self) -> WaveFit:
        """Return the fit with its strongest mode bent.

        Where frequency and damping change a little with the amplitude ``a = exp(-rate t)``, averaging gives terms of
        the exponent in powers of it (A. H. Nayfeh, D. T. Mook, Nonlinear Oscillations, 1979, section 2.3).
        They are taken about their line of least squares, so that the pole stays that of the mean.
        """
        size = np.sum(np.linalg.norm(self.shapes[:, :, None] * self.waves, axis=2), axis=0)
        bent = int(np.argmax(size))
        decays = np.minimum(max(-self.poles[bent].real, 1.0 / self.times[-1]) * self.times, MOST_GROWTH * 2)
        curves = [np.exp(-power * decays) for power in POWERS]
        lines = [np.polynomial.Polynomial.fit(self.times, curve, 1, w=np.exp(-decays))(self.times) for curve in curves]
        return replace(self, bent=bent, bends=np.zeros(len(POWERS), complex), curves=np.array(curves) - lines)

    def largest_wave(self) -> complex:
        """Return the pole of the wave that explains most of the whitened residuals, on a grid of matched filters."""
        left = self.whitened(self.residuals[:, None])[:, 0]
        n, span = self.times.size, float(self.times[-1])
        even = np.linspace(0.0, span, n)
        left = np.array([np.interp(even, self.times, channel) for channel in left])
        best, most = 0j, -1.0
        for rate in np.geomspace(0.3, n / 8, DECAYS) / span:
            window = np.exp(-rate * even)
            power = np.sum(np.abs(np.fft.rfft(left * window, 2 * n)) ** 2, axis=0)[2:] / (window @ window)
            if np.max(power) > most:
                most = float(np.max(power))
                best = complex(-rate, np.pi * (n - 1) / (n * span) * (2 + int(np.argmax(power))))
        return best

    @property
    def unknowns(self) -> int:
        return 2 * (self.bends.size + self.poles.size) + self.values.shape[0] * (2 * self.poles.size + 1)

    def modes(self) -> tuple[Mode, ...]:
        """Return the modes in order of frequency, with standard errors from the Fisher information."""
        m = self.poles.size
        (q, r), slopes = self.projection, self.slopes
        half = slopes.shape[2] // 2
        along = np.swapaxes(q, 1, 2) @ slopes
        across = slopes - q @ along
        covariance = np.linalg.pinv(np.einsum("cni,cnj->ij", across, across), hermitian=True)
        inverse = np.linalg.pinv(r)
        by_pole = inverse @ along
        variances = np.sum(inverse**2, axis=2) + np.einsum("cai,ij,caj->ca", by_pole, covariance, by_pole)
        shape_sd = np.sqrt((variances[:, :m] + variances[:, m : 2 * m]) / 2.0)
        size = np.linalg.norm(self.values - np.mean(self.values, axis=1, keepdims=True)) or 1.0
        modes = []
        for i, pole in enumerate(self.poles):
            share = float(np.linalg.norm((self.shapes[:, i, None] * self.waves[i]).real) / size)
            places = np.ix_([i, half + i], [i, half + i])
            modes.append(Mode.of_pole(pole, covariance[places], self.shapes[:, i], shape_sd[:, i], share))
        return tuple(sorted(modes, key=lambda mode: mode.frequency))


@dataclass(frozen=True)
class Waves(ModalIdentifier):
    """Maximum likelihood of damped waves in all channels together."""

    card = ModalCard(
        summary="maximum likelihood of damped waves in all channels; number by the Bayesian information criterion",
        settings_source="none to choose",
        title="Damped waves",
        order=10,
    )
    serves = (FreeDecays,)

    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Fit one mode, two and so on; answer those in the band."""
        assert isinstance(problem.data, FreeDecays)
        data, auto = problem.data, problem.count is None
        low, high = problem.band or (0.0, np.inf)

        def inside(fit: WaveFit) -> int:
            rates = np.abs(fit.poles) / (2 * np.pi)
            return int(np.count_nonzero((low <= rates) & (rates <= high)))

        def may_grow(fit: WaveFit) -> bool:
            full = fit.poles.size == MOST_MODES or inside(fit) == problem.count
            return not full and data.values.size > 4 * fit.unknowns

        fits, decided = [WaveFit.empty(data.times, np.atleast_2d(data.values))], "as asked"
        while may_grow(fits[-1]):
            longer = fits[-1].longer(coloured=False, bend=auto)
            if auto and not (longer.plausible and longer.criterion(False) < fits[-1].criterion(False)):
                break
            fits.append(longer)
        fit = fits[-1].settled()
        if auto:
            fit = min((fit, *(fewer.settled() for fewer in fits[:-1])), key=lambda fit: fit.criterion())
            decided = "as many as are sought: what is there may be no sum of modes"
            while may_grow(fit):
                longer = fit.longer(coloured=True, bend=True)
                gain = fit.criterion() - longer.criterion()
                if not longer.plausible:
                    decided = "a further one would only split one that does not decay as a mode"
                    break
                if gain <= 0:
                    decided = f"a further one would raise the Bayesian information criterion by {-gain:.2g}"
                    break
                fit = longer
        modes = tuple(mode for mode in fit.modes() if low <= mode.frequency <= high)
        changes = ""
        if fit.bent is not None:
            bent = float(abs(fit.poles[fit.bent])) / (2 * np.pi)
            changes = f"; frequency or damping of the mode at {bent:.4g} Hz change with its amplitude"
            if auto:
                linear = [m for m in modes if all(abs(m.frequency / bent / k - 1) > HARMONIC for k in HARMONICS)]
                changes += ", and its harmonics are left out" if len(linear) < len(modes) else ""
                modes = tuple(linear)
        if not modes:
            return ModalEstimate((), status=Status.DIVERGED, message="no mode stands out of the noise there")
        message = f"{len(modes)} mode{'' if len(modes) == 1 else 's'}: {decided}{changes}"
        return ModalEstimate(modes, float(max(data.values.size - fit.unknowns, 1)), message=message)
