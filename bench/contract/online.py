"""Interface of online methods: a layout without data, samples one at a time, and an estimate after each sample.

A tracker uses past samples only; its memory and the cost of a sample are bounded. This module handles what all trackers
have in common: gaps and repeated time stamps, missing and saturated values, and steps that fail.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from math import isfinite, nan
from typing import Any, ClassVar, Protocol, Self, final

import numpy as np

from bench.contract.distribution import Marginal, Normal
from bench.contract.problem import Measures
from bench.errors import InputError
from bench.systems import MEASURED, Quantity, System

STUCK = 2
"""A sensor counts as saturated after this many exact repeats of its extreme value."""
MOST_SKIPPED = 32
"""Largest number of consecutive failed steps whose forces are kept."""
LONGEST_GAP = 10_000
"""Largest gap (sampling intervals); after a longer one the state of motion is considered unknown."""


class SampleStatus(StrEnum):
    """Outcome of processing a sample."""

    OK = "ok"
    WARMING_UP = "warming_up"
    MISSING = "missing"
    GAP = "gap"
    REPEATED = "repeated"
    SATURATED = "saturated"
    OUTLIER = "outlier"
    SENSOR_JUMP = "sensor_jump"
    AT_REST = "at_rest"
    LOST = "lost"
    FAILED = "failed"


@dataclass(frozen=True)
class Sensor:
    """A sensor.

    Attributes:
        measures: Measured quantity.
        dof: Degree of freedom, from 0.
        limits: Lower and upper limit of the range, at and beyond which values are ignored; None if unknown.

    Raises:
        InputError: If the quantity is unknown or the limits are not in increasing order.
    """

    measures: Measures = "displacement"
    dof: int = 0
    limits: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.measures not in MEASURED:
            raise InputError("sensor.measures", self.measures, f"one of {', '.join(MEASURED)}")
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            raise InputError("sensor.limits", self.limits, "the lower limit, then a larger upper limit")


@dataclass(frozen=True)
class Layout:
    """Description of a data stream: system, sensors, sampling interval and forces.

    With a known force every parameter is identifiable, without one only the groups of the system.

    Attributes:
        system: Equation of motion.
        sensors: Sensors, at least one.
        interval: Sampling interval (s).
        forced: DOFs with a known force, which is given with each sample and constant until the next.
        ambient: DOFs with an unmeasured force.

    Raises:
        InputError: If there is no sensor, a DOF does not exist, or the interval is not positive.
    """

    system: System
    sensors: tuple[Sensor, ...]
    interval: float
    forced: tuple[int, ...] = ()
    ambient: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        n = self.system.n_dof
        if not self.sensors:
            raise InputError("sensors", 0, "at least one sensor is needed")
        for dof in (*(s.dof for s in self.sensors), *self.forced, *self.ambient):
            if not 0 <= dof < n:
                raise InputError("dof", dof, f"{self.system.name} has DOFs 0 to {n - 1}")
        if not 0 < self.interval < float("inf"):
            raise InputError("interval", self.interval, "a positive number of seconds")

    @property
    def scale_known(self) -> bool:
        """True if a known force makes every parameter identifiable."""
        return bool(self.forced)

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Estimated parameters: all, or, without a known force, all except the gauge mass, which is set to 1."""
        names = self.system.names
        return names if self.scale_known else tuple(name for name in names if name != self.system.gauge)

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """Identifiable quantities: parameters, groups and modal quantities; without a known force, no parameters."""
        if self.scale_known:
            return self.system.quantities
        return tuple(self.system.groups) + tuple(self.system.modal)


@dataclass(frozen=True, eq=False)
class Sample:
    """Measurements at one instant.

    Attributes:
        time: Time (s).
        values: One value per sensor; NaN if missing.
        forces: Force (N) on each forced DOF from this time on.
    """

    time: float
    values: tuple[float, ...]
    forces: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class TrackerOutput:
    """Estimate of a tracker after a sample, from this and earlier samples.

    Attributes:
        time: Time of the sample (s).
        status: Outcome of processing the sample.
        distribution: Normal distribution of the logarithms of the free parameters of the layout, or of quantities by
            name; None before the first estimate.
        prediction: One-step prediction of the sample in sensor units, shape (n_sensors,).
        prediction_sd: Standard deviation of the prediction, shape (n_sensors,).
        alarm: Statistic of a change detector, to be compared with a threshold; NaN if the method has none.
        message: Explanation if the status is not ``ok``.
    """

    time: float
    status: SampleStatus
    distribution: Normal | None = None
    prediction: np.ndarray | None = None
    prediction_sd: np.ndarray | None = None
    alarm: float = float("nan")
    message: str = ""

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """Return the distribution of a quantity of :attr:`Layout.quantities`; None if there is no estimate."""
        if self.distribution is None:
            return None
        if quantity.name in self.distribution.names:
            quantity = replace(quantity, exponents={quantity.name: 1.0}, coefficient=1.0)
        known = {n: power for n, power in quantity.exponents.items() if n in self.distribution.names}
        return self.distribution.marginal(replace(quantity, exponents=known))


