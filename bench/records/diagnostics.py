"""Diagnostics of a fit to measured records: each check gives the reasons for caution that it finds, in a sentence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from bench.contract.problem import Channel, Problem
from bench.likelihood.autoregression import even_times
from bench.records.colour import autocorrelation
from bench.records.dominant_frequency import dominant_frequency
from bench.records.intervals import StatedInterval
from bench.records.linearised_fit import LinearisedFit
from bench.records.modes import OfferedMode, alias_of, modes_of
from bench.records.saturation import at_limit
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
LINE_LEVEL = 1e-6
"""Chance that white noise has such a line: far below that of a false alarm in a life of records."""
BEGINNINGS, LEAST_BEGINNING = (1, 4, 16), 100
"""Parts of the record in whose beginning lines are sought, and the least samples there."""
SAME_LINE = 0.15
"""Distance of a line from the natural frequency, relative, within which it is what the decay law leaves out."""
HARMONIC = 0.01
"""Distance of a ratio of two frequencies from a whole number, relative, within which the second is a harmonic."""
HIGHEST_HARMONIC = 10
"""Beyond, one ratio in five or more is as near to a whole number by chance."""
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
"""What a linear equation of motion leaves over what the fit does, below which a negative force in it is believed."""
PURE_SINE = 0.02
"""What a sine leaves of a force, over its root mean square, if the force is one: harmonics of 2 % tell nothing more."""
SETTLED = 1.1
"""What a sine leaves of the motion over what the fit leaves, up to which the motion has settled."""


def diagnose(
    fit: LinearisedFit | None,
    problem: Problem,
    intervals: Mapping[str, StatedInterval],
    missing: Sequence[str],
    message: str,
) -> tuple[tuple[Reason, ...], tuple[OfferedMode, ...]]:
    """Return reasons for caution, and modes to choose from where the system describes none or only one of them.

    Args:
        fit: The likelihood of the records at the answer; None where the answer has no finite response.
        problem: The records, in the user's units.
        intervals: Stated intervals.
        missing: Forces that the model lacks.
        message: The method's own message.
    """
    if fit is None:
        return (Reason(Trust.NO, "the answer's response is not finite"),), ()
    line_reasons, modes = _lines(fit, problem)
    reasons = [*line_reasons, *_of_fit(fit), *([] if len(modes) > 1 else start_up(*_channels(fit)))]
    if sine := steady_sine(problem, part_of_signal(fit)):
        reasons.insert(0, Reason(Trust.NO, sine))
    if verdict(reasons) is not Trust.NO:  # what follows from a fit that describes nothing is not worth a word
        n, unknowns = fit.residuals.size, fit.theta.size
        texts = [f"{n} samples for {unknowns} unknowns"] if n < 2 * unknowns else []
        if part_of_signal(fit) >= NOISE_FREE and missing:
            what = " and ".join(missing)
            texts.append(f"the residuals show {what}, which the system lacks: name it, or let system=auto choose")
        coloured = any(noise is None or noise.order for noise in fit.noises)
        colour = max((interval.colour for interval in intervals.values()), default=1.0)
        if coloured and part_of_signal(fit) >= NOISE_FREE and colour > STRETCHED:
            texts.append(f"the residuals are not white: intervals are up to {colour:.2g} times those of white noise")
        reasons += [*(Reason(Trust.CAUTION, text) for text in texts), *reasons_of_intervals(intervals)]
    if message:
        reasons.append(Reason(Trust.CAUTION, f"the method says: {message}"))
    return tuple(dict.fromkeys(reasons)), modes


def reasons_of_intervals(intervals: Mapping[str, StatedInterval]) -> list[Reason]:
    """Return the reasons for caution that stated intervals give."""
    texts = []
    uneven, most = max(intervals.items(), key=lambda item: item[1].unevenness, default=("", None))
    if most is not None and most.unevenness > UNEVEN and not most.limit:
        said = f"{readable(uneven)} may differ by {100 * most.relative_error:.2g} %"
        texts.append(f"{said} within the record or between repeats: the interval takes it in")
    limits = [readable(name) for name, interval in intervals.items() if interval.limit]
    if limits:
        texts.append(f"not determined, only limited to one side: {', '.join(limits)}")
    wide = [readable(name) for name, i in intervals.items() if not (i.limit or i.relative_error < WIDE)]
    if wide:
        texts.append(f"known to an order of magnitude at most: {', '.join(wide)}")
    return [Reason(Trust.CAUTION, text) for text in texts]


def readable(name: str) -> str:
    """Return the name of a quantity as it is written: k/m."""
    return name.replace("_over_", "/").replace("_", " ")


def _of_fit(fit: LinearisedFit) -> Iterator[Reason]:
    """Yield the reasons that record and residuals give, the gravest first."""
    signals = [channel.values for _, channel in fit.model.channels if channel.n > 3]
    forced, free = fit.model.problem.forced, not fit.model.problem.forced
    white, share = whiteness_level(fit) > LEVEL, part_of_signal(fit)
    if (chance := _chance_of_noise(fit, signals)) > FALSE_ALARM:
        what = "the force explains nothing of the motion" if forced else "no vibration found"
        yield Reason(Trust.NO, f"{what}: p = {chance:.2g} under noise alone")
    if any(np.any(at_limit(values)) for values in signals):
        yield Reason(Trust.NO, "the sensor is clipped: samples stay at its largest or smallest value")
    forces = [force.values for record in fit.model.problem.records for force in record.forces]
    if (cut := sum(int(np.count_nonzero(at_limit(values))) for values in forces)) and not white:
        said = f"the force sensor is saturated: {cut} samples stay at its largest or smallest value"
        yield Reason(Trust.NO, said)
    growth = growth_of(signals)
    if free and growth > GROWTH and fit.model.system.name != "van_der_pol":  # which gains energy
        yield Reason(Trust.NO, f"the motion grows {growth:.2g} times over the record, and no damping does that")
    said = f"the residuals are {share:.0%} of the signal"
    if share > MOST_LEFT:
        grave, mild = f"{said} and not white: the model does not describe this record", f"{said}: much noise"
        yield Reason(Trust.CAUTION, mild) if white else Reason(Trust.NO, grave)
    elif share > MUCH_LEFT and not white:
        yield Reason(Trust.CAUTION, f"{said} and not white")
    cycles = _cycles(fit)
    if free and cycles < TOO_FEW_CYCLES:
        yield Reason(Trust.NO, f"the record holds {cycles:.2g} cycles; record at least two")
    elif free and cycles < FEW_CYCLES:
        yield Reason(Trust.CAUTION, f"the record holds {cycles:.2g} cycles")
    if share > MOST_LEFT and _force_is_turned(fit):
        yield Reason(Trust.NO, "the force turned round fits far better: its sign is wrong; say force_gain=-1")
    outliers = _outliers(fit)
    if 0 < outliers <= MOST_OUTLIERS * fit.residuals.size:
        yield Reason(Trust.CAUTION, f"{outliers} {OUTLIERS}")


def _chance_of_noise(fit: LinearisedFit, signals: Sequence[np.ndarray]) -> float:
    """Return the chance that the best of the record's frequencies explains as much of white noise as the fit does."""
    from scipy.stats import f as f_distribution

    n, used = fit.residuals.size, max(fit.used, 1.0)
    constants = sum(float(np.sum((values - np.mean(values)) ** 2)) for values in signals)
    left = float(fit.residuals @ fit.residuals)
    if n - used < 1 or left <= 0:
        return 0.0
    statistic = max(constants - left, 0.0) / used / (left / (n - used))
    return min(1.0, n / 2.0 * float(f_distribution.sf(statistic, used, n - used)))


