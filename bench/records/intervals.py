"""95 % intervals of the quantities of a measured record: for this record, and for a repeat of the test.

The logarithms of the free parameters are jointly normal, so the intervals of all quantities that are products of their
powers (k/m, c/m, natural frequency, damping ratio) are consistent.

*This record*: the covariance of the estimate for noise of the colour of the residuals (``linearised_fit``), widened if
the method's interval is wider than that of least squares, plus the error of the clock.

*A repeat*: the variance between repeats is added. It is estimated from the differences between parts of the record
(:mod:`bench.records.parts`) by a random-effects model (R. C. Paule, J. Mandel, J. Res. Natl. Bur. Stand. 87:377, 1982),
and shrunk towards a prior variance as by a scaled inverse chi-square prior (A. Gelman and others, Bayesian Data
Analysis, 3rd ed. 2013, section 2.6). A dependence on the amplitude, estimated from the parts, is common to all repeats,
which differ in their amplitude. For several records it is the variance between the records.

A quantity whose interval would reach beyond a factor of three from its value is not determined: one limit is stated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from bench.contract.distribution import standard_quantile
from bench.contract.estimate import Estimate
from bench.records.linearised_fit import LinearisedFit
from bench.records.models import ClassComparison
from bench.records.parts import PartFit

UPPER = 0.975
HALF = float(standard_quantile(UPPER, None))
"""Half-width of a 95 % interval over the standard error."""
PRIOR_SPREAD: Mapping[str, float] = {"mass": 0.002, "stiffness": 0.002, "damping": 0.04, "other": 0.02}
"""Prior standard deviation of a log-parameter by its kind: between repeats, due to causes that do not act within a
record (temperature, clamping), and again between parts."""
PRIOR_DOF = 5.0
"""Degrees of freedom of the prior variance between parts; it weighs as much as six parts."""
PRIOR_SLOPE: Mapping[str, float] = {"mass": 0.02, "stiffness": 0.02, "damping": 0.3, "other": 0.1}
"""Prior standard deviation of the derivative of a log-parameter with respect to the log of the amplitude."""
AMPLITUDES = 0.2
"""Standard deviation of the log of the amplitude between repeats, for a release by hand."""
CHANCE = 0.01
"""p-value under noise alone below which parts or repeats differ significantly."""
WIDEST = math.log(3.0)
"""Half-width of a logarithm above which the value is not determined and a limit is stated."""
ASSUMED_DOF = 60.0
"""Degrees of freedom of a variance that is the prior's alone, which is treated as known."""

ENDS = ("value", "low", "high", "record_low", "record_high", "white_low", "white_high")
"""Fields of an interval that have the quantity's unit."""
Limit = Literal["", "at most", "at least"]


@dataclass(frozen=True)
class StatedInterval:
    """Value of a quantity with 95 % intervals.

    Attributes:
        value: Estimate, in ``unit``.
        low: Lower end for a repeat of the test.
        high: Upper end for a repeat of the test.
        record_low: Lower end for this record.
        record_high: Upper end for this record.
        white_low: Lower end assuming white noise.
        white_high: Upper end assuming white noise.
        unit: Unit.
        limit: If only one end is determined: "at most" (``low`` is 0) or "at least" (``high`` is infinite).
        unevenness: Standard deviation between parts or repeats over the prior one; 1 if noise explains the differences.
    """

    value: float
    low: float
    high: float
    record_low: float
    record_high: float
    white_low: float
    white_high: float
    unit: str
    limit: Limit = ""
    unevenness: float = 1.0

    @property
    def colour(self) -> float:
        """Ratio of the width of this record's interval to that assuming white noise."""
        width, white = self.record_high - self.record_low, self.white_high - self.white_low
        return width / white if 0 < white < math.inf and math.isfinite(width) else 1.0

    @property
    def relative_error(self) -> float:
        """Half-width of the interval of a repeat over the value."""
        return (self.high - self.low) / 2.0 / abs(self.value) if self.value else math.inf


