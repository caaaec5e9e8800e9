"""The contract of an online identifier: a layout without data, one sample at a time, what is believed after each.

A tracker sees the past only. What it holds is bounded, and a sample costs the same however many came before. What
every tracker needs is done here, once: the clock of the samples (a gap, a repeated time stamp), values that say nothing
(missing, at the limit of the range), and a step that went wrong.
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
"""So often again the most extreme value so far, to the last digit, is a sensor at its limit."""
MOST_SKIPPED = 32
"""Samples whose steps failed, one behind the other, of which the forces are kept."""
LONGEST_GAP = 10_000
"""Sampling intervals; behind a longer gap the motion is taken to be unknown, as at the start."""


class SampleStatus(StrEnum):
    """What became of one sample."""

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
    """What a channel measures and where; ``limits`` of its range, beyond which it says nothing, where they are told."""

    measures: Measures = "displacement"
    dof: int = 0
    limits: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.measures not in MEASURED:
            raise InputError("sensor.measures", self.measures, f"one of {', '.join(MEASURED)}")
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            raise InputError("sensor.limits", self.limits, "the lower limit first, and below the upper")


@dataclass(frozen=True)
class Layout:
    """A problem without data: system, sensors, sampling interval (s), and on which DOFs a force acts.

    ``forced``: DOFs under a force that is told with each sample and held until the next. ``ambient``: DOFs under a
    force that nobody measures. Without a known force, free or ambient motion tells ratios to one mass only, the
    system's groups; with one, every parameter. Raises InputError where the parts do not fit.
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
        """Whether the data tell every parameter, by a known force."""
        return bool(self.forced)

    @cached_property
    def free(self) -> tuple[str, ...]:
        """The parameters that a tracker estimates: all, or all but the gauge, which is then one unit of mass."""
        names = self.system.names
        return names if self.scale_known else tuple(name for name in names if name != self.system.gauge)

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """What the data tell: parameters, groups and modal quantities, or the last two alone."""
        if self.scale_known:
            return self.system.quantities
        return tuple(self.system.groups) + tuple(self.system.modal)


@dataclass(frozen=True, eq=False)
class Sample:
    """One instant: time (s), a value a sensor (NaN: missing), and the force (N) on each forced DOF from now on."""

    time: float
    values: tuple[float, ...]
    forces: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class TrackerOutput:
    """What a tracker believes after a sample, from the past alone.

    ``distribution``: normal, in the logarithms of the layout's free parameters (or of quantities by name); None where
    there is none yet. ``prediction`` and ``prediction_sd``, shape (n_sensors,): of this sample before it was seen, in
    the sensors' units. ``alarm``: what a detector of changes stands at, compared with a threshold of the user's choice;
    NaN where the method has none. ``message``: a sentence where the status is not ``ok``.
    """

    time: float
    status: SampleStatus
    distribution: Normal | None = None
    prediction: np.ndarray | None = None
    prediction_sd: np.ndarray | None = None
    alarm: float = float("nan")
    message: str = ""

    def marginal(self, quantity: Quantity) -> Marginal | None:
        """The distribution about a quantity of :attr:`Layout.quantities`; None where there is none."""
        if self.distribution is None:
            return None
        if quantity.name in self.distribution.names:
            quantity = replace(quantity, exponents={quantity.name: 1.0}, coefficient=1.0)
        held = set(self.distribution.names)
        known = {name: power for name, power in quantity.exponents.items() if name in held}
        return self.distribution.marginal(replace(quantity, exponents=known))


@dataclass(frozen=True)
class OnlineCard:
    """What a reader must know of an online method, and how tables and figures call it."""

    summary: str
    source: str
    settings_source: str
    title: str
    order: int = 1000


