"""A scenario of the online track: a system whose parameters change, its forces, its sensors; it makes the streams."""

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
from bench.online.motion import held_motion
from bench.scenario.declaration import STRICT, Positive, Within
from bench.scenario.stream import anonymous_stream
from bench.systems import System, make_system

FORCES, NOISE, WALK = range(3)
"""What a random stream is for."""


@dataclass(frozen=True, eq=False)
class OnlineTruth:
    """What scores a tracker; no method receives it.

    ``parameters`` by name, each of shape (n,): held over the interval that begins at a sample. ``motion``
    (n, n_motion), ``told`` (n, n_forced) and ``ambient`` (n, n_ambient) in N, ``clean`` (n, n_sensors), ``sigma``
    (n_sensors,).
    """

    parameters: Mapping[str, np.ndarray]
    motion: np.ndarray
    told: np.ndarray
    ambient: np.ndarray
    clean: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True, eq=False)
class Stream:
    """One replicate: times (s), values (n, n_sensors), and the truth."""

    layout: Layout
    times: np.ndarray
    values: np.ndarray
    truth: OnlineTruth

    def samples(self) -> list[Sample]:
        """What a tracker is given, one by one."""
        told = self.truth.told.tolist()
        rows = zip(self.times.tolist(), self.values.tolist(), told, strict=True)
        return [Sample(t, tuple(y), tuple(f)) for t, y, f in rows]


@dataclass(frozen=True)
class OnlineScenario:
    """A system with ``parameters`` at time 0, of which ``varying`` change, sampled ``rate`` times a second.

    ``initial``: displacements and velocities at time 0, which no tracker is told. ``forces`` are held over intervals.
    ``sensors``: displacements of these DOFs (None: of all). Noise at ``snr_db``, sensor by sensor: mean square of the
    clean samples over its variance.
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
            raise InputError("system.parameters", sorted(self.parameters), f"needed: {', '.join(system.names)}")
        for name in self.varying:
            if name not in system.names:
                raise InputError(f"system.varying.{name}", self.varying[name].kind, f"one of {', '.join(system.names)}")
        if self.initial is None and not self.forces:
            raise InputError("online.forces", "none", "a force, or a start away from rest (initial)")
        self.layout()

    def make_system(self) -> System:
        return make_system(self.system, self.options)

    def layout(self) -> Layout:
        """What a tracker is told."""
        system = self.make_system()
        dofs = tuple(range(system.n_dof)) if self.sensors is None else self.sensors
        told, ambient = (tuple(f.dof for f in self.forces if f.told is of) for of in (True, False))
        return Layout(system, tuple(Sensor(dof=dof) for dof in dofs), 1.0 / self.rate, told, ambient)

    @cached_property
    def identity(self) -> str:
        """A digest of what decides the data; the label has no part in it."""
        stated = {name: value for name, value in asdict(self).items() if name != "label"}
        return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def times(self) -> np.ndarray:
        """Of the samples (s), shape (samples,)."""
        return np.arange(self.samples) / self.rate

    @property
    def constant(self) -> bool:
        """Whether no parameter changes."""
        return all(course.kind == "constant" for course in self.varying.values())

    @property
    def change_at(self) -> int | None:
        """The first sample behind a step, where every course that is not constant steps there."""
        places = {course.at for course in self.varying.values() if course.kind != "constant"}
        settled = all(course.settled for course in self.varying.values() if course.kind != "constant")
        if len(places) != 1 or not settled:
            return None
        return int(np.ceil(places.pop() * (self.samples - 1)))

    def increment_variances(self) -> np.ndarray:
        """Process noise of the log-parameters that the bound is stated for, shape (samples, n_parameters)."""
        nothing = Course()
        courses = [self.varying.get(name, nothing) for name in self.make_system().names]
        return np.stack([course.increment_variances(self.samples) for course in courses], axis=1)

    def describe(self) -> str:
        """The scenario in a sentence."""
        values = ", ".join(f"{name} {value:g}" for name, value in self.parameters.items())
        forces = "; ".join(force.describe() for force in self.forces) or "no force"
        changes = "; ".join(f"{name}: {course.describe()}" for name, course in self.varying.items())
        length = f"{self.samples} samples at {self.rate:g} Hz, {self.snr_db:g} dB"
        return f"`{self.system}` with {values}; {forces}; {length}; {changes or 'no parameter changes'}."

    def stream(self, seed: int, replicate: int) -> Stream:
        """A replicate: the same for every tracker."""
        system, layout, times = self.make_system(), self.layout(), self.times
        walk = self._rng(WALK, seed, replicate)
        parameters = {
            name: self.parameters[name] * self.varying.get(name, Course()).factors(self.samples, walk)
            for name in system.names
        }
        rng = self._rng(FORCES, seed, replicate)
        drawn = [force.draw(times, rng) for force in self.forces]
        told = _columns([f for f, of in zip(drawn, self.forces, strict=True) if of.told], times.size)
        ambient = _columns([f for f, of in zip(drawn, self.forces, strict=True) if not of.told], times.size)
        pushes = np.zeros((times.size, system.n_dof))
        for values, of in zip(drawn, self.forces, strict=True):
            pushes[:, of.dof] += values
        start = np.zeros(2 * system.n_dof + system.n_hidden)
        if self.initial is not None:
            start[: 2 * system.n_dof] = np.concatenate(self.initial)
        motion = held_motion(system, parameters, start, pushes, 1.0 / self.rate)
        clean = motion[:, [sensor.dof for sensor in layout.sensors]]
        sigma = np.sqrt(np.mean(clean**2, axis=0) / 10.0 ** (self.snr_db / 10.0))
        values = clean + sigma * self._rng(NOISE, seed, replicate).standard_normal(clean.shape)
        return Stream(layout, times, values, OnlineTruth(parameters, motion, told, ambient, clean, sigma))

    def _rng(self, axis: int, seed: int, replicate: int) -> np.random.Generator:
        key = (axis, int(self.identity[:8], 16), replicate)
        return anonymous_stream(seed, key)


def _columns(columns: list[np.ndarray], n: int) -> np.ndarray:
    return np.stack(columns, axis=1) if columns else np.zeros((n, 0))
