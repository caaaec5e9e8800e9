"""Diagnostics of a fit to measured records: each check gives the reasons for caution that it finds, in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from bench.likelihood.autoregression import even_times
from bench.likelihood.output_error import OutputError
from bench.records.colour import autocorrelation, cumulative_periodogram, periodogram
from bench.records.grown import first_guess
from bench.records.intervals import StatedInterval
from bench.records.linearised import Linearised
from bench.records.model_error import ModelError
from bench.records.strongest import strongest_frequency
from bench.records.verdict import Reason, Trust
from bench.scoring.statistics import whiteness

FALSE_ALARM = 1e-3
"""How often pure noise may pass for a vibration."""
MOST_LEFT, MUCH_LEFT = 0.30, 0.10
"""Residuals over the signal, root mean squares: beyond the first a coloured rest is a wrong model."""
STRETCHED = 1.5
UNEVEN = 2.0
"""Standard deviation between parts or repeats over the usual one beyond which they count as different."""
WIDE = 0.5
"""Half of an interval over its value beyond which the value is known to an order only."""
OUTLIER = 6.0
"""Robust standard deviations (Rousseeuw and Croux, J. Am. Stat. Assoc. 88:1273, 1993, for the scale by the median)."""
OUTLIERS = "samples are far off"
RUN = 3
CLIPPED_RUNS = 3
LINE = 1e-6
SECOND_MODE = 0.05
SLOW = 0.5
FEW_SAMPLES_A_CYCLE = 2.5
FEW_CYCLES, TOO_FEW_CYCLES = 1.5, 0.75
GROWTH = 1.2
LEVEL = 0.01


def reasons_for_caution(
    at: Linearised | None,
    intervals: Mapping[str, StatedInterval],
    lacking: ModelError,
    message: str,
) -> tuple[Reason, ...]:
    """Return the reasons for caution about an answer.

    Args:
        at: The likelihood of the records at the answer; None where the answer has no finite response.
        intervals: Stated intervals.
        lacking: What the model leaves out.
        message: The method's own message.
    """
    if at is None:
        return (Reason(Trust.NO, "the answer's response is not finite"),)
    reasons = [reason for check in CHECKS for reason in check(at)]
    reasons += _of_intervals(intervals, lacking)
    if message:
        reasons.append(Reason(Trust.CAUTION, f"the method says: {message}"))
    return tuple(dict.fromkeys(reasons))


def _of_intervals(intervals: Mapping[str, StatedInterval], lacking: ModelError) -> list[Reason]:
    found = []
    if lacking.missing:
        what = " and ".join(lacking.missing)
        found.append(
            Reason(
                Trust.CAUTION, f"the residuals show {what}, which the system lacks: name it, or let system=auto choose"
            )
        )
    elif lacking.suspected:
        what = " or ".join(lacking.suspected)
        found.append(
            Reason(Trust.CAUTION, f"the residuals are coloured by their noise or by {what}, which the system lacks")
        )
    coloured = [q for q, own in intervals.items() if own.colour > STRETCHED]
    if coloured:
        most = max(own.colour for own in intervals.values())
        found.append(
            Reason(
                Trust.CAUTION, f"the residuals are not white: intervals are up to {most:.2g} times those of white noise"
            )
        )
    uneven = max(intervals.items(), key=lambda item: item[1].unevenness, default=None)
    if uneven is not None and uneven[1].unevenness > UNEVEN:
        said = f"{uneven[0].replace('_over_', '/')} may differ by {100 * uneven[1].relative_error:.2g} %"
        found.append(Reason(Trust.CAUTION, f"{said} within the record or between repeats: the interval takes it in"))
    wide = [name.replace("_over_", "/") for name, own in intervals.items() if not own.relative_error < WIDE]
    if wide:
        found.append(Reason(Trust.CAUTION, f"known to an order of magnitude at most: {', '.join(wide)}"))
    return found


def _vibration(at: Linearised) -> list[Reason]:
    """Whether the fit explains more than the best of as many frequencies as there are samples would of white noise."""
    from scipy.stats import f as f_distribution

    if at.model.problem.forced:
        return []
    n, used = at.residuals.size, max(at.used, 1.0)
    constants = sum(float(np.sum((values - np.mean(values)) ** 2)) for values in _values(at))
    left = float(at.residuals @ at.residuals)
    if n - used < 1 or left <= 0:
        return []
    statistic = max(constants - left, 0.0) / used / (left / (n - used))
    chance = min(1.0, n / 2.0 * float(f_distribution.sf(statistic, used, n - used)))
    if chance <= FALSE_ALARM:
        return []
    return [Reason(Trust.NO, f"no vibration found: noise alone would look like this in {chance:.2g} of all records")]


def _residual(at: Linearised) -> list[Reason]:
    share = part_of_signal(at)
    if share <= MUCH_LEFT:
        return []
    white = whiteness_level(at) > LEVEL
    said = f"the residuals are {share:.0%} of the signal"
    if share > MOST_LEFT and not white:
        return [Reason(Trust.NO, f"{said} and not white: the model does not describe this record")]
    if share > MOST_LEFT:
        return [Reason(Trust.CAUTION, f"{said}: much noise")]
    return [] if white else [Reason(Trust.CAUTION, f"{said} and not white")]


def _cycles(at: Linearised) -> list[Reason]:
    channel = at.model.channels[0][1]
    if at.model.problem.forced or channel.n < 4:
        return []
    fitted = at.model.data[: channel.n] - at.residuals[: channel.n]
    frequency = natural_frequency(at) or strongest_frequency(channel.times, fitted)
    cycles, rate = at.model.problem.records[0].duration * frequency, (channel.n - 1) / float(np.ptp(channel.times))
    found = []
    if cycles < TOO_FEW_CYCLES:
        found.append(Reason(Trust.NO, f"the record holds {cycles:.2g} cycles; record at least two"))
    elif cycles < FEW_CYCLES:
        found.append(Reason(Trust.CAUTION, f"the record holds {cycles:.2g} cycles"))
    if rate < FEW_SAMPLES_A_CYCLE * frequency:
        said = f"{rate / frequency:.2g} samples a cycle: a faster vibration may stand behind it (aliasing)"
        found.append(Reason(Trust.CAUTION, said))
    return found


def _outliers(at: Linearised) -> list[Reason]:
    found = 0
    for own in at.channels:
        r = at.residuals[own] - np.median(at.residuals[own])
        scale = 1.4826 * float(np.median(np.abs(r)))
        if scale > 0:
            found += int(np.count_nonzero(np.abs(r) > OUTLIER * scale))
    if not found or found > 0.05 * at.residuals.size:
        return []
    return [Reason(Trust.CAUTION, f"{found} {OUTLIERS}")]


def _clipping(at: Linearised) -> list[Reason]:
    """Several stretches of samples that stay at the largest or the smallest value."""
    for values in _values(at):
        for extreme in (np.max(values), np.min(values)):
            held = np.concatenate([[False], values == extreme, [False]])
            ends = np.flatnonzero(np.diff(held.astype(int)))
            runs = ends[1::2] - ends[::2]
            step = np.min(np.diff(np.unique(values)), initial=np.inf)
            fine = step < 0.02 * np.ptp(values) or np.unique(values).size < 5
            if fine and (np.count_nonzero(runs >= RUN) >= CLIPPED_RUNS or np.max(runs, initial=0) >= 3 * RUN):
                return [Reason(Trust.NO, "the sensor is clipped: samples stay at its largest or smallest value")]
    return []


def _second_mode(at: Linearised) -> list[Reason]:
    """A line in the spectrum of the residuals (R. A. Fisher, Proc. R. Soc. A 125:54, 1929, for its test)."""
    for own, (_, channel) in zip(at.channels, at.model.channels, strict=True):
        if not even_times(channel.times) or own.size < 16:
            continue
        power = periodogram(at.residuals[own])
        chance = power.size * (1.0 - float(np.max(power))) ** (power.size - 1)
        fitted = np.std(at.model.data[own] - at.residuals[own])
        share = float(np.std(at.residuals[own]) * np.sqrt(np.max(power)) / (fitted or 1.0))
        frequency = (int(np.argmax(power)) + 1) / (channel.times[-1] - channel.times[0])
        strongest = natural_frequency(at) or strongest_frequency(channel.times, channel.values)
        harmonic = frequency / strongest
        if chance < LINE and share > SECOND_MODE and abs(harmonic - 1.0) > 0.15:
            said = f"the residuals hold a line at {harmonic:.2f} times the natural frequency, {share:.0%} of the motion"
            worst = Trust.NO if share > MOST_LEFT else Trust.CAUTION
            slow = "a drift of the sensor, or something slower; detrend=true takes a straight drift away"
            source = "a second mode, or a harmonic" if harmonic > SLOW else slow
            return [Reason(worst, f"{said}: {source}")]
    return []


def _growth(at: Linearised) -> list[Reason]:
    """Whether a free motion grows."""
    if at.model.problem.forced:
        return []
    for values in _values(at):
        thirds = np.array_split(values - np.mean(values), 3)
        first, last = float(np.std(thirds[0])), float(np.std(thirds[2]))
        if last > GROWTH * first and _decays(at):
            said = f"the motion grows {last / (first or 1.0):.2g} times over the record, and no damping does that"
            return [Reason(Trust.NO, said)]
    return []


def _decays(at: Linearised) -> bool:
    """Whether the system can only lose energy; van der Pol's gains some."""
    return at.model.system.name != "van_der_pol"


