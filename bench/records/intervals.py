"""Two 95 % intervals of every quantity of a measured record: of this record, and of a repeat of the test.

The logarithms of the free parameters are jointly normal, so every quantity that is a product of their powers (k/m, c/m,
the frequency, the damping ratio) has intervals that agree with those of the others.

*This record*: the covariance of a fit whose noise has the colour of the residuals (``linearised_fit``),
wider where the method's own interval is wider than that of least squares, and the error of the clock.

*A repeat*: to this the variance between repeats is added. It is estimated from the differences between parts of the
record (:mod:`bench.records.parts`) by a random-effects model in which each part counts by its own variance (R. C.
Paule, J. Mandel, J. Res. Natl. Bur. Stand. 87:377, 1982), and drawn towards a prior spread as by a scaled inverse
chi-square prior (A. Gelman and others, Bayesian Data Analysis, 3rd ed. 2013, section 2.6). A dependence on the
amplitude that the parts show is the same in every repeat, and only the amplitude of the release differs. Of several
records it is the variance between the records.

A quantity whose interval would be wider than a factor of three either way is not determined: one limit is stated.
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
"""Half of a 95 % interval over the standard error."""
PRIOR_SPREAD: Mapping[str, float] = {"mass": 0.002, "stiffness": 0.002, "damping": 0.04, "other": 0.02}
"""Standard deviation of a log-parameter by its kind: between repeats, which parts of one record cannot show (another
temperature, another clamping), and once more between parts, before the data."""
PRIOR_DOF = 5.0
"""Degrees of freedom of the spread between parts before the data: it weighs as much as six parts."""
PRIOR_SLOPE: Mapping[str, float] = {"mass": 0.02, "stiffness": 0.02, "damping": 0.3, "other": 0.1}
"""Standard deviation of a log-parameter's derivative by the log of the amplitude, before the data."""
AMPLITUDES = 0.2
"""Standard deviation of the log of the amplitude between repeats: a release by hand."""
CHANCE = 0.01
"""Probability that noise alone makes parts, or repeats, differ as much, below which they count as different."""
WIDEST = math.log(3.0)
"""Half-width of a logarithm beyond which the value is not determined and a limit is stated."""
ASSUMED_DOF = 60.0
"""Degrees of freedom of a spread that is the prior's alone: taken as known."""

ENDS = ("value", "low", "high", "record_low", "record_high", "white_low", "white_high")
"""The numbers of an interval that have the quantity's unit."""
Limit = Literal["", "at most", "at least"]


@dataclass(frozen=True)
class StatedInterval:
    """A quantity with 95 % intervals: of a repeat of the test, of this record, and assuming white noise.

    With a ``limit`` the data determine only one end of the interval of a repeat, at 95 %: ``high`` if "at most"
    (``low`` is 0), ``low`` if "at least" (``high`` is infinite). ``unevenness``: the standard deviation between parts
    or repeats over the one that was expected before the data; 1 where noise explains their differences.
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
        """Width of this record's interval over that assuming white noise."""
        width, white = self.record_high - self.record_low, self.white_high - self.white_low
        return width / white if 0 < white < math.inf and math.isfinite(width) else 1.0

    @property
    def relative_error(self) -> float:
        """Half of the interval of a repeat over the value."""
        return (self.high - self.low) / 2.0 / abs(self.value) if self.value else math.inf


