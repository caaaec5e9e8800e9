"""Diagnostics of a fit to measured records: each check gives the reasons for caution that it finds, in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.contract.problem import Channel, Problem
from bench.likelihood.autoregression import even_times
from bench.likelihood.output_error import OutputError
from bench.records.colour import autocorrelation, cumulative_periodogram
from bench.records.intervals import StatedInterval
from bench.records.linearised import Linearised
from bench.records.models import first_guess
from bench.records.modes import Mode, alias_of, line, modes_of
from bench.records.saturation import at_limit
from bench.records.strongest import strongest_frequency
from bench.records.verdict import Reason, Trust, verdict
from bench.scoring.statistics import whiteness

FALSE_ALARM = 1e-3
"""Chance at which pure noise may pass for a motion; an answer that explains no more is refused."""
MOST_LEFT, MUCH_LEFT = 0.30, 0.10
"""Residuals over the signal, root mean squares: coloured ones beyond the first are a wrong model and the answer is
refused (a tenth of the power is unexplained); beyond the second they are a reason for caution."""
NOISE_FREE = 1e-5
"""Residuals over the signal below which they are rounding of the file, whose colour says nothing."""
STRETCHED = 1.5
"""Widening of an interval that is said: less lies within what different estimates of the noise make of it."""
UNEVEN = 2.0
"""Standard deviation between parts or repeats over the usual one beyond which they count as different."""
WIDE = 0.5
"""Half of an interval over its value beyond which the value is known to an order of magnitude only."""
OUTLIER = 6.0
"""Robust standard deviations (P. J. Rousseeuw, C. Croux, J. Am. Stat. Assoc. 88:1273, 1993): normal noise has one such
sample in 500 million, so each is an outlier, and a robust fit is made beside this one."""
MOST_OUTLIERS = 0.05
"""Share of samples beyond which they are no outliers, but noise with heavy tails, or a wrong model."""
OUTLIERS = "samples are far off"
SECOND_MODE = 0.05
"""Root mean square of a line in the residuals over the fitted motion that is said: below it the values move little."""
SAME_LINE = 0.15
"""Distance of a line from the natural frequency, relative, within which it is what the decay law leaves out."""
HARMONIC = 0.005
"""Distance of a ratio of two frequencies from a whole number, relative, within which the second is a harmonic."""
SLOW = 0.5
"""Frequency of a line over the natural one below which it is a drift."""
AMBIGUOUS, FEW_SAMPLES = 3.0, 8.0
"""Samples per cycle: below the first the vibration may as well be beyond the Nyquist frequency and the answer is
refused; below the second the alias is named (one that is no higher than 7/8 of the sampling rate)."""
FEW_CYCLES, TOO_FEW_CYCLES = 1.5, 0.75
"""Cycles in a free decay: below the first damping and drift are hardly distinguished, below the second nor is the
frequency, and the answer is refused."""
GROWTH = 1.2
"""Standard deviation of the last third over that of the first beyond which a free motion grows; noise moves it less."""
START_UP, START_UP_SHARE = 3.0, 0.05
"""Residuals of the first tenth over those of the rest, and over the signal, beyond which the start is not free."""
LEVEL = 0.01
"""p-value below which residuals are not white; one in a hundred good records is said to be coloured."""
TURNED = 0.5
"""Residuals with the force turned round over those without, below which its sign is wrong."""
PURE_SINE = 0.02
"""What a sine leaves of a force, over its root mean square, if the force is one: harmonics of 2 % tell nothing more."""
SETTLED = 1.1
"""What a sine leaves of the motion over what the fit leaves, up to which the motion has settled."""


@dataclass(frozen=True)
class Diagnosis:
    """Reasons for caution, and the modes that the user may choose from where the system describes none or only one."""

    reasons: tuple[Reason, ...] = ()
    modes: tuple[Mode, ...] = ()


def diagnose(
    at: Linearised | None,
    problem: Problem,
    intervals: Mapping[str, StatedInterval],
    missing: Sequence[str],
    message: str,
) -> Diagnosis:
    """Diagnose an answer.

    Args:
        at: The likelihood of the records at the answer; None where the answer has no finite response.
        problem: The records, in the user's units.
        intervals: Stated intervals.
        missing: Forces that the model lacks.
        message: The method's own message.
    """
    if at is None:
        return Diagnosis((Reason(Trust.NO, "the answer's response is not finite"),))
    several = _several_modes(at, problem)
    reasons = [*several.reasons, *(reason for check in CHECKS for reason in check(at))]
    if len(several.modes) < 2:
        reasons += _start_up(at)
    if sine := steady_sine(problem, part_of_signal(at)):
        reasons.insert(0, Reason(Trust.NO, sine))
    if verdict(reasons) is not Trust.NO:  # what follows from a fit that describes nothing is not worth a word
        reasons += _few(at)
        reasons += [] if part_of_signal(at) < NOISE_FREE else _of_residuals(intervals, missing)
        reasons += reasons_of_intervals(intervals)
    if message:
        reasons.append(Reason(Trust.CAUTION, f"the method says: {message}"))
    return Diagnosis(tuple(dict.fromkeys(reasons)), several.modes)


def _of_residuals(intervals: Mapping[str, StatedInterval], missing: Sequence[str]) -> list[Reason]:
    texts = []
    if missing:
        what = " and ".join(missing)
        texts.append(f"the residuals show {what}, which the system lacks: name it, or let system=auto choose")
    colour = max((interval.colour for interval in intervals.values()), default=1.0)
    if colour > STRETCHED:
        texts.append(f"the residuals are not white: intervals are up to {colour:.2g} times those of white noise")
    return [Reason(Trust.CAUTION, text) for text in texts]


def reasons_of_intervals(intervals: Mapping[str, StatedInterval]) -> list[Reason]:
    """Return the reasons for caution that stated intervals give."""
    texts = []
    uneven, most = max(intervals.items(), key=lambda item: item[1].unevenness, default=("", None))
    if most is not None and most.unevenness > UNEVEN and not most.limit:
        said = f"{readable(uneven)} may differ by {100 * most.relative_error:.2g} %"
        texts.append(f"{said} within the record or between repeats: the interval takes it in")
    limits = [name for name, interval in intervals.items() if interval.limit]
    if limits:
        texts.append(f"not determined, only limited to one side: {', '.join(map(readable, limits))}")
    wide = [name for name, own in intervals.items() if not (own.limit or own.relative_error < WIDE)]
    if wide:
        texts.append(f"known to an order of magnitude at most: {', '.join(map(readable, wide))}")
    return [Reason(Trust.CAUTION, text) for text in texts]


def readable(name: str) -> str:
    """Return the name of a quantity as it is written: k/m."""
    return name.replace("_over_", "/").replace("_", " ")


def _motion(at: Linearised) -> list[Reason]:
    """Test whether the fit explains more than the best of the record's frequencies would explain of white noise."""
    from scipy.stats import f as f_distribution

    n, used = at.residuals.size, max(at.used, 1.0)
    constants = sum(float(np.sum((values - np.mean(values)) ** 2)) for values in _values(at))
    left = float(at.residuals @ at.residuals)
    if n - used < 1 or left <= 0:
        return []
    statistic = max(constants - left, 0.0) / used / (left / (n - used))
    chance = min(1.0, n / 2.0 * float(f_distribution.sf(statistic, used, n - used)))
    if chance <= FALSE_ALARM:
        return []
    what = "the force explains nothing of the motion" if at.model.problem.forced else "no vibration found"
    return [Reason(Trust.NO, f"{what}: p = {chance:.2g} under noise alone")]


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
    cycles = at.model.problem.records[0].duration * (
        natural_frequency(at) or strongest_frequency(channel.times, fitted)
    )
    if cycles < TOO_FEW_CYCLES:
        return [Reason(Trust.NO, f"the record holds {cycles:.2g} cycles; record at least two")]
    return [Reason(Trust.CAUTION, f"the record holds {cycles:.2g} cycles")] if cycles < FEW_CYCLES else []


