"""Modes of blows and frequency responses: maximum likelihood on spectra.

The frequency response is ``s^d (sum_m R_m / (s - p_m) + conjugates + residual terms)``, d = 0, 1, 2 for receptance,
mobility and accelerance; the residual terms, powers -2 to 1 of s, represent modes outside of the band (D. J. Ewins,
Modal Testing, 2nd ed., 2000, chapter 4). Poles are common; residues and other factors differ between blows and outputs.

A record may end before its motion has decayed, which causes leakage with the same poles (R. Pintelon, J. Schoukens,
System Identification, 2nd ed., 2012, section 6.3): the free motion after the end is subtracted, which is exact for a
band-limited force that ends within the record. If the motion does not start from rest, a free motion of each record is
fitted as well; the Bayesian information criterion decides.

Each blow has separate factors. Noise of the force within the pulse is smooth over the lines of a mode: it scales the
motion of a blow and does not affect the poles. Outside of the pulse the force is zero. So noise of the force does not
bias the poles, and is included in the standard errors of the residues, which are means over the blows. Noise of the
force of a shaker is neglected; it reduces residues by its share of the mean square of the force.

The variance of the noise of a response is a smooth function of frequency, estimated from the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.linalg import matmul_toeplitz
from scipy.ndimage import uniform_filter1d
from scipy.signal import fftconvolve

from bench.contract.estimate import Status
from bench.contract.modal import (
    DERIVATIVES,
    Blows,
    FrequencyResponses,
    ModalCard,
    ModalEstimate,
    ModalIdentifier,
    ModalProblem,
    Mode,
)
from bench.modal.blows import force_windowed, touched
from bench.modal.pole_search import DECAYS, ROUNDING, TRIAL, PoleFit, add_modes

POWERS = np.arange(-2, 2)
"""Powers of s in the residual terms: mass and stiffness lines, and those of damping."""
COLOUR = 3
"""Degree of the polynomial of the log variance of the noise in the log frequency."""
NEIGHBOURS = 5
"""Number of lines over which given variances are averaged, as those of few records scatter."""
LEAST_LINES = 16
"""Least number of lines in the band."""
REAL_MODE = 10.0
"""Phase difference (degrees) of a residue from that of a real mode above which it is reported."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Spectra of responses and forces.

    Attributes:
        s: Complex frequencies (rad/s), shape (lines,).
        values: Responses, shape (blocks, outputs, lines).
        forces: Forces, shape (blocks, lines).
        order: Derivative of the displacement that is measured.
        pulses: Samples of the forces within the blows, shape (blocks, n); none for frequency responses.
        left: Times of these samples before the end of the record (s), shape (n,).
        step: Sampling interval (s).
        force_noise: Standard deviation of the noise of the force within the blows; it is zero outside.
        variances: Given relative variances, shape (outputs, lines).
    """

    s: np.ndarray
    values: np.ndarray
    forces: np.ndarray
    order: int
    pulses: np.ndarray
    left: np.ndarray
    step: float
    force_noise: float
    variances: np.ndarray | None = None

    @staticmethod
    def of(data: Blows | FrequencyResponses, low: float, high: float) -> Spectra:
        """Return the spectra between two frequencies (Hz), without the line at 0 Hz."""
        order = DERIVATIVES[data.response]
        if isinstance(data, FrequencyResponses):
            inside = (data.frequencies >= low) & (data.frequencies <= high) & (data.frequencies > 0)
            s = data.window + 2j * np.pi * data.frequencies[inside]
            variances = data.variances
            if variances is not None:
                variances = uniform_filter1d(variances, NEIGHBOURS)[:, inside]
            values, ones, none = data.values[None, :, inside], np.ones((1, s.size), complex), np.zeros((1, 0))
            return Spectra(s, values, ones, order, none, none[0], 1.0, 0.0, variances)
        hammer, n, step = touched(data.forces), data.forces.shape[1], data.step
        pulses = force_windowed(data).forces
        noise = 0.0 if hammer is None else float(np.std(data.forces[~hammer]))
        frequencies = np.fft.rfftfreq(n, step)
        inside = (frequencies >= low) & (frequencies <= high) & (frequencies > 0) & (frequencies < 0.5 / step)
        unwindowed = data.responses * np.exp(data.window * step * np.arange(n))
        values, forces = (step * np.fft.rfft(part)[..., inside] for part in (unwindowed, pulses))
        acts = np.any(pulses != 0.0, axis=0)
        left = step * np.arange(n, 0, -1)[acts]
        return Spectra(2j * np.pi * frequencies[inside], values, forces, order, pulses[:, acts], left, step, noise)

    def force_errors(self, rates: np.ndarray) -> np.ndarray:
        """Return variances (blocks, m) of the relative in-phase error of the forces' spectra at ``rates`` (m,)."""
        waves = np.exp(1j * rates[:, None] * self.left)
        relative = waves / (self.pulses @ waves.T)[..., None]
        return np.asarray(self.force_noise**2 * np.sum((self.pulses != 0.0)[:, None] * relative.real**2, axis=-1))

    def free(self, poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return spectra (m, lines) of infinite sampled free motions ``exp(pole t)``, and derivatives by the pole."""
        ratio = np.exp((poles[:, None] - self.s) * self.step)
        return self.step / (1.0 - ratio), self.step**2 * ratio / (1.0 - ratio) ** 2

    def forced(self, poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return spectra (blocks, m, lines) of motions from rest with residue 1, and derivatives by the pole.

        The free motion after the end of the record, from ``x(T) = sum f(t) exp(pole (T - t)) step``, is subtracted.
        """
        d, left = self.order, self.left
        motion = (self.s**d * self.forces)[:, None] / (self.s - poles[:, None])
        waves = np.exp(poles[:, None] * left)
        end = self.step * self.pulses @ waves.T
        end_slope = poles**d * (self.step * self.pulses @ (left * waves).T) + d * poles ** max(d - 1, 0) * end
        end = poles**d * end
        free, free_slope = self.free(poles)
        slope = motion / (self.s - poles[:, None]) - end_slope[..., None] * free - end[..., None] * free_slope
        return motion - end[..., None] * free, slope


def pairs(plus: np.ndarray, minus: np.ndarray) -> np.ndarray:
    """Return the functions of real and of imaginary factors from conjugate functions (..., m, lines)."""
    return np.concatenate([plus + minus, 1j * (plus - minus)], axis=-2)


@dataclass(frozen=True, eq=False)
class SpectralFit(PoleFit):
    """Fit of modes to spectra; a block is a blow.

    Attributes:
        spectra: The data.
        colour: Mean square of the complex error over ``level``, shape (1 or outputs, lines).
        moving: Whether records do not start from rest.
    """

    spectra: Spectra
    colour: np.ndarray
    moving: bool = False

    @staticmethod
    def empty(spectra: Spectra) -> SpectralFit:
        """Return the fit of the residual terms alone."""
        level, colour = np.ones(spectra.values.shape[1]), np.ones((1, spectra.s.size))
        spacing = float(np.ptp(np.abs(spectra.s)) / spectra.s.size)
        return SpectralFit(np.zeros(0, complex), level, spectra.values, spacing, spectra, colour).with_noise()

    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Whiten rows (blocks, outputs or 1, k, lines); return real columns (blocks, outputs or 1, 2 lines, k)."""
        rows = rows * np.sqrt(2.0 / self.colour)[:, None]
        return np.swapaxes(np.concatenate([rows.real, rows.imag], axis=-1), -1, -2)

    @cached_property
    def functions(self) -> tuple[np.ndarray, np.ndarray]:
        """Functions of poles and conjugate poles (2, blocks, families m, lines), and derivatives by the pole.

        The first family are motions from rest; the second one, if ``moving``, free motions.
        """
        values, slopes = [], []
        for poles in (self.poles, self.poles.conj()):
            value, slope = self.spectra.forced(poles)
            if self.moving:
                free = (np.broadcast_to(part, value.shape) for part in self.spectra.free(poles))
                value, slope = (np.concatenate(both, axis=1) for both in zip((value, slope), free, strict=True))
            values.append(value)
            slopes.append(slope)
        return np.stack(values), np.stack(slopes)

    @property
    def functions_count(self) -> int:
        return self.poles.size * (1 + self.moving)

    @cached_property
    def basis(self) -> np.ndarray:
        """Basis functions: those of poles, the residual terms, and smooth leakage if ``moving``."""
        s, forces = self.spectra.s, self.spectra.forces
        relative = s / np.mean(np.abs(s))
        smooth = [forces * s**self.spectra.order * relative**power for power in POWERS]
        if self.moving:
            smooth += [np.broadcast_to(relative**power, forces.shape) for power in (0, 1)]
        return np.concatenate([pairs(*self.functions[0]), np.stack(smooth, axis=1)], axis=1)

    @property
    def slopes(self) -> np.ndarray:
        factors = np.stack([self.residues, self.residues.conj()])
        by_pole = factors[..., None] * self.functions[1][:, :, None]
        families = by_pole.reshape(*by_pole.shape[:3], -1, self.poles.size, by_pole.shape[-1])
        return pairs(*np.sum(families, axis=3))

    def moved(self, nonlinear: np.ndarray) -> SpectralFit:
        """Return the fit with other poles, clipped to stable ones near the band."""
        omega = np.abs(self.spectra.s)
        low, high = 0.5 * omega[0], omega[-1] + 0.1 * (omega[-1] - omega[0])
        imaginary = np.clip(nonlinear.imag, low, high)
        return replace(self, poles=np.clip(nonlinear.real, -high, -ROUNDING * imaginary) + 1j * imaginary)

    def part(self, mode: int) -> np.ndarray:
        residues, functions = self.residues[..., mode, None], self.functions[0][:, :, None, mode]
        return np.asarray(residues * functions[0] + residues.conj() * functions[1])

    def factor_errors(self) -> np.ndarray:
        """Return variances (blocks, m) of the relative error of a blow's force, equal for all lines of a mode."""
        return self.spectra.force_errors(self.poles.imag)

    def gradient_covariance(self, slopes: np.ndarray) -> np.ndarray:
        """Return the covariance of the gradient, with noise of lines correlated by an exponential window.

        White noise times ``exp(-a t)`` has lines with the correlation ``1 / (1 + (s_k - s_l) / (2 a))``.
        """
        window = float(self.spectra.s[0].real)
        if not window:
            return super().gradient_covariance(slopes)
        real, imaginary = np.split(slopes, 2, axis=-2)
        correlation = 1.0 / (1.0 + (self.spectra.s - self.spectra.s[0]) / (2.0 * window))
        rows = (real + 1j * imaginary).reshape(-1, *real.shape[-2:])
        parts = [(row.conj().T @ matmul_toeplitz((correlation, correlation.conj()), row)).real for row in rows]
        return np.asarray(np.sum(parts, axis=0))

    @property
    def unknowns(self) -> int:
        blocks, outputs, _ = self.values.shape
        return 2 * self.poles.size + blocks * outputs * self.basis.shape[1]

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the residuals of an output."""
        blocks, outputs, lines = self.values.shape
        return max(2.0 * blocks * lines - self.unknowns / outputs, 1.0)

    @property
    def has_room(self) -> bool:
        return self.degrees > LEAST_LINES

    @property
    def criterion(self) -> float:
        blocks, outputs, lines = self.values.shape
        count, fit = 2 * blocks * lines, self.with_noise()
        logarithms = np.sum(np.log(fit.colour)) * outputs / len(fit.colour) + lines * np.sum(np.log(fit.level))
        return float(
            2 * blocks * logarithms + count * outputs * np.log(self.degrees / count) + self.unknowns * np.log(count)
        )

    def with_noise(self) -> SpectralFit:
        """Return the fit with a noise model estimated from its residuals, of smooth or given colour.

        The logarithm of the squared residuals is a robust measure of the colour, hardly affected by the few lines of
        a missing mode.
        """
        spectra, blocks = self.spectra, len(self.values)
        floor = ROUNDING**2 * np.mean(np.abs(self.values) ** 2, axis=(0, 2))[:, None] + 1e-300
        squares = np.mean(np.abs(self.residuals) ** 2, axis=0) + floor
        colour = spectra.variances
        if colour is None:
            x = np.log(np.abs(spectra.s))
            powers = np.vander((x - np.mean(x)) / (np.ptp(x) or 1.0), COLOUR + 1)
            colour = np.exp(powers @ np.linalg.lstsq(powers, np.mean(np.log(squares), axis=0))[0])[None]
        return replace(self, colour=colour, level=2.0 * blocks * np.sum(squares / colour, axis=1) / self.degrees)

    def starts(self) -> list[SpectralFit]:
        """Return starting points with the largest mode of the residuals, and with each mode split in two.

        White noise is used as well, as a missing mode resembles coloured noise.
        """
        level = np.mean(np.abs(self.residuals) ** 2, axis=(0, 2))
        white = replace(self, colour=np.ones_like(self.colour[:1]), level=level)
        return [*(replace(fit, poles=np.append(self.poles, fit.largest())) for fit in (white, self)), *white.splits()]

    def longer(self) -> SpectralFit:
        """Return the best fit with one more mode, from rest or with a free motion."""
        best = super().longer()
        if self.spectra.pulses.shape[1] == 0:
            return best
        other = replace(best, moving=not best.moving).refined(TRIAL)
        return other.settled() if other.criterion < best.criterion else best

    def largest(self) -> complex:
        """Return the pole that explains most of the whitened residuals, on a grid of matched filters."""
        omega = np.abs(self.spectra.s)
        even = np.linspace(omega[0], omega[-1], omega.size)
        spacing = even[1] - even[0]
        noise = np.sqrt(self.colour * self.level[:, None])
        force = (self.spectra.forces * self.spectra.s**self.spectra.order)[:, None] / noise
        rows = (np.conj(force) * self.residuals / noise).reshape(-1, omega.size)
        products = np.stack([np.interp(even, omega, row) for row in rows])
        weights = np.interp(even, omega, np.sum(np.abs(force) ** 2, axis=(0, 1)))
        best, most = 0j, -1.0
        for rate in np.geomspace(0.5 * spacing, np.ptp(omega) / 8.0, DECAYS):
            function = 1.0 / (rate + 1j * spacing * np.arange(1 - omega.size, omega.size))
            matched = fftconvolve(products, np.conj(function[::-1])[None], "same", axes=1)
            energy = fftconvolve(weights, np.abs(function) ** 2, "same")
            gain = np.sum(np.abs(matched) ** 2, axis=0) / energy
            if np.max(gain) > most:
                most, best = float(np.max(gain)), complex(-rate, even[int(np.argmax(gain))])
        return best


@dataclass(frozen=True)
class ModalParameters:
    """Modal parameters at a drive point.

    Attributes:
        m: Modal mass (kg).
        c: Modal damping (N s/m).
        k: Modal stiffness (N/m).
        m_sd: Standard error of ``m``.
        c_sd: Standard error of ``c``.
        k_sd: Standard error of ``k``.
        phase: Phase of the residue relative to that of a real mode (degrees).
        note: Warning if this phase is large; otherwise empty.
    """

    m: float
    c: float
    k: float
    m_sd: float
    c_sd: float
    k_sd: float
    phase: float
    note: str


def modal_parameters(mode: Mode, output: int = 0) -> ModalParameters:
    """Return the modal parameters of a mode in SI units; the force acts at ``output``.

    The residue of a real mode is ``1 / (2j m omega_d)`` (D. J. Ewins, 2000, chapter 2). Errors of frequency, damping
    ratio and residue are treated as independent; those of the last two are correlated, so that of c is too large.
    """
    residue, rate, ratio = complex(mode.shape[output]), 2.0 * np.pi * mode.frequency, mode.damping_ratio
    m = 1.0 / (2.0 * abs(residue) * rate * np.sqrt(1.0 - ratio**2))
    size, hertz = float(mode.shape_sd[output]) / abs(residue), mode.frequency_sd / mode.frequency
    turn = mode.damping_ratio_sd / ratio
    sds = np.hypot(size, [hertz, turn, hertz])
    phase = float(np.degrees(np.angle(1j * residue)))
    off = f"the phase of the residue differs by {phase:.0f} degrees from that of a real mode at a drive point"
    c, k = 2.0 * ratio * rate * m, rate**2 * m
    m_sd, c_sd, k_sd = (float(sd) for sd in np.array([m, c, k]) * sds)
    return ModalParameters(float(m), float(c), float(k), m_sd, c_sd, k_sd, phase, off if abs(phase) > REAL_MODE else "")


@dataclass(frozen=True)
class SpectralLikelihood(ModalIdentifier):
    """Maximum likelihood of modes on spectra of force and response, or on frequency responses."""

    version = 2
    card = ModalCard(
        summary="maximum likelihood on spectra, leakage included; number by the Bayesian information criterion",
        settings_source="none to choose",
        title="Spectra",
        order=20,
    )
    scope = (Blows, FrequencyResponses)

    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Add modes one by one; return those in the band."""
        assert isinstance(problem.data, Blows | FrequencyResponses)
        low, high = problem.band or (0.0, np.inf)
        spectra = Spectra.of(problem.data, low, high)
        if spectra.s.size < LEAST_LINES:
            return ModalEstimate((), status=Status.DIVERGED, message=f"too few lines in the band: {spectra.s.size}")
        fit, modes, decided = add_modes(SpectralFit.empty(spectra), problem)
        if not modes:
            return ModalEstimate((), status=Status.DIVERGED, message="no significant mode")
        sentences = [f"{len(modes)} mode{'s' * (len(modes) > 1)}: {decided}"]
        if fit.moving:
            sentences.append("the records do not start from rest, which the fit includes")
        for a, b in combinations(modes, 2):
            if b.frequency - a.frequency < (a.bandwidth + b.bandwidth) / 2.0:
                sentences.append(
                    f"the modes at {a.frequency:.4g} and {b.frequency:.4g} Hz are within their half-power bandwidth"
                )
        return ModalEstimate(modes, fit.degrees, message="; ".join(sentences))
