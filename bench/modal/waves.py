"""Modes of free vibrations: maximum likelihood of damped waves in all channels together.

A channel is ``Re sum_m shape_m exp(pole_m (t - t0))``, a constant and noise. Poles are common. The noise of each
channel has a size of its own and, at even times, a colour: an autoregression of the residuals, by which all is
whitened.

Modes are added one by one while the criterion of white noise falls, as the autoregression of a fit that lacks strong
modes would stand for them; then the number is judged with the noise's coefficients counted, so that a hump in the noise
does not pass for a mode.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bench.contract.estimate import Status
from bench.contract.modal import FreeDecays, ModalCard, ModalEstimate, ModalIdentifier, ModalProblem
from bench.likelihood.autoregression import Autoregression, autoregression, even_times
from bench.modal.pole_search import DECAYS, ROUNDING, PoleFit, add_modes

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
PATIENCE = 2
"""Modes that are added in vain before the search ends."""


@dataclass(frozen=True, eq=False)
class WaveFit(PoleFit):
    """Damped waves beside values (1, channels, n) at ``times`` (n,) from 0 on.

    ``filters``: by which the misfit of each channel is whitened, of variance 1; none where noise is taken as white.
    One mode may be ``bent``, its frequency and damping changing with its amplitude: the exponent has the terms
    ``bends`` beside; a search may try that where it ``may_bend``.
    """

    times: np.ndarray
    filters: tuple[Autoregression, ...] = ()
    may_bend: bool = False
    bent: int | None = None
    bends: np.ndarray = field(default_factory=lambda: np.zeros(0, complex))
    curves: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @staticmethod
    def empty(times: np.ndarray, samples: np.ndarray, may_bend: bool = False) -> WaveFit:
        """Return the fit of constants alone, with white noise of the size of the samples."""
        about, apart = samples[None] - np.mean(samples, axis=1, keepdims=True), 2.0 / float(np.ptp(times))
        first = WaveFit(np.zeros(0, complex), np.ones(len(samples)), about, apart, times - times[0], may_bend=may_bend)
        return first.with_noise()

    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (1, channels or 1, k, n) as (1, channels, n, k), (1, 1, n, k) for white noise."""
        if self.filters:
            rows = np.broadcast_to(rows[0], (len(self.filters), *rows.shape[2:]))
            rows = np.stack([noise.whiten(part) for noise, part in zip(self.filters, rows, strict=True)])[None]
        return np.swapaxes(rows, -1, -2)

    @cached_property
    def waves(self) -> np.ndarray:
        """``exp(pole t)`` (m, n), 1 at first."""
        exponents = self.poles[:, None] * self.times
        if self.bent is not None:
            exponents[self.bent] += self.bends @ self.curves
        waves = np.exp(np.minimum(exponents.real, MOST_GROWTH) + 1j * exponents.imag)
        return np.asarray(waves / waves[:, :1])

    @cached_property
    def basis(self) -> np.ndarray:
        return np.vstack([self.waves.real, -self.waves.imag, np.ones(self.times.size)])[None]

    @property
    def slopes(self) -> np.ndarray:
        waves = self.residues[0, :, :, None] * self.waves
        moving = waves * self.times
        if self.bent is not None:
            moving = np.concatenate([moving, waves[:, self.bent, None] * (self.curves - self.curves[:, :1])], axis=1)
        return np.concatenate([moving.real, -moving.imag], axis=1)[None]

    @property
    def nonlinear(self) -> np.ndarray:
        return np.append(self.poles, self.bends)

    def moved(self, nonlinear: np.ndarray) -> WaveFit:
        """Return the fit with other poles, slower than the sampling and no slower than the record, and bends."""
        fastest, m = np.pi * (self.times.size - 1) / self.times[-1], self.poles.size
        real, imaginary = np.clip(nonlinear.real[:m], -fastest, 0.0), nonlinear.imag[:m]
        imaginary = np.clip(imaginary, 0.5 * np.pi / self.times[-1], fastest)
        return replace(self, poles=real + 1j * imaginary, bends=nonlinear[m:])

    def part(self, mode: int) -> np.ndarray:
        return (self.residues[0, :, mode, None] * self.waves[mode]).real

    @property
    def unknowns(self) -> int:
        return 2 * self.nonlinear.size + self.level.size * self.basis.shape[1]

    @property
    def criterion(self) -> float:
        """The Bayesian information criterion with the best noise of these residuals, by its exact likelihood.

        The variance of Levinson and Durbin holds the ends of the residuals, which resonant noise makes many times too
        large: a wave that lowers them would pass for a mode.
        """
        n, total = self.times.size, 0.0
        noises, deviations = self._noises(bool(self.filters)), np.std(self.values[0], axis=1)
        for residuals, noise, deviation in zip(self.residuals[0], noises, deviations, strict=True):
            unit = replace(noise, variance=1.0)
            square = np.mean(unit.whiten(residuals) ** 2) + (ROUNDING * deviation) ** 2 + 1e-300
            total += n * np.log(square) - 2.0 * np.sum(np.log(np.diag(unit.whiten(np.eye(noise.order)))))
        return float(total + (self.unknowns + sum(noise.order for noise in noises)) * np.log(n))

    def _noises(self, coloured: bool, spent: float = 0.0) -> list[Autoregression]:
        """Return the noises of the residuals, which are smaller by the degrees of freedom that the fit has spent."""
        if coloured and even_times(self.times):
            return [autoregression(channel, spent) for channel in self.residuals[0]]
        scale = 1.0 / max(self.times.size - spent, 1.0)
        return [Autoregression(np.zeros(0), float(scale * r @ r) or 1e-300) for r in self.residuals[0]]

    def with_noise(self, coloured: bool | None = None) -> WaveFit:
        """Return the fit with noise as its residuals have it, of a colour or white, by default as it is."""
        coloured = bool(self.filters) if coloured is None else coloured
        noises = self._noises(coloured, self.unknowns / self.level.size)
        filters = tuple(replace(noise, variance=1.0) for noise in noises) if coloured else ()
        return replace(self, filters=filters, level=np.array([noise.variance for noise in noises]))

    @property
    def has_room(self) -> bool:
        return self.values.size > 4 * self.unknowns

    def starts(self) -> list[WaveFit]:
        """Return fits with the largest wave of the residuals, with a mode split in two, with the strongest bent."""
        starts = [replace(self, poles=np.append(self.poles, self.largest_wave()))]
        starts += [fit for i, fit in enumerate(self.splits()) if i != self.bent]
        return [*starts, self.with_bend()] if self.may_bend and self.bent is None and self.poles.size else starts

    @property
    def rank(self) -> tuple[bool, float]:
        return not self.plausible, self.criterion - (self.bent is not None) * CLEAR

    @property
    def plausible(self) -> bool:
        """Return whether no two modes are at one frequency, as friction shows them, and none beside a bent one."""
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
        size = np.sum(np.linalg.norm(self.residues[0, :, :, None] * self.waves, axis=2), axis=0)
        bent = int(np.argmax(size))
        decays = np.minimum(max(-self.poles[bent].real, 1.0 / self.times[-1]) * self.times, MOST_GROWTH * 2)
        curves = [np.exp(-power * decays) for power in POWERS]
        lines = [np.polynomial.Polynomial.fit(self.times, curve, 1, w=np.exp(-decays))(self.times) for curve in curves]
        return replace(self, bent=bent, bends=np.zeros(len(POWERS), complex), curves=np.array(curves) - lines)

    def largest_wave(self) -> complex:
        """Return the pole of the wave that explains most of the whitened residuals, on a grid of matched filters."""
        left = self.whitened(self.residuals[:, :, None])[0, ..., 0] / np.sqrt(self.level)[:, None]
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


@dataclass(frozen=True)
class Waves(ModalIdentifier):
    """Maximum likelihood of damped waves in all channels together."""

    version = 2
    card = ModalCard(
        summary="maximum likelihood of damped waves in all channels; number by the Bayesian information criterion",
        settings_source="none to choose",
        title="Damped waves",
        order=10,
    )
    scope = (FreeDecays,)

    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Fit one mode, two and so on; answer those in the band."""
        assert isinstance(problem.data, FreeDecays)
        data, auto = problem.data, problem.count is None
        first = WaveFit.empty(data.times, np.atleast_2d(data.values), auto)
        fits = [first.with_noise(coloured=True)]

        def judge(fit: WaveFit) -> bool:
            fits.append(fit.with_noise(coloured=True).settled())
            return int(np.argmin([fit.criterion for fit in fits])) + PATIENCE >= len(fits)

        if auto:
            add_modes(first, problem, judge)
            best = min(fits, key=lambda fit: fit.criterion)
        else:
            best = add_modes(first, problem)[0].with_noise(coloured=True).settled()
        fit, modes, decided = add_modes(best, problem)
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