def _cycles(fit: LinearisedFit) -> float:
    """Count the cycles in the first record, by the answer or by the fitted motion."""
    channel = fit.model.channels[0][1]
    fitted = fit.model.data[: channel.n] - fit.residuals[: channel.n]
    return fit.model.problem.records[0].duration * (natural_frequency(fit) or dominant_frequency(channel.times, fitted))


def _outliers(fit: LinearisedFit) -> int:
    """Count the samples that are far off, by the median of their distance to the median."""
    count = 0
    for rows in fit.channels:
        distance = np.abs(fit.residuals[rows] - np.median(fit.residuals[rows]))
        scale = 1.4826 * float(np.median(distance))
        count += int(np.count_nonzero(distance > OUTLIER * scale)) if scale > 0 else 0
    return count


def _lines(fit: LinearisedFit, problem: Problem) -> tuple[list[Reason], tuple[OfferedMode, ...]]:
    """Look for a line in the residuals, or an alias of a free motion's frequency: then the modes are offered."""
    channel = problem.records[0].channels[0]
    reasons, is_mode = _line(fit)
    if fit.model.problem.forced:
        return reasons, ()
    if is_mode:
        modes = modes_of(channel.times, channel.values)
        pair = modes_of(channel.times, channel.values, count=2)
        if len(pair) < 2:
            return reasons, ()
        first, second = pair
        ratio = max(first.frequency / second.frequency, second.frequency / first.frequency)
        if 1 < round(ratio) <= HIGHEST_HARMONIC and abs(ratio / round(ratio) - 1.0) < HARMONIC:
            said = f"{second.share:.0%} of the signal is a harmonic at {ratio:.3g} times the natural frequency"
            return [Reason(Trust.NO, f"{said}: a clipped sensor, or a spring that is far from linear")], ()
        if len(modes) < 2:
            return reasons, ()
        names = " and ".join(f"{mode.frequency:.4g} Hz (damping ratio {mode.damping_ratio:.3g})" for mode in modes)
        said = f"the record holds modes at {names}: add modes={len(modes)}; {reasons[0].text}"
        return [Reason(reasons[0].verdict, said)], modes
    frequency = (natural_frequency(fit) or 0.0) / problem.natural_units().time
    rate = (channel.n - 1) / float(np.ptp(channel.times))
    if not rate / FEW_SAMPLES < frequency < rate or channel.n < 12:
        return reasons, ()
    modes = modes_of(channel.times, channel.values, count=1)
    alias = alias_of(modes[0], channel.times) if modes else None
    if alias is None:
        return reasons, ()
    per_cycle = rate / modes[0].frequency
    said = (
        f"{modes[0].frequency:.4g} Hz and {alias.frequency:.4g} Hz fit the samples alike ({per_cycle:.2g} samples per "
        f"cycle of the lower): only a sampling rate above {2 * alias.frequency:.3g} Hz excludes the alias"
    )
    return [*reasons, Reason(Trust.NO if per_cycle < AMBIGUOUS else Trust.CAUTION, said)], (modes[0], alias)


