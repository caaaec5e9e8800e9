"""Two 95 % intervals of every quantity of a measured record: of this record, and of a repeat of the test.

The logarithms of the free parameters are jointly normal, so every quantity that is a product of their powers (k/m, c/m,
the frequency, the damping ratio) has intervals that agree with those of the others.

*This record*: the covariance of a fit whose noise has the colour of the residuals (:mod:`bench.records.linearised`),
where the method's own covariance is not larger, and the error of the clock.

*A repeat*: to this the variance between repeats is added. It is estimated from the differences between parts of the
record (:mod:`bench.records.parts`) by a random-effects model in which each part counts by its own variance (R. C.
Paule, J. Mandel, J. Res. Natl. Bur. Stand. 87:377, 1982), and drawn towards a prior spread as by a scaled inverse
chi-square prior (A. Gelman and others, Bayesian Data Analysis, 3rd ed. 2013, section 2.6). A dependence on the
amplitude that the parts show is the same in every repeat, and only the amplitude of the release differs. Of several
records it is the variance between the records.

A quantity whose interval would be wider than a factor of three either way is not determined: one limit is stated.
Degrees of freedom: F. E. Satterthwaite, Biometrics Bull. 2:110, 1946.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bench.contract.belief import standard_quantile
from bench.contract.estimate import Estimate
from bench.records.linearised import CORRELATED_CYCLES, Linearised
from bench.records.models import ClassComparison
from bench.records.strongest import strongest_frequency

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
SWEEPS = 5
"""Alternations between slope and variance; they settle within three."""
WIDEST = math.log(3.0)
"""Half-width of a logarithm beyond which the value is not determined and a limit is stated."""
ASSUMED_DOF = 60.0
"""Degrees of freedom of a spread that is the prior's alone: taken as known."""
LEAST_DOF = 14.0
"""Degrees of freedom of a coloured variance, at least: those of a periodogram smoothed over seven frequencies."""

ENDS = ("value", "low", "high", "record_low", "record_high", "white_low", "white_high")
"""The numbers of an interval that have the quantity's unit."""
Limit = Literal["", "at most", "at least"]


