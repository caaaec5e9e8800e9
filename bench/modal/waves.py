"""Modes of free vibrations: maximum likelihood of damped waves in all channels jointly.

A channel is the sum of ``Re sum_m shape_m exp(pole_m (t - t0))``, a constant and noise. Poles are common. The noise of
each channel has its own variance and, at even times, its own colour: an autoregression of the residuals, which whitens
the channel.

Modes are first added with white noise, as an autoregression would represent strong missing modes; then their number is
selected with coloured noise, whose coefficients are counted, so that a peak of the noise spectrum is not a mode.
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
"""Upper limit of the exponent of a wave, which may be exceeded during a search."""
POWERS = (1, 2, -1)
"""Powers of the amplitude in amplitude-dependent frequency and damping, for springs, drag and dry friction."""
CLEAR = 10.0
"""Decrease of the criterion (very strong evidence: R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90:773, 1995) by
which two modes must be better than one with amplitude-dependent frequency and damping."""
HARMONICS, HARMONIC = (2, 3), 0.05
"""Multiples of an amplitude-dependent frequency, and relative distance within which a mode is a harmonic."""
RESOLVED, SEPARATE = 0.25, 0.25
"""Least distance of two modes in cycles over the record; least relative distance from an amplitude-dependent one."""
PATIENCE = 2
"""Number of modes that are added without a decrease of the criterion before the search ends."""


@dataclass(frozen=True, eq=False)
class WaveFit(PoleFit):
    """Fit of damped waves to values (1, channels, n).

    Attributes:
        times: Times (s), from 0; shape (n,).
        filters: Noise models of variance 1 by which channels are whitened; empty for white noise.
        may_bend: Whether a mode may have amplitude-dependent frequency and damping.
        bent: Number of this mode; None if there is none.
        bends: Coefficients of its amplitude-dependent exponent.
        curves: Terms of this exponent, shape (terms, n).
    """

    times: np.ndarray
    filters: tuple[Autoregression, ...] = ()
    may_bend: bool = False
    bent: int | None = None
    bends: np.ndarray = field(default_factory=lambda: np.zeros(0, complex))
    curves: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @staticmethod
    def empty(times: np.ndarray, samples: np.ndarray, may_bend: bool = False) -> WaveFit:
        """Return the fit of constants with white noise."""
        centred, resolution = samples[None] - np.mean(samples, axis=1, keepdims=True), 2.0 / float(np.ptp(times))
        poles, level = np.zeros(0, complex), np.ones(len(samples))
        return WaveFit(poles, level, centred, resolution, times - times[0], may_bend=may_bend).with_noise()

    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Whiten rows (1, channels or 1, k, n); return columns (1, channels, n, k), or (1, 1, n, k) if white."""
        if self.filters:
            rows = np.broadcast_to(rows[0], (len(self.filters), *rows.shape[2:]))
            rows = np.stack([noise.whiten(part) for noise, part in zip(self.filters, rows, strict=True)])[None]
        return np.swapaxes(rows, -1, -2)

    @cached_property
    def waves(self) -> np.ndarray:
        """Waves ``exp(pole t)``, shape (m, n); 1 at time 0."""
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
        """Return the fit with other bends and poles, clipped between half a cycle per two records and Nyquist."""
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
        """Bayesian information criterion with the noise model estimated from the residuals, by the exact likelihood.

        The variance by Levinson and Durbin includes the ends of the residuals, which are far too large for resonant
        noise: a wave that reduces them would be accepted as a mode.
        """
        n, total = self.times.size, 0.0
        noises, deviations = self._noises(bool(self.filters)), np.std(self.values[0], axis=1)
        for residuals, noise, deviation in zip(self.residuals[0], noises, deviations, strict=True):
            unit = replace(noise, variance=1.0)
            square = np.mean(unit.whiten(residuals) ** 2) + (ROUNDING * deviation) ** 2 + 1e-300
            total += n * np.log(square) - 2.0 * np.sum(np.log(np.diag(unit.whiten(np.eye(noise.order)))))
        return float(total + (self.unknowns + sum(noise.order for noise in noises)) * np.log(n))

    def _noises(self, coloured: bool, spent: float = 0.0) -> list[Autoregression]:
        """Return noise models of the residuals, corrected for the degrees of freedom ``spent`` by the fit."""
        if coloured and even_times(self.times):
            return [autoregression(channel, spent) for channel in self.residuals[0]]
        scale = 1.0 / max(self.times.size - spent, 1.0)
        return [Autoregression(np.zeros(0), float(scale * r @ r) or 1e-300) for r in self.residuals[0]]

    def with_noise(self, coloured: bool | None = None) -> WaveFit:
        """Return the fit with a noise model estimated from its residuals, coloured or white; by default as before."""
        coloured = bool(self.filters) if coloured is None else coloured
        noises = self._noises(coloured, self.unknowns / self.level.size)
        filters = tuple(replace(noise, variance=1.0) for noise in noises) if coloured else ()
        return replace(self, filters=filters, level=np.array([noise.variance for noise in noises]))

    @property
    def has_room(self) -> bool:
        return self.values.size > 4 * self.unknowns

    def starts(self) -> list[WaveFit]:
        """Return starting points: the largest wave of the residuals added, a mode split, or the strongest mode bent."""
        starts = [replace(self, poles=np.append(self.poles, self.largest_wave()))]
        starts += [fit for i, fit in enumerate(self.splits()) if i != self.bent]
        return [*starts, self.with_bend()] if self.may_bend and self.bent is None and self.poles.size else starts

    @property
    def rank(self) -> tuple[bool, float]:
        return not self.plausible, self.criterion - (self.bent is not None) * CLEAR

    @property
    def plausible(self) -> bool:
        """Whether no two modes have equal frequencies, as for friction, and none is near an amplitude-dependent one."""
        rates = self.poles.imag
        distances = np.abs(rates[:, None] - rates) + np.diag(np.full(rates.size, np.inf))
        nearest = np.inf if self.bent is None else np.min(distances[self.bent]) / rates[self.bent]
        resolved = np.min(distances, initial=np.inf) > 2 * np.pi * RESOLVED / self.times[-1]
        return bool(resolved and nearest > SEPARATE)

    def with_bend(self) -> WaveFit:
        """Return the fit with amplitude-dependent frequency and damping of its strongest mode.

        For a weak dependence on the amplitude ``a = exp(-rate t)``, averaging gives terms of the exponent in powers of
        it (A. H. Nayfeh, D. T. Mook, Nonlinear Oscillations, 1979, section 2.3). Their least-squares lines are
        subtracted, so that the pole is that of the mean.
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
    """Maximum likelihood of damped waves in all channels jointly."""

    version = 2
    card = ModalCard(
        summary="maximum likelihood of damped waves in all channels; number by the Bayesian information criterion",
        settings_source="none to choose",
        title="Damped waves",
        order=10,
    )
    scope = (FreeDecays,)

    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Add modes one by one; return those in the band."""
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
            changes = f"; frequency or damping of the mode at {bent:.4g} Hz depends on its amplitude"
            if auto:
                linear = [m for m in modes if all(abs(m.frequency / bent / k - 1) > HARMONIC for k in HARMONICS)]
                changes += ", and its harmonics are excluded" if len(linear) < len(modes) else ""
                modes = tuple(linear)
        if not modes:
            return ModalEstimate((), status=Status.DIVERGED, message="no significant mode")
        message = f"{len(modes)} mode{'' if len(modes) == 1 else 's'}: {decided}{changes}"
        return ModalEstimate(modes, float(max(data.values.size - fit.unknowns, 1)), message=message)