def _outliers(at: Linearised) -> list[Reason]:
    found = 0
    for own in at.channels:
        r = at.residuals[own] - np.median(at.residuals[own])
        scale = 1.4826 * float(np.median(np.abs(r)))
        if scale > 0:
            found += int(np.count_nonzero(np.abs(r) > OUTLIER * scale))
    if not found or found > MOST_OUTLIERS * at.residuals.size:
        return []
    return [Reason(Trust.CAUTION, f"{found} {OUTLIERS}")]


def _clipping(at: Linearised) -> list[Reason]:
    """Find samples of a motion at the limit of its sensor, or of a force whose fit leaves coloured residuals."""
    found = []
    if any(np.any(at_limit(values)) for values in _values(at)):
        found.append(Reason(Trust.NO, "the sensor is clipped: samples stay at its largest or smallest value"))
    forces = [force for record in at.model.problem.records for force in record.forces]
    cut = sum(int(np.count_nonzero(at_limit(force.values))) for force in forces)
    if cut and whiteness_level(at) <= LEVEL:
        said = f"the force sensor is saturated: {cut} samples stay at its largest or smallest value"
        found.append(Reason(Trust.NO, said))
    return found


def _several_modes(at: Linearised, problem: Problem) -> Diagnosis:
    """Look for a line in the residuals of a free motion, or an alias of its frequency: then the modes are offered."""
    if at.model.problem.forced:
        return _line(at)
    channel = problem.records[0].channels[0]
    unexplained = _line(at)
    frequency = (natural_frequency(at) or 0.0) / problem.natural_units().time
    rate = (channel.n - 1) / float(np.ptp(channel.times))
    if any(reason.text.endswith("a second mode") for reason in unexplained.reasons):
        modes = modes_of(channel.times, channel.values)
        if len(modes) < 2:
            return unexplained
        first, second = modes[:2]
        ratio = max(first.frequency / second.frequency, second.frequency / first.frequency)
        if abs(ratio / round(ratio) - 1.0) < HARMONIC:
            said = f"{second.share:.0%} of the signal is a harmonic at {ratio:.3g} times the natural frequency"
            return Diagnosis((Reason(Trust.NO, f"{said}: a clipped sensor, or a spring that is far from linear"),))
        names = " and ".join(f"{mode.frequency:.4g} Hz (damping ratio {mode.damping_ratio:.3g})" for mode in modes)
        reason = unexplained.reasons[0]
        return Diagnosis((replace(reason, text=f"the record holds modes at {names}; {reason.text}"),), modes)
    if not rate / FEW_SAMPLES < frequency < rate or channel.n < 12:
        return unexplained
    modes = modes_of(channel.times, channel.values, most=1)
    alias = alias_of(modes[0], channel.times) if modes else None
    if alias is None:
        return unexplained
    per_cycle = rate / modes[0].frequency
    said = (
        f"{modes[0].frequency:.4g} Hz and {alias.frequency:.4g} Hz fit the samples alike ({per_cycle:.2g} samples per "
        f"cycle of the lower): only a sampling rate above {2 * alias.frequency:.3g} Hz excludes the alias"
    )
    worst = Trust.NO if per_cycle < AMBIGUOUS else Trust.CAUTION
    return Diagnosis((*unexplained.reasons, Reason(worst, said)), (modes[0], alias))


