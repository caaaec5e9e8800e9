"""Disturbances: data that break what the methods assume, where a scenario makes its replicates.

A method that is tested on data made by its own assumptions is flattered (an "inverse crime": Kaipio and Somersalo,
J. Comput. Appl. Math. 198:493, 2007). Each kind below breaks one assumption, by one size. The base noise of a
replicate, its standard deviation and the nominal values stay those of the undisturbed scenario, so disturbed and
undisturbed results are paired; what a kind draws besides comes from a stream of its own. The bound stays that of the
undisturbed scenario too: a method is compared with what would be possible without the disturbance.

No method is told of a disturbance, except that the times of ``irregular`` are stated as they are. Its bound is that of
these times.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, ClassVar

import numpy as np

from bench.contract.problem import Force, InitialState
from bench.errors import InputError
from bench.scenario.declaration import STRICT, changed
from bench.scenario.truth import integrated_response, reference_response, reference_state
from bench.systems import System


@dataclass(frozen=True)
class Disturbance:
    """What each kind may change; by default nothing. Raises InputError where the size makes no sense.

    ``allowed``: the size is above the first number and at most the second; ``meaning``: what it is.
    """

    __pydantic_config__ = STRICT
    size: float
    kind: ClassVar[str]
    allowed: ClassVar[tuple[float, float]]
    meaning: ClassVar[str]

    def __post_init__(self) -> None:
        low, high = self.allowed
        if not low < self.size <= high:
            raise InputError("disturbance.size", self.size, f"above {low:g}, at most {high:g}: {self.meaning}")

    def to_dict(self) -> dict[str, Any]:
        """Kind and settings, as JSON holds them."""
        return {"kind": self.kind, **changed(self)}

    @staticmethod
    def from_dict(stated: Mapping[str, Any]) -> Disturbance:
        """The disturbance of :meth:`to_dict`; raises InputError for what is unknown, missing or too large."""
        settings = dict(stated)
        return kind_of(settings.pop("kind"), settings)(**settings)

    def check(self, duration: float, forced: bool) -> None:
        """Raise InputError where the disturbance does not go with a record of that duration (s), forced or free."""

    def start(self, system: System, p: Mapping[str, float], start: InitialState) -> InitialState:
        """The true state at time 0 of the record; ``start`` is that of the motion."""
        return start

    def response(
        self, system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
    ) -> np.ndarray:
        """True displacement (m), shape (n_dof, n_times), at times of the record (s)."""
        return reference_response(system, p, start, times, forces)

    def sampling(self, times: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Stated and actual sample times (s) of one replicate, each of the shape of the uniform ``times``."""
        return times, times

    def noise(self, base: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """The noise in standard deviations, shape (n_dof, n_samples), from the standard normal base draw."""
        return base

    def reading_error(self, times: np.ndarray) -> np.ndarray:
        """Systematic error of the sensor at the stated times, over the root mean square of the clean samples."""
        return np.zeros_like(times)


class Integrator(Disturbance):
    """The truth from an implicit Runge-Kutta integrator (Radau IIA, order five) at relative tolerance ``size``.

    No method integrates by it, nor does any reference. Nothing should change: where the truth comes from does not
    matter.
    """

    kind, allowed, meaning = "integrator", (1e-13, 1e-4), "relative tolerance"

    def response(
        self, system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
    ) -> np.ndarray:
        return integrated_response(system, p, start, times, forces, "Radau", self.size, 0.01 * self.size)


class Jitter(Disturbance):
    """Actual times are off the stated ones by normal errors of standard deviation ``size`` times the sampling step.

    The first sample starts the clock, so its time is exact; samples are taken in order, and none before the start.
    """

    kind, allowed, meaning = "jitter", (0.0, 0.25), "standard deviation, as a part of the sampling step"

    def sampling(self, times: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        errors = self.size * (times[1] - times[0]) * rng.standard_normal(times.size)
        errors[0] = 0.0
        return times, np.sort(np.maximum(times + errors, 0.0))


class Irregular(Disturbance):
    """Sample times drawn uniformly over the record, ends kept, and told; ``size`` below 1 mixes in the uniform grid."""

    kind, allowed, meaning = "irregular", (0.0, 1.0), "1 for random times, towards 0 for the uniform grid"

    def sampling(self, times: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        drawn = times.copy()
        drawn[1:-1] = np.sort(rng.uniform(times[0], times[-1], times.size - 2))
        drawn = self.size * drawn + (1.0 - self.size) * times
        drawn[-1] = times[-1]
        return drawn, drawn


class Coloured(Disturbance):
    """First-order autoregressive noise of unit variance whose neighbouring samples have correlation ``size``.

    ``e_0 = z_0``, ``e_i = phi e_(i-1) + sqrt(1 - phi²) z_i`` with z the base noise: stationary from the first sample
    on (Box and Jenkins, Time Series Analysis, chapter 3).
    """

    kind, allowed, meaning = "coloured", (0.0, 0.999), "correlation of neighbouring samples"

    def noise(self, base: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        gain = np.sqrt(1.0 - self.size**2)
        # the filter's state is set so that the first value is the first base value, not gain times it
        from scipy.signal import lfilter  # a second to import, and few need it

        return np.asarray(lfilter([gain], [1.0, -self.size], base, axis=1, zi=(1.0 - gain) * base[:, :1])[0])


class HeavyTails(Disturbance):
    """Student's t noise with ``size`` degrees of freedom, scaled to unit variance: ``z / sqrt(w) sqrt((v - 2) / v)``.

    z is the base noise and w an independent chi-square over its v degrees of freedom (the definition of t); the
    variance of t is v / (v - 2).
    """

    kind, allowed, meaning = "heavy_tails", (2.0, 1e6), "degrees of freedom (two or fewer have no variance)"

    def noise(self, base: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        v = self.size
        return np.asarray(base / np.sqrt(rng.chisquare(v, base.shape) / v) * np.sqrt((v - 2.0) / v))


@dataclass(frozen=True)
class Outliers(Disturbance):
    """A ``share`` of the samples of each channel, at least one, at random places, has noise ``size`` times larger."""

    share: float
    kind, allowed, meaning = "outliers", (1.0, 1e6), "how many times larger the noise of an outlier is"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.share < 1.0:
            raise InputError("disturbance.share", self.share, "between 0 and 1: the part of the samples")

    def noise(self, base: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        count = max(1, round(self.share * base.shape[1]))
        chosen = np.argsort(rng.random(base.shape), axis=1) < count  # each row a random order of 0, 1, 2, ...
        return np.where(chosen, self.size * base, base)


class Bias(Disturbance):
    """A constant offset of the sensor, ``size`` times the root mean square of the clean samples, that is not told."""

    kind, allowed, meaning = "bias", (0.0, 100.0), "offset over the root mean square of the clean samples"

    def reading_error(self, times: np.ndarray) -> np.ndarray:
        return np.full_like(times, self.size)


class Drift(Disturbance):
    """A linear drift of the sensor from zero at the start to ``size`` times the root mean square at the end."""

    kind, allowed, meaning = "drift", (0.0, 100.0), "drift at the end over the root mean square of the clean samples"

    def reading_error(self, times: np.ndarray) -> np.ndarray:
        return np.asarray(self.size * times / times[-1])


class LateTrigger(Disturbance):
    """The record starts ``size`` seconds into the motion, while the told start is that of the motion.

    Time is that of the record, also where displacement and forecast are scored. So it matters only where the start is
    told: a method that estimates the start finds the state at the trigger.
    """

    kind, allowed, meaning = "late_trigger", (0.0, 1e6), "seconds"

    def check(self, duration: float, forced: bool) -> None:
        if self.size >= duration:
            raise InputError("disturbance.size", self.size, f"seconds, below the duration of the record ({duration:g})")
        if forced:  # the force would have to be told late too, and between its samples
            raise InputError("disturbance", self.kind, "free vibration only; choose a system without a force")

    def start(self, system: System, p: Mapping[str, float], start: InitialState) -> InitialState:
        return reference_state(system, p, start, self.size)

    def response(
        self, system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
    ) -> np.ndarray:
        return reference_response(system, p, start, times + self.size, forces)


def kinds() -> dict[str, type[Disturbance]]:
    """Every kind by its name; found, not named, so that a cell hangs on the one that it uses."""
    return {found.kind: found for found in Disturbance.__subclasses__()}


def kind_of(kind: str, settings: Mapping[str, Any]) -> type[Disturbance]:
    """Return the class of a kind; raises InputError for an unknown one, and where these are not its settings."""
    known = kinds()
    if kind not in known:
        raise InputError("disturbance.kind", kind, f"known: none, {', '.join(known)}")
    names = [field.name for field in fields(known[kind])]
    needed = [field.name for field in fields(known[kind]) if field.default is MISSING]
    if not set(needed) <= set(settings) <= set(names):
        raise InputError("disturbance", kind, f"its settings are {' and '.join(names)}, and each is needed")
    return known[kind]
