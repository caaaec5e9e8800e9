"""Online estimation by repeated fits of a batch method to a moving window of samples.

Consecutive windows overlap. With an **arrival cost** (C. V. Rao, J. B. Rawlings, D. Q. Mayne, IEEE Trans. Automatic
Control 48:246, 2003) the estimate from a window is combined with the estimate from the time before its first sample, so
that no sample is used twice. Both are normal in the logarithms, and so is their product. The earlier estimate is
widened for changes of the parameters by the value of :data:`WIDTHS` that maximises the likelihood of the difference of
the two. The initial state of a window is estimated from the window alone.

A jump of a sensor's zero (:mod:`bench.contract.zero`) is removed; its size is then refined by the mean of the residuals
after the jump.
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
"""Distance from the reconstruction (robust standard deviations) beyond which a sample is excluded in a second fit."""
WIDTHS = (0.0, 0.003, 0.03, 0.3, 3.0)
"""Candidates for the standard deviation of the change of the log-parameters since the window began."""


class WindowTracker(Tracker):
    """Tracker that fits a moving window of samples. Subclasses implement :meth:`answer`.

    Args:
        layout: Description of the stream.
        length: Number of samples in the window.
        every: Number of new samples between fits.
        arrival: True to combine each fit with the estimate from before the window.
    """

    state_names: ClassVar[tuple[str, ...]] = (
        "times", "values", "pushes", "unseen", "belief_mean", "belief_covariance", "belief_names",
        "past_times", "past_means", "past_covariances", "zero", "jumped",
    )  # fmt: skip

    def __init__(self, layout: Layout, length: int, every: int, arrival: bool = False) -> None:
        super().__init__(layout)
        self.length, self.every, self.arrival = length, every, arrival
        self.times = np.zeros(0)
        self.values, self.pushes = np.zeros((0, len(layout.sensors))), np.zeros((0, len(layout.forced)))
        self.unseen = 0
        self.zero, self.jumped = np.zeros(len(layout.sensors)), -np.inf  # time of the last jump (s)
        self.belief_mean, self.belief_covariance, self.belief_names = np.zeros(0), np.zeros((0, 0)), list[str]()
        self.past_times, self.past_means, self.past_covariances = list[float](), list[np.ndarray](), list[np.ndarray]()

    @abstractmethod
    def answer(self, problem: Problem) -> Estimate:
        """Estimate the parameters from a window whose times start at 0 (to be implemented)."""

    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Add a sample to the window, and fit the window if a fit is due.

        Args:
            sample: Sample whose missing and saturated values are NaN.
            steps: Sampling intervals since the previous sample.

        Returns:
            The estimate after the sample.
        """
        if steps > 1 and self.layout.forced:  # the force during the gap is unknown, so no fit may include the gap
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
        moved = self._remove_jumps()
        window, message = self._fit()
        if window is not None and moved:  # fit again with the refined zero
            window, message = self._fit()
        if window is None:
            return TrackerOutput(sample.time, SampleStatus.FAILED, self._distribution(), message=message)
        status = SampleStatus.SENSOR_JUMP if moved else SampleStatus.OK
        message = "the zero of a sensor has jumped; the jump is removed" if moved else ""
        if self.arrival:
            window = self._combine(window)
        self.belief_names, self.belief_mean = list(window.names), window.mean
        self.belief_covariance = np.asarray(window.covariance)
        return TrackerOutput(sample.time, status, self._distribution(), message=message)

    def _remove_jumps(self) -> bool:
        """Remove a jump of a sensor's zero from the window; return True if there was one."""
        if np.ptp(np.diff(self.times)) > 0.5 * self.layout.interval:
            return False
        first = remove_jumps(self.values, self.zero)
        if first is not None:
            self.jumped = float(self.times[first])
        return first is not None

    def _refine_zero(self, problem: Problem, estimate: Estimate) -> None:
        """Correct the zeros by the median residual after the last jump."""
        jump = self.jumped - self.times[0]
        if not estimate.reconstructions or not np.isfinite(jump):
            return
        for i, channel in enumerate(problem.records[0].channels):
            late = channel.times >= jump - 0.5 * self.layout.interval
            if channel.measures == "displacement" and late.any():
                residuals = channel.values[late] - estimate.reconstructions[0](channel.times[late])[channel.dof]
                self.values[self.times - self.times[0] >= jump - 0.5 * self.layout.interval, i] -= np.median(residuals)
                self.zero[i] += np.median(residuals)

    def _distribution(self) -> Normal | None:
        if not self.belief_names:
            return None
        return Normal(tuple(self.belief_names), self.belief_mean, self.belief_covariance, log=True)

    def _combine(self, window: Normal) -> Normal:
        """Combine the window's distribution with the one from before its first sample, which is then dropped."""
        if list(window.names) != self.belief_names:
            self.past_times, self.past_means, self.past_covariances = [], [], []
        before = [i for i, t in enumerate(self.past_times) if t < self.times[0]]
        if before:
            newest = before[-1]
            window = product(window, self.past_means[newest], self.past_covariances[newest])
            for past in (self.past_times, self.past_means, self.past_covariances):
                del past[:newest]
        assert window.covariance is not None
        self.past_times.append(float(self.times[-1]))
        self.past_means.append(window.mean)
        self.past_covariances.append(window.covariance)
        return window

    def _fit(self) -> tuple[Normal | None, str]:
        """Fit the window, and again without outliers; return the distribution, or None and the reason."""
        times = (self.times - self.times[0]).round(12)
        problem = window_problem(self.layout, times, self.values, self.pushes)
        if problem is None:
            return None, "too few samples of the window are valid"
        estimate = self.answer(problem)
        clean = _without_spikes(problem, estimate)
        if clean is not None:
            estimate = self.answer(clean)
        if estimate.status is not Status.OK:
            return None, estimate.message
        self._refine_zero(problem, estimate)
        return _log_distribution(estimate, self.layout)


