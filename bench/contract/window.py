"""What follows a stream by fitting its last samples again, every so many of them: a batch method's way to be online.

Windows overlap, so estimates one behind the other share samples. With an **arrival cost** (C. V. Rao, J. B. Rawlings,
D. Q. Mayne, IEEE Trans. Automatic Control 48:246, 2003) what was learned before a window joins what the window tells:
the distribution that stood when the sample before the window's first had come, so that no sample counts twice. Both are
normal in the logarithms, so their product is. How much the parameters may have changed meanwhile is not set by hand:
of :data:`WIDTHS` the one is taken under which the difference of the two is most likely. The motion at the start of a
window is estimated from the window alone.

A sensor's zero that jumps (:mod:`bench.contract.zero`) is taken off; how far it moved is what the fits leave on
average from then on.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np

from bench.contract.distribution import Normal, standard_quantile
from bench.contract.estimate import Estimate, Status
from bench.contract.online import Layout, Sample, SampleStatus, Tracker, TrackerOutput
from bench.contract.problem import Channel, Force, Problem, Record
from bench.contract.zero import remove_jumps

SPIKE = 5.0
"""Robust standard deviations from the reconstruction, beyond which a sample is left out and the window fitted again."""
WIDTHS = (0.0, 0.003, 0.03, 0.3, 3.0)
"""Standard deviations by which the log-parameters may have moved since the window began."""


class WindowTracker(Tracker):
    """Fits the last ``length`` samples, every ``every`` new ones; times from the window's first. Write :meth:`answer`.

    ``arrival``: whether what was learned before the window counts.
    """

    holds: ClassVar[tuple[str, ...]] = (
        "times", "values", "pushes", "unseen", "belief_mean", "belief_covariance", "belief_names",
        "past_times", "past_means", "past_covariances", "zero", "jumped",
    )  # fmt: skip

    def __init__(self, layout: Layout, length: int, every: int, arrival: bool = False) -> None:
        super().__init__(layout)
        self.length, self.every, self.arrival = length, every, arrival
        self.times = np.zeros(0)
        self.values, self.pushes = np.zeros((0, len(layout.sensors))), np.zeros((0, len(layout.forced)))
        self.unseen = 0
        self.zero, self.jumped = np.zeros(len(layout.sensors)), -np.inf  # of the sensors; time of the last jump (s)
        self.belief_mean, self.belief_covariance, self.belief_names = np.zeros(0), np.zeros((0, 0)), list[str]()
        self.past_times, self.past_means, self.past_covariances = list[float](), list[np.ndarray](), list[np.ndarray]()

    @abstractmethod
    def answer(self, problem: Problem) -> Estimate:
        """Write this: the estimate from a window."""

    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Fit the window where it is time."""
        if steps > 1 and self.layout.forced:  # the force of the gap is not known, so no fit may reach across it
            self.times, self.values, self.pushes = self.times[:0], self.values[:0], self.pushes[:0]
        keep = slice(-(self.length - 1), None)
        self.times = np.append(self.times, sample.time)[-self.length :]
        self.values = np.concatenate([self.values[keep], [np.subtract(sample.values, self.zero)]])
        self.pushes = np.concatenate([self.pushes[keep], [sample.forces]])
        self.unseen += 1
        if self.times.size < self.length or self.unseen < self.every:
            waits = not self.belief_names
            status = SampleStatus.WARMING_UP if waits else SampleStatus.OK
            return TrackerOutput(
                sample.time, status, self._distribution(), message="the window is not full" if waits else ""
            )
        self.unseen = 0
        moved = self._levelled()
        found, message = self._fitted()
        if found is not None and moved:  # the zero is known better now
            found, message = self._fitted()
        if found is None:
            return TrackerOutput(sample.time, SampleStatus.FAILED, self._distribution(), message=message)
        status = SampleStatus.SENSOR_JUMP if moved else SampleStatus.OK
        message = "the sensor's zero has jumped, and is taken off" if moved else ""
        if self.arrival:
            found = self._joined(found)
        self.belief_names, self.belief_mean = list(found.names), found.mean
        self.belief_covariance = np.asarray(found.covariance)
        return TrackerOutput(sample.time, status, self._distribution(), message=message)

    def _levelled(self) -> bool:
        """Take a jump of a sensor's zero off the samples behind it; whether there was one."""
        if np.ptp(np.diff(self.times)) > 0.5 * self.layout.interval:
            return False
        at = remove_jumps(self.values, self.zero)
        if at is not None:
            self.jumped = float(self.times[at])
        return at is not None

    def _relevelled(self, problem: Problem, estimate: Estimate) -> None:
        """Move the zeros by what a fit leaves on average behind the last jump."""
        behind = self.jumped - self.times[0]
        if not estimate.reconstructions or not np.isfinite(behind):
            return
        for i, channel in enumerate(problem.records[0].channels):
            late = channel.times >= behind - 0.5 * self.layout.interval
            if channel.measures == "displacement" and late.any():
                left = channel.values[late] - estimate.reconstructions[0](channel.times[late])[channel.dof]
                self.values[self.times - self.times[0] >= behind - 0.5 * self.layout.interval, i] -= np.median(left)
                self.zero[i] += np.median(left)

    def _distribution(self) -> Normal | None:
        if not self.belief_names:
            return None
        return Normal(tuple(self.belief_names), self.belief_mean, self.belief_covariance, log=True)

    def _joined(self, found: Normal) -> Normal:
        """Combine the window's distribution with the one from before its first sample, which is then dropped."""
        if list(found.names) != self.belief_names:
            self.past_times, self.past_means, self.past_covariances = [], [], []
        before = [i for i, t in enumerate(self.past_times) if t < self.times[0]]
        if before:
            newest = before[-1]
            found = product(found, self.past_means[newest], self.past_covariances[newest])
            for past in (self.past_times, self.past_means, self.past_covariances):
                del past[:newest]
        assert found.covariance is not None
        self.past_times.append(float(self.times[-1]))
        self.past_means.append(found.mean)
        self.past_covariances.append(found.covariance)
        return found

    def _fitted(self) -> tuple[Normal | None, str]:
        """Fit; once more without the samples that are far from the reconstruction."""
        times = (self.times - self.times[0]).round(12)
        problem = window_problem(self.layout, times, self.values, self.pushes)
        if problem is None:
            return None, "too few samples of the window can be read"
        estimate = self.answer(problem)
        clean = _without_spikes(problem, estimate)
        if clean is not None:
            estimate = self.answer(clean)
        if estimate.status is not Status.OK:
            return None, estimate.message
        self._relevelled(problem, estimate)
        return _log_distribution(estimate, self.layout)


