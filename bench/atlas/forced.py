"""A test with a measured force, from rest."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import ClassVar

from bench.atlas.axes import Axis, AxisValues
from bench.atlas.point import DAMPED, DENSE, GROUPS, NOISY, SIZED, Point
from bench.scenario.force import ForceSpec, Shape
from bench.scenario.scenario import Scenario

KINDS: tuple[Shape, ...] = ("multisine", "swept_sine", "band_limited_noise", "impulse")
LONG = 0.82
"""Length of a half-sine pulse times the frequency at which its amplitude spectrum is half of that at 0: where
``cos(pi x) / (1 - 4 x²)`` is 0.5."""
FINE = 10
"""Samples of the force in a period of its highest frequency."""


@dataclass(frozen=True)
class Forced(Point):
    """A known force on an oscillator at rest.

    ``bandwidth``: highest frequency of the force over the natural frequency; of a pulse, where its spectrum has fallen
    to half. The lowest is one period in twice the record. ``force_snr_db``: mean square of the force over its sensor's
    noise; the motion follows the clean force. ``force``: its kind.
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
        """All that the test is, the kind of its force by its place."""
        *numbers, kind = astuple(self)
        return [*map(float, numbers), float(KINDS.index(kind))]

    def scenario(self) -> Scenario:
        """The force as large as moves the oscillator by its size if it were steady."""
        parameters, omega, size = self._oscillator()
        duration = 2.0 * math.pi * self.cycles / omega
        high, periods = self.bandwidth * omega / (2.0 * math.pi), self.bandwidth * self.cycles
        pulse = self.force == "impulse"
        shape = {"length_s": LONG / high} if pulse else {"low_hz": 0.5 / duration, "high_hz": high}
        force = ForceSpec(
            amplitude=parameters["k"] * size,
            kind=self.force,
            samples=math.ceil(FINE * periods) + 1,
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
        """Never: the force is sampled finely enough to tell the frequencies apart."""
        return False