@dataclass(frozen=True)
class OnlineCard:
    """Description of an online method for tables and figures.

    Attributes:
        summary: What the method does, in one sentence.
        source: Publication.
        settings_source: Origin of the default settings.
        title: Name in tables and figures.
        order: Position in tables and figures, lowest first.
    """

    summary: str
    source: str
    settings_source: str
    title: str
    order: int = 1000


class Tracker(ABC):
    """Online estimator for one data stream. Subclasses implement :meth:`step`; callers use :meth:`update`.

    ``state_names`` lists the attributes that a step changes: numbers, strings, arrays, or lists of these. Only they are
    saved; everything else is derived from the settings and the layout.
    """

    state_names: ClassVar[tuple[str, ...]] = ()

    def __init__(self, layout: Layout) -> None:
        """Initialise the tracker before the first sample."""
        self.layout = layout
        self.samples = 0
        self.owed = 0
        self.skipped = list[list[float]]()
        self.last: float | None = None
        self.stray: float | None = None
        self.forces = list[float]()
        self._output: TrackerOutput | None = None
        n = len(layout.sensors)
        self.repeats = [0] * n
        self.lowest, self.highest = [float("inf")] * n, [float("-inf")] * n

    @abstractmethod
    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Process a sample (to be implemented).

        Args:
            sample: Sample whose missing and saturated values are NaN.
            steps: Sampling intervals since the previous sample: 1, more after a gap, 0 for the first sample.

        Returns:
            The estimate after the sample.
        """

    def prepare(self) -> None:  # noqa: B027 - most methods need no preparation
        """Perform slow preparations that need no sample, such as compilation. Does nothing by default."""

    def reset_motion(self) -> None:  # noqa: B027
        """Discard the state of motion, but not the parameters, after a long gap. Does nothing by default."""

    def smooth(self) -> list[TrackerOutput]:
        """Return smoothed estimates of the samples in memory; empty for methods without a smoother."""
        return []

    @final
    def update(self, sample: Sample) -> TrackerOutput:
        """Process a sample and return the estimate. Raises InputError if the sample does not fit the layout."""
        if len(sample.values) != len(self.layout.sensors) or len(sample.forces) != len(self.layout.forced):
            wanted = f"{len(self.layout.sensors)} value(s) and {len(self.layout.forced)} force(s)"
            raise InputError("sample", f"{len(sample.values)} and {len(sample.forces)}", wanted)
        if not isfinite(sample.time):
            return self._unread(sample, SampleStatus.REPEATED, "its time is not a finite number; ignored")
        if self.is_far(sample.time):
            self.stray = sample.time
            return self._unread(sample, SampleStatus.GAP, FAR)
        steps = 0 if self.last is None else round((sample.time - self.last) / self.layout.interval)
        if self.last is not None and steps <= 0:
            return self._unread(sample, SampleStatus.REPEATED, "its time is not later than the previous one; ignored")
        sample, status = self._usable(sample)
        self.forces = list(sample.forces)
        self.last = sample.time
        self.samples += 1
        missing, steps = steps - 1, steps + self.owed
        if steps > LONGEST_GAP:
            self.reset_motion()
            steps = 1
        output = self._checked_step(sample, steps)
        if output.status is SampleStatus.OK:
            if status is not SampleStatus.OK:
                output = replace(output, status=status, message=SENTENCES[status])
            elif missing > 0:
                output = replace(output, status=SampleStatus.GAP, message=f"{missing} sample(s) are missing")
        self._output = output
        return output

    @final
    def is_far(self, time: float) -> bool:
        """Return True for an isolated time far after the previous sample, which is accepted only if another follows."""
        reach = LONGEST_GAP * self.layout.interval
        followed = self.stray is not None and 0 < time - self.stray <= reach
        return self.last is not None and time - self.last > reach and not followed

    def _checked_step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Perform a step; if it fails numerically, keep the previous estimate."""
        try:
            output = self.step(sample, steps)
            self.owed, self.skipped = 0, []
            return output
        except (ArithmeticError, np.linalg.LinAlgError, ValueError) as error:
            self.owed = max(steps, 1)  # the next step treats it as a gap with known forces
            self.skipped = [*self.skipped[1 - MOST_SKIPPED :], list(sample.forces)]
            distribution = self._output.distribution if self._output else None
            message = f"the step failed ({type(error).__name__}: {error})"
            return TrackerOutput(sample.time, SampleStatus.FAILED, distribution, message=message)

    def _unread(self, sample: Sample, status: SampleStatus, message: str) -> TrackerOutput:
        """Return the previous estimate for a sample that is ignored."""
        last = self._output
        alarm = last.alarm if last else float("nan")
        return TrackerOutput(sample.time, status, last.distribution if last else None, alarm=alarm, message=message)

    def _usable(self, sample: Sample) -> tuple[Sample, SampleStatus]:
        """Replace unusable values by NaN and missing forces by the previous ones; return the sample and its status."""
        values, forces, status = list(sample.values), list(sample.forces), SampleStatus.OK
        for i, (value, sensor) in enumerate(zip(sample.values, self.layout.sensors, strict=True)):
            if not isfinite(value):
                values[i], status = nan, SampleStatus.MISSING
                continue
            if is_saturated(self, i, value, sensor):
                values[i], status = nan, SampleStatus.SATURATED
        if not all(map(isfinite, forces)):
            previous = self.forces or [0.0] * len(forces)
            forces = [f if isfinite(f) else last for f, last in zip(forces, previous, strict=True)]
            status = SampleStatus.MISSING
        if status is SampleStatus.OK:
            return sample, status
        return Sample(sample.time, tuple(values), tuple(forces)), status

    @final
    def saved(self) -> dict[str, Any]:
        """Return the state as numbers, strings, lists and arrays by name, for :meth:`restored`."""
        every = {name: getattr(self, name) for name in (*CLOCK, *self.state_names)}
        return {name: _copied(value) for name, value in every.items()}

    @final
    def restored(self, state: Mapping[str, Any]) -> Self:
        """Restore a saved state and return the tracker. Raises InputError for a state of another method."""
        names = (*CLOCK, *self.state_names)
        if set(state) != set(names):
            raise InputError("state", sorted(set(state) ^ set(names)), "the state of this method in this version")
        for name in names:
            setattr(self, name, state[name])
        self.rebuild()
        return self

    def rebuild(self) -> None:  # noqa: B027
        """Recompute what is derived from a restored state. Does nothing by default."""


