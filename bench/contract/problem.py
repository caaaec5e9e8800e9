"""Identification problem as given to a method: measurements, known forces and initial states, prior, system.

The data are validated here and read-only afterwards. A Problem holds no true values; estimates are scored with
:class:`bench.scenario.truth.Truth`.
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
"""Degree of the polynomial between two samples of a force (for ``zero_order``, a line that is constant)."""
MIN_SAMPLES = 3
"""Smallest number of samples of a record."""


def read_only(values: object, field_name: str) -> np.ndarray:
    """Return a read-only float64 copy of one-dimensional finite values.

    Args:
        values: Sequence of numbers, shape (n,).
        field_name: Field to name in an error.

    Returns:
        Array of shape (n,).

    Raises:
        InputError: If the values are not numbers, not finite, or not one-dimensional.
    """
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
    """System of units, given by the sizes of its base units in the units of the Problem (SI unless converted).

    Attributes:
        mass: Size of the unit of mass (kg).
        length: Size of the unit of length (m).
        time: Size of the unit of time (s).
    """

    mass: float = 1.0
    length: float = 1.0
    time: float = 1.0

    def of(self, dimension: Dimension) -> float:
        """Return the size of the unit of a dimension."""
        return dimension_scale(dimension, self.mass, self.length, self.time)

    @property
    def inverse(self) -> Units:
        """Units that convert back."""
        return Units(1.0 / self.mass, 1.0 / self.length, 1.0 / self.time)

    def scales(self, system: System) -> dict[str, float]:
        """Return the size of the unit of each parameter of a system, by name."""
        return {p.name: self.of(p.dimension) for p in system.parameters}


@dataclass(frozen=True, eq=False)
class Channel:
    """Samples of one sensor.

    Attributes:
        times: Times since the start of the record (s), shape (n_samples,); increasing, not necessarily uniform.
        values: Measured values, shape (n_samples,).
        measures: Measured quantity.
        dof: Degree of freedom, from 0.
        unit: Unit of the values.
        offset: True if an unknown constant is added to every value, to be estimated with the parameters.

    Raises:
        InputError: If the arrays do not fit each other, or times are negative or do not increase.
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
            raise InputError("times", self.times[0], "0 or later: times count from the start of the record")

    @property
    def n(self) -> int:
        """Number of samples."""
        return int(self.times.size)


@dataclass(frozen=True, eq=False)
class Force:
    """Known force on one DOF, zero outside its times; call it with times (s) to evaluate it (N).

    Attributes:
        times: Times since the start of the record (s), shape (n,), at least two, increasing.
        values: Force (N), shape (n,).
        hold: Interpolation between samples: ``zero_order`` holds each sample until the next, ``linear`` connects them,
            ``cubic`` is the not-a-knot cubic spline (de Boor, A Practical Guide to Splines, chapter IV).
        dof: Degree of freedom, from 0.

    Raises:
        InputError: If the arrays do not fit each other, or times do not increase.
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
            raise InputError("force.values", self.values.size, "at least two samples, one per time, are needed")
        _increasing(self.times, "force.times")

    @property
    def degree(self) -> int:
        """Degree of the polynomial between two samples."""
        return DEGREES[self.hold]

    @cached_property
    def _spline(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline  # slow to import, rarely needed

        return CubicSpline(self.times, self.values)

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the force (N) at times (s) of any shape."""
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
    """State at time 0 of a record.

    Attributes:
        displacement: Displacement (m), shape (n_dof,).
        velocity: Velocity (m/s), shape (n_dof,).
    """

    displacement: np.ndarray
    velocity: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "displacement", read_only(np.atleast_1d(self.displacement), "initial displacement"))
        object.__setattr__(self, "velocity", read_only(np.atleast_1d(self.velocity), "initial velocity"))

    def expressed_in(self, units: Units) -> InitialState:
        """Convert the state to other units."""
        return InitialState(
            self.displacement / units.of(MEASURED["displacement"]), self.velocity / units.of(MEASURED["velocity"])
        )


@dataclass(frozen=True, eq=False)
class Record:
    """Measurements of one test.

    Attributes:
        channels: Measured channels.
        forces: Known forces; several on one DOF add up.
        initial_state: State at time 0; None if unknown.
        added_mass: Known masses (kg), shape (n_dof,), attached to the structure during this test.

    Raises:
        InputError: If an added mass is negative, or there are too few samples.
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
                raise InputError("added_mass", list(self.added_mass), "masses (kg) of 0 or more")
        n = sum(channel.n for channel in self.channels)
        if n < MIN_SAMPLES:
            raise InputError("samples", n, f"a record needs at least {MIN_SAMPLES} samples")

    @property
    def duration(self) -> float:
        """Time of the last sample (s)."""
        return max(float(channel.times[-1]) for channel in self.channels if channel.n)

    @property
    def n(self) -> int:
        """Number of samples over all channels."""
        return sum(channel.n for channel in self.channels)

    def rig(self, system: System) -> System:
        """Return the system with the added masses of this test."""
        return system if self.added_mass is None else LoadedSystem(system, tuple(map(float, self.added_mass)))

    def force(self, times: np.ndarray, n_dof: int) -> list[np.ndarray]:
        """Evaluate the known forces.

        Args:
            times: Times (s), of any shape.
            n_dof: Number of degrees of freedom.

        Returns:
            Force (N) on each DOF, ``n_dof`` arrays of the shape of ``times``.
        """
        total = [np.zeros(np.shape(times)) for _ in range(n_dof)]
        for force in self.forces:
            total[force.dof] = total[force.dof] + force(times)
        return total

    def expressed_in(self, units: Units) -> Record:
        """Convert times, measurements, forces, initial state and added masses to other units."""
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
    """One or more records of a system with common parameters. The noise level is unknown.

    Attributes:
        system: Equation of motion.
        records: Records, at least one.
        prior: Prior of all parameters, in the order of the system; None for no prior.
        name: Name for messages.

    Raises:
        InputError: If records, prior and system do not fit each other.
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
                raise InputError("added_mass", list(record.added_mass), f"one mass per DOF, {n} in all")
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
        """True if a known force acts in any record."""
        return any(np.any(force.values != 0) for record in self.records for force in record.forces)

    @property
    def scale_known(self) -> bool:
        """True if a known force or added mass makes the scale of the parameters identifiable."""
        return self.forced or any(np.any(r.added_mass > 0) for r in self.records if r.added_mass is not None)

    @property
    def silent(self) -> bool:
        """True if no sensor shows motion: all values are zero, or constant if the offset is unknown."""
        return not any(
            np.any(c.values - (c.values[:1] if c.offset else 0.0)) for record in self.records for c in record.channels
        )

    @property
    def start_known(self) -> bool:
        """True if the initial state of every record is known."""
        return all(record.initial_state is not None for record in self.records)

    def expressed_in(self, units: Units) -> Problem:
        """Convert the problem to other units, including prior, initial states and forces."""
        prior = self.prior.expressed_in(units.scales(self.system)) if self.prior else None
        system = self.system.rescaled(units.of)
        return Problem(system, tuple(r.expressed_in(units) for r in self.records), prior, self.name)

    def natural_units(self) -> Units:
        """Return units in which data, times and mass are of order one.

        The unit of time is the duration of the longest record. The unit of length is the root mean square of the
        largest channel, converted to a displacement by the unit of time. The unit of mass is the nominal gauge mass,
        or else computed from the force, or else an added mass, or 1. A method that works in these units returns
        estimates that do not depend on the units of the data.
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