def product(window: Normal, mean: np.ndarray, covariance: np.ndarray) -> Normal:
    """Combine a distribution with an earlier one, which is first widened by the most likely of :data:`WIDTHS`.

    Args:
        window: Distribution of d quantities from the window.
        mean: Mean of the earlier distribution, shape (d,).
        covariance: Covariance of the earlier distribution, shape (d, d).

    Returns:
        The product of the two normal densities, normalised.
    """
    assert window.covariance is not None
    difference, size = window.mean - mean, len(window.mean)

    def minus_log_likelihood(width: float) -> float:
        spread = window.covariance + covariance + width**2 * np.eye(size)
        return float(difference @ np.linalg.solve(spread, difference) + np.linalg.slogdet(spread)[1])

    widened = covariance + min(WIDTHS, key=minus_log_likelihood) ** 2 * np.eye(size)
    gain = np.linalg.solve(window.covariance + widened, widened).T
    combined = widened - gain @ widened
    return replace(window, mean=mean + gain @ difference, covariance=0.5 * (combined + combined.T))


def window_problem(layout: Layout, times: np.ndarray, values: np.ndarray, pushes: np.ndarray) -> Problem | None:
    """Return the problem of a batch method for a window of samples.

    Args:
        layout: Description of the stream.
        times: Times (s), shape (n,).
        values: Values, shape (n, n_sensors); NaN if missing.
        pushes: Known forces (N), shape (n, n_forced).

    Returns:
        The problem; None if a sensor has no valid value.
    """
    channels = []
    for sensor, column in zip(layout.sensors, values.T, strict=True):
        valid = np.isfinite(column)
        if not valid.any():
            return None
        channels.append(Channel(times[valid], column[valid], sensor.measures, sensor.dof))
    forces = tuple(
        Force(times, column, hold="zero_order", dof=dof) for dof, column in zip(layout.forced, pushes.T, strict=True)
    )
    return Problem(layout.system, (Record(tuple(channels), forces),))


def _without_spikes(problem: Problem, estimate: Estimate) -> Problem | None:
    """Remove outliers with respect to the reconstruction; return None if there are none, or no reconstruction."""
    if estimate.status is not Status.OK or not estimate.reconstructions:
        return None
    record, channels, dropped = problem.records[0], [], 0
    for channel in record.channels:
        if channel.measures != "displacement":
            channels.append(channel)
            continue
        residuals = channel.values - estimate.reconstructions[0](channel.times)[channel.dof]
        deviations = np.abs(residuals - np.median(residuals))
        near = deviations <= SPIKE * 1.4826 * np.median(deviations)
        dropped += int(np.sum(~near))
        channels.append(replace(channel, times=channel.times[near], values=channel.values[near]))
    return replace(problem, records=(replace(record, channels=tuple(channels)),)) if dropped else None


def _log_distribution(estimate: Estimate, layout: Layout) -> tuple[Normal | None, str]:
    """Return a normal distribution of logarithms; for groups, it matches their 95 % intervals."""
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
