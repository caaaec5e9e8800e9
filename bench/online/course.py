"""Time-varying parameters: the course of a parameter as a factor on its value at time 0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from bench.errors import InputError
from bench.scenario.declaration import STRICT, Positive, Within

Kind = Literal["constant", "step", "ramp", "sinusoid", "random_walk"]


@dataclass(frozen=True)
class Course:
    """The factor on a parameter as a function of time, by ``kind``:

    - ``constant``: 1;
    - ``step``: 1 before ``at``, ``1 + change`` after it;
    - ``ramp``: linear from 1 at ``at`` to ``1 + change`` at ``until``;
    - ``sinusoid``: ``1 + change sin(2π periods t / T)``, with the duration T of the record;
    - ``random_walk``: the logarithm is a random walk, with standard deviation ``spread`` over the record.

    ``at`` and ``until`` are fractions of the duration.
    """

    __pydantic_config__ = STRICT
    kind: Kind = "constant"
    change: Annotated[float, Within(gt=-1.0, le=10.0)] = -0.1
    at: Annotated[float, Within(ge=0.0, le=1.0)] = 0.5
    until: Annotated[float, Within(ge=0.0, le=1.0)] = 1.0
    periods: Positive = 2.0
    spread: Positive = 0.1

    def __post_init__(self) -> None:
        if self.kind == "ramp" and not self.at < self.until:
            raise InputError("system.varying.until", self.until, f"must be greater than at ({self.at:g})")

    def factors(self, samples: int, rng: np.random.Generator) -> np.ndarray:
        """Return the factor over the interval after each sample, (samples,)."""
        part = np.arange(samples) / max(samples - 1, 1)
        if self.kind == "step":
            return np.where(part >= self.at, 1.0 + self.change, 1.0)
        if self.kind == "ramp":
            return 1.0 + self.change * np.clip((part - self.at) / (self.until - self.at), 0.0, 1.0)
        if self.kind == "sinusoid":
            return np.asarray(1.0 + self.change * np.sin(2.0 * np.pi * self.periods * part))
        if self.kind == "random_walk":
            steps = rng.standard_normal(samples) * self.spread / np.sqrt(max(samples - 1, 1))
            return np.asarray(np.exp(np.cumsum(steps) - steps[0]))
        return np.ones(samples)

    def increment_variances(self, samples: int) -> np.ndarray:
        """Return the mean-square increments of the log-factor from each sample to the next, (samples,); the last is 0.

        They are the process noise of the random walk in the bound. That of a step is concentrated at the step; that of
        a ramp is constant during the ramp; that of a sinusoid is constant, with the mean square of its increments.
        """
        variances = np.zeros(samples)
        if self.kind == "random_walk":
            variances[:-1] = self.spread**2 / max(samples - 1, 1)
        elif self.kind != "constant":
            squares = np.diff(np.log(self.factors(samples, np.random.default_rng(0)))) ** 2
            moving = np.ones(samples - 1, bool) if self.kind == "sinusoid" else squares > 0
            variances[:-1][moving] = np.mean(squares[moving]) if np.any(moving) else 0.0
        return variances

    @property
    def is_step(self) -> bool:
        """True if the factor changes by one step within the record, so that a delay of its detection is defined."""
        return self.kind == "step" and self.change != 0 and 0 < self.at < 1

    def describe(self) -> str:
        """Describe the course in words."""
        if self.kind == "step":
            return f"a step of {self.change:+.0%} at {self.at:.0%} of the record"
        if self.kind == "ramp":
            return f"a ramp of {self.change:+.0%} from {self.at:.0%} to {self.until:.0%} of the record"
        if self.kind == "sinusoid":
            return f"a sinusoid of {self.change:.0%}, {self.periods:g} periods"
        return f"a random walk of {self.spread:.0%} over the record" if self.kind == "random_walk" else "constant"