@dataclass(frozen=True)
class StatedInterval:
    """A quantity with 95 % intervals: of a repeat of the test, of this record, and assuming white noise.

    With a ``limit`` the data determine only one end of the interval of a repeat, at 95 %: ``high`` if "at most"
    (``low`` is 0), ``low`` if "at least" (``high`` is infinite). ``unevenness``: the standard deviation between parts
    or repeats over the one that was expected before the data.
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


@dataclass(frozen=True, eq=False)
class Covariances:
    """Variances of the logs of the free parameters' ratios to the gauge mass, in which repeats differ independently.

    ``to`` (k, k): from the logs of the parameters to those of the ratios. ``record`` (k, k): covariance of this record.
    ``repeats`` (k,): variances that repeats add. ``unevenness`` (k,): standard deviations between parts, over the ones
    expected before the data. ``infinite`` (k,): whether a ratio may be infinite, as a mass that only the force
    determines; the others may vanish.
    """

    to: np.ndarray
    record: np.ndarray
    repeats: np.ndarray
    unevenness: np.ndarray
    infinite: np.ndarray
    record_dof: float
    repeats_dof: float

    def stated(self, own: StatedInterval, gradient: np.ndarray, classes: float) -> StatedInterval:
        """Return a method's interval with those of the record and of a repeat.

        ``gradient`` (k,): of its logarithm; ``classes``: its variance between model classes that are as good.
        """
        powers = np.linalg.solve(self.to.T, gradient)
        noise, spread = max(float(powers @ self.record @ powers) + classes, 1e-300), float(powers**2 @ self.repeats)
        total = noise + spread
        dof = total**2 / (noise**2 / self.record_dof + spread**2 / self.repeats_dof)
        repeat = float(standard_quantile(UPPER, dof)) * math.sqrt(total)
        record = float(standard_quantile(UPPER, self.record_dof)) * math.sqrt(noise)
        own = replace(own, unevenness=float(np.max(self.unevenness[powers != 0])))
        if repeat <= WIDEST:
            low, high, record_low, record_high = (
                own.value * math.exp(half) for half in (-repeat, repeat, -record, record)
            )
            return replace(own, low=low, high=high, record_low=record_low, record_high=record_high)
        leading = int(np.argmax(powers**2 * (np.diag(self.record) + self.repeats)))
        return limited(own, math.sqrt(total), -powers[leading] if self.infinite[leading] else powers[leading])


def limited(own: StatedInterval, error: float, power: float) -> StatedInterval:
    """State the end that the data determine of a quantity whose logarithm has a large standard ``error``.

    The parameter that is open, of which the quantity is a ``power``, may vanish, and is determined to so much on its
    own scale, not on that of its logarithm; of one that may be infinite, the reciprocal is (a negative ``power``).
    """
    factor = float((1.0 + float(standard_quantile(0.95, None)) * error / abs(power)) ** abs(power))
    if power > 0:
        high = own.value * factor
        return replace(own, low=0.0, high=high, record_low=0.0, record_high=high, limit="at most")
    low = own.value / factor
    return replace(own, low=low, high=math.inf, record_low=low, record_high=math.inf, limit="at least")


def stated_intervals(
    estimate: Estimate,
    fit: Linearised | None,
    parts: Sequence[Linearised] = (),
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
    covariances = None if fit is None else covariances_of(estimate, fit, parts, rate_error)
    intervals = {}
    for quantity in estimate.system.quantities:
        marginal = estimate.marginal(quantity)
        if marginal is None:
            continue
        ends = marginal.interval(0.95)
        own = StatedInterval(float(marginal.value), *ends, *ends, *ends, quantity.unit)
        gradient = np.array(quantity.vector(fit.model.free)) if fit is not None else np.zeros(1)
        if covariances is not None and marginal.ppf is not None and np.any(gradient) and own.value > 0:
            own = covariances.stated(own, gradient, 0.0 if classes is None else classes.variance(quantity.name))
        elif own.value == 0:
            own = replace(own, limit="at most")
        elif 0 < own.low < own.high < math.inf and math.log(own.high / own.low) > 2.0 * WIDEST:
            # where the scale is open all parameters may be infinite together; what is over the mass may vanish
            power = -1.0 if quantity.exponents.get(estimate.system.gauge, 1.0) > 0 else 1.0
            own = limited(own, math.log(own.high / own.low) / 2.0 / HALF, power)
        intervals[quantity.name] = own
    return intervals


def covariances_of(
    estimate: Estimate, fit: Linearised, parts: Sequence[Linearised] = (), rate_error: float = 0.0
) -> Covariances | None:
    """Return the variances of an answer, see :func:`stated_intervals`; None where a direction is open."""
    if fit.white is None or fit.coloured is None:
        return None
    system, free = fit.model.system, fit.model.free
    to = np.eye(len(free))
    if system.gauge in free:
        to[:, free.index(system.gauge)] -= [
            system.dimensions[name].mass if name != system.gauge else 0.0 for name in free
        ]
    white, coloured = (to @ c[: len(free), : len(free)] @ to.T for c in (fit.white, fit.coloured))
    least = np.sqrt(np.diag(white))
    over = _over_least_error(estimate, fit, least)
    scale = np.maximum(least / np.sqrt(np.diag(coloured)), 1.0) * over
    clock = to @ [system.dimensions[name].time for name in free] * rate_error
    record = coloured * np.outer(scale, scale) + np.outer(clock, clock)
    spread = spread_of(fit, parts, to)
    # the differences between parts hold what the colour of the noise does, so that the two do not add up
    repeats = np.maximum(spread[1] - (np.diag(record) - (least * over) ** 2), 0.0)
    return Covariances(
        to, record, repeats, spread[0], np.array(free) == system.gauge,
        max(independent_samples(fit) - fit.used, LEAST_DOF), PRIOR_DOF + len(parts) - 1 if parts else ASSUMED_DOF,
    )  # fmt: skip


def _over_least_error(estimate: Estimate, fit: Linearised, least: np.ndarray) -> np.ndarray:
    """Return the method's standard errors (k,) over the least ones assuming white noise, at least 1."""
    system, over = fit.model.system, np.ones(least.size)
    quantile = float(standard_quantile(UPPER, max(fit.residuals.size - fit.used, 1.0)))
    for i, name in enumerate(fit.model.free):
        ratio = name != system.gauge and system.dimensions[name].mass
        marginal = estimate.marginal(system.quantity(f"{name}_over_{system.gauge}" if ratio else name))
        if marginal is not None:
            low, high = marginal.interval(0.95)
            width = math.log(high / low) if 0 < low < math.inf else (high - low) / max(abs(marginal.value), 1e-300)
            over[i] = max(width / 2.0 / quantile / least[i], 1.0) if math.isfinite(width) else 1.0
    return over


def independent_samples(fit: Linearised) -> float:
    """Return how many white samples would determine a variance as well as these residuals: ``n c_0² / sum c_k²``.

    M. S. Bartlett, J. R. Stat. Soc. Suppl. 8:27, 1946; ``c_k``: autocovariance at lag k. At uneven times as many as the
    triangular weights over a reach leave independent, 1.5 spans over reaches.
    """
    total = 0.0
    for i, (noise, samples) in enumerate(zip(fit.noises, fit.channels, strict=True)):
        if noise is None:
            channel = fit.model.channels[i][1]
            reach = CORRELATED_CYCLES / strongest_frequency(channel.times, channel.values)
            total += min(1.5 * float(np.ptp(channel.times)) / reach + fit.used, samples.size)
        elif noise.order == 0 or samples.size < 2:
            total += samples.size
        else:
            c = noise.autocovariance(samples.size)
            total += samples.size * c[0] ** 2 / (c[0] ** 2 + 2.0 * float(np.sum(c[1:] ** 2)))
    return total


