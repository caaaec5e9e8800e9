"""The interval that is stated of a measured record: of the method, corrected for coloured noise and unequal parts.

A method takes the noise for white and the model for right. Of both, its residuals tell otherwise: the variance of each
quantity's logarithm is multiplied by what coloured noise makes of that of a maximum-likelihood fit
(:mod:`bench.records.linearised`), and what parts of the record or repeats differ by is added
(:mod:`bench.records.parts`). For draws of a posterior such a stretch about their median is the open-faced sandwich
adjustment (B. A. Shaby, J. Comput. Graph. Stat. 23:801, 2014) in one dimension. Degrees of freedom: F. E.
Satterthwaite, Biometrics Bull. 2:110, 1946.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.contract.belief import standard_quantile
from bench.contract.estimate import Estimate
from bench.records.linearised import CORRELATED_CYCLES, Linearised
from bench.records.model_error import NOTHING_LACKING, ModelError
from bench.records.parts import NOTHING, Between, between
from bench.records.strongest import strongest_frequency
from bench.systems import Quantity

UPPER = 0.975
HALF = float(standard_quantile(UPPER, None))
"""Half of a 95 % interval over the standard error."""
LEAST_DOF = 2.0
SHARE_DOF = 4.0
"""At least, of a variance between parts: two parts show their difference as a whole, not as a draw."""
MOST_LOG = 50.0
"""Beyond this half-width of a logarithm an interval says nothing, and numbers overflow."""


@dataclass(frozen=True)
class StatedInterval:
    """A quantity with its 95 % intervals: as stated, and of the method alone, which takes the noise for white.

    ``colour`` and ``between``: how much wider coloured noise makes the interval, and beyond that unequal parts and
    what the model leaves out; their product is ``stretch``. ``change``: of the logarithm over the record.
    """

    value: float
    low: float
    high: float
    white_low: float
    white_high: float
    unit: str
    colour: float = 1.0
    between: float = 1.0
    change: float = 0.0

    @property
    def stretch(self) -> float:
        return self.colour * self.between

    @property
    def relative_error(self) -> float:
        """Half of the interval over the value."""
        return (self.high - self.low) / 2.0 / abs(self.value) if self.value else np.inf


def stated_intervals(
    estimate: Estimate,
    at: Linearised | None,
    parts: Sequence[Linearised] = (),
    lacking: ModelError = NOTHING_LACKING,
) -> dict[str, StatedInterval]:
    """The quantities that an answer tells, each with its intervals.

    Args:
        estimate: The answer, in the user's units, combined with the prior.
        at: The likelihood there; without one the method's own intervals are stated.
        parts: Fits of the parts of the record, or of its repeats; maybe none.
        lacking: What the model leaves out.
    """
    found = {}
    for quantity in estimate.system.quantities:
        marginal = estimate.marginal(quantity)
        if marginal is None:
            continue
        low, high = marginal.interval(0.95)
        own = StatedInterval(marginal.value, low, high, low, high, quantity.unit)
        known = at is not None and at.coloured is not None and np.isfinite(low) and np.isfinite(high)
        found[quantity.name] = _stated(own, quantity, at, parts, lacking) if known and at is not None else own
    return found


def _stated(
    own: StatedInterval, quantity: Quantity, at: Linearised, parts: Sequence[Linearised], lacking: ModelError
) -> StatedInterval:
    gradient = at.gradient(quantity)
    if at.white is None or at.coloured is None or not np.any(gradient):
        return own
    white, coloured = (max(float(gradient @ c @ gradient), 0.0) for c in (at.white, at.coloured))
    if not (white > 0 and 0 < coloured < np.inf):
        return own
    log = own.low > 0 and own.value > 0
    below = np.log(own.value / own.low) if log else (own.value - own.low) / abs(own.value)
    above = np.log(own.high / own.value) if log else (own.high - own.value) / abs(own.value)
    dof = max(at.residuals.size - at.used, 1.0)
    deviation = (below + above) / 2.0 / standard_quantile(UPPER, dof)
    if not deviation > 0:
        return own
    share, change = between(parts, quantity) if parts else NOTHING, lacking.change(quantity)
    if change**2 > share.variance:
        share = replace(NOTHING, variance=change**2, trend=change)
    noise = deviation**2 * coloured / white
    colour = _half(noise, NOTHING, at) / (deviation * standard_quantile(UPPER, dof))
    whole = _half(noise, share, at) / (deviation * standard_quantile(UPPER, dof))
    below, above = (min(whole * half, MOST_LOG if log else np.inf) for half in (below, above))
    low, high = (
        (own.value * np.exp(-below), own.value * np.exp(above))
        if log
        else (own.value - abs(own.value) * below, own.value + abs(own.value) * above)
    )
    return StatedInterval(
        own.value, float(low), float(high), own.low, own.high, own.unit, colour, whole / colour, share.trend
    )


def _half(noise: float, share: Between, at: Linearised) -> float:
    """Half of the 95 % interval of a logarithm with a variance of its noise and one between parts."""
    total, own = noise + share.variance, max(_independent(at) - at.used, LEAST_DOF)
    dof = total**2 / (noise**2 / own + share.variance**2 / max(share.dof, SHARE_DOF))
    return float(standard_quantile(UPPER, dof) * np.sqrt(total))


def _independent(at: Linearised) -> float:
    """As many white samples tell a variance as well as these residuals: ``n c_0² / sum c_k²``.

    M. S. Bartlett, J. R. Stat. Soc. Suppl. 8:27, 1946; ``c_k``: autocovariance at lag k. At uneven times as many as the
    triangular weights over a reach leave independent, 1.5 spans over reaches.
    """
    total = 0.0
    for i, (noise, own) in enumerate(zip(at.noises, at.channels, strict=True)):
        if noise is None:
            channel = at.model.channels[i][1]
            reach = CORRELATED_CYCLES / strongest_frequency(channel.times, channel.values)
            total += min(1.5 * float(np.ptp(channel.times)) / reach + at.used, own.size)
            continue
        if noise.order == 0 or own.size < 2:
            total += own.size
            continue
        covariances = noise.autocovariance(own.size)
        total += own.size * covariances[0] ** 2 / (covariances[0] ** 2 + 2.0 * float(np.sum(covariances[1:] ** 2)))
    return total