def stated_intervals(
    estimate: Estimate,
    fit: LinearisedFit | None,
    parts: Sequence[PartFit] = (),
    rate_error: float = 0.0,
    classes: ClassComparison | None = None,
) -> dict[str, StatedInterval]:
    """Return the quantities that an answer determines, each with its intervals.

    Args:
        estimate: The answer, in the user's units, combined with the prior.
        fit: The likelihood there; without one, or where it leaves a direction open, the method's interval is stated.
        parts: Fits of the parts of the record, or of each of several records; maybe none.
        rate_error: Relative standard uncertainty of the clock.
        classes: Model classes that were compared; those that the record cannot tell apart widen the intervals.
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
            # where the scale is open all parameters may be infinite together; what is over the mass may vanish
            power = -1.0 if quantity.exponents.get(estimate.system.gauge, 1.0) > 0 else 1.0
            interval = limited(interval, math.log(interval.high / interval.low) / 2.0 / HALF, power)
        intervals[quantity.name] = interval
    return intervals


@dataclass(frozen=True, eq=False)
class JointCovariance:
    """Variances of the logs of the free parameters' ratios to the gauge mass, in which repeats differ independently.

    ``to`` (k, k): from the logs of the parameters to those of the ratios. ``white``, ``record`` (k, k): covariances of
    this record. ``clock`` (k,): standard errors by that of the clock. ``repeats`` (k,): variances that repeats add.
    ``unevenness`` (k,): as in :class:`StatedInterval`. ``infinite`` (k,): whether a ratio may be infinite, as a mass
    that only the force determines; the others may vanish.
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
        """Return a method's interval with those of the record and of a repeat.

        ``gradient`` (k,): of its logarithm; ``classes``: its variance between model classes that are as good.
        """
        powers, record_quantile = np.linalg.solve(self.to.T, gradient), _quantile(self.record_dof)
        width = (interval.high - interval.low) / interval.value
        if interval.low > 0 and math.isfinite(width):  # a method's interval is symmetric about the value or its log
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
    """Compute the variances of an answer, see :func:`stated_intervals`; None where a direction is open."""
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
        several = len(fit.model.problem.records) > 1  # records are repeats: there is no trend from one to the next
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
    """State the end that the data determine of a quantity whose logarithm has a large standard ``error``.

    The parameter that is open, of which the quantity is a ``power``, may vanish, and is determined to so much on its
    own scale, not on that of its logarithm; of one that may be infinite, the reciprocal is (a negative ``power``).
    """
    factor = float((1.0 + float(standard_quantile(0.95, None)) * error / abs(power)) ** abs(power))
    if power > 0:
        high = interval.value * factor
        return replace(interval, low=0.0, high=high, record_low=0.0, record_high=high, limit="at most")
    low = interval.value / factor
    return replace(interval, low=low, high=math.inf, record_low=low, record_high=math.inf, limit="at least")


class Heterogeneity(NamedTuple):
    """Differences of values beyond their errors.

    ``variance`` between them beyond a line, ``slope`` of the line, and the ``chance`` that errors alone make as much of
    a difference.
    """

    variance: float
    slope: float
    chance: float


def between_parts(
    values: np.ndarray, errors: np.ndarray, prior: float, sizes: np.ndarray, prior_slope: float
) -> Heterogeneity:
    """Estimate what ``values`` (n,) with variances ``errors`` (n,) differ by, drawn towards a ``prior`` variance."""
    variance, _, chance = paule_mandel(values, errors, sizes, prior_slope)
    dof = values.size - 1
    variance = (dof * variance + PRIOR_DOF * prior) / (dof + PRIOR_DOF)
    return Heterogeneity(variance, _line(values, errors + variance, sizes, prior_slope)[1], chance)


def paule_mandel(
    values: np.ndarray, errors: np.ndarray, sizes: np.ndarray | None = None, prior_slope: float = 1.0
) -> Heterogeneity:
    """Find the variance at which the weighted sum of squares of values (n,) equals its degrees of freedom; at least 0.

    The values, with variances ``errors`` (n,), lie about a line over ``sizes`` (n,), the logs of the amplitudes, whose
    slope has a normal prior about zero of variance ``prior_slope``: one more square and one more unknown, so that n - 1
    degrees of freedom are left. Without a variance the sum has their chi-square distribution (W. G. Cochran, Biometrics
    10:101, 1954).
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
    """Fit a line to values (n,); return the weighted sum of squares about it, that of the prior too, and its slope."""
    weights = 1.0 / variances
    x, y = (values - np.sum(weights * values) / np.sum(weights) for values in (sizes, values))
    slope = float(np.sum(weights * x * y) / (np.sum(weights * x**2) + 1.0 / prior_slope))
    return float(np.sum(weights * (y - slope * x) ** 2)) + slope**2 / prior_slope, slope
