"""Covariance-driven stochastic subspace identification in windows, for ambient excitation.

Correlations of the samples at lags of one and more (lag zero contains the sensor noise) fill a block Hankel matrix, the
product of observability and controllability matrices. Its two largest singular values belong to one mass, and the
shift invariance of the observability matrix gives the poles (P. Van Overschee, B. De Moor, Subspace Identification for
Linear Systems, 1996; B. Peeters, G. De Roeck, Mech. Syst. Signal Process. 13:855, 1999). ``k/m = s1 s2`` and
``c/m = -(s1 + s2)`` with ``s = ln z / h``, as for a free decay.

The interval is a jackknife over blocks of the window. A known force is not used.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from bench import Layout, Normal, OnlineCard, OnlineIdentifier, Sample, SampleStatus, Tracker, TrackerOutput
from methods.modal.matrix_pencil import groups_from_poles
from methods.online.likelihood import without_spikes

BLOCKS = 12
FEWEST_ROWS, MOST_ROWS = 4, 120
"""Limits of the Hankel matrix's block rows, which span :data:`CYCLES` cycles."""
CYCLES = 2.0


@dataclass(frozen=True)
class OnlineSSI(OnlineIdentifier):
    """An estimate from the last ``length`` samples, every ``every`` samples."""

    length: Annotated[int, Interval(ge=200)] = 1500
    every: Annotated[int, Interval(ge=1)] = 25
    card: ClassVar[OnlineCard] = OnlineCard(
        "covariance-driven stochastic subspace identification in windows",
        "B. Peeters, G. De Roeck, Mech. Syst. Signal Process. 13:855, 1999",
        "rows: two cycles; window: 100 cycles or fewer at 15 samples a cycle",
        "SSI, window",
        120,
    )

    def objection(self, layout: Layout) -> str | None:
        """Require an unknown force and one linear mass."""
        if layout.system.n_dof > 1 or not layout.system.linear or len(layout.system.names) != 3:
            return "it supports one mass, spring and damper only"
        if not layout.ambient:
            return "it requires an unknown white force; it cannot use a known one"
        return None

    def start(self, layout: Layout) -> Tracker:
        """Return a tracker before its first sample."""
        return _SSITracker(layout, self)


class _SSITracker(Tracker):
    state_names = ("values", "unseen", "mean", "covariance")

    def __init__(self, layout: Layout, settings: OnlineSSI) -> None:
        super().__init__(layout)
        self.settings = settings
        self.values, self.unseen = np.zeros((0, len(layout.sensors))), 0
        self.mean, self.covariance = np.zeros(0), np.zeros((0, 0))

    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Store a sample; estimate when due. Missing samples are left out of the correlations."""
        missing = np.full((min(max(steps - 1, 0), self.settings.length), len(self.layout.sensors)), np.nan)
        self.values = np.concatenate([self.values, missing, [sample.values]])[-self.settings.length :]
        self.unseen += 1
        if len(self.values) < self.settings.length or self.unseen < self.settings.every:
            waits = not self.mean.size
            status = SampleStatus.WARMING_UP if waits else SampleStatus.OK
            return TrackerOutput(
                sample.time, status, self._distribution(), message="the window is not full" if waits else ""
            )
        self.unseen = 0
        answer = self._fitted()
        if answer is None:
            message = "the dominant poles of the window are not those of an oscillator"
            return TrackerOutput(sample.time, SampleStatus.FAILED, self._distribution(), message=message)
        self.mean, self.covariance = answer
        return TrackerOutput(sample.time, SampleStatus.OK, self._distribution())

    def _distribution(self) -> Normal | None:
        return Normal(self.layout.free, self.mean, self.covariance, log=True) if self.mean.size else None

    def _fitted(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return mean and covariance of log c/m and log k/m; None where a block gives no oscillator."""
        values = without_spikes(self.values - np.nanmean(self.values, axis=0))
        rows = self._rows(values)
        by_block = _products(values, 2 * rows)
        whole = by_block.sum(axis=0)
        logs = np.array([self._logs(products, rows) for products in (whole, *(whole - by_block))])
        if not np.all(np.isfinite(logs)):
            return None
        off = logs[1:] - np.mean(logs[1:], axis=0)
        return logs[0], (BLOCKS - 1) / BLOCKS * off.T @ off

    def _rows(self, values: np.ndarray) -> int:
        """Return the number of block rows: the samples of :data:`CYCLES` cycles of the strongest frequency."""
        n = len(values)
        power = np.sum(np.abs(np.fft.rfft(np.nan_to_num(values) * np.hanning(n)[:, None], axis=0)) ** 2, axis=1)
        top = 1 + int(np.argmax(power[1:]))
        return int(np.clip(round(CYCLES * n / top), FEWEST_ROWS, MOST_ROWS))

    def _logs(self, products: np.ndarray, rows: int) -> np.ndarray:
        """Return the logarithms of c/m and k/m, not finite where the poles are not those of an oscillator."""
        c = products.shape[1]
        lags = np.arange(rows)[:, None] + np.arange(rows)[None] + 1
        hankel = products[lags - 1].transpose(0, 2, 1, 3).reshape(rows * c, rows * c)
        left, sizes, _ = np.linalg.svd(hankel)
        observability = left[:, :2] * np.sqrt(sizes[:2])
        poles = np.linalg.eigvals(np.linalg.lstsq(observability[:-c], observability[c:], rcond=None)[0])
        with np.errstate(all="ignore"):
            return np.asarray(np.log(groups_from_poles(poles[None].astype(complex), self.layout.interval)[0, ::-1]))


def _products(values: np.ndarray, lags: int) -> np.ndarray:
    """Return sums of products at lags 1 to ``lags`` by block, (BLOCKS, lags, c, c), scaled for missing samples."""
    measured = np.isfinite(values)
    filled, counted = np.where(measured, values, 0.0), measured.astype(float)
    edges = np.linspace(0, len(values) - lags, BLOCKS + 1).round().astype(int)
    sums = np.empty((BLOCKS, lags, values.shape[1], values.shape[1]))
    for lag in range(1, lags + 1):
        for block, (low, high) in enumerate(itertools.pairwise(edges.tolist())):
            total = filled[low + lag : high + lag].T @ filled[low:high]
            number = counted[low + lag : high + lag].T @ counted[low:high]
            sums[block, lag - 1] = total * (high - low) / np.maximum(number, 1.0)
    return sums
