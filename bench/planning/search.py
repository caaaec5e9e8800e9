"""Search for the free-decay test with the fewest samples that reaches a required accuracy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.atlas.point import FreeDecay
from bench.atlas.threshold import wrong_basin
from bench.planning.free_decay import QUANTITIES, Decay, Oscillator, errors, information, motion

CYCLES = np.geomspace(0.5, 400.0, 120)
"""Candidate durations, in cycles of the nominal frequency."""
LEAST_RATE = 2.5
"""Smallest number of samples per cycle of the highest likely frequency, to avoid aliasing."""
LEAST_SAMPLES, MOST_SAMPLES = 8, 100_000
WITHIN = 1.96
"""95 % of normal errors are within this many standard deviations."""
DRAWN = 32
"""Number of oscillators that represent the prior knowledge."""
RISK = 0.01
"""Largest accepted probability of a wrong basin."""
SHARE = 0.9
"""A test must reach the required error for this share of the likely oscillators."""


@dataclass(frozen=True)
class Likely:
    """Prior knowledge of an oscillator: medians, and standard deviations of the logarithms."""

    frequency: float
    damping_ratio: float
    frequency_sd: float = 0.0
    damping_sd: float = 0.0

    @property
    def nominal(self) -> Oscillator:
        """The oscillator with the median values."""
        return Oscillator(self.frequency, self.damping_ratio)

    @cached_property
    def oscillators(self) -> list[Oscillator]:
        """Quasi-random draws of :data:`DRAWN` oscillators; only the nominal one if it is known exactly."""
        return self.drawn(DRAWN)

    def drawn(self, number: int) -> list[Oscillator]:
        """Draw ``number`` oscillators (a Sobol sequence); only the nominal one if it is known exactly."""
        from scipy.special import ndtri  # slow to import
        from scipy.stats import qmc

        if not self.uncertain:
            return [self.nominal]
        shares = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(0)).random(number)
        deviations = ndtri(shares) * [self.frequency_sd, self.damping_sd]
        return [Oscillator(self.frequency * math.exp(a), self.damping_ratio * math.exp(b)) for a, b in deviations]

    @property
    def uncertain(self) -> bool:
        """True unless frequency and damping are known exactly."""
        return self.frequency_sd > 0 or self.damping_sd > 0

    @property
    def fastest(self) -> float:
        """Upper limit of the likely frequencies (Hz): two standard deviations above the median."""
        return self.frequency * math.exp(2.0 * self.frequency_sd)


@dataclass(frozen=True)
class ProposedTest:
    """A test with its expected errors.

    Errors are bounds on the standard deviation of the logarithm of each quantity: for the ``nominal`` oscillator, the
    ``median`` over the likely ones, and the quantile :data:`SHARE` over them. ``wrong_basin``: the probability that the
    maximum of the likelihood lies in a wrong basin, where the bound does not apply, for the nominal oscillator.
    """

    decay: Decay
    wrong_basin: float
    nominal: dict[str, float]
    median: dict[str, float]
    share: dict[str, float]


def proposal(likely: Likely, decay: Decay) -> ProposedTest:
    """Return a test with its expected errors."""
    bounds = [errors(information(oscillator, decay)) for oscillator in likely.oscillators]
    by_name = {name: np.array([bound[name] for bound in bounds]) for name in QUANTITIES}
    return ProposedTest(
        decay,
        wrong_basin(as_point(likely.nominal, decay)),
        errors(information(likely.nominal, decay)),
        {name: float(np.median(values)) for name, values in by_name.items()},
        {name: float(np.quantile(values, SHARE, method="higher")) for name, values in by_name.items()},
    )


def quantile_error(likely: Likely, decay: Decay, quantity: str) -> float:
    """Return the quantile :data:`SHARE`, over the likely oscillators, of the error of a quantity's logarithm."""
    bounds = [errors(information(oscillator, decay))[quantity] for oscillator in likely.oscillators]
    return float(np.quantile(bounds, SHARE, method="higher"))


def as_point(oscillator: Oscillator, decay: Decay) -> FreeDecay:
    """Return the test as a point of the atlas, in dimensionless numbers."""
    clean = motion(oscillator, decay.times, (decay.amplitude, 0.0))[0]
    snr = 10.0 * math.log10(float(np.mean(clean**2)))
    return FreeDecay(decay.samples, decay.duration * oscillator.frequency, oscillator.damping_ratio, snr, 0.0, False)


def cheapest(likely: Likely, quantity: str, error: float, amplitude: float, rate: float = 0.0) -> ProposedTest | None:
    """Find the test with the fewest samples that reaches a required error for :data:`SHARE` of the likely oscillators.

    Args:
        likely: Prior knowledge of the oscillator.
        quantity: One of :data:`QUANTITIES`.
        error: Required standard deviation of its logarithm.
        amplitude: Initial displacement over the standard deviation of the noise.
        rate: Sampling rate, 1/s; 0 if it is free.

    Returns:
        The test, or None if more than :data:`MOST_SAMPLES` samples are needed.
    """
    best: Decay | None = None
    # Durations near one decay time come first, since they limit the search for the others.
    cycles = CYCLES[np.argsort(np.abs(np.log(CYCLES * 2.0 * math.pi * likely.damping_ratio)))]
    for duration in cycles / likely.frequency:
        most = MOST_SAMPLES if best is None else best.samples - 1
        least = max(LEAST_SAMPLES, math.ceil(LEAST_RATE * likely.fastest * duration) + 1)
        if rate:
            least = most = round(rate * duration) + 1
            if least < LEAST_SAMPLES or rate < LEAST_RATE * likely.fastest or (best and least >= best.samples):
                continue
        if least > most:
            continue
        samples = _fewest(likely, quantity, error, Decay(least, float(duration), amplitude), most)
        if samples is not None and wrong_basin(as_point(likely.nominal, Decay(samples, duration, amplitude))) < RISK:
            best = Decay(samples, float(duration), amplitude)
    return proposal(likely, best) if best is not None else None


def _fewest(likely: Likely, quantity: str, error: float, decay: Decay, most: int) -> int | None:
    """Return the smallest sufficient number of samples over the duration of ``decay``, to 0.5 %.

    The search is between the number of samples of ``decay`` and ``most``; None if ``most`` are too few. The error falls
    nearly as the square root of the number of samples.
    """

    def error_of(samples: int) -> float:
        return quantile_error(likely, decay.with_samples(samples), quantity)

    def guess(samples: int, reached: float) -> float:
        return samples * (reached / error) ** 2

    low, reached = decay.samples, error_of(decay.samples)
    if reached <= error:
        return low
    high = int(min(1.1 * guess(low, reached) + 2.0, most)) if math.isfinite(reached) else most
    reached = error_of(high)
    while reached > error:
        if high == most:
            return None
        low, high = high, int(min(1.1 * guess(high, reached) + 2.0, most))
        reached = error_of(high)
    while high - low > max(1, low // 200):
        middle = math.ceil(guess(high, reached))
        middle = middle if low < middle <= high - max(1, low // 200) else (low + high) // 2
        at_middle = error_of(middle)
        low, high, reached = (low, middle, at_middle) if at_middle <= error else (middle, high, reached)
    return high
