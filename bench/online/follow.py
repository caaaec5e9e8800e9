"""Application of a tracker to a stream: its estimates after each sample, and its time and memory."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from bench.contract.online import Layout, OnlineIdentifier, SampleStatus, Tracker, TrackerOutput
from bench.online.scenario import Stream


@dataclass(frozen=True, eq=False)
class Followed:
    """The path of a tracker over one stream of n samples.

    ``means`` and ``sds`` (n, n_quantities): mean and standard deviation of the logarithm of each quantity, NaN without
    a distribution; ``alarms`` (n,); ``status`` (n,); ``micros`` (n,): wall time per sample (µs); ``held_bytes``: size
    of the tracker's state at the end.
    """

    means: np.ndarray
    sds: np.ndarray
    alarms: np.ndarray
    status: np.ndarray
    micros: np.ndarray
    held_bytes: int


def moments(output: TrackerOutput, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of the logarithm of each quantity; NaN if the distribution has no value."""
    n = len(layout.quantities)
    means, sds, distribution = np.full(n, np.nan), np.full(n, np.nan), output.distribution
    if distribution is None or distribution.covariance is None:
        return means, sds
    for i, quantity in enumerate(layout.quantities):
        if quantity.name in distribution.names:
            j = distribution.names.index(quantity.name)
            means[i], sds[i] = distribution.mean[j], np.sqrt(distribution.covariance[j, j])
        elif set(layout.free) <= set(distribution.names):
            weights = np.array(quantity.vector(distribution.names))
            means[i] = weights @ distribution.mean + np.log(quantity.coefficient)
            sds[i] = np.sqrt(max(weights @ distribution.covariance @ weights, 0.0))
    return means, sds


def held_bytes(tracker: Tracker) -> int:
    """Return the size of all arrays in a tracker's state (bytes)."""
    return int(sum(np.asarray(value).nbytes for value in tracker.saved().values()))


def follow(method: OnlineIdentifier, stream: Stream) -> Followed:
    """Apply a tracker to all samples of a stream."""
    layout, samples = stream.layout, stream.samples()
    tracker = method.start(layout)
    n, q = len(samples), len(layout.quantities)
    means, sds = np.full((n, q), np.nan), np.full((n, q), np.nan)
    alarms, micros, status = np.full(n, np.nan), np.empty(n), np.empty(n, dtype="<U12")
    before: TrackerOutput | None = None
    for i, sample in enumerate(samples):
        started = time.perf_counter()
        standing = tracker.update(sample)
        micros[i] = 1e6 * (time.perf_counter() - started)
        same = before is not None and standing.distribution is before.distribution
        means[i], sds[i] = (means[i - 1], sds[i - 1]) if same else moments(standing, layout)
        alarms[i], status[i], before = standing.alarm, standing.status.value, standing
    return Followed(means, sds, alarms, status, micros, held_bytes(tracker))


def first_estimate(path: Followed) -> int:
    """Return the index of the first sample with a distribution; the number of samples if there is none."""
    there = np.flatnonzero(np.all(np.isfinite(path.means), axis=1) & (path.status != SampleStatus.WARMING_UP.value))
    return int(there[0]) if there.size else len(path.means)
