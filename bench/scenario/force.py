"""The known force of a scenario: its shape, how it is sampled, and how well it is measured."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np

from bench.contract.problem import Force, Hold
from bench.errors import InputError
from bench.scenario.declaration import STRICT, Positive, Within, changed, plain

Shape = Literal["multisine", "impulse", "step", "swept_sine", "band_limited_noise", "column"]
MIN_IN_PULSE = 5
"""Samples that a pulse must hold, to be distinguished from a spike."""


@dataclass(frozen=True)
class ForceSpec:
    """A known force on one DOF, sampled at ``samples`` uniform times over the record; between them it runs as ``hold``.

    By ``kind``, with ``amplitude`` (N) the root mean square of what goes on, the largest value of what does not:

    - ``multisine``: ``tones`` sine waves of equal amplitude from ``low_hz`` to ``high_hz``, uniform random phases;
    - ``swept_sine``: one sine wave whose frequency rises linearly from ``low_hz`` to ``high_hz`` over the record;
    - ``band_limited_noise``: Gaussian noise, flat between ``low_hz`` and ``high_hz`` and nothing outside;
    - ``impulse``: a half-sine from ``start_s`` that lasts ``length_s``, of impulse ``2 amplitude length_s / pi`` (N·s);
    - ``step``: ``amplitude`` from the first sample at or after ``start_s`` on; under ``linear`` and ``cubic`` it rises
      over the sampling step before, so ``zero_order`` is what a step wants;
    - ``column``: ``amplitude`` times the numbers in ``file``, one a line (# for comments); ``samples`` is their number.

    Random phases and noise are drawn once a scenario and seed. ``noise_db``: a method knows the samples with Gaussian
    noise at that SNR, drawn replicate by replicate, while the motion follows the clean force; the bound is then that of
    a force known exactly, hence still a bound. The force is zero after the record.
    """

    __pydantic_config__ = STRICT
    amplitude: Annotated[Positive, "N: root mean square of a continuing force, maximum of an impulse or a step"]
    low_hz: Annotated[Positive | None, "lower end of the band (Hz)"] = None
    high_hz: Annotated[Positive | None, "upper end of the band (Hz)"] = None
    tones: Annotated[int, Within(ge=1), "number of sine waves of a multisine"] = 10
    samples: Annotated[int, Within(ge=2), "number of force samples"] = 201
    hold: Annotated[Hold, "interpolation between force samples"] = "linear"
    dof: Annotated[int, Within(ge=0), "DOF on which the force acts"] = 0
    kind: Annotated[Shape, "shape of the force"] = "multisine"
    start_s: Annotated[float, Within(ge=0.0), "start of an impulse or a step (s)"] = 0.0
    length_s: Annotated[Positive | None, "length of an impulse (s)"] = None
    file: Annotated[str | None, "file of a column: one number per line"] = None
    noise_db: Annotated[float | None, "signal-to-noise ratio of the force that is given to a method (dB)"] = None

    def __post_init__(self) -> None:
        if self.kind not in SHAPES:
            raise InputError("system.force.kind", self.kind, f"one of {', '.join(SHAPES)}")
        uses = SHAPES[self.kind][1]
        for name in ("low_hz", "high_hz", "length_s", "file"):
            if (getattr(self, name) is None) == (name in uses):
                remedy = (
                    f"{self.kind} needs {' and '.join(uses)}" if name in uses else f"{self.kind} has none; leave it out"
                )
                raise InputError(f"system.force.{name}", getattr(self, name), remedy)
        if self.low_hz is not None and self.high_hz is not None and not 0 < self.low_hz <= self.high_hz:
            raise InputError("system.force.high_hz", self.high_hz, f"at least low_hz ({self.low_hz:g})")
        if self.file is not None:
            object.__setattr__(self, "samples", _read_column(self.file).size)

    def to_dict(self) -> dict[str, Any]:
        """Return what decides the force and what is known of it, as JSON holds it, without what its kind has not."""
        specific = {name for _, names in SHAPES.values() for name in names}
        other = [name for name in changed(self) if name not in specific]
        stated = plain(self, "samples", "hold", "dof", *SHAPES[self.kind][1], *other)
        if self.file is not None:  # known by its numbers, not by its place
            stated["file"] = hashlib.sha256(_read_column(self.file).tobytes()).hexdigest()
        return stated

    @property
    def band(self) -> tuple[float, float]:
        """Return the lowest and highest frequency (Hz) of a kind that has them."""
        assert self.low_hz is not None
        assert self.high_hz is not None
        return self.low_hz, self.high_hz

    def draw(self, duration: float, rng: np.random.Generator) -> Force:
        """Return the force over a record of that duration (s). Raises InputError where its samples cannot show it."""
        times = np.linspace(0.0, duration, self.samples)
        values = self.amplitude * SHAPES[self.kind][0](self, times, rng)
        return Force(times, values, self.hold, self.dof)

    def measured(self, force: Force, rng: np.random.Generator) -> Force:
        """Return the force as a method knows it: with the noise of its sensor."""
        if self.noise_db is None:
            return force
        sigma = np.sqrt(np.mean(force.values**2) / 10.0 ** (self.noise_db / 10.0))
        return replace(force, values=force.values + sigma * rng.standard_normal(force.values.size))


def _multisine(spec: ForceSpec, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    frequencies = np.linspace(*spec.band, spec.tones)
    phases = rng.uniform(0.0, 2 * np.pi, spec.tones)
    waves = np.sin(2 * np.pi * frequencies[:, None] * times + phases[:, None])
    return np.asarray(np.sqrt(2.0 / spec.tones) * waves.sum(0))


def _swept_sine(spec: ForceSpec, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The phase is the integral of the frequency: ``2 pi (low t + (high - low) t² / 2T)``."""
    low, high = spec.band
    cycles = low * times + 0.5 * (high - low) * times**2 / times[-1]
    return np.asarray(np.sqrt(2.0) * np.sin(2 * np.pi * cycles))


def _band_limited_noise(spec: ForceSpec, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Independent complex normal lines of the discrete Fourier transform inside the band, scaled to unit mean square.

    The transform's period is the record plus one sampling step, so that end and start are no neighbours.
    """
    low, high = spec.band
    lines = np.fft.rfftfreq(times.size, times[1] - times[0])
    inside = (lines >= low) & (lines <= high)
    if not np.any(inside) or high >= lines[-1]:
        remedy = f"a band below {lines[-1]:g} Hz that holds a multiple of {lines[1]:g} Hz; take more samples"
        raise InputError("system.force.high_hz", high, remedy)
    real, imaginary = rng.standard_normal((2, lines.size))
    noise = np.fft.irfft(np.where(inside, real + 1j * imaginary, 0.0), times.size)
    return np.asarray(noise / np.sqrt(np.mean(noise**2)))


def _impulse(spec: ForceSpec, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    assert spec.length_s is not None
    part = (times - spec.start_s) / spec.length_s
    inside = (part > 0) & (part < 1)
    if np.count_nonzero(inside) < MIN_IN_PULSE:
        remedy = f"the pulse must hold {MIN_IN_PULSE} samples of the force; take more samples, or a longer pulse"
        raise InputError("system.force.length_s", spec.length_s, remedy)
    return np.where(inside, np.sin(np.pi * part), 0.0)


def _step(spec: ForceSpec, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if not 0 <= spec.start_s < times[-1]:
        raise InputError("system.force.start_s", spec.start_s, "within the record")
    return np.where(times >= spec.start_s, 1.0, 0.0)


def _column(spec: ForceSpec, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    assert spec.file is not None
    return _read_column(spec.file)


def _read_column(file: str) -> np.ndarray:
    try:
        values = np.loadtxt(Path(file), ndmin=1)
    except (OSError, ValueError) as error:
        raise InputError("system.force.file", file, f"one number a line is needed: {error}") from None
    if values.ndim != 1 or values.size < 2 or not np.all(np.isfinite(values)):
        raise InputError("system.force.file", file, "one finite number a line, at least two lines")
    return values


Maker = Callable[[ForceSpec, np.ndarray, np.random.Generator], np.ndarray]
"""The force over ``amplitude`` at uniform times."""

SHAPES: dict[Shape, tuple[Maker, tuple[str, ...]]] = {
    "multisine": (_multisine, ("low_hz", "high_hz", "tones")),
    "impulse": (_impulse, ("start_s", "length_s")),
    "step": (_step, ("start_s",)),
    "swept_sine": (_swept_sine, ("low_hz", "high_hz")),
    "band_limited_noise": (_band_limited_noise, ("low_hz", "high_hz")),
    "column": (_column, ("file",)),
}
"""The function that makes each kind of force, and the settings that it uses beside the common ones."""
assert set(SHAPES) == set(get_args(Shape))
