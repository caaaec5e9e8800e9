"""Forces of the online track, constant between samples, either given to the tracker or ambient."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from bench.errors import InputError
from bench.scenario.declaration import STRICT, Positive, Within

Kind = Literal["multisine", "white", "coloured", "impulses"]


@dataclass(frozen=True)
class HeldForce:
    """A force on one degree of freedom, constant over each sampling interval, with root mean square ``amplitude`` (N).

    - ``multisine``: ``tones`` sine waves of equal amplitude from ``low_hz`` to ``high_hz``, with random phases;
    - ``white``: white Gaussian noise;
    - ``coloured``: autoregressive Gaussian noise of order one with coefficient ``memory``;
    - ``impulses``: a pulse of one interval and height ``amplitude`` every ``period`` s from time 0, which gives
      repeated free decays.

    ``told``: whether the force is given to the tracker; otherwise it is ambient.
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
            raise InputError("online.force.high_hz", self.high_hz, f"must be at least low_hz ({self.low_hz:g})")

    def draw(self, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Draw the values (N) over the interval after each time, (n,)."""
        if self.kind == "white":
            return self.amplitude * rng.standard_normal(times.size)
        if self.kind == "coloured":
            from scipy.signal import lfilter  # slow to import

            noise = rng.standard_normal(times.size)
            noise[1:] *= np.sqrt(1.0 - self.memory**2)
            return np.asarray(self.amplitude * lfilter([1.0], [1.0, -self.memory], noise))
        if self.kind == "impulses":
            periods = np.floor(times / self.period + 1e-9)
            return self.amplitude * (np.diff(periods, prepend=-1.0) > 0)
        frequencies = np.linspace(self.low_hz, self.high_hz, self.tones)
        phases = rng.uniform(0.0, 2.0 * np.pi, self.tones)
        waves = np.sin(2.0 * np.pi * frequencies * times[:, None] + phases)
        return np.asarray(self.amplitude * np.sqrt(2.0 / self.tones) * waves.sum(axis=1))

    @property
    def autocorrelation(self) -> float:
        """The autocorrelation of the force at a lag of one interval, as assumed for an ambient force."""
        return self.memory if self.kind == "coloured" else 0.0

    def describe(self) -> str:
        """Describe the force in words."""
        knowledge = "known" if self.told else "unknown"
        if self.kind == "impulses":
            return f"{knowledge} impulses of {self.amplitude:g} N over one interval, every {self.period:g} s"
        bands = {"multisine": f", {self.low_hz:g} to {self.high_hz:g} Hz", "coloured": f", memory {self.memory:g}"}
        return f"{knowledge} {self.kind} force of {self.amplitude:g} N{bands.get(self.kind, '')}"
