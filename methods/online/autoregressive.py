"""Recursive prediction-error identification of a discrete-time model with forgetting.

A sampled oscillator satisfies ``y_k + a1 y_(k-1) + a2 y_(k-2) = b1 f_(k-1) + b2 f_(k-2) + e_k + c1 e_(k-1) +
c2 e_(k-2)`` exactly, with a known force ``f`` held between samples and innovations ``e``. A least-squares
autoregression omits the moving average and is biased by the noise in its regressors. Two cases avoid this bias:

- with an unknown white force, force and sensor noise together give an autoregression with a moving average (ARMA);
- under a known force, white sensor noise makes the moving average equal to the autoregression (output error), and the
  regressors are the model's simulated outputs, which contain no noise.

All coefficients are updated by one Gauss-Newton step per sample on the squared prediction error (recursive maximum
likelihood: T. Söderström, L. Ljung, I. Gustavsson, Automatica 14:231, 1978; L. Ljung, T. Söderström, Theory and
Practice of Recursive Identification, 1983, section 3.7). Poles ``z`` give ``s = ln z / h``, hence ``k/m = s1 s2`` and
``c/m = -(s1 + s2)``; the static gain gives ``1/k``.

The recursion starts from the minimum of the squared prediction error of the first samples, found by a batch search from
several initial guesses, with a free initial state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from bench import Layout, Normal, OnlineCard, OnlineIdentifier, Sample, SampleStatus, TrackerOutput
from methods.discrete.ar import coefficient_slopes, coefficients_of
from methods.online.least_squares import LeastSquaresTracker

RADII = (0.5, 0.9, 0.98)
"""Initial guesses of the moving average under an unknown force: pole radii relative to the autoregression's."""
RATIOS = (0.01, 0.05, 0.2)
"""Initial guesses of the damping ratio."""
GATE = 6.0
IN_A_ROW = 5
ZEROED = 400
"""Samples after a jump of the sensor's zero over which the new zero is estimated."""
FADED = 0.02
"""After a gap, updates wait until the unknown initial state has decayed to this fraction in the innovations."""
MOST = 4
"""Largest number of first samples kept, in multiples of ``warm_up``, where some are missing."""
LEAST_MOVE = 1e-3


@dataclass(frozen=True)
class OnlineAR(OnlineIdentifier):
    """``factor``: forgetting factor per sample; ``warm_up``: samples of the initial batch search."""

    factor: Annotated[float, Interval(gt=0.5, le=1.0)] = 0.995
    warm_up: Annotated[int, Interval(ge=30)] = 150
    card: ClassVar[OnlineCard] = OnlineCard(
        "recursive maximum likelihood of a discrete ARMA model, or output error under a known force, with forgetting",
        "Söderström, Ljung and Gustavsson, Automatica 14:231, 1978",
        "factor: Ljung, System Identification Toolbox user's guide (0.98 to 0.995)",
        "AR, recursive",
        110,
    )

    def objection(self, layout: Layout) -> str | None:
        """Require one linear mass with one sensor, of displacement under a known force."""
        if layout.system.n_dof > 1 or not layout.system.linear or len(layout.system.names) != 3:
            return "it supports one mass, spring and damper only, whose two poles it estimates"
        if len(layout.sensors) != 1 or (layout.forced and layout.sensors[0].measures != "displacement"):
            return "it requires one sensor, of displacement under a known force"
        if layout.forced and layout.ambient:
            return "it supports a known or an unknown force, not both at once"
        return None

    def start(self, layout: Layout) -> LeastSquaresTracker:
        """Return a tracker before its first sample."""
        return _ARTracker(layout, self)