def stated_intervals(
    estimate: Estimate,
    fit: LinearisedFit | None,
    parts: Sequence[PartFit] = (),
    rate_error: float = 0.0,
    classes: ClassComparison | None = None,
) -> dict[str, StatedInterval]:
    """Return the intervals of the quantities that an estimate determines, by name.

    Args:
        estimate: The estimate, in the user's units, combined with the prior.
        fit: Linearised likelihood at the estimate; the method's interval is stated if it is None or singular.
        parts: Fits of the parts of the record, or of each of several records; may be empty.
        rate_error: Relative standard uncertainty of the sampling rate.
        classes: Compared model classes; differences between tied classes widen the intervals.
    """
    joint = None if fit is None else joint_covariance(fit, parts, rate_error)
    intervals = {}
    for quantity in estimate.system.quantities:
        marginal = estimate.marginal(quantity)
        if marginal is None:
            continue
        ends = marginal.interval(0.95)
        interval = StatedInterval(float(marginal.value), *ends, *ends, *ends, quantity.unit)
        gradient = np.array(quantity.vector(fit.model.free)) if fit is not None else np.zeros(1)
        if joint is not None and marginal.ppf is not None and np.any(gradient) and interval.value > 0:
            interval = joint.stated(interval, gradient, 0.0 if classes is None else classes.variance(quantity.name))
        elif interval.value == 0:
            interval = replace(interval, limit="at most")
        elif 0 < interval.low < interval.high < math.inf and math.log(interval.high / interval.low) > 2.0 * WIDEST:
            # Without a known scale, the parameters have no upper limit, and ratios to the mass have no lower one.
            power = -1.0 if quantity.exponents.get(estimate.system.gauge, 1.0) > 0 else 1.0
            interval = limited(interval, math.log(interval.high / interval.low) / 2.0 / HALF, power)
        intervals[quantity.name] = interval
    return intervals


@dataclass(frozen=True, eq=False)
class JointCovariance:
    """Covariances of the logarithms of the ratios of free parameters to the gauge mass, which vary independently.

    Attributes:
        to: Transformation of log-parameters to log-ratios, shape (k, k).
        white: Covariance for this record assuming white noise, shape (k, k).
        record: Covariance for this record, shape (k, k).
        clock: Errors due to the sampling rate, shape (k,).
        repeats: Additional variances of a repeat, shape (k,).
        unevenness: As in :class:`StatedInterval`, shape (k,).
        infinite: Mask of ratios without an upper limit, such as a mass determined by the force; shape (k,).
        record_dof: Degrees of freedom of the noise.
        repeats_dof: Degrees of freedom of the variance of repeats.
    """

    to: np.ndarray
    white: np.ndarray
    record: np.ndarray
    clock: np.ndarray
    repeats: np.ndarray
    unevenness: np.ndarray
    infinite: np.ndarray
    record_dof: float
    repeats_dof: float

    def stated(self, interval: StatedInterval, gradient: np.ndarray, classes: float) -> StatedInterval:
        """Return a method's interval with the ends for this record and for a repeat.

        Args:
            interval: The method's interval.
            gradient: Derivative of the quantity's logarithm by the log-parameters, shape (k,).
            classes: Variance of the logarithm between tied model classes.
        """
        powers, record_quantile = np.linalg.solve(self.to.T, gradient), _quantile(self.record_dof)
        width = (interval.high - interval.low) / interval.value
        if interval.low > 0 and math.isfinite(width):  # the interval is symmetric on the linear or on the log scale
            width = min(width, math.log(interval.high / interval.low))
        least = 2.0 * record_quantile * math.sqrt(max(powers @ self.white @ powers, 1e-300))
        over = max(width / least, 1.0) if math.isfinite(width) else 1.0
        noise = over**2 * float(powers @ self.record @ powers) + float(powers @ self.clock) ** 2 + classes
        total = max(noise, 1e-300) + float(powers**2 @ self.repeats)
        record, repeat = record_quantile * math.sqrt(noise), _quantile(self.repeats_dof) * math.sqrt(total)
        interval = replace(interval, unevenness=float(np.max(self.unevenness[powers != 0])))
        if repeat > WIDEST:
            leading = int(np.argmax(powers**2 * (np.diag(self.record) + self.repeats)))
            return limited(interval, math.sqrt(total), -powers[leading] if self.infinite[leading] else powers[leading])
        low, high, record_low, record_high = (
            interval.value * math.exp(half) for half in (-repeat, repeat, -record, record)
        )
        return replace(interval, low=low, high=high, record_low=record_low, record_high=record_high)


def joint_covariance(fit: LinearisedFit, parts: Sequence[PartFit], rate_error: float) -> JointCovariance | None:
    """Compute the covariances at a fit, with arguments as :func:`stated_intervals`; None if the fit is singular."""
    if fit.white is None or fit.coloured is None:
        return None
    system, free, k = fit.model.system, fit.model.free, len(fit.model.free)
    to = np.eye(k)
    if system.gauge in free:
        to[:, free.index(system.gauge)] -= [
            system.dimensions[name].mass if name != system.gauge else 0.0 for name in free
        ]
    white, coloured = (to @ c[:k, :k] @ to.T for c in (fit.white, fit.coloured))
    clock = to @ [system.dimensions[name].time for name in free] * rate_error
    kinds = {parameter.name: parameter.kind for parameter in system.parameters}
    expected, slopes = (np.array([sd[kinds[name]] ** 2 for name in free]) for sd in (PRIOR_SPREAD, PRIOR_SLOPE))
    unevenness, repeats = np.ones(k), 2.0 * expected + slopes * AMPLITUDES**2
    if len(parts) > 1:
        logs = np.array([to @ part.logs for part in parts])
        errors = np.array([np.diag(to @ part.covariance @ to.T) for part in parts])
        several = len(fit.model.problem.records) > 1  # records are repeats, between which there is no trend
        sizes = np.zeros(len(parts)) if several else np.log([part.amplitude for part in parts])
        for i in range(k):
            between = between_parts(logs[:, i], errors[:, i], expected[i], sizes, slopes[i])
            weights = 1.0 / (errors[:, i] + between.variance)
            mean_error = between.variance * float(np.sum(weights**2) / np.sum(weights) ** 2)
            repeats[i] = (between.variance if several else expected[i]) + mean_error + (between.slope * AMPLITUDES) ** 2
            unevenness[i] = math.sqrt(between.variance / expected[i]) if between.chance < CHANCE else 1.0
    return JointCovariance(
        to, white, coloured, clock, repeats, unevenness, np.array(free) == system.gauge,
        max(fit.residuals.size - fit.used, 1.0), PRIOR_DOF + len(parts) - 1 if parts else ASSUMED_DOF,
    )  # fmt: skip