class Extremes(Protocol):
    """Extreme values of each sensor so far, and the number of exact repeats of the more recent one."""

    repeats: list[int]
    lowest: list[float]
    highest: list[float]


def is_saturated(extremes: Extremes, i: int, value: float, sensor: Sensor) -> bool:
    """Decide whether a sensor is saturated, and update its extreme values.

    Args:
        extremes: Extreme values of all sensors; updated in place.
        i: Index of the sensor.
        value: Next value of the sensor.
        sensor: The sensor, with its limits if they are known.

    Returns:
        True if the value is at or beyond a known limit, or repeats the extreme value.
    """
    low, high = extremes.lowest[i], extremes.highest[i]
    repeated = value in (low, high)
    if repeated:
        extremes.repeats[i] += 1
    elif not low <= value <= high:
        extremes.repeats[i] = 0
        extremes.lowest[i], extremes.highest[i] = min(low, value), max(high, value)
    beyond = sensor.limits is not None and not sensor.limits[0] < value < sensor.limits[1]
    return beyond or (repeated and extremes.repeats[i] >= STUCK)


def _copied(value: Any) -> Any:
    """Return a copy of a value, with arrays of other libraries converted to NumPy."""
    if isinstance(value, list):
        return [_copied(item) for item in value]
    return np.array(value) if hasattr(value, "__array__") else value


CLOCK = ("samples", "owed", "skipped", "last", "stray", "forces", "repeats", "lowest", "highest")
"""State of every tracker: times of samples, and extreme values of sensors."""

FAR = "its time is far after the previous one; ignored, unless another sample follows"
SENTENCES = {
    SampleStatus.MISSING: "a value or force is missing; the previous force is used",
    SampleStatus.SATURATED: "a sensor is at the limit of its range",
}
"""Message for a sample that is used only in part."""


class OnlineIdentifier(ABC):
    """Base class of online methods: a frozen dataclass whose fields are the settings.

    Register a method by an entry point in the group ``bench.trackers``. Raise ``version`` when a change of the method
    alters its results; stored results of another version are recomputed.
    """

    version: ClassVar[int] = 1
    card: ClassVar[OnlineCard]
    requires: ClassVar[tuple[str, ...]] = ()
    extra: ClassVar[str] = ""

    @abstractmethod
    def start(self, layout: Layout) -> Tracker:
        """Return a new tracker for a stream."""

    def objection(self, layout: Layout) -> str | None:
        """Return the reason why the method cannot follow such a stream, in one sentence; None if it can."""
        return None
