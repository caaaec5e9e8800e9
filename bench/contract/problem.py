"""What a method is given: measurements, known forces, what is said of the start, the prior and the equations.

Everything is validated once, here, and read-only afterwards. No true value can be in a Problem; what scores an
estimate is :class:`bench.scenario.truth.Truth`, a type of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from bench.contract.prior import Prior, dimension_scale
from bench.errors import InputError
from bench.systems import FORCE, MASS, MEASURED, Dimension, LoadedSystem, System

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Measures = Literal["displacement", "velocity", "acceleration"]
Hold = Literal["zero_order", "linear", "cubic"]
DEGREES: dict[Hold, int] = {"zero_order": 1, "linear": 1, "cubic": 3}
"""Degree of the polynomial that carries a force from one sample to the next (a step is carried as a line)."""
MIN_SAMPLES = 3


def read_only(values: object, field_name: str) -> np.ndarray:
    """A read-only float64 copy of one-dimensional finite values; raises InputError otherwise."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(field_name, values, "numbers are needed") from None
    if array.ndim != 1:
        raise InputError(field_name, f"array of shape {array.shape}", "one dimension is needed")
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise InputError(field_name, array[bad[0]], f"value number {bad[0] + 1} is not finite; remove or repair it")
    array.setflags(write=False)
    return array


def _increasing(times: np.ndarray, field_name: str) -> None:
    bad = np.flatnonzero(np.diff(times) <= 0)
    if bad.size:
        i = int(bad[0])
        pair = f"{times[i]:g}, {times[i + 1]:g}"
        raise InputError(field_name, pair, f"times must increase (at sample {i + 2}); sort them")


@dataclass(frozen=True)
class Units:
    """A system of units: how much one unit of mass (kg), length (m) and time (s) is in the units of the Problem."""

    mass: float = 1.0
    length: float = 1.0
    time: float = 1.0

    def of(self, dimension: Dimension) -> float:
        """How much one unit of the given dimension is."""
        return dimension_scale(dimension, self.mass, self.length, self.time)

    @property
    def inverse(self) -> Units:
        return Units(1.0 / self.mass, 1.0 / self.length, 1.0 / self.time)

    def scales(self, system: System) -> dict[str, float]:
        """How much one unit of each parameter of the system is."""
        return {p.name: self.of(p.dimension) for p in system.parameters}


@dataclass(frozen=True, eq=False)
class Channel:
    """One sensor: what it measures, of which DOF (from 0), at which times (s, from the start of its record).

    ``values`` and ``times`` have shape (n_samples,); times increase and need not be uniform. ``offset`` says that
    an unknown constant is added to every value, to be estimated with the rest.
    """

    times: np.ndarray
    values: np.ndarray
    measures: Measures = "displacement"
    dof: int = 0
    unit: str = "m"
    offset: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", read_only(self.times, "times"))
        object.__setattr__(self, "values", read_only(self.values, "values"))
        if self.measures not in MEASURED:
            raise InputError("channel.measures", self.measures, f"one of {', '.join(MEASURED)}")
        if self.times.size != self.values.size:
            raise InputError("values", self.values.size, f"as many values as times are needed ({self.times.size})")
        _increasing(self.times, "times")
        if self.times.size and self.times[0] < 0:
            raise InputError("times", self.times[0], "times count from the start of the record, so none is negative")

    @property
    def n(self) -> int:
        return int(self.times.size)


@dataclass(frozen=True, eq=False)
class Force:
    """A known force on one DOF: samples (N) at times (s), shape (n,), and how it runs between them.

    ``zero_order`` holds each sample to the next time, ``linear`` joins them, ``cubic`` is the cubic spline through them
    (not-a-knot: de Boor, A Practical Guide to Splines, chapter IV); it is zero outside its times.
    """

    times: np.ndarray
    values: np.ndarray
    hold: Hold = "linear"
    dof: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", read_only(self.times, "force.times"))
        object.__setattr__(self, "values", read_only(self.values, "force.values"))
        if self.hold not in DEGREES:
            raise InputError("force.hold", self.hold, f"one of {', '.join(DEGREES)}")
        if self.times.size != self.values.size or self.times.size < 2:
            raise InputError("force.values", self.values.size, "at least two samples, as many as times")
        _increasing(self.times, "force.times")

    @property
    def degree(self) -> int:
        """Degree of the polynomial between samples."""
        return DEGREES[self.hold]

    @cached_property
    def _spline(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline  # slow to import, and few need it

        return CubicSpline(self.times, self.values)

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """The force (N) at the times, same shape."""
        times = np.asarray(times, float)
        if self.hold == "linear":
            inside = np.interp(times, self.times, self.values)
        elif self.hold == "cubic":
            inside = self._spline(times)
        else:
            inside = self.values[np.clip(np.searchsorted(self.times, times, "right") - 1, 0, self.times.size - 1)]
        return np.where((times < self.times[0]) | (times > self.times[-1]), 0.0, inside)


@dataclass(frozen=True, eq=False)
class InitialState:
    """Displacement (m) and velocity (m/s) at time 0 of a record, each of shape (n_dof,)."""

    displacement: np.ndarray
    velocity: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "displacement", read_only(np.atleast_1d(self.displacement), "initial displacement"))
        object.__setattr__(self, "velocity", read_only(np.atleast_1d(self.velocity), "initial velocity"))

    def expressed_in(self, units: Units) -> InitialState:
        """The same state in other units."""
        return InitialState(
            self.displacement / units.of(MEASURED["displacement"]), self.velocity / units.of(MEASURED["velocity"])
        )