def _start_up(at: Linearised) -> list[Reason]:
    """Residuals of the first part that are far larger than those of the rest."""
    for own, (_, channel) in zip(at.channels, at.model.channels, strict=True):
        n = max(own.size // 10, 5)
        if own.size < 4 * n:
            continue
        early, rest = np.std(at.residuals[own[:n]]), np.std(at.residuals[own[n:]])
        share = early / (np.std(channel.values) or 1.0)
        if early > 3.0 * rest and share > 0.05:
            said = f"the first tenth of the record fits {early / (rest or 1.0):.2g} times worse than the rest"
            return [Reason(Trust.CAUTION, f"{said}: leave a start-up out by from=")]
    return []


def _few(at: Linearised) -> list[Reason]:
    n = at.residuals.size
    if n >= 2 * at.theta.size:
        return []
    return [Reason(Trust.CAUTION, f"{n} samples for {at.theta.size} unknowns")]


def _turned_force(at: Linearised) -> list[Reason]:
    """Where a forced fit leaves most of the signal: whether the force turned round would leave much less."""
    if not at.model.problem.forced or part_of_signal(at) <= MOST_LEFT:
        return []
    records = tuple(
        replace(r, forces=tuple(replace(f, values=-f.values) for f in r.forces)) for r in at.model.problem.records
    )
    turned = replace(at.model, problem=replace(at.model.problem, records=records))
    theta = min(turned.settle(_forced_starts(turned, at.theta), 2, 20), key=turned.profile)
    left = turned.data - turned.predict(theta)
    if not np.all(np.isfinite(left)) or np.std(left) > 0.5 * np.std(at.residuals):
        return []
    return [Reason(Trust.NO, "the force turned round fits far better: its sign is wrong; say force_gain=-1")]


def _forced_starts(model: OutputError, theta: np.ndarray) -> np.ndarray:
    """Vectors from which to search a forced motion: the given one, and at rest with natural frequencies on a grid."""
    duration = max(record.duration for record in model.problem.records)
    size, found = float(np.std(model.data)) or 1.0, [theta]
    for cycles in np.geomspace(0.5, max(model.data.size / 4.0, 2.0), 16):
        p = first_guess(model.system, 2 * np.pi * cycles / duration, size)
        start = np.zeros(theta.size)
        start[: len(model.free)] = np.log([p[name] for name in model.free])
        heavier = float(np.std(model.predict(start))) / size
        massive = [bool(q.dimension.mass) for q in model.system.parameters if q.name in model.free]
        if np.isfinite(heavier) and heavier > 0:
            start[: len(model.free)] += np.where(massive, np.log(heavier), 0.0)
            found.append(start)
    return np.stack(found)


CHECKS: tuple[Callable[[Linearised], list[Reason]], ...] = (
    _vibration, _clipping, _growth, _residual, _second_mode, _cycles, _few, _start_up, _outliers, _turned_force,
)  # fmt: skip
"""What is looked at in record and residuals, the gravest first."""


def _values(at: Linearised) -> list[np.ndarray]:
    return [channel.values for _, channel in at.model.channels if channel.n > 3]


def part_of_signal(at: Linearised) -> float:
    """Root mean square of the residuals over that of the signal about its mean, over all channels."""
    total, left = 0.0, 0.0
    for own, (_, channel) in zip(at.channels, at.model.channels, strict=True):
        size = float(np.std(channel.values)) or 1.0
        total += own.size
        left += float(np.sum((at.residuals[own] / size) ** 2))
    return float(np.sqrt(left / total))


def whiteness_level(at: Linearised) -> float:
    """The smallest p-value of the channels that their residuals are white: Ljung-Box, or the cumulative periodogram."""
    levels = [1.0]
    for own, (_, channel) in zip(at.channels, at.model.channels, strict=True):
        if own.size < 12 or own.size <= at.theta.size + 2:
            continue
        r, tangents = at.residuals[own], at.slopes[own]
        if own.size > 2000:  # the test draws white noise as long as the record
            r, tangents = r[:2000], tangents[:2000]
        levels.append(float(whiteness(r[None], tangents)[0]))
        if even_times(channel.times):
            power, band = cumulative_periodogram(at.residuals[own])
            line = np.arange(1, power.size + 1) / power.size
            levels.append(1.0 if np.max(np.abs(power - line)) <= band * 1.2 else 0.005)
    return min(levels)


def lag_one(at: Linearised) -> float:
    """Autocorrelation of the first channel's residuals at one sample."""
    return float(autocorrelation(at.residuals[at.channels[0]], 1)[1])


def natural_frequency(at: Linearised) -> float | None:
    """By the answer's own k/m, cycles per unit of its time; None for a system without them."""
    p = at.model.parameters(at.theta)
    if not {"k", "m"} <= set(p):
        return None
    return float(np.sqrt(p["k"] / p["m"]) / (2 * np.pi))
