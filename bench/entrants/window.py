"""A batch method as an online one: it fits the last samples again, every so many of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from bench.contract.belief import Normal, standard_quantile
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.online import Layout, OnlineCard, OnlineIdentifier, Sample, SampleStatus, Standing, Tracker
from bench.contract.problem import Channel, Force, Problem, Record
from bench.entrants.registry import make_method
from bench.errors import InputError

OF_WINDOW = ("length", "every")
"""Settings of the window; all others are the method's own."""
SPIKE = 5.0
"""Robust standard deviations from the reconstruction, beyond which a sample is left out and the window fitted again."""
FEWEST = 10


@dataclass(frozen=True)
class Window(OnlineIdentifier):
    """The batch method ``batch``, with its ``settings``, on the last ``length`` samples, every ``every`` new ones.

    The state at the start of a window is not told. Windows overlap, so estimates one behind the other share samples;
    each is a fit of its own, and nothing is counted twice.
    """

    batch: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    length: int = 150
    every: int = 10

    card: ClassVar[OnlineCard] = OnlineCard("a batch method in windows", "", "", "window")

    def __post_init__(self) -> None:
        if self.length < FEWEST:
            raise InputError("method.length", self.length, f"at least {FEWEST} samples")
        if self.every < 1:
            raise InputError("method.every", self.every, "at least 1 sample")

    def start(self, layout: Layout) -> Tracker:
        """A tracker before its first sample."""
        return _WindowTracker(layout, make_method(self.batch, self.settings), self.length, self.every)

    def objection(self, layout: Layout) -> str | None:
        """A batch method knows of no unknown force; else what it says of a problem of this kind."""
        if layout.ambient:
            return "a batch method takes what moves the system for known, and here a force is not"
        times = np.arange(float(FEWEST)) * layout.interval
        rows = np.sin(times / layout.interval)[:, None]
        empty = _problem(layout, times, np.tile(rows, len(layout.sensors)), np.tile(rows, len(layout.forced)))
        return make_method(self.batch, self.settings).objection(empty)


class _WindowTracker(Tracker):
    """Holds the samples of one window, times from its first."""

    holds = ("times", "values", "pushes", "unseen", "belief_mean", "belief_covariance", "belief_names")

    def __init__(self, layout: Layout, method: Identifier, length: int, every: int) -> None:
        super().__init__(layout)
        self.method, self.length, self.every = method, length, every
        self.times = np.zeros(0)
        self.values, self.pushes = np.zeros((0, len(layout.sensors))), np.zeros((0, len(layout.forced)))
        self.unseen = 0
        self.belief_mean, self.belief_covariance, self.belief_names = np.zeros(0), np.zeros((0, 0)), list[str]()

    def step(self, sample: Sample, steps: int) -> Standing:
        """Fit the window where it is time."""
        if steps > 1 and self.layout.forced:  # the force of the gap is not known, so no fit may reach across it
            self.times, self.values, self.pushes = self.times[:0], self.values[:0], self.pushes[:0]
        keep = slice(-(self.length - 1), None)
        self.times = np.append(self.times, sample.time)[-self.length :]
        self.values = np.concatenate([self.values[keep], [sample.values]])
        self.pushes = np.concatenate([self.pushes[keep], [sample.forces]])
        self.unseen += 1
        if self.times.size < self.length or self.unseen < self.every:
            waits = not self.belief_names
            status = SampleStatus.WARMING_UP if waits else SampleStatus.OK
            return Standing(sample.time, status, self._belief(), message="the window is not full" if waits else "")
        self.unseen = 0
        found, message = self._fitted()
        if found is None:
            return Standing(sample.time, SampleStatus.FAILED, self._belief(), message=message)
        self.belief_names, self.belief_mean = list(found.names), found.mean
        assert found.covariance is not None
        self.belief_covariance = found.covariance
        return Standing(sample.time, SampleStatus.OK, self._belief())

    def _belief(self) -> Normal | None:
        if not self.belief_names:
            return None
        return Normal(tuple(self.belief_names), self.belief_mean, self.belief_covariance, log=True)

    def _fitted(self) -> tuple[Normal | None, str]:
        """Fit; once more without the samples that are far from the reconstruction."""
        times = (self.times - self.times[0]).round(12)
        problem = _problem(self.layout, times, self.values, self.pushes)
        if problem is None:
            return None, "too few samples of the window can be read"
        estimate = self.method.identify(problem, np.random.default_rng(0))
        clean = _without_spikes(problem, estimate)
        if clean is not None:
            estimate = self.method.identify(clean, np.random.default_rng(0))
        if estimate.status is not Status.OK:
            return None, estimate.message
        return _log_belief(estimate, self.layout)


def _problem(layout: Layout, times: np.ndarray, values: np.ndarray, pushes: np.ndarray) -> Problem:
    channels = []
    for sensor, own in zip(layout.sensors, values.T, strict=True):
        there = np.isfinite(own)
        channels.append(Channel(times[there], own[there], sensor.measures, sensor.dof))
    forces = tuple(
        Force(times, own, hold="zero_order", dof=dof) for dof, own in zip(layout.forced, pushes.T, strict=True)
    )
    return Problem(layout.system, (Record(tuple(channels), forces),))


def _without_spikes(problem: Problem, estimate: Estimate) -> Problem | None:
    """The window without samples far from the reconstruction; None where there are none, or there is none."""
    if estimate.status is not Status.OK or not estimate.reconstructions:
        return None
    record, channels, dropped = problem.records[0], [], 0
    for channel in record.channels:
        if channel.measures != "displacement":
            channels.append(channel)
            continue
        left = channel.values - estimate.reconstructions[0](channel.times)[channel.dof]
        near = np.abs(left - np.median(left)) <= SPIKE * 1.4826 * np.median(np.abs(left - np.median(left)))
        dropped += int(np.sum(~near))
        channels.append(replace(channel, times=channel.times[near], values=channel.values[near]))
    return replace(problem, records=(replace(record, channels=tuple(channels)),)) if dropped else None


def _log_belief(estimate: Estimate, layout: Layout) -> tuple[Normal | None, str]:
    """Normal in logarithms: of the parameters as they are, of groups by their 95 % intervals."""
    belief = estimate.belief
    if (
        isinstance(belief, Normal)
        and belief.log
        and belief.covariance is not None
        and set(belief.names) >= set(layout.free)
    ):
        return belief, ""
    names, means, sds, width = [], [], [], 2.0 * float(standard_quantile(0.975, None))
    for quantity in layout.quantities:
        marginal = estimate.marginal(quantity)
        low, high = marginal.interval(0.95) if marginal is not None else (np.nan, np.nan)
        if marginal is None or not (marginal.value > 0 and high > 0):
            return None, f"{quantity.name} is not positive, or has no interval"
        names.append(quantity.name)
        means.append(np.log(marginal.value))
        sds.append(np.log(high / low) / width if low > 0 else 2.0 * np.log(high / marginal.value) / width)
    return Normal(tuple(names), np.array(means), np.diag(np.square(sds)), log=True), ""