def _line(at: Linearised) -> Diagnosis:
    """Look for a line in the spectrum of the residuals of each channel."""
    for own, (_, channel) in zip(at.channels, at.model.channels, strict=True):
        if not even_times(channel.times) or own.size < 16:
            continue
        frequency, share = line(channel.times, at.residuals[own], at.model.data[own] - at.residuals[own])
        strongest = natural_frequency(at) or strongest_frequency(channel.times, channel.values)
        harmonic = frequency / strongest
        if share > SECOND_MODE and abs(harmonic - 1.0) > SAME_LINE:
            said = f"the residuals hold a line at {harmonic:.2f} times the natural frequency, {share:.0%} of the motion"
            worst = Trust.NO if share > MOST_LEFT else Trust.CAUTION
            slow = "a drift of the sensor, or something slower; detrend=true takes a straight drift away"
            source = "a second mode" if harmonic > SLOW else slow
            return Diagnosis((Reason(worst, f"{said}: {source}"),))
    return Diagnosis()


def steady_sine(problem: Problem, left: float | None = None) -> str:
    """Describe force and motion where both are one settled sine: two numbers, from which m, c and k do not follow.

    Args:
        problem: The records, in the user's units.
        left: What a fit leaves of the motion's standard deviation; without one, the motion has settled where a sine
            leaves no line in its spectrum.

    Returns:
        A sentence, empty where the records may hold more.
    """
    if not problem.forced or len(problem.records) > 1 or problem.system.n_dof > 1 or problem.prior is not None:
        return ""
    (record,) = problem.records
    if len(record.forces) != 1 or record.channels[0].n < 8 or record.forces[0].times.size < 8:
        return ""
    force, channel = record.forces[0], record.channels[0]
    modes = modes_of(force.times, force.values, most=1)
    if not modes:
        return ""
    frequency = modes[0].frequency
    push, rest_of_force = _sine(force.times, force.values, frequency)
    response, rest = _sine(channel.times, channel.values, frequency)
    if np.std(rest_of_force) > PURE_SINE * np.std(force.values):
        return ""
    moving = line(channel.times, rest, channel.values)[1] > 0 if left is None else _over(rest, channel) > SETTLED * left
    if moving:
        return ""
    ratio = response / push
    return (
        f"the force is one steady sine at {frequency:.4g} Hz and the motion has settled: the record determines the "
        f"response there, {abs(ratio):.4g} {channel.unit}/N at {np.degrees(np.angle(ratio)):.3g}°, but not m, c and k; "
        "record the start, or another frequency"
    )


def _over(rest: np.ndarray, channel: Channel) -> float:
    return float(np.std(rest) / (np.std(channel.values) or 1.0))


def _sine(times: np.ndarray, values: np.ndarray, frequency: float) -> tuple[complex, np.ndarray]:
    """Fit a sine and a constant to values (n,): return the complex amplitude, and what is left of the values."""
    phase = 2 * np.pi * frequency * times
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones(times.size)])
    sizes = np.linalg.lstsq(basis, values, rcond=None)[0]
    return complex(sizes[0], -sizes[1]), values - basis @ sizes


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
        if early > START_UP * rest and share > START_UP_SHARE:
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
    if not np.all(np.isfinite(left)) or np.std(left) > TURNED * np.std(at.residuals):
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
    _motion, _clipping, _growth, _residual, _cycles, _turned_force, _outliers,
)  # fmt: skip
"""Checks of record and residuals, the gravest first."""


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
