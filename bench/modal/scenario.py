"""Scenarios of the modal track: modes in a free decay or under hammer blows, and simulation of their records.

The motion is in closed form: a sum of damped waves, or the convolution of each mode with the force of a blow.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from typing import Annotated

import numpy as np

from bench.contract.modal import Blows, FreeDecays, ModalProblem
from bench.errors import InputError
from bench.scenario.declaration import STRICT, Positive, Within
from bench.scenario.stream import anonymous_stream

VERSION = 1
"""Version of the simulated records; to be raised if they change."""
WIDTH, START = 0.006, 0.05
"""Duration of a blow, and its earliest time in a record (s); it begins between this time and twice this time."""


@dataclass(frozen=True, eq=False)
class ModalTruth:
    """True modes of a replicate, which are hidden from methods.

    Attributes:
        frequencies: Natural frequencies (Hz), shape (modes,).
        damping_ratios: Damping ratios, shape (modes,).
        waves: Function of a pole that returns the complex motion of a mode of unit size, shape (records, n).
        shapes: Complex amplitudes, shape (modes, sensors); the motion of sensor c is the real part of the sum over
            modes of ``shapes[i, c] * waves(pole)``.
        sigma: Standard deviations of the noise, shape (sensors,).
    """

    frequencies: np.ndarray
    damping_ratios: np.ndarray
    waves: Callable[[complex], np.ndarray]
    shapes: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True)
class ModalScenario:
    """Scenario of the modal track.

    Real mode shapes, the phases of a free decay, and the times and peaks of blows are drawn for each replicate.

    Attributes:
        label: Name.
        frequencies: Natural frequencies (Hz).
        damping_ratios: Damping ratios.
        strengths: Amplitude of each mode of a free decay, or its modal constant under blows (1/kg, of the
            accelerance); root mean square over the sensors.
        rate: Sampling rate (Hz).
        samples: Samples of a record.
        snr_db: Signal-to-noise ratio of each sensor (dB); the noise is white.
        sensors: Number of sensors.
        blows: Number of hammer blows; 0 for a free decay.
        force_snr_db: Signal-to-noise ratio of the force (dB).
        window: Decay rate (1/s) of an exponential window on the responses.
        band: Lower and upper frequency (Hz), given to the methods.
    """

    __pydantic_config__ = STRICT
    label: str
    frequencies: tuple[Positive, ...]
    damping_ratios: tuple[Annotated[float, Within(gt=0.0, lt=1.0)], ...]
    strengths: tuple[Positive, ...]
    rate: Positive
    samples: Annotated[int, Within(ge=50, le=1_000_000)]
    snr_db: Annotated[float, Within(ge=-20, le=100)] = 30.0
    sensors: Annotated[int, Within(ge=1, le=100)] = 1
    blows: Annotated[int, Within(ge=0, le=100)] = 0
    force_snr_db: Annotated[float, Within(ge=-20, le=100)] = 20.0
    window: Annotated[float, Within(ge=0.0)] = 0.0
    band: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not len(self.frequencies) == len(self.damping_ratios) == len(self.strengths) > 0:
            raise InputError("modal.strengths", list(self.strengths), "one for each frequency and damping ratio")

    @cached_property
    def identity(self) -> str:
        """Digest of all fields that affect the data, so not of the label."""
        stated = {**asdict(self), "label": "", "version": VERSION}
        return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:16]

    def describe(self) -> str:
        """Return a sentence that describes the scenario."""
        each = zip(self.frequencies, self.damping_ratios, self.strengths, strict=True)
        modes = ", ".join(f"{hertz:g} Hz ({100 * damping:g} %, {strength:g})" for hertz, damping, strength in each)
        kind = f"{self.blows} hammer blows" if self.blows else "Free decay"
        sensors = "one sensor" if self.sensors == 1 else f"{self.sensors} sensors"
        noise = f"{self.snr_db:g} dB" + (f", force {self.force_snr_db:g} dB" if self.blows else "")
        window = f", exponential window {self.window:g}/s" if self.window else ""
        return f"{kind}: {modes}; {sensors}, {self.samples} samples at {self.rate:g} Hz, {noise}{window}."

    def draw(self, seed: int, replicate: int) -> tuple[ModalProblem, ModalTruth]:
        """Return the problem of a replicate, which is the same for every method, and the true modes."""
        rng = anonymous_stream(seed, (int(self.identity[:8], 16), replicate))
        frequencies, damping_ratios = np.array(self.frequencies), np.array(self.damping_ratios)
        times, modal_poles = np.arange(self.samples) / self.rate, poles(frequencies, damping_ratios)
        shapes = rng.standard_normal((len(modal_poles), self.sensors)).astype(complex)
        shapes *= np.array(self.strengths)[:, None] / np.sqrt(np.mean(np.abs(shapes) ** 2, axis=1, keepdims=True))
        starts, peaks = START * (1.0 + rng.uniform(size=self.blows)), rng.uniform(0.5, 1.5, self.blows)
        if self.blows:
            waves = partial(blow_waves, times, starts, peaks)
            shapes /= 1j * modal_poles.imag[:, None]
        else:
            waves = partial(free_waves, times)
            shapes *= np.exp(2j * np.pi * rng.uniform(size=(len(modal_poles), 1)))
        clean = motion(waves, modal_poles, shapes)
        sigma = noise_level(clean, self.snr_db)
        values = clean + sigma[:, None] * rng.standard_normal(clean.shape)
        truth = ModalTruth(frequencies, damping_ratios, waves, shapes, sigma)
        if not self.blows:
            constants = np.sqrt(np.mean(clean**2)) * rng.standard_normal((self.sensors, 1))
            return ModalProblem(FreeDecays(times, values[0] + constants), band=self.band), truth
        force = blow_force(times, starts, peaks)[:, None]
        forces = force + noise_level(force, self.force_snr_db) * rng.standard_normal(force.shape)
        responses = values * np.exp(-self.window * times)
        data = Blows(1.0 / self.rate, forces[:, 0], responses, "accelerance", self.window)
        return ModalProblem(data, band=self.band), truth


def poles(frequencies: np.ndarray, damping_ratios: np.ndarray) -> np.ndarray:
    """Return the poles (1/s) of modes with positive imaginary parts."""
    return np.asarray(2.0 * np.pi * frequencies * (-damping_ratios + 1j * np.sqrt(1.0 - damping_ratios**2)))


def motion(waves: Callable[[complex], np.ndarray], modal_poles: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Return the motion of the sensors without noise, shape (records, sensors, n)."""
    parts = [shape[:, None] * waves(pole)[:, None] for pole, shape in zip(modal_poles, shapes, strict=True)]
    return np.asarray(np.sum(parts, axis=0).real)


