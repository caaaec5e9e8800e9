"""Forces of the online track: held from a sample to the next, told to the tracker or not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from bench.errors import InputError
from bench.scenario.declaration import STRICT, Positive, Within

Kind = Literal["multisine", "white", "coloured", "impulses"]


@dataclass(frozen=True)
class HeldForce:
    """A force on one DOF, held over each sampling interval; ``amplitude`` (N) is its root mean square, by ``kind``:

    - ``multisine``: ``tones`` sine waves of equal amplitude from ``low_hz`` to ``high_hz``, random phases;
    - ``white``: independent normal values;
    - ``coloured``: normal values that keep ``memory`` of the one before (autoregressive of order one);
    - ``impulses``: one interval of ``amplitude`` (there its size) every ``period`` s from time 0: repeated free decays.

    ``told``: whether the tracker is given it with each sample; else it is ambient.
    """

    __pydantic_config__ = STRICT
    kind: Kind = "multisine"
    amplitude: Positive = 1.0
    dof: Annotated[int, Within(ge=0)] = 0
    told: bool = True
    low_hz: Positive = 0.1
    high_hz: Positive = 1.0
    tones: Annotated[int, Within(ge=1)] = 20
    memory: Annotated[float, Within(ge=0.0, lt=1.0)] = 0.9
    period: Positive = 20.0

    def __post_init__(self) -> None:
        if self.kind == "multisine" and not self.low_hz <= self.high_hz:
            raise InputError("online.force.high_hz", self.high_hz, f"at least low_hz ({self.low_hz:g})")

    def draw(self, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Values (N) from each time on, shape of ``times``."""
        if self.kind == "white":
            return self.amplitude * rng.standard_normal(times.size)
        if self.kind == "coloured":
            from scipy.signal import lfilter  # slow to import, and few need it

            keep, given = self.memory, rng.standard_normal(times.size)
            given[1:] *= np.sqrt(1.0 - keep**2)
            return np.asarray(self.amplitude * lfilter([1.0], [1.0, -keep], given))
        if self.kind == "impulses":
            beats = np.floor(times / self.period + 1e-9)
            return self.amplitude * (np.diff(beats, prepend=-1.0) > 0)
        frequencies = np.linspace(self.low_hz, self.high_hz, self.tones)
        phases = rng.uniform(0.0, 2.0 * np.pi, self.tones)
        waves = np.sin(2.0 * np.pi * frequencies * times[:, None] + phases)
        return np.asarray(self.amplitude * np.sqrt(2.0 / self.tones) * waves.sum(axis=1))

    @property
    def kept(self) -> float:
        """What an unknown force keeps of itself over an interval."""
        return self.memory if self.kind == "coloured" else 0.0

    def describe(self) -> str:
        """In words."""
        told = "known" if self.told else "unknown"
        if self.kind == "impulses":
            return f"{told} impulses of {self.amplitude:g} N over one interval, every {self.period:g} s"
        bands = {"multisine": f", {self.low_hz:g} to {self.high_hz:g} Hz", "coloured": f", memory {self.memory:g}"}
        return f"{told} {self.kind} force of {self.amplitude:g} N{bands.get(self.kind, '')}"