def spread_of(fit: Linearised, parts: Sequence[Linearised], to: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate how repeats differ, from parts of a record or from several records.

    Returns:
        Standard deviations (k,) between parts over the expected ones; variances (k,) that repeats add to a record's.
    """
    k, free = len(fit.model.free), fit.model.free
    kinds = {parameter.name: parameter.kind for parameter in fit.model.system.parameters}
    expected, slopes = (np.array([sd[kinds[name]] ** 2 for name in free]) for sd in (PRIOR_SPREAD, PRIOR_SLOPE))
    if len(parts) < 2:
        return np.ones(k), 2.0 * expected + slopes * AMPLITUDES**2
    logs = np.array([to @ part.theta[:k] for part in parts])
    errors = np.array([
        np.max([np.diag(to @ c[:k, :k] @ to.T) for c in (part.white, part.coloured) if c is not None], axis=0)
        for part in parts
    ])  # fmt: skip
    if len(fit.model.problem.records) > 1:
        variance = np.maximum([paule_mandel(logs[:, i], errors[:, i]) for i in range(k)], expected)
        return np.sqrt(variance / expected), variance * (1.0 + _share(errors + variance))
    motions = [(part.model.data - part.residuals)[part.channels[0]] for part in parts]
    sizes = np.log([float(np.std(motion)) or 1.0 for motion in motions])
    sloped = [sloped_spread(logs[:, i], errors[:, i], sizes, expected[i], slopes[i]) for i in range(k)]
    variance, added = np.array(sloped).T
    return np.sqrt(variance / expected), added


def _share(variances: np.ndarray) -> np.ndarray:
    """Return one over the number of values that count, of values (n, ...) with such variances in a weighted mean."""
    weights = 1.0 / variances
    return np.asarray(np.sum(weights**2, axis=0) / np.sum(weights, axis=0) ** 2)


def sloped_spread(
    values: np.ndarray, errors: np.ndarray, sizes: np.ndarray, prior: float, prior_slope: float
) -> tuple[float, float]:
    """Estimate what parts differ by beyond a dependence on the amplitude, which every repeat has alike.

    A line goes through the ``values`` (n,) with variances ``errors`` (n,) over ``sizes`` (n,), the logs of the
    amplitudes. Its slope has a normal prior about zero of variance ``prior_slope``; the variance about it is drawn
    towards ``prior``.

    Returns:
        Variance between parts beyond the line; variance of a whole record's value between repeats, whose amplitudes
        differ too.
    """
    variance, slope = prior, 0.0
    for _ in range(SWEEPS):
        weights = 1.0 / (errors + variance)
        away = sizes - np.sum(weights * sizes) / np.sum(weights)
        determined = np.sum(weights * away**2)
        of_slope = 1.0 / (determined + 1.0 / prior_slope)
        slope = of_slope * np.sum(weights * away * values)
        variance = shrunk_variance(values - slope * away, errors, prior, 1.0 + determined * of_slope)
    added = prior + variance * float(_share(errors + variance)) + (slope * AMPLITUDES) ** 2
    return variance, float(added)


def shrunk_variance(values: np.ndarray, errors: np.ndarray, prior: float, used: float = 1.0) -> float:
    """Return the variance between ``values`` (n,) with variances ``errors`` (n,), drawn towards a prior variance.

    ``used``: degrees of freedom of the values that their mean, and a slope, have taken.
    """
    dof = max(values.size - used, 0.0)
    return (dof * paule_mandel(values, errors, used) + PRIOR_DOF * prior) / (dof + PRIOR_DOF)


def paule_mandel(values: np.ndarray, errors: np.ndarray, used: float = 1.0) -> float:
    """Return the variance at which the weighted sum of squares equals its degrees of freedom; at least 0."""
    from scipy.optimize import brentq

    def excess(variance: float) -> float:
        weights = 1.0 / (errors + variance)
        mean = np.sum(weights * values) / np.sum(weights)
        return float(np.sum(weights * (values - mean) ** 2)) - (values.size - used)

    if values.size <= used or excess(0.0) <= 0:
        return 0.0
    high = float(np.sum((values - np.mean(values)) ** 2)) / (values.size - used)
    return float(brentq(excess, 0.0, high, xtol=1e-12 * high, rtol=1e-8))