def product(own: Normal, mean: np.ndarray, covariance: np.ndarray) -> Normal:
    """Combine a distribution with an earlier one, which is first widened by the most likely of :data:`WIDTHS`."""
    assert own.covariance is not None
    off, size = own.mean - mean, len(own.mean)

    def minus_log_likelihood(width: float) -> float:
        spread = own.covariance + covariance + width**2 * np.eye(size)
        return float(off @ np.linalg.solve(spread, off) + np.linalg.slogdet(spread)[1])

    widened = covariance + min(WIDTHS, key=minus_log_likelihood) ** 2 * np.eye(size)
    gain = np.linalg.solve(own.covariance + widened, widened).T
    joined = widened - gain @ widened
    return replace(own, mean=mean + gain @ off, covariance=0.5 * (joined + joined.T))


def window_problem(layout: Layout, times: np.ndarray, values: np.ndarray, pushes: np.ndarray) -> Problem | None:
    """The samples of a window as the problem of a batch method; None where a sensor shows nothing."""
    channels = []
    for sensor, own in zip(layout.sensors, values.T, strict=True):
        there = np.isfinite(own)
        if not there.any():
            return None
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


def _log_distribution(estimate: Estimate, layout: Layout) -> tuple[Normal | None, str]:
    """Normal in logarithms: of the parameters as they are, of groups by their 95 % intervals."""
    distribution = estimate.distribution
    if (
        isinstance(distribution, Normal)
        and distribution.log
        and distribution.covariance is not None
        and set(distribution.names) >= set(layout.free)
    ):
        return distribution, ""
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
