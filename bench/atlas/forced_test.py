"""A test with a measured force that acts on an oscillator at rest."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import ClassVar

from bench.atlas.axes import Axis, AxisValues
from bench.atlas.point import DAMPED, DENSE, GROUPS, NOISY, SIZED, Point
from bench.scenario.force import ForceSpec, Shape
from bench.scenario.scenario import Scenario

KINDS: tuple[Shape, ...] = ("multisine", "swept_sine", "band_limited_noise", "impulse")
PULSE_LENGTH = 0.82
"""Duration of a half-sine pulse times the frequency at which its amplitude spectrum is half of that at 0: the solution
x of ``cos(pi x) / (1 - 4 x²) = 0.5``."""
SAMPLES_PER_PERIOD = 10
"""Samples of the force per period of its highest frequency."""


@dataclass(frozen=True)
class Forced(Point):
    """A measured force on an oscillator at rest.

    ``bandwidth``: highest frequency of the force over the natural frequency; for an impulse, the frequency at which the
    spectrum has fallen to half. The lowest frequency is one period per twice the record. ``force_snr_db``: mean square
    of the force over the variance of its sensor noise; the motion is the response to the noise-free force. ``force``:
    kind of force.
    """

    bandwidth: float
    force_snr_db: float
    force: Shape

    AXES: ClassVar[tuple[Axis, ...]] = (
        SIZED, Axis("cycles", 2.0, 50.0, "logarithmic"), DAMPED, NOISY,
        Axis("bandwidth", 0.5, 4.0, "logarithmic"), Axis("force_snr_db", 10.0, 70.0),
    )  # fmt: skip
    CHOICE: ClassVar[AxisValues] = AxisValues("force", KINDS)
    QUANTITIES: ClassVar[tuple[str, ...]] = (*GROUPS, "m")

    def numbers(self) -> list[float]:
        """Return the test as numbers; the kind of force is its index in :data:`KINDS`."""
        *numbers, kind = astuple(self)
        return [*map(float, numbers), float(KINDS.index(kind))]

    def scenario(self) -> Scenario:
        """Return the scenario; the amplitude of the force is the static force for the oscillator's displacement."""
        parameters, omega, size = self._oscillator()
        duration = 2.0 * math.pi * self.cycles / omega
        high, periods = self.bandwidth * omega / (2.0 * math.pi), self.bandwidth * self.cycles
        pulse = self.force == "impulse"
        shape = {"length_s": PULSE_LENGTH / high} if pulse else {"low_hz": 0.5 / duration, "high_hz": high}
        force = ForceSpec(
            amplitude=parameters["k"] * size,
            kind=self.force,
            samples=math.ceil(SAMPLES_PER_PERIOD * periods) + 1,
            noise_db=self.force_snr_db,
            **shape,  # type: ignore[arg-type]
        )
        return Scenario(
            "sdof",
            parameters,
            ((0.0,), (0.0,)),
            self.snr_db,
            duration=float(duration),
            samples=self.samples,
            initial_state="known",
            force=force,
            dense=DENSE,
        )

    @property
    def aliased(self) -> bool:
        """Always False: the known force distinguishes frequencies beyond half the sampling rate."""
        return False