class Tracker(ABC):
    """What follows one stream. Subclass it and write :meth:`step`; callers use :meth:`update`.

    ``holds`` names the attributes that a step changes: numbers, texts, arrays, or lists of these. They are what is
    saved; everything else follows from the settings and the layout.
    """

    holds: ClassVar[tuple[str, ...]] = ()

    def __init__(self, layout: Layout) -> None:
        """Begin before the first sample."""
        self.layout = layout
        self.samples = 0
        self.owed = 0
        self.skipped = list[list[float]]()
        self.last: float | None = None
        self.stray: float | None = None
        self.forces = list[float]()
        self._standing: TrackerOutput | None = None
        n = len(layout.sensors)
        self.repeats = [0] * n
        self.lowest, self.highest = [float("inf")] * n, [float("-inf")] * n

    @abstractmethod
    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Write this: what is believed after a sample.

        Args:
            sample: its values are NaN where they say nothing.
            steps: sampling intervals since the sample before; 1 but after a gap, 0 for the first.
        """

    def prepare(self) -> None:  # noqa: B027 - most have nothing to do
        """Do what takes long and needs no sample, such as compiling. By default nothing."""

    def reset_motion(self) -> None:  # noqa: B027
        """Forget the motion, but not the parameters: behind a long gap. By default nothing."""

    def smooth(self) -> list[TrackerOutput]:
        """What is believed of the samples still held, given all of them; empty where a method has none."""
        return []

    @final
    def update(self, sample: Sample) -> TrackerOutput:
        """Take a sample and say what is believed. Raises InputError for a sample that does not fit the layout."""
        if len(sample.values) != len(self.layout.sensors) or len(sample.forces) != len(self.layout.forced):
            wanted = f"{len(self.layout.sensors)} value(s) and {len(self.layout.forced)} force(s)"
            raise InputError("sample", f"{len(sample.values)} and {len(sample.forces)}", wanted)
        if not isfinite(sample.time):
            return self._unread(sample, SampleStatus.REPEATED, "its time is not a finite number; left out")
        if self.is_far(sample.time):
            self.stray = sample.time
            return self._unread(sample, SampleStatus.GAP, FAR)
        steps = 0 if self.last is None else round((sample.time - self.last) / self.layout.interval)
        if self.last is not None and steps <= 0:
            return self._unread(sample, SampleStatus.REPEATED, "its time is not after the one before; left out")
        sample, status = self._usable(sample)
        self.forces = list(sample.forces)
        self.last = sample.time
        self.samples += 1
        missing, steps = steps - 1, steps + self.owed
        if steps > LONGEST_GAP:
            self.reset_motion()
            steps = 1
        found = self._stepped(sample, steps)
        if found.status is SampleStatus.OK:
            if status is not SampleStatus.OK:
                found = replace(found, status=status, message=SENTENCES[status])
            elif missing > 0:
                found = replace(found, status=SampleStatus.GAP, message=f"{missing} sample(s) are not there")
        self._standing = found
        return found

    @final
    def is_far(self, time: float) -> bool:
        """Whether a time is so far behind the sample before that only another sample near it makes it believed."""
        reach = LONGEST_GAP * self.layout.interval
        followed = self.stray is not None and 0 < time - self.stray <= reach
        return self.last is not None and time - self.last > reach and not followed

    def _stepped(self, sample: Sample, steps: int) -> TrackerOutput:
        try:
            found = self.step(sample, steps)
            self.owed, self.skipped = 0, []
            return found
        except (ArithmeticError, np.linalg.LinAlgError, ValueError) as error:
            self.owed = max(steps, 1)  # to the next step it is a gap, whose forces are known
            self.skipped = [*self.skipped[1 - MOST_SKIPPED :], list(sample.forces)]
            before = self._standing
            distribution = before.distribution if before else None
            said = f"{type(error).__name__}: {error}"
            return TrackerOutput(
                sample.time, SampleStatus.FAILED, distribution, message=f"the step went wrong ({said})"
            )

    def _unread(self, sample: Sample, status: SampleStatus, message: str) -> TrackerOutput:
        before = self._standing
        alarm = before.alarm if before else float("nan")
        return TrackerOutput(sample.time, status, before.distribution if before else None, alarm=alarm, message=message)

    def _usable(self, sample: Sample) -> tuple[Sample, SampleStatus]:
        """The sample with NaN for values that say nothing and forces as before for missing ones; and why."""
        values, forces, status = list(sample.values), list(sample.forces), SampleStatus.OK
        for i, (value, sensor) in enumerate(zip(sample.values, self.layout.sensors, strict=True)):
            if not isfinite(value):
                values[i], status = nan, SampleStatus.MISSING
                continue
            if is_saturated(self, i, value, sensor):
                values[i], status = nan, SampleStatus.SATURATED
        if not all(map(isfinite, forces)):
            before = self.forces or [0.0] * len(forces)
            forces = [f if isfinite(f) else held for f, held in zip(forces, before, strict=True)]
            status = SampleStatus.MISSING
        if status is SampleStatus.OK:
            return sample, status
        return Sample(sample.time, tuple(values), tuple(forces)), status

    @final
    def saved(self) -> dict[str, Any]:
        """All that it holds, as numbers, texts, lists and arrays by name: what :meth:`restored` goes on from."""
        every = {name: getattr(self, name) for name in (*CLOCK, *self.holds)}
        return {name: _copied(value) for name, value in every.items()}

    @final
    def restored(self, state: Mapping[str, Any]) -> Self:
        """Itself in a saved state; raises InputError for one of something else."""
        names = (*CLOCK, *self.holds)
        if set(state) != set(names):
            raise InputError("state", sorted(set(state) ^ set(names)), "the state of this method in this version")
        for name in names:
            setattr(self, name, state[name])
        self.rebuild()
        return self

    def rebuild(self) -> None:  # noqa: B027
        """Make again what follows from a restored state. By default nothing."""


class Extremes(Protocol):
    """Holds the extreme values so far of each sensor, and how often the more recent was repeated to the last digit."""

    repeats: list[int]
    lowest: list[float]
    highest: list[float]


def is_saturated(extremes: Extremes, i: int, value: float, sensor: Sensor) -> bool:
    """Return whether the next value of the i-th sensor is at the limit of its range, stated or seen."""
    low, high = extremes.lowest[i], extremes.highest[i]
    held = value in (low, high)
    if held:
        extremes.repeats[i] += 1
    elif not low <= value <= high:
        extremes.repeats[i] = 0
        extremes.lowest[i], extremes.highest[i] = min(low, value), max(high, value)
    beyond = sensor.limits is not None and not sensor.limits[0] < value < sensor.limits[1]
    return beyond or (held and extremes.repeats[i] >= STUCK)


def _copied(value: Any) -> Any:
    """A value that a later step cannot change; arrays of another library become numpy's."""
    if isinstance(value, list):
        return [_copied(item) for item in value]
    return np.array(value) if hasattr(value, "__array__") else value


CLOCK = ("samples", "owed", "skipped", "last", "stray", "forces", "repeats", "lowest", "highest")
"""What every tracker holds: the clock of the samples, and what shows a sensor at its limit."""

FAR = "its time is far after the one before; left out, unless the next sample follows it"
SENTENCES = {
    SampleStatus.MISSING: "a value, or a force, is missing; a force is taken to be as before",
    SampleStatus.SATURATED: "a sensor is at the limit of its range",
}
"""What is said of a sample that tells less than it should."""


class OnlineIdentifier(ABC):
    """An online method: a frozen dataclass whose fields are its settings; ``start`` makes a tracker of a layout.

    Register it by an entry point in the group ``bench.trackers``. Raise ``version`` where a change of the method alters
    its results: stored runs of another version are computed again.
    """

    version: ClassVar[int] = 1
    card: ClassVar[OnlineCard]
    requires: ClassVar[tuple[str, ...]] = ()
    extra: ClassVar[str] = ""

    @abstractmethod
    def start(self, layout: Layout) -> Tracker:
        """A tracker before its first sample."""

    def objection(self, layout: Layout) -> str | None:
        """Why this method cannot follow such a stream, in a sentence; None where it can."""
        return None