def _line(fit: LinearisedFit) -> tuple[list[Reason], bool]:
    """Look for a line in the spectrum of the residuals of each channel; return whether it may be a mode."""
    for rows, (_, channel) in zip(fit.channels, fit.model.channels, strict=True):
        if not even_times(channel.times) or rows.size < 16:
            continue
        frequency, share = line(channel.times, fit.residuals[rows], fit.model.data[rows] - fit.residuals[rows])
        harmonic = frequency / (natural_frequency(fit) or dominant_frequency(channel.times, channel.values))
        if share > SECOND_MODE and abs(harmonic - 1.0) > SAME_LINE:
            said = f"the residuals hold a line at {harmonic:.2f} times the natural frequency, {share:.0%} of the motion"
            slow = "a drift of the sensor, or something slower; detrend=true takes a straight drift away"
            source = "a second mode" if harmonic > SLOW else slow
            return [Reason(Trust.NO if share > MOST_LEFT else Trust.CAUTION, f"{said}: {source}")], harmonic > SLOW
    return [], False


def line(times: np.ndarray, residuals: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Return frequency (1/time) and root mean square, over that of the values, of a significant line; 0 if none is.

    By the test of R. A. Fisher, Proc. R. Soc. A 125:54, 1929.

    It is sought in the whole record and in its beginning, where a mode that soon dies out is seen better.
    """
    parts = [slice(0, times.size // part) for part in BEGINNINGS if times.size // part >= LEAST_BEGINNING or part == 1]
    return max((_part_line(times[part], residuals[part], values[part]) for part in parts), key=lambda line: line[1])


def _part_line(times: np.ndarray, residuals: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    even = np.interp(np.linspace(times[0], times[-1], times.size), times, residuals)
    power = np.abs(np.fft.rfft(even - np.mean(even))[1:]) ** 2
    total, size = float(np.sum(power)), float(np.std(values))
    if not (total > 0 and size > 0):
        return 0.0, 0.0
    largest = float(np.max(power)) / total
    frequency = (int(np.argmax(power)) + 1) / float(np.ptp(times))
    chance = power.size * (1.0 - largest) ** (power.size - 1)
    return (frequency, float(np.std(residuals)) * np.sqrt(largest) / size) if chance < LINE_LEVEL else (frequency, 0.0)


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
    modes = modes_of(force.times, force.values, count=1)
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


def growth_of(signals: Iterable[np.ndarray]) -> float:
    """Return the standard deviation of the last third over that of the first, the largest of several signals."""
    thirds = [[float(np.std(third)) for third in np.array_split(values, 3)] for values in signals]
    return max((last / (first or 1.0) for first, _, last in thirds), default=0.0)


def _channels(fit: LinearisedFit) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return residuals and samples of each channel."""
    return [fit.residuals[rows] for rows in fit.channels], [channel.values for _, channel in fit.model.channels]


def start_up(residuals: Iterable[np.ndarray], values: Iterable[np.ndarray]) -> list[Reason]:
    """Find residuals of the first part of a channel that are far larger than those of the rest."""
    for left, samples in zip(residuals, values, strict=True):
        n = max(left.size // 10, 5)
        if left.size < 4 * n:
            continue
        early, rest = np.std(left[:n]), np.std(left[n:])
        share = early / (np.std(samples) or 1.0)
        if early > START_UP * rest and share > START_UP_SHARE:
            said = f"the first tenth of the record fits {early / (rest or 1.0):.2g} times worse than the rest"
            return [Reason(Trust.CAUTION, f"{said}: leave a start-up out by from=")]
    return []


def _force_is_turned(fit: LinearisedFit) -> bool:
    """Decide whether a linear equation of motion describes the first motion with a force of the opposite sign.

    Integrated twice, ``x = -c/m I x - k/m I² x + 1/m I² f + a + b t + d t²``, with an offset of x, is linear in all
    unknowns and hardly minds noise; of a velocity the force is integrated once, of an acceleration not at all.
    """
    record = fit.model.problem.records[0]
    if not record.forces or fit.model.system.n_dof > 1:
        return False
    channel, force = record.channels[0], record.forces[0]
    t, y = channel.times, channel.values - np.mean(channel.values)

    def integral(values: np.ndarray) -> np.ndarray:
        return np.append(0.0, np.cumsum((values[1:] + values[:-1]) / 2.0 * np.diff(t)))

    push = np.interp(t, force.times, force.values)
    for _ in range({"displacement": 2, "velocity": 1, "acceleration": 0}[channel.measures]):
        push = integral(push)
    columns = np.column_stack([push, integral(y), integral(integral(y)), np.ones(t.size), t, t**2])
    sizes = np.linalg.norm(columns, axis=0)
    coefficients = np.linalg.lstsq(columns / np.where(sizes > 0, sizes, 1.0), y, rcond=None)[0]
    left = y - columns @ (coefficients / np.where(sizes > 0, sizes, 1.0))
    return bool(coefficients[0] < 0 and np.std(left) < TURNED * np.std(fit.residuals[fit.channels[0]]))


def part_of_signal(fit: LinearisedFit) -> float:
    """Compute the root mean square of the residuals over that of the signal about its mean, over all channels."""
    total, left = 0.0, 0.0
    for rows, (_, channel) in zip(fit.channels, fit.model.channels, strict=True):
        size = float(np.std(channel.values)) or 1.0
        total += rows.size
        left += float(np.sum((fit.residuals[rows] / size) ** 2))
    return float(np.sqrt(left / total))


def whiteness_level(fit: LinearisedFit) -> float:
    """Compute the smallest p-value of the channels that their residuals are white, by Ljung and Box."""
    levels = [1.0]
    for rows in fit.channels:
        if rows.size >= 12 and rows.size > fit.theta.size + 2:
            kept = rows[:2000]  # the test draws white noise as long as the record
            levels.append(float(whiteness(fit.residuals[kept][None], fit.slopes[kept])[0]))
    return min(levels)


def lag_one(fit: LinearisedFit) -> float:
    """Compute the autocorrelation of the first channel's residuals at one sample."""
    return float(autocorrelation(fit.residuals[fit.channels[0]], 1)[1])


def natural_frequency(fit: LinearisedFit) -> float | None:
    """Compute the frequency by the answer's own k/m, in cycles per unit of its time; None for a system without them."""
    p = fit.model.parameters(fit.theta)
    if not {"k", "m"} <= set(p):
        return None
    return float(np.sqrt(p["k"] / p["m"]) / (2 * np.pi))