class _ARTracker(LeastSquaresTracker):
    """Tracker of the coefficients ``theta``: a1, a2, then b1, b2 where forced, else c1, c2, for scaled samples.

    ``recent``: regressors of the next prediction; ``slopes``: the last two gradients of the prediction.
    """

    state_names = (
        *LeastSquaresTracker.state_names, "begun", "head_values", "head_forces", "information", "recent", "slopes",
        "sizes", "far", "settling", "zero", "zeroed", "off",
    )  # fmt: skip

    def __init__(self, layout: Layout, settings: OnlineAR) -> None:
        super().__init__(layout, 4)
        self.settings, self.forced = settings, bool(layout.forced)
        self.head_values, self.head_forces = np.zeros(0), np.zeros(0)
        self.begun, self.far, self.settling = False, 0, 0
        self.sizes = np.ones(2)
        self.zero, self.zeroed, self.off = 0.0, ZEROED, 0.0
        self._forget_everything()

    def _forget_everything(self) -> None:
        self.information, self.recent, self.slopes = np.zeros((4, 4)), np.zeros(4), np.zeros((2, 4))

    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Collect the first samples; then make one Gauss-Newton step per sample."""
        value, force = float(sample.values[0]), float(sample.forces[0]) if self.forced else 0.0
        if not self.begun:
            return self._collected(sample, value, force, steps)
        if steps > 1 and len(self.skipped) == steps - 1:
            for known in self.skipped:
                self._pass_by(float(self.recent @ self.theta), known[0] / self.sizes[1] if self.forced else 0.0)
        elif steps > 1:
            self.recent, self.slopes = np.zeros_like(self.recent), np.zeros_like(self.slopes)
            radius = float(np.clip(np.sqrt(abs(self._average[1])), 0.5, 0.995))
            self.settling = 4 + int(np.log(FADED) / np.log(radius))
        y, f = value / self.sizes[0] - self.zero, force / self.sizes[1]
        predicted = float(self.recent @ self.theta)
        level = self.power / max(self.weight, 1.0)
        status, message = SampleStatus.OK, ""
        if not np.isfinite(y):
            self._pass_by(predicted, f)
        elif self.settling:
            self.settling -= 1
            self._pass_by(y, f)
        elif (y - predicted) ** 2 > GATE**2 * level and self.far < IN_A_ROW:
            status, message = self._outlying(y - predicted, np.sqrt(level))
            self._pass_by(predicted, f)
        else:
            self.far = (
                self.far if (y - predicted) ** 2 > GATE**2 * level else 0
            )  # after IN_A_ROW outliers no value is left out
            self._rezero(y - predicted)
            self._learn(y, f, self.settings.factor)
        if not np.all(np.isfinite(self.theta)):
            self.begun = False
            self.head_values, self.head_forces = np.zeros(0), np.zeros(0)
            return TrackerOutput(sample.time, SampleStatus.FAILED, message="the recursion diverged and is restarted")
        distribution = self._distribution()
        if distribution is None:
            return TrackerOutput(
                sample.time, SampleStatus.FAILED, message="the estimated poles are not those of an oscillator"
            )
        sd = self.sizes[0] * np.sqrt(np.array([level]))
        return TrackerOutput(
            sample.time, status, distribution, self.sizes[0] * np.array([predicted]), sd, message=message
        )

    def _outlying(self, left: float, sd: float) -> tuple[SampleStatus, str]:
        """Omit an outlier; several in a row with one sign are a jump of the sensor's zero, which is subtracted."""
        self.off, self.far = (self.off if self.far else 0.0) + left, self.far + 1
        if self.far < IN_A_ROW or abs(self.off) < IN_A_ROW * GATE * sd:
            return (
                SampleStatus.OUTLIER,
                f"a value is more than {GATE:g} standard deviations from its prediction; omitted",
            )
        self.zero, self.zeroed, self.far = self.zero + self.off / IN_A_ROW, IN_A_ROW, 0
        return (
            SampleStatus.SENSOR_JUMP,
            "several successive samples are outliers of one sign: the sensor's zero has jumped",
        )

    def _rezero(self, left: float) -> None:
        """Refine the zero for ``ZEROED`` samples after a jump, by averaging the innovations."""
        if self.zeroed >= ZEROED:
            return
        self.zeroed += 1
        reach = 1.0 if self.forced else (1.0 + self.theta[2:].sum()) / (1.0 + self.theta[:2].sum())
        self.zero += float(np.clip(reach, 0.1, 10.0)) * left / self.zeroed

    def _collected(self, sample: Sample, value: float, force: float, steps: int) -> TrackerOutput:
        if steps > 1 or self.head_values.size >= MOST * self.settings.warm_up:
            self.head_values, self.head_forces = np.zeros(0), np.zeros(0)
        self.head_values, self.head_forces = np.append(self.head_values, value), np.append(self.head_forces, force)
        waiting = TrackerOutput(sample.time, SampleStatus.WARMING_UP, message="collecting the first samples")
        there = np.isfinite(self.head_values)
        if np.sum(there) < self.settings.warm_up or not there[-1]:
            return waiting
        forces = self.head_forces[int(np.argmax(there)) :]
        values = _filled(self.head_values[int(np.argmax(there)) :])
        self.head_values, self.head_forces = np.zeros(0), np.zeros(0)
        self.sizes = np.array([np.sqrt(np.mean(values**2)) or 1.0, np.sqrt(np.mean(forces**2)) or 1.0])
        if not self._begin(values / self.sizes[0], forces / self.sizes[1]):
            return TrackerOutput(sample.time, SampleStatus.FAILED, message="no model explains the first samples")
        self.begun = True
        return TrackerOutput(sample.time, SampleStatus.OK, self._distribution())

    def _begin(self, y: np.ndarray, f: np.ndarray) -> bool:
        """Initialise the recursion by the best model of the first samples; False where there is none."""
        from scipy.optimize import least_squares  # slow to import

        errors = _output_errors if self.forced else _innovations
        ends = []
        for start in self._starts(y):
            try:
                end = least_squares(lambda eta: errors(eta, y, f)[0], start, method="lm", max_nfev=200)
            except (ValueError, np.linalg.LinAlgError):
                continue
            self.theta = errors(end.x, y, f)[1]
            if _invertible(self._average) and self._groups() is not None:
                ends.append((end.cost, end.x))
        if not ends:
            return False
        cost, eta = min(ends, key=lambda end: end[0])
        left, self.theta = errors(eta, y, f)
        self._forget_everything()
        for value, force in zip(y.tolist(), f.tolist(), strict=True):
            slope = self._slope()
            self.information = self.information + np.outer(slope, slope)
            self._shift(slope, value, force)
        shown = y - left
        if self.forced:  # including the free motion from the initial state
            self.recent = np.array([-shown[-1], -shown[-2], f[-1], f[-2]])
        self.inverse = np.asarray(np.linalg.pinv(self.information, hermitian=True), float)
        self.power, self.weight = 2.0 * cost, float(y.size - (2 if self.forced else 0))
        return self._distribution() is not None

    def _starts(self, values: np.ndarray) -> list[np.ndarray]:
        """Return initial guesses: log frequency per sample, log damping ratio, and c1, c2 under an unknown force."""
        power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(values.size))) ** 2
        peaks = 1 + np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:]))
        strongest = sorted(peaks.tolist() or [1], key=lambda i: -power[i])[:3]
        if self.forced:  # the strongest peak may belong to the force
            strongest = np.geomspace(1.0, values.size / 3.0, 12).tolist()
        poles = [np.log([2.0 * np.pi * i / values.size, ratio]) for i in strongest for ratio in RATIOS]
        if self.forced:
            return poles
        return [np.concatenate([eta, _coefficients(eta) * [r, r**2]]) for eta in poles for r in RADII]

    @property
    def _average(self) -> np.ndarray:
        """Return the moving average, under a known force the autoregression."""
        return self.theta[:2] if self.forced else self.theta[2:]

    def _slope(self) -> np.ndarray:
        """Return the gradient of the next prediction."""
        c = self._average
        return np.asarray(self.recent - c[0] * self.slopes[0] - c[1] * self.slopes[1])

    def _learn(self, y: float, f: float, keep: float) -> None:
        """Make a Gauss-Newton step, shortened so that the moving average stays invertible."""
        before, slope, move = self.theta, self._slope(), 1.0
        left = y - float(self.recent @ before)
        self.forget(keep)
        self.learn(slope, left)
        whole = self.theta - before
        while move > LEAST_MOVE and not _invertible(self._average):
            move *= 0.5
            self.theta = before + (move if move > LEAST_MOVE else 0.0) * whole
        self.information = keep**2 * self.information + np.outer(slope, slope)
        self._shift(slope, y, f)

    def _pass_by(self, y: float, f: float) -> None:
        """Advance past a sample without an update; for a missing one, ``y`` is its prediction."""
        self._shift(self._slope(), y, f)

    def _shift(self, slope: np.ndarray, y: float, f: float) -> None:
        """Advance the regressors and gradients by one sample."""
        expected, old = float(self.recent @ self.theta), self.recent
        self.slopes = np.stack([slope, self.slopes[0]])
        self.recent = np.array([-expected, old[0], f, old[2]] if self.forced else [-y, old[0], y - expected, old[2]])

    def _distribution(self) -> Normal | None:
        """Return the distribution of the log-parameters, by the delta method; None without an oscillator's poles."""
        groups, variance = self._groups(), self.variance
        if groups is None or variance is None:
            return None
        k_over_m, c_over_m = groups
        (by_k, by_c), (_, decay) = coefficient_slopes(groups, self.layout.interval).tolist()
        # derivatives by a1 and a2 of log k/m (k1, k2) and by a2 of log c/m (c2), and of log k (p, p, q, q)
        k1, k2, c2 = -1.0 / (by_k * k_over_m), by_c / (by_k * decay * k_over_m), -1.0 / (decay * c_over_m)
        if self.forced:
            rest, push = 1.0 + float(self.theta[:2].sum()), float(self.theta[2:].sum())
            p, q = 1.0 / rest, -1.0 / push
            jacobian = np.array([[p - k1, p - k2, q, q], [p - k1, p - k2 + c2, q, q], [p, p, q, q]])
            k = rest / push * self.sizes[1] / self.sizes[0]
            logs = np.log([k / k_over_m, k / k_over_m * c_over_m, k])
        else:
            jacobian = np.array([[0.0, c2, 0.0, 0.0], [k1, k2, 0.0, 0.0]])
            logs = np.log([c_over_m, k_over_m])
        # with exponential weights the covariance is a sandwich with the sum of squared weights in the middle
        spread = self.inverse @ self.information @ self.inverse * variance
        return Normal(self.layout.free, logs, jacobian @ spread @ jacobian.T, log=True)

    def _groups(self) -> tuple[float, float] | None:
        """Return k/m and c/m; None where poles or static gain are not those of an oscillator."""
        (a1, a2, b1, b2), h = self.theta.tolist(), self.layout.interval
        inside = a2 - 0.25 * a1**2
        large = -0.5 * a1 + math.sqrt(max(-inside, 0.0))  # the larger real root
        if not 0 < a2 < 1 or (inside <= 0 and large <= 0) or (self.forced and not (b1 + b2) / (1.0 + a1 + a2) > 0):
            return None
        c_over_m = -math.log(a2) / h
        if inside > 0:
            k_over_m = 0.25 * c_over_m**2 + (math.atan2(math.sqrt(inside), -0.5 * a1) / h) ** 2
        else:
            k_over_m = math.log(large) * math.log(a2 / large) / h**2
        return (k_over_m, c_over_m) if k_over_m > 0 else None


