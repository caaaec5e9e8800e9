"""Disturbances: data that break what the methods assume, where a scenario makes its replicates.

A method that is tested on data made by its own assumptions is flattered (an "inverse crime": Kaipio and Somersalo,
J. Comput. Appl. Math. 198:493, 2007). Each kind below breaks one assumption, by one size. The base noise of a
replicate, its standard deviation and the nominal values stay those of the undisturbed scenario, so disturbed and
undisturbed results are paired; what a kind draws besides comes from a stream of its own. The bound stays that of the
undisturbed scenario too: a method is compared with what would be possible without the disturbance.

No method knows of a disturbance, except that the times of ``irregular`` are stated as they are. Its bound is that of
these times.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from bench.contract.problem import Force, InitialState
from bench.errors import InputError
from bench.scenario.declaration import STRICT, changed, plain, validated
from bench.scenario.truth import integrated_response, reference_response, reference_state
from bench.systems import System


@dataclass(frozen=True)
class Disturbance:
    """The parts of the data that a kind may change; by default none. Raises InputError for a size without a meaning.

    ``allowed``: the size is above the first number and at most the second; ``meaning``: what it is. ``free``: free
    vibration only; ``one_mass``: one mass with a linear spring only.
    """

    __pydantic_config__ = STRICT
    size: float
    kind: ClassVar[str]
    allowed: ClassVar[tuple[float, float]]
    meaning: ClassVar[str]
    free: ClassVar[bool] = False
    one_mass: ClassVar[bool] = False

    def __post_init__(self) -> None:
        low, high = self.allowed
        if not low < self.size <= high:
            raise InputError("disturbance.size", self.size, f"above {low:g}, at most {high:g}: {self.meaning}")

    def to_dict(self) -> dict[str, Any]:
        """Return kind and settings, as JSON holds them."""
        return {"kind": self.kind, **plain(self, *changed(self))}

    @staticmethod
    def from_dict(stated: Mapping[str, Any]) -> Disturbance:
        """Return the disturbance of :meth:`to_dict`; raises InputError for what is unknown, missing or too large."""
        settings = dict(stated)
        kind, known = settings.pop("kind"), kinds()
        if kind not in known:
            raise InputError("disturbance.kind", kind, f"known: none, {', '.join(known)}")
        names = [field.name for field in fields(known[kind])]
        if set(settings) != set(names):
            raise InputError("disturbance", kind, f"its settings are {' and '.join(names)}, and each is needed")
        return validated(known[kind], settings, "disturbance")

    def check(self, system: System, duration: float, forced: bool) -> None:
        """Raise InputError where the disturbance does not go with a system, or with a record of that duration (s)."""
        if self.free and forced:
            raise InputError("disturbance", self.kind, "free vibration only; choose a system without a force")
        if self.one_mass and system.name != "sdof":
            remedy = "one mass with a linear spring only: system=sdof and its like"
            raise InputError("disturbance", self.kind, remedy)

    def start(self, system: System, p: Mapping[str, float], start: InitialState) -> InitialState:
        """Return the true state at time 0 of the record; ``start`` is that of the motion."""
        return start

    def response(
        self, system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
    ) -> np.ndarray:
        """Return the true displacement (m), shape (n_dof, n_times), at times of the record (s)."""
        return reference_response(system, p, start, times, forces)

    def sampling(self, times: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return stated and actual sample times (s) of one replicate, each of the shape of the uniform ``times``."""
        return times, times

    def noise(self, base: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return the noise in standard deviations, shape (n_dof, n_samples), from the standard normal base draw."""
        return base

    def reading_error(self, times: np.ndarray) -> np.ndarray:
        """Return the systematic error at the stated times, over the root mean square of the clean samples."""
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
        return integrated_response(
            system, p, start, times, forces, method="Radau", rtol=self.size, atol=0.01 * self.size
        )


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
    """Known sample times, drawn uniformly between the ends; a ``size`` below 1 mixes in the uniform grid."""

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
    """A constant, unknown offset of the sensor, ``size`` times the root mean square of the clean samples."""

    kind, allowed, meaning = "bias", (0.0, 100.0), "offset over the root mean square of the clean samples"

    def reading_error(self, times: np.ndarray) -> np.ndarray:
        return np.full_like(times, self.size)


class Drift(Disturbance):
    """A linear drift of the sensor from zero at the start to ``size`` times the root mean square at the end."""

    kind, allowed, meaning = "drift", (0.0, 100.0), "drift at the end over the root mean square of the clean samples"

    def reading_error(self, times: np.ndarray) -> np.ndarray:
        return np.asarray(self.size * times / times[-1])


class LateTrigger(Disturbance):
    """The record starts ``size`` seconds into the motion, while the known initial state is that of the motion.

    Time is that of the record, also where displacement and forecast are scored. So it matters only where the initial
    state is known: a method that estimates it finds the state at the trigger.
    """

    kind, allowed, meaning = "late_trigger", (0.0, 1e6), "seconds"
    free = True  # a force would have to be late too, and between its samples

    def check(self, system: System, duration: float, forced: bool) -> None:
        super().check(system, duration, forced)
        if self.size >= duration:
            raise InputError("disturbance.size", self.size, f"seconds, below the duration of the record ({duration:g})")

    def start(self, system: System, p: Mapping[str, float], start: InitialState) -> InitialState:
        return reference_state(system, p, start, self.size)

    def response(
        self, system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
    ) -> np.ndarray:
        return reference_response(system, p, start, times + self.size, forces)


def kinds() -> dict[str, type[Disturbance]]:
    """Return every kind by its name."""
    return {cls.kind: cls for cls in Disturbance.__subclasses__()}
