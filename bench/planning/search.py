"""The cheapest free decays that reach a wanted error: fewest samples by duration and by rate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.atlas.point import FreeDecay
from bench.atlas.threshold import wrong_basin
from bench.planning.free_decay import QUANTITIES, Decay, Oscillator, errors, information, motion

CYCLES = np.geomspace(0.5, 400.0, 120)
"""Durations that are tried, in cycles of the nominal frequency."""
LEAST_RATE = 2.5
"""Samples a cycle of the fastest frequency that is likely: one more than half would leave it ambiguous."""
LEAST_SAMPLES, MOST_SAMPLES = 8, 100_000
WITHIN = 1.96
"""Wanted errors, within which 95 % of normal errors are."""
DRAWN = 32
"""Oscillators that stand for all that are likely."""
RISK = 0.01
"""Most probability of a wrong basin."""
SHARE = 0.9
"""A test must reach the wanted error at this share of the oscillators that are likely."""


@dataclass(frozen=True)
class Likely:
    """What is known of an oscillator before the test: medians, and standard deviations of the logarithms."""

    frequency: float
    damping_ratio: float
    frequency_sd: float = 0.0
    damping_sd: float = 0.0

    @property
    def nominal(self) -> Oscillator:
        """The median."""
        return Oscillator(self.frequency, self.damping_ratio)

    @cached_property
    def oscillators(self) -> list[Oscillator]:
        """:data:`DRAWN` as likely as they are known; the nominal one alone where there is no doubt."""
        return self.drawn(DRAWN)

    def drawn(self, number: int) -> list[Oscillator]:
        """So many oscillators as likely as they are known; the nominal one alone where there is no doubt."""
        from scipy.special import ndtri  # slow to import
        from scipy.stats import qmc

        if not self.in_doubt:
            return [self.nominal]
        shares = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(0)).random(number)
        offs = ndtri(shares) * [self.frequency_sd, self.damping_sd]
        return [Oscillator(self.frequency * math.exp(a), self.damping_ratio * math.exp(b)) for a, b in offs]

    @property
    def in_doubt(self) -> bool:
        """Whether more than the nominal one is likely."""
        return self.frequency_sd > 0 or self.damping_sd > 0

    @property
    def fastest(self) -> float:
        """A frequency (Hz) that is hardly exceeded."""
        return self.frequency * math.exp(2.0 * self.frequency_sd)


@dataclass(frozen=True)
class ProposedTest:
    """A test with what it is expected to give.

    By quantity the error (standard deviation of the logarithm, by the bound) of the nominal oscillator, the median over
    the likely ones, and what is not exceeded in :data:`SHARE` of them. ``wrong_basin``: the probability that maximum
    likelihood ends in a wrong basin, where the bound means nothing, at the nominal oscillator.
    """

    decay: Decay
    wrong_basin: float
    nominal: dict[str, float]
    median: dict[str, float]
    share: dict[str, float]


def proposal(likely: Likely, decay: Decay) -> ProposedTest:
    """What a test is expected to give."""
    every = [errors(information(one, decay)) for one in likely.oscillators]
    by_name = {name: np.array([one[name] for one in every]) for name in QUANTITIES}
    return ProposedTest(
        decay,
        wrong_basin(as_point(likely.nominal, decay)),
        errors(information(likely.nominal, decay)),
        {name: float(np.median(values)) for name, values in by_name.items()},
        {name: float(np.quantile(values, SHARE, method="higher")) for name, values in by_name.items()},
    )


def not_exceeded(likely: Likely, decay: Decay, quantity: str) -> float:
    """The error of a quantity's logarithm that is not exceeded at :data:`SHARE` of the likely oscillators."""
    every = [errors(information(one, decay))[quantity] for one in likely.oscillators]
    return float(np.quantile(every, SHARE, method="higher"))


def as_point(oscillator: Oscillator, decay: Decay) -> FreeDecay:
    """The test in dimensionless numbers."""
    clean = motion(oscillator, decay.times, (decay.amplitude, 0.0))[0]
    snr = 10.0 * math.log10(float(np.mean(clean**2)))
    return FreeDecay(decay.samples, decay.duration * oscillator.frequency, oscillator.damping_ratio, snr, 0.0, False)


def cheapest(likely: Likely, quantity: str, error: float, amplitude: float, rate: float = 0.0) -> ProposedTest | None:
    """The test of fewest samples that reaches an error of a quantity's logarithm in :data:`SHARE` of all cases.

    Args:
        likely: what is known of the oscillator.
        quantity: of :data:`QUANTITIES`.
        error: standard deviation of its logarithm.
        amplitude: displacement at the start over the noise's standard deviation.
        rate: samples a second; 0 where the test may have any.

    Returns:
        The test, or None where none of up to :data:`MOST_SAMPLES` samples reaches it.
    """
    found: Decay | None = None
    cycles = CYCLES[np.argsort(np.abs(np.log(CYCLES * 2.0 * math.pi * likely.damping_ratio)))]  # a good one soon
    for duration in cycles / likely.frequency:
        most = MOST_SAMPLES if found is None else found.samples - 1
        least = max(LEAST_SAMPLES, math.ceil(LEAST_RATE * likely.fastest * duration) + 1)
        if rate:
            least = most = round(rate * duration) + 1
            if least < LEAST_SAMPLES or rate < LEAST_RATE * likely.fastest or (found and least >= found.samples):
                continue
        if least > most:
            continue
        samples = _fewest(likely, quantity, error, Decay(least, float(duration), amplitude), most)
        if samples is not None and wrong_basin(as_point(likely.nominal, Decay(samples, duration, amplitude))) < RISK:
            found = Decay(samples, float(duration), amplitude)
    return proposal(likely, found) if found is not None else None


def _fewest(likely: Likely, quantity: str, error: float, decay: Decay, most: int) -> int | None:
    """The fewest samples from those of ``decay`` on over its duration, to half a percent; None where ``most`` are too
    few.

    More samples over the same time tell more, and the error falls nearly as the root of their number.
    """

    def error_of(samples: int) -> float:
        return not_exceeded(likely, decay.longer(samples), quantity)

    def guess(samples: int, found: float) -> float:
        return samples * (found / error) ** 2

    low, own = decay.samples, error_of(decay.samples)
    if own <= error:
        return low
    high = int(min(1.1 * guess(low, own) + 2.0, most)) if math.isfinite(own) else most
    own = error_of(high)
    while own > error:
        if high == most:
            return None
        low, high = high, int(min(1.1 * guess(high, own) + 2.0, most))
        own = error_of(high)
    while high - low > max(1, low // 200):
        middle = math.ceil(guess(high, own))
        middle = middle if low < middle <= high - max(1, low // 200) else (low + high) // 2
        found = error_of(middle)
        low, high, own = (low, middle, found) if found <= error else (middle, high, own)
    return high