def _filled(values: np.ndarray) -> np.ndarray:
    """Interpolate missing values by a cubic spline, for the batch search."""
    from scipy.interpolate import CubicSpline  # slow to import

    measured = np.isfinite(values)
    if measured.all():
        return values
    index = np.arange(values.size)
    return np.where(measured, values, CubicSpline(index[measured], values[measured])(index))


def _invertible(c: np.ndarray) -> bool:
    """Return True where the roots of ``z² + c1 z + c2`` lie within the unit circle (Jury's conditions)."""
    return bool(abs(c[1]) < 0.9995 and abs(c[0]) < 1.0 + c[1])


def _coefficients(eta: np.ndarray) -> np.ndarray:
    """Return a1, a2 for the logarithms of frequency (radians per sample) and of damping ratio."""
    omega, ratio = np.exp(np.clip(eta[:2], -12.0, 3.0))
    return -coefficients_of(np.array([omega**2, 2.0 * ratio * omega]), 1.0)


def _innovations(eta: np.ndarray, y: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the one-step prediction errors of an ARMA model, and its coefficients."""
    from scipy.signal import lfilter

    a, c = _coefficients(eta), eta[2:4]
    if not _invertible(c):
        return np.full(y.size, 10.0 * (1.0 + abs(c[1]))), np.concatenate([a, c])
    return lfilter([1.0, *a], [1.0, *c], y), np.concatenate([a, c])


def _output_errors(eta: np.ndarray, y: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the output errors with b1, b2 and the initial state by least squares, and the coefficients."""
    from scipy.signal import lfilter

    a, n = _coefficients(eta), y.size
    inputs = np.zeros((n, 4))
    inputs[1:, 0], inputs[2:, 1], inputs[0, 2], inputs[1, 3] = f[:-1], f[:-2], 1.0, 1.0
    columns = lfilter([1.0], [1.0, *a], inputs, axis=0)
    linear = np.linalg.lstsq(columns, y, rcond=None)[0]
    return y - columns @ linear, np.concatenate([a, linear[:2]])