def noise_level(clean: np.ndarray, snr_db: float) -> np.ndarray:
    """Return the standard deviation (sensors,) of the noise for clean motions (records, sensors, n)."""
    return np.asarray(np.sqrt(np.mean(clean**2, axis=(0, 2)) / 10.0 ** (snr_db / 10.0)))


def free_waves(times: np.ndarray, pole: complex) -> np.ndarray:
    """Return ``exp(pole t)``, (1, n)."""
    return np.exp(pole * times)[None]


def blow_force(times: np.ndarray, starts: np.ndarray, peaks: np.ndarray) -> np.ndarray:
    """Return the force (blows, n) of each blow, a haversine pulse ``peak sin²(pi (t - start) / WIDTH)``.

    Its spectrum is zero at 2 / WIDTH (333 Hz) and each further multiple of 1 / WIDTH, and falls by 18 dB per octave.
    """
    since = times - starts[:, None]
    pulse = np.sin(np.pi * since / WIDTH) ** 2
    return np.asarray(peaks[:, None] * np.where((since > 0.0) & (since < WIDTH), pulse, 0.0))


def blow_waves(times: np.ndarray, starts: np.ndarray, peaks: np.ndarray, pole: complex) -> np.ndarray:
    """Return the second derivative (blows, n) of the convolution of ``exp(pole t)`` with the force of each blow.

    The pulse is a sum of exponentials ``w exp(r t)``, whose convolution is ``w (exp(r t) - exp(pole t)) / (r - pole)``;
    after the pulse the mode decays freely.
    """
    since = times - starts[:, None]
    inside, behind = np.clip(since, 0.0, WIDTH), np.clip(since - WIDTH, 0.0, None)
    weights, rates = (0.5, -0.25, -0.25), 2j * np.pi / WIDTH * np.array([0.0, 1.0, -1.0])
    parts = [w * (np.exp(r * inside) - np.exp(pole * inside)) / (r - pole) for w, r in zip(weights, rates, strict=True)]
    convolution = peaks[:, None] * np.sum(parts, axis=0) * np.exp(pole * behind)
    slope = np.pi / WIDTH * np.where(inside < WIDTH, np.sin(2.0 * np.pi * inside / WIDTH), 0.0)
    return np.asarray(pole**2 * convolution + pole * blow_force(times, starts, peaks) + peaks[:, None] * slope)