@dataclass(frozen=True, eq=False)
class Record:
    """One run of the rig: its channels, the known forces, and its state at time 0 where that is told.

    ``added_mass``: known masses (kg, shape (n_dof,)) that the rig carried in this run, beside its own.
    """

    channels: tuple[Channel, ...]
    forces: tuple[Force, ...] = ()
    initial_state: InitialState | None = None
    added_mass: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "forces", tuple(self.forces))
        if self.added_mass is not None:
            object.__setattr__(self, "added_mass", read_only(self.added_mass, "added_mass"))
            if np.any(self.added_mass < 0):
                raise InputError("added_mass", list(self.added_mass), "no negative mass (kg)")
        n = sum(channel.n for channel in self.channels)
        if n < MIN_SAMPLES:
            raise InputError("samples", n, f"a record needs at least {MIN_SAMPLES}")

    @property
    def duration(self) -> float:
        """Time of the last sample (s)."""
        return max(float(channel.times[-1]) for channel in self.channels if channel.n)

    @property
    def n(self) -> int:
        """Number of samples over all channels."""
        return sum(channel.n for channel in self.channels)

    def rig(self, system: System) -> System:
        """The system as it was in this run: with the added masses in its equation of motion."""
        return system if self.added_mass is None else LoadedSystem(system, tuple(map(float, self.added_mass)))

    def force(self, times: np.ndarray, n_dof: int) -> list[np.ndarray]:
        """The known force (N) on each DOF at the times: ``n_dof`` arrays of the shape of ``times``."""
        total = [np.zeros(np.shape(times)) for _ in range(n_dof)]
        for force in self.forces:
            total[force.dof] = total[force.dof] + force(times)
        return total

    def expressed_in(self, units: Units) -> Record:
        """The same record in other units: times, measurements, forces and start."""
        channels = tuple(
            replace(c, times=c.times / units.time, values=c.values / units.of(MEASURED[c.measures]))
            for c in self.channels
        )
        forces = tuple(replace(f, times=f.times / units.time, values=f.values / units.of(FORCE)) for f in self.forces)
        start = self.initial_state.expressed_in(units) if self.initial_state else None
        added = None if self.added_mass is None else self.added_mass / units.of(MASS)
        return Record(channels, forces, start, added)


@dataclass(frozen=True, eq=False)
class Problem:
    """One or more records of one system that share its parameters, with the prior if there is one.

    The noise level is not told. Raises InputError where records and system do not fit each other.
    """

    system: System
    records: tuple[Record, ...]
    prior: Prior | None = None
    name: str = field(default="")

    def __post_init__(self) -> None:
        object.__setattr__(self, "records", tuple(self.records))
        if not self.records:
            raise InputError("records", 0, "a problem needs at least one record")
        n = self.system.n_dof
        for record in self.records:
            for dof in (*(c.dof for c in record.channels), *(f.dof for f in record.forces)):
                if not 0 <= dof < n:
                    raise InputError("dof", dof, f"{self.system.name} has DOFs 0 to {n - 1}")
            if record.added_mass is not None and record.added_mass.size != n:
                raise InputError("added_mass", list(record.added_mass), f"one mass a DOF, {n} in all")
            start = record.initial_state
            if start is not None and (start.displacement.size != n or start.velocity.size != n):
                raise InputError("initial_state", start.displacement.size, f"{self.system.name} has {n} DOF")
        if self.prior is not None and self.prior.names != self.system.names:
            raise InputError("prior", self.prior.names, f"name the parameters {', '.join(self.system.names)}, in order")

    @property
    def n(self) -> int:
        """Number of samples over all records."""
        return sum(record.n for record in self.records)

    @property
    def forced(self) -> bool:
        """Whether any known force acts."""
        return any(np.any(force.values != 0) for record in self.records for force in record.forces)

    @property
    def scale_known(self) -> bool:
        """Whether the data tell the scale of the parameters: by a known force, or by a known mass in some record."""
        return self.forced or any(np.any(r.added_mass > 0) for r in self.records if r.added_mass is not None)

    @property
    def silent(self) -> bool:
        """Whether no sensor shows any motion: every value zero, or constant where a constant offset is unknown."""
        return not any(
            np.any(c.values - (c.values[:1] if c.offset else 0.0)) for record in self.records for c in record.channels
        )

    @property
    def start_known(self) -> bool:
        """Whether every record's initial state is told."""
        return all(record.initial_state is not None for record in self.records)

    def expressed_in(self, units: Units) -> Problem:
        """The same problem in other units: prior, initial state and forces converted too."""
        prior = self.prior.expressed_in(units.scales(self.system)) if self.prior else None
        system = self.system.rescaled(units.of)
        return Problem(system, tuple(r.expressed_in(units) for r in self.records), prior, self.name)

    def natural_units(self) -> Units:
        """Units in which data, time and prior mass are of order one, from the problem alone.

        Time: the longest record. Length: root mean square of the largest channel (integrated to a displacement by
        the unit of time). Mass: the nominal value of the gauge mass, else from the force, else an added mass, else 1.
        A method that works in these units gives the same answer whatever units its user measures in.
        """
        time = max(record.duration for record in self.records)
        sizes = [
            float(np.sqrt(np.mean(c.values**2))) * time ** (-MEASURED[c.measures].time)
            for record in self.records
            for c in record.channels
            if c.n
        ]
        length = max(sizes, default=0.0) or 1.0
        if self.prior is not None:
            mass = self.prior.nominal[self.system.gauge]
        else:
            pushes = [float(np.sqrt(np.mean(f.values**2))) for record in self.records for f in record.forces]
            added = max((float(np.max(r.added_mass)) for r in self.records if r.added_mass is not None), default=0.0)
            mass = max(pushes, default=0.0) * time**2 / length or added or 1.0
        return Units(mass, length, time)
