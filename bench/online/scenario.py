"""A scenario of the online track: a system with time-varying parameters, forces and sensors, and its streams."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from bench.contract.online import Layout, Sample, Sensor
from bench.errors import InputError
from bench.online.course import Course
from bench.online.forces import HeldForce
from bench.online.motion import simulate_motion
from bench.scenario.declaration import STRICT, Positive, Within
from bench.scenario.stream import anonymous_stream
from bench.systems import System, make_system

FORCES, NOISE, WALK = range(3)
"""Keys of the random generators."""


@dataclass(frozen=True, eq=False)
class OnlineTruth:
    """True values of a stream, for scoring; not given to any method.

    ``parameters``: values over the interval after each sample, by name, each (n,); ``motion``: states (n, n_motion);
    ``known`` (n, n_forced) and ``ambient`` (n, n_ambient): known and ambient forces, N; ``clean``: noise-free samples
    (n, n_sensors); ``sigma``: standard deviations of the noise (n_sensors,).
    """

    parameters: Mapping[str, np.ndarray]
    motion: np.ndarray
    known: np.ndarray
    ambient: np.ndarray
    clean: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True, eq=False)
class Stream:
    """One replicate: times (s), (n,), values (n, n_sensors), and the true values."""

    layout: Layout
    times: np.ndarray
    values: np.ndarray
    truth: OnlineTruth

    def samples(self) -> list[Sample]:
        """Return the samples as they are given to a tracker."""
        rows = zip(self.times.tolist(), self.values.tolist(), self.truth.known.tolist(), strict=True)
        return [Sample(t, tuple(y), tuple(f)) for t, y, f in rows]


@dataclass(frozen=True)
class OnlineScenario:
    """A system with time-varying parameters, sampled at ``rate`` (1/s).

    ``parameters``: values at time 0; ``varying``: courses of the time-varying ones; ``initial``: displacements and
    velocities at time 0, unknown to trackers; ``forces``: constant over sampling intervals; ``sensors``: measured
    degrees of freedom (None for all); ``snr_db``: mean square of the noise-free samples over the variance of the noise,
    for each sensor.
    """

    __pydantic_config__ = STRICT
    label: str
    system: str
    parameters: Mapping[str, Positive]
    rate: Positive
    samples: Annotated[int, Within(ge=50, le=1_000_000)]
    snr_db: Annotated[float, Within(ge=-20, le=100)] = 20.0
    forces: tuple[HeldForce, ...] = ()
    varying: Mapping[str, Course] = field(default_factory=dict)
    initial: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    sensors: tuple[int, ...] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        system = self.make_system()
        if set(self.parameters) != set(system.names):
            raise InputError("system.parameters", sorted(self.parameters), f"required: {', '.join(system.names)}")
        for name in self.varying:
            if name not in system.names:
                known = ", ".join(system.names)
                raise InputError(f"system.varying.{name}", self.varying[name].kind, f"parameters: {known}")
        if self.initial is None and not self.forces:
            raise InputError("online.forces", "none", "give a force, or initial conditions other than rest (initial)")
        self.layout()

    def make_system(self) -> System:
        return make_system(self.system, self.options)

    def layout(self) -> Layout:
        """Return the information that is given to a tracker."""
        system = self.make_system()
        dofs = tuple(range(system.n_dof)) if self.sensors is None else self.sensors
        known, ambient = (tuple(f.dof for f in self.forces if f.told is told) for told in (True, False))
        return Layout(system, tuple(Sensor(dof=dof) for dof in dofs), 1.0 / self.rate, known, ambient)

    @cached_property
    def identity(self) -> str:
        """Digest of everything that determines the data; the label has no influence."""
        stated = {name: value for name, value in asdict(self).items() if name != "label"}
        return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def times(self) -> np.ndarray:
        """Times of the samples (s), (samples,)."""
        return np.arange(self.samples) / self.rate

    @property
    def constant(self) -> bool:
        """True if no parameter varies."""
        return all(course.kind == "constant" for course in self.varying.values())

    @property
    def change_at(self) -> int | None:
        """The first sample after a step common to all courses that are not constant; None if there is no such step."""
        courses = [course for course in self.varying.values() if course.kind != "constant"]
        instants = {course.at for course in courses}
        if len(instants) != 1 or not all(course.is_step for course in courses):
            return None
        return int(np.ceil(instants.pop() * (self.samples - 1)))

    def increment_variances(self) -> np.ndarray:
        """Return the process noise of the log-parameters in the bound, (samples, n_parameters)."""
        constant = Course()
        courses = [self.varying.get(name, constant) for name in self.make_system().names]
        return np.stack([course.increment_variances(self.samples) for course in courses], axis=1)

    def describe(self) -> str:
        """Describe the scenario in one sentence."""
        values = ", ".join(f"{name} {value:g}" for name, value in self.parameters.items())
        forces = "; ".join(force.describe() for force in self.forces) or "no force"
        changes = "; ".join(f"{name}: {course.describe()}" for name, course in self.varying.items())
        length = f"{self.samples} samples at {self.rate:g} Hz, {self.snr_db:g} dB"
        return f"`{self.system}` with {values}; {forces}; {length}; {changes or 'no parameter changes'}."

    def stream(self, seed: int, replicate: int) -> Stream:
        """Return a replicate, which is the same for all trackers."""
        system, layout, times = self.make_system(), self.layout(), self.times
        walk = self._rng(WALK, seed, replicate)
        parameters = {
            name: self.parameters[name] * self.varying.get(name, Course()).factors(self.samples, walk)
            for name in system.names
        }
        rng = self._rng(FORCES, seed, replicate)
        drawn = [force.draw(times, rng) for force in self.forces]
        known = _columns([f for f, force in zip(drawn, self.forces, strict=True) if force.told], times.size)
        ambient = _columns([f for f, force in zip(drawn, self.forces, strict=True) if not force.told], times.size)
        total = np.zeros((times.size, system.n_dof))
        for values, force in zip(drawn, self.forces, strict=True):
            total[:, force.dof] += values
        start = np.zeros(2 * system.n_dof + system.n_hidden)
        if self.initial is not None:
            start[: 2 * system.n_dof] = np.concatenate(self.initial)
        motion = simulate_motion(system, parameters, start, total, 1.0 / self.rate)
        clean = motion[:, [sensor.dof for sensor in layout.sensors]]
        sigma = np.sqrt(np.mean(clean**2, axis=0) / 10.0 ** (self.snr_db / 10.0))
        values = clean + sigma * self._rng(NOISE, seed, replicate).standard_normal(clean.shape)
        return Stream(layout, times, values, OnlineTruth(parameters, motion, known, ambient, clean, sigma))

    def _rng(self, axis: int, seed: int, replicate: int) -> np.random.Generator:
        key = (axis, int(self.identity[:8], 16), replicate)
        return anonymous_stream(seed, key)


def _columns(columns: list[np.ndarray], n: int) -> np.ndarray:
    return np.stack(columns, axis=1) if columns else np.zeros((n, 0))