def _quantile(dof: float) -> float:
    return float(standard_quantile(UPPER, dof))


def limited(interval: StatedInterval, error: float, power: float) -> StatedInterval:
    """Return an interval with a single limit, for a quantity whose logarithm has a large standard error.

    The undetermined parameter is normal on its linear scale rather than on the log scale; its reciprocal is, if it has
    no upper limit.

    Args:
        interval: The interval.
        error: Standard error of the logarithm.
        power: Power of the undetermined parameter in the quantity; negative for a lower limit.
    """
    factor = float((1.0 + float(standard_quantile(0.95, None)) * error / abs(power)) ** abs(power))
    if power > 0:
        high = interval.value * factor
        return replace(interval, low=0.0, high=high, record_low=0.0, record_high=high, limit="at most")
    low = interval.value / factor
    return replace(interval, low=low, high=math.inf, record_low=low, record_high=math.inf, limit="at least")


class Heterogeneity(NamedTuple):
    """Heterogeneity of values: ``variance`` about a line, its ``slope``, and ``chance``, the p-value of homogeneity."""

    variance: float
    slope: float
    chance: float


def between_parts(
    values: np.ndarray, errors: np.ndarray, prior: float, sizes: np.ndarray, prior_slope: float
) -> Heterogeneity:
    """Estimate the heterogeneity as :func:`paule_mandel`, with the variance shrunk towards a ``prior`` variance."""
    variance, _, chance = paule_mandel(values, errors, sizes, prior_slope)
    dof = values.size - 1
    variance = (dof * variance + PRIOR_DOF * prior) / (dof + PRIOR_DOF)
    return Heterogeneity(variance, _line(values, errors + variance, sizes, prior_slope)[1], chance)


def paule_mandel(
    values: np.ndarray, errors: np.ndarray, sizes: np.ndarray | None = None, prior_slope: float = 1.0
) -> Heterogeneity:
    """Estimate the variance of values about a line, at which the weighted sum of squares is its degrees of freedom.

    The slope has a normal prior of zero mean, which adds a square and an unknown, so there are n - 1 degrees of
    freedom. The p-value is that of the chi-square distribution (W. G. Cochran, Biometrics 10:101, 1954).

    Args:
        values: Values, shape (n,).
        errors: Their variances, shape (n,).
        sizes: Abscissas, the logarithms of the amplitudes, shape (n,); without them there is no slope.
        prior_slope: Prior variance of the slope.
    """
    from scipy.optimize import brentq
    from scipy.stats import chi2

    sizes, dof = np.zeros(values.size) if sizes is None else sizes, values.size - 1
    if dof < 1:
        return Heterogeneity(0.0, 0.0, 1.0)
    squares, slope = _line(values, errors, sizes, prior_slope)
    chance, variance = float(chi2.sf(squares, dof)), 0.0
    if squares > dof:
        high = float(np.sum((values - np.mean(values)) ** 2)) / dof
        variance = float(brentq(lambda u: _line(values, errors + u, sizes, prior_slope)[0] - dof, 0.0, high, rtol=1e-8))
        slope = _line(values, errors + variance, sizes, prior_slope)[1]
    return Heterogeneity(variance, slope, chance)


def _line(values: np.ndarray, variances: np.ndarray, sizes: np.ndarray, prior_slope: float) -> tuple[float, float]:
    """Fit a line to values (n,); return the weighted sum of squares, including the prior's, and the slope."""
    weights = 1.0 / variances
    x, y = (values - np.sum(weights * values) / np.sum(weights) for values in (sizes, values))
    slope = float(np.sum(weights * x * y) / (np.sum(weights * x**2) + 1.0 / prior_slope))
    return float(np.sum(weights * (y - slope * x) ** 2)) + slope**2 / prior_slope, slope
