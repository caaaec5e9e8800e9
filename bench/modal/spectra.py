"""Modes of blows and frequency responses: maximum likelihood on the lines of their spectra.

The response per unit of force is ``s^d (sum_m R_m / (s - p_m) + conjugates + residual terms)``, d = 0, 1, 2 for
receptance, mobility and accelerance; the residual terms, of the powers -2 to 1 of s, stand for modes outside of the
band (D. J. Ewins, Modal Testing, 2nd ed., 2000, chapter 4). Poles are common; residues and all other factors are
linear, and are eliminated by variable projection (G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973; Jacobian
of L. Kaufman, BIT 15:49, 1975).

A record ends before its motion does, so that its spectrum leaks. The leakage has the same poles (R. Pintelon, J.
Schoukens, System Identification, 2nd ed., 2012, section 6.3): the free motion after the end is taken off, which is
exact for a force that is in the band of the sampling and over within the record. Where the motion does not start from
rest, a free motion of each record is unknown as well; the Bayesian information criterion decides.

Each blow has factors of its own. What noise does to the force within the pulse is smooth over the lines of a mode: it
scales the motion of a blow as a whole, and does not touch the poles. Outside of the pulse the force is zero. So the
force's noise biases no pole, and enters the standard errors of the residues, which are means over the blows. The noise
of a shaker's force counts as nought; it lowers residues by its share in the force's mean square.

The noise of a response has a variance that is smooth over frequency, estimated from the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import fftconvolve

from bench.contract.estimate import Status
from bench.contract.modal import (
    DERIVATIVES,
    MOST_MODES,
    Blows,
    FrequencyResponses,
    ModalCard,
    ModalEstimate,
    ModalIdentifier,
    ModalProblem,
    Mode,
)
from bench.likelihood.least_squares import Linearisation, minimise
from bench.modal.blows import force_windowed, touched

FIRST, ITERATIONS = 5, 60
"""Trial steps of a search from every start, and from the best of them."""
ROUNDING = 1e-7
"""Least noise, over the size of an output: less is rounding of the numbers."""
POWERS = np.arange(-2, 2)
"""Of s in the residual terms: mass and stiffness lines, and what damping adds to them."""
COLOUR = 3
"""Degree of the logarithm of a noise's variance as a polynomial of the logarithm of frequency."""
NEIGHBOURS = 5
"""Lines over which given variances are averaged: those of few records scatter."""
LEAST_LINES = 16
"""In the band."""
DECAYS = 8
"""Decay rates of the search for a further mode, in equal ratios."""
REAL_MODE = 10.0
"""Degrees by which the residue of a mode may differ from that of a real mode before this is said."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Spectra of responses ``values`` (blocks, outputs, lines) and forces (blocks, lines) at ``s`` (lines,).

    ``order``: how often the displacement is differentiated; ``pulses`` (blocks, n): the forces at times ``left`` (n,)
    before the end of the record, sampled at ``step``; none of frequency responses; ``force_noise``: standard
    deviation of the samples of the force within the pulses, zero is taken outside; ``variances`` (outputs, lines):
    relative, where they are given.
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
        """Take the lines between two frequencies (Hz), but not that of 0 Hz."""
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
        """Return variances (blocks, m) of the relative error of the forces' spectra, in phase, at ``rates`` (m,)."""
        waves = np.exp(1j * rates[:, None] * self.left)
        relative = waves / (self.pulses @ waves.T)[..., None]
        return np.asarray(self.force_noise**2 * np.sum((self.pulses != 0.0)[:, None] * relative.real**2, axis=-1))

    def free(self, poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return spectra (m, lines) of sampled free motions ``exp(pole t)`` without end, and their slopes by pole."""
        ratio = np.exp((poles[:, None] - self.s) * self.step)
        return self.step / (1.0 - ratio), self.step**2 * ratio / (1.0 - ratio) ** 2

    def forced(self, poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return spectra (blocks, m, lines) of motions from rest with residue 1, and their slopes by pole.

        The motion after the end of the record, free from ``x(T) = sum f(t) exp(pole (T - t)) step``, is taken off.
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
    """Return what unit real and unit imaginary factors of conjugate functions (..., m, lines) add."""
    return np.concatenate([plus + minus, 1j * (plus - minus)], axis=-2)


def stacked(values: np.ndarray) -> np.ndarray:
    """Return real and imaginary parts of (..., lines) one behind the other."""
    return np.concatenate([values.real, values.imag], axis=-1)


@dataclass(frozen=True, eq=False)
class SpectralFit:
    """Modes of ``poles`` (m,) beside spectra, with the other factors of least squares.

    The mean square of the complex error is ``colour`` (1 or outputs, lines) times ``level`` (outputs,); ``moving``:
    records do not start from rest.
    """

    spectra: Spectra
    colour: np.ndarray
    level: np.ndarray
    poles: np.ndarray
    moving: bool = False

    @staticmethod
    def empty(spectra: Spectra) -> SpectralFit:
        """Return the fit of the residual terms alone."""
        outputs, lines = spectra.values.shape[1:]
        return SpectralFit(spectra, np.ones((1, lines)), np.ones(outputs), np.zeros(0, complex)).with_noise()

    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (blocks, outputs or 1, k, lines) with white noise of ``level``: (blocks, outputs, 2 lines, k)."""
        return np.swapaxes(stacked(rows * np.sqrt(2.0 / self.colour)[:, None]), -1, -2)

    @cached_property
    def functions(self) -> tuple[np.ndarray, np.ndarray]:
        """Functions with poles and conjugate poles (2, blocks, families m, lines), and their slopes by pole.

        One family are motions from rest; the other, where ``moving``, free motions.
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

    @cached_property
    def basis(self) -> np.ndarray:
        """All functions (blocks, k, lines): those with poles, the residual terms, and smooth leakage where moving."""
        s, forces = self.spectra.s, self.spectra.forces
        relative = s / np.mean(np.abs(s))
        smooth = [forces * s**self.spectra.order * relative**power for power in POWERS]
        if self.moving:
            smooth += [np.broadcast_to(relative**power, forces.shape) for power in (0, 1)]
        return np.concatenate([pairs(*self.functions[0]), np.stack(smooth, axis=1)], axis=1)

    @cached_property
    def projection(self) -> tuple[np.ndarray, np.ndarray]:
        """Orthonormal columns and triangle of the whitened basis, of each block and colour."""
        q, r = np.linalg.qr(self.whitened(self.basis[:, None]))
        return q, r

    @cached_property
    def factors(self) -> np.ndarray:
        """Of the basis, real: (blocks, outputs, k)."""
        q, r = self.projection
        data = np.swapaxes(q, -1, -2) @ self.whitened(self.spectra.values[:, :, None])
        return np.asarray((np.linalg.pinv(r) @ data)[..., 0])

    @property
    def residues(self) -> np.ndarray:
        """Complex factors of the functions with poles (blocks, outputs, families m), those of the modes first."""
        size = self.functions[0].shape[2]
        return np.asarray(self.factors[..., :size] + 1j * self.factors[..., size : 2 * size])

    @cached_property
    def residuals(self) -> np.ndarray:
        """Shape (blocks, outputs, lines)."""
        return np.asarray(self.spectra.values - self.factors @ self.basis)

    @property
    def slopes(self) -> np.ndarray:
        """Whitened derivatives (blocks, outputs, 2 lines, 2 m) by real and imaginary parts of the poles."""
        factors = np.stack([self.residues, self.residues.conj()])
        by_pole = factors[..., None] * self.functions[1][:, :, None]
        families = by_pole.reshape(*by_pole.shape[:3], -1, self.poles.size, by_pole.shape[-1])
        return self.whitened(pairs(*np.sum(families, axis=3)))

    @property
    def unknowns(self) -> int:
        blocks, outputs, _ = self.spectra.values.shape
        return 2 * self.poles.size + blocks * outputs * self.basis.shape[1]

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the residuals of an output."""
        blocks, outputs, lines = self.spectra.values.shape
        return max(2.0 * blocks * lines - self.unknowns / outputs, 1.0)

    @property
    def criterion(self) -> float:
        """The Bayesian information criterion with the best noise of these residuals."""
        blocks, outputs, lines = self.spectra.values.shape
        count, fit = 2 * blocks * lines, self.with_noise()
        logarithms = np.sum(np.log(fit.colour)) * outputs / len(fit.colour) + lines * np.sum(np.log(fit.level))
        return float(
            2 * blocks * logarithms + count * outputs * np.log(self.degrees / count) + self.unknowns * np.log(count)
        )

    def with_noise(self) -> SpectralFit:
        """Return the fit with noise as the residuals have it: of a smooth colour for all outputs, or the given ones.

        The logarithm of residuals' squares is a robust measure of the colour: the few lines of a mode that is still
        missing hardly count.
        """
        spectra, blocks = self.spectra, len(self.spectra.values)
        floor = ROUNDING**2 * np.mean(np.abs(spectra.values) ** 2, axis=(0, 2))[:, None] + 1e-300
        squares = np.mean(np.abs(self.residuals) ** 2, axis=0) + floor
        colour = spectra.variances
        if colour is None:
            x = np.log(np.abs(spectra.s))
            powers = np.vander((x - np.mean(x)) / (np.ptp(x) or 1.0), COLOUR + 1)
            colour = np.exp(powers @ np.linalg.lstsq(powers, np.mean(np.log(squares), axis=0))[0])[None]
        return replace(self, colour=colour, level=2.0 * blocks * np.sum(squares / colour, axis=1) / self.degrees)

    def refined(self, iterations: int = ITERATIONS) -> SpectralFit:
        """Return the fit of all poles, searched for from these, with the noise as it is."""
        m, omega = self.poles.size, np.abs(self.spectra.s)
        low, high = 0.5 * omega[0], omega[-1] + 0.1 * (omega[-1] - omega[0])

        def evaluate(_: np.ndarray, unknowns: np.ndarray) -> Linearisation:
            real, imaginary = unknowns[0, :m], np.clip(unknowns[0, m:], low, high)
            real = np.clip(real, -high, -ROUNDING * imaginary)
            fit = replace(self, poles=real + 1j * imaginary)
            q, slopes = fit.projection[0], fit.slopes
            left = fit.whitened(fit.residuals[:, :, None])
            slopes = q @ (np.swapaxes(q, -1, -2) @ slopes) - slopes
            left, slopes = (part / np.sqrt(self.level)[:, None, None] for part in (left, slopes))
            x = np.concatenate([real, imaginary])[None]
            return Linearisation.of(x, left.reshape(1, -1), slopes.reshape(1, -1, 2 * m))

        start = evaluate(np.zeros(1), np.concatenate([self.poles.real, self.poles.imag])[None])
        x = minimise(evaluate, start, iterations).at.unknowns[0]
        return replace(self, poles=x[:m] + 1j * x[m:])

    def settled(self) -> SpectralFit:
        """Return the fit with noise and poles to each other's liking."""
        fit = self.refined()
        for _ in range(2):
            fit = fit.with_noise().refined()
        return fit

    def longer(self) -> SpectralFit:
        """Return the best fit with one more mode: from the largest in the residuals, and from each split in two.

        A mode that is still missing may pass for coloured noise, so white noise is tried as well. Blows may start from
        rest or not.
        """
        level = np.mean(np.abs(self.residuals) ** 2, axis=(0, 2))
        white = replace(self, colour=np.ones_like(self.colour[:1]), level=level)
        starts = [replace(fit, poles=np.append(self.poles, fit.largest())) for fit in (white, self)]
        for i, pole in enumerate(self.poles):
            apart = 1j * max(-pole.real, np.ptp(np.abs(self.spectra.s)) / self.spectra.s.size)
            starts.append(replace(white, poles=np.append(np.delete(self.poles, i), [pole - apart, pole + apart])))
        best = min((start.refined(FIRST) for start in starts), key=lambda fit: fit.criterion).settled()
        if self.spectra.pulses.shape[1] == 0:
            return best
        other = replace(best, moving=not best.moving).refined(FIRST)
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

    def modes(self) -> tuple[Mode, ...]:
        """Return the modes in order of frequency, with standard errors from the Fisher information.

        A residue is a mean over the blows with the weights of least variance; the force of a blow has an error of its
        own, which is one factor for all lines of a mode.
        """
        m, spectra = self.poles.size, self.spectra
        (q, r), slopes, size = self.projection, self.slopes, self.functions[0].shape[2]
        along = np.swapaxes(q, -1, -2) @ slopes
        across = ((slopes - q @ along) / np.sqrt(self.level)[:, None, None]).reshape(-1, 2 * m)
        covariance = np.linalg.pinv(across.T @ across, hermitian=True)
        inverse = np.linalg.pinv(r)
        places = np.array([np.arange(m), size + np.arange(m)])
        own = np.mean(np.sum(inverse**2, axis=-1)[..., places], axis=-2) * self.level[:, None]
        by_pole = (inverse @ along)[..., places, :]
        residues = self.residues[..., :m]
        force_part = spectra.force_errors(self.poles.imag)
        first = np.sum(residues / own, axis=0) / np.sum(1.0 / own, axis=0)
        blow = own + np.abs(first) ** 2 * force_part[:, None]
        weights = 1.0 / blow / np.sum(1.0 / blow, axis=0)
        shapes = np.sum(weights * residues, axis=0)
        mean_by_pole = np.sum(weights[:, :, None, :, None] * by_pole, axis=0)
        by_poles = np.einsum("ocmi,ij,ocmj->om", mean_by_pole, covariance, mean_by_pole) / 2.0
        shape_sd = np.sqrt(np.sum(weights**2 * blow, axis=0) + by_poles)
        whole = np.linalg.norm(spectra.values) or 1.0
        modes = []
        for i, pole in enumerate(self.poles):
            motion = residues[..., i, None] * self.functions[0][0][:, None, i]
            motion = motion + residues[..., i, None].conj() * self.functions[0][1][:, None, i]
            share = float(np.linalg.norm(motion) / whole)
            pair = np.ix_([i, m + i], [i, m + i])
            modes.append(Mode.of_pole(pole, covariance[pair], shapes[:, i], shape_sd[:, i], share))
        return tuple(sorted(modes, key=lambda mode: mode.frequency))


@dataclass(frozen=True)
class ModalParameters:
    """Modal mass (kg), damping (N s/m) and stiffness (N/m) at a drive point, with standard errors.

    ``phase``: degrees between the residue and that of a real mode; ``note``: what is doubtful, empty if nothing is.
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
    """Return m, c, k of a mode whose force acts where ``output`` is measured, in N and SI units.

    A real mode has the residue ``1 / (2j m omega_d)`` (D. J. Ewins, 2000, chapter 2). Errors of frequency, damping
    ratio and residue are taken as independent; those of the last two agree in sign, so that of c is too large.
    """
    residue, rate, ratio = complex(mode.shape[output]), 2.0 * np.pi * mode.frequency, mode.damping_ratio
    m = 1.0 / (2.0 * abs(residue) * rate * np.sqrt(1.0 - ratio**2))
    size, hertz = float(mode.shape_sd[output]) / abs(residue), mode.frequency_sd / mode.frequency
    turn = mode.damping_ratio_sd / ratio
    sds = np.hypot(size, [hertz, turn, hertz])
    phase = float(np.degrees(np.angle(1j * residue)))
    off = f"the residue is {phase:.0f} degrees off that of a real mode at a drive point"
    c, k = 2.0 * ratio * rate * m, rate**2 * m
    m_sd, c_sd, k_sd = (float(sd) for sd in np.array([m, c, k]) * sds)
    return ModalParameters(float(m), float(c), float(k), m_sd, c_sd, k_sd, phase, off if abs(phase) > REAL_MODE else "")


@dataclass(frozen=True)
class SpectralLikelihood(ModalIdentifier):
    """Maximum likelihood of modes on spectra of force and response, or on frequency responses."""

    card = ModalCard(
        summary="maximum likelihood on spectra, leakage included; number by the Bayesian information criterion",
        settings_source="none to choose",
        title="Spectra",
        order=20,
    )
    serves = (Blows, FrequencyResponses)

    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Fit one mode, two and so on; answer those in the band."""
        assert isinstance(problem.data, Blows | FrequencyResponses)
        low, high = problem.band or (0.0, np.inf)
        spectra = Spectra.of(problem.data, low, high)
        if spectra.s.size < LEAST_LINES:
            return ModalEstimate((), status=Status.DIVERGED, message=f"{spectra.s.size} lines in the band are too few")
        fit, decided = SpectralFit.empty(spectra), "; no more can be told apart"
        modes: tuple[Mode, ...] = ()
        while len(modes) < (problem.count or MOST_MODES) and fit.poles.size < MOST_MODES and fit.degrees > LEAST_LINES:
            longer = fit.longer()
            gain = fit.criterion - longer.criterion
            if problem.count is None and gain <= 0:
                decided = f": a further one would raise the Bayesian information criterion by {-gain:.2g}"
                break
            fit = longer
            modes = tuple(mode for mode in fit.modes() if low <= mode.frequency <= high)
        if not modes:
            return ModalEstimate((), status=Status.DIVERGED, message="no mode there")
        sentences = [f"{len(modes)} modes{decided}" if problem.count is None else f"{len(modes)} modes as asked"]
        if fit.moving:
            sentences.append("the records do not start from rest, which is allowed for")
        for a, b in combinations(modes, 2):
            if b.frequency - a.frequency < (a.bandwidth + b.bandwidth) / 2.0:
                sentences.append(
                    f"{a.frequency:.4g} and {b.frequency:.4g} Hz are close: within their half-power bandwidth"
                )
        return ModalEstimate(modes, fit.degrees, message="; ".join(sentences))
