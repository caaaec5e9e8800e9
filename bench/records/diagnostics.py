"""Diagnostics of a fit to measured records: checks that return reasons for caution."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from bench.contract.problem import Problem
from bench.likelihood.autoregression import even_times
from bench.records.dominant_frequency import dominant_frequency
from bench.records.intervals import StatedInterval
from bench.records.linearised_fit import LinearisedFit
from bench.records.modes import OfferedMode, alias_of, modes_of
from bench.records.saturation import at_limit
from bench.records.verdict import Reason, Trust, verdict
from bench.scoring.statistics import whiteness

FALSE_ALARM = 1e-3
"""p-value under noise alone above which an estimate is rejected."""
MOST_LEFT, MUCH_LEFT = 0.30, 0.10
"""Ratios of residuals to signal (root mean square) of coloured residuals: above the first the model is wrong and the
estimate is rejected (a tenth of the power is unexplained); above the second, caution."""
NOISE_FREE = 1e-5
"""Ratio of residuals to signal below which they are due to rounding, and their colour is ignored."""
STRETCHED = 1.5
"""Least widening of an interval by coloured noise that is reported; smaller ones depend on the noise estimate."""
UNEVEN = 2.0
"""Ratio of the standard deviation between parts or repeats to the expected one above which it is reported."""
WIDE = 0.5
"""Ratio of the half-width of an interval to its value above which only the order of magnitude is known."""
OUTLIER = 6.0
"""Distance from the median, in robust standard deviations (P. J. Rousseeuw, C. Croux, J. Am. Stat. Assoc. 88:1273,
1993), beyond which a sample is an outlier; normal noise has one in 500 million."""
MOST_OUTLIERS = 0.05
"""Share of samples above which they are not outliers, but noise with heavy tails or a wrong model."""
SECOND_MODE = 0.05
"""Ratio of a line in the residuals to the fitted motion (root mean square) above which it is reported."""
LINE_LEVEL = 1e-6
"""p-value of a line under white noise below which it is significant."""
BEGINNINGS, LEAST_BEGINNING = (1, 4, 16), 100
"""Lines are sought in the record and in its first fourth and sixteenth, if these have enough samples."""
SAME_LINE = 0.15
"""Relative distance from the natural frequency within which a line is due to an error of the decay law."""
HARMONIC = 0.01
"""Relative distance of a frequency ratio from a whole number within which the second frequency is a harmonic."""
HIGHEST_HARMONIC = 10
"""Highest harmonic considered; above it, one ratio in five or more is that close to a whole number by chance."""
SLOW = 0.5
"""Ratio of the frequency of a line to the natural frequency below which it is a drift."""
AMBIGUOUS, FEW_SAMPLES = 3.0, 8.0
"""Samples per cycle: below the first the frequency may be an alias and the estimate is rejected; below the second the
alias is reported, which is then at most 7/8 of the sampling rate."""
FEW_CYCLES, TOO_FEW_CYCLES = 1.5, 0.75
"""Cycles in a free decay: below the first, damping and drift are hardly distinguishable; below the second, the
frequency is not determined either and the estimate is rejected."""
GROWTH = 1.2
"""Ratio of the standard deviations of the last and first third above which a free motion grows."""
START_UP, START_UP_SHARE = 3.0, 0.05
"""Ratios of the residuals of the first tenth to those of the rest, and to the signal, above which it is a start-up."""
LEVEL = 0.01
"""p-value below which residuals are not white; one in a hundred good records fails."""
REVERSED = 0.5
"""Ratio of the residuals of a linear equation of motion to those of the fit below which its force sign is trusted."""
PURE_SINE = 0.02
"""Ratio of the residuals of a sine to a force (root mean square) below which the force is a pure sine."""
SETTLED = 1.1
"""Ratio of the residuals of a sine to those of the fit below which the motion is steady."""


def diagnose(
    fit: LinearisedFit | None,
    problem: Problem,
    intervals: Mapping[str, StatedInterval],
    missing: Sequence[str],
    message: str,
) -> tuple[tuple[Reason, ...], tuple[OfferedMode, ...]]:
    """Return the reasons for caution, and candidate modes if the record shows several or an alias.

    Args:
        fit: Linearised likelihood at the estimate; None if the response is not finite.
        problem: The records, in the user's units.
        intervals: Stated intervals.
        missing: Forces that the model lacks.
        message: Message of the method.
    """
    if fit is None:
        return (Reason(Trust.NO, "the response of the estimate is not finite"),), ()
    line_reasons, modes = _lines(fit, problem)
    reasons = [*line_reasons, *_fit_reasons(fit)]
    if len(modes) < 2:
        residuals, values = (fit.residuals[rows] for rows in fit.channels), (c.values for _, c in fit.model.channels)
        reasons += start_up(residuals, values)
    if sine := steady_sine(problem, part_of_signal(fit)):
        reasons.insert(0, Reason(Trust.NO, sine))
    if verdict(reasons) is not Trust.NO:  # further properties of a rejected fit are meaningless
        n, unknowns = fit.residuals.size, fit.theta.size
        texts = [f"{n} samples for {unknowns} unknowns"] if n < 2 * unknowns else []
        if part_of_signal(fit) >= NOISE_FREE and missing:
            forces = " and ".join(missing)
            texts.append(f"the residuals indicate {forces}, which the model lacks: add it, or use system=auto")
        coloured = any(noise is None or noise.order for noise in fit.noises)
        colour = max((interval.colour for interval in intervals.values()), default=1.0)
        if coloured and part_of_signal(fit) >= NOISE_FREE and colour > STRETCHED:
            texts.append(f"the residuals are not white: intervals are up to {colour:.2g} times those of white noise")
        reasons += [*(Reason(Trust.CAUTION, text) for text in texts), *reasons_of_intervals(intervals)]
    if message:
        reasons.append(Reason(Trust.CAUTION, f"message of the method: {message}"))
    return tuple(dict.fromkeys(reasons)), modes


def reasons_of_intervals(intervals: Mapping[str, StatedInterval]) -> list[Reason]:
    """Return the reasons for caution that follow from stated intervals."""
    texts = []
    uneven, most = max(intervals.items(), key=lambda item: item[1].unevenness, default=("", None))
    if most is not None and most.unevenness > UNEVEN and not most.limit:
        difference = f"{readable(uneven)} differs by up to {100 * most.relative_error:.2g} %"
        texts.append(f"{difference} within the record or between repeats, which the interval includes")
    limits = [readable(name) for name, interval in intervals.items() if interval.limit]
    if limits:
        texts.append(f"only an upper or lower limit is determined: {', '.join(limits)}")
    wide = [readable(name) for name, i in intervals.items() if not (i.limit or i.relative_error < WIDE)]
    if wide:
        texts.append(f"only the order of magnitude is determined: {', '.join(wide)}")
    return [Reason(Trust.CAUTION, text) for text in texts]


def readable(name: str) -> str:
    """Return the display name of a quantity, such as k/m."""
    return name.replace("_over_", "/").replace("_", " ")


def _fit_reasons(fit: LinearisedFit) -> Iterator[Reason]:
    """Yield the reasons for caution that follow from records and residuals."""
    signals = [channel.values for _, channel in fit.model.channels if channel.n > 3]
    forced, free = fit.model.problem.forced, not fit.model.problem.forced
    white, share = whiteness_level(fit) > LEVEL, part_of_signal(fit)
    if (chance := _chance_of_noise(fit, signals)) > FALSE_ALARM:
        problem = "the motion is unrelated to the force" if forced else "no vibration detected"
        yield Reason(Trust.NO, f"{problem}: p = {chance:.2g} under noise alone")
    if any(np.any(at_limit(values)) for values in signals):
        yield Reason(Trust.NO, "the sensor is clipped: samples repeat its largest or smallest value")
    forces = [force.values for record in fit.model.problem.records for force in record.forces]
    if (cut := sum(int(np.count_nonzero(at_limit(values))) for values in forces)) and not white:
        yield Reason(Trust.NO, f"the force sensor is clipped: {cut} samples are at its largest or smallest value")
    growth = growth_of(signals)
    if free and growth > GROWTH and fit.model.system.name != "van_der_pol":  # which gains energy
        yield Reason(Trust.NO, f"the motion grows by a factor of {growth:.2g}: this is not a damped free vibration")
    ratio = f"residual RMS is {share:.0%} of signal RMS"
    if share > MOST_LEFT:
        wrong, noisy = f"{ratio} and not white: the model does not describe the record", f"{ratio}: strong noise"
        yield Reason(Trust.CAUTION, noisy) if white else Reason(Trust.NO, wrong)
    elif share > MUCH_LEFT and not white:
        yield Reason(Trust.CAUTION, f"{ratio} and not white")
    cycles = _cycles(fit)
    if free and cycles < TOO_FEW_CYCLES:
        yield Reason(Trust.NO, f"the record has {cycles:.2g} cycles; record at least two")
    elif free and cycles < FEW_CYCLES:
        yield Reason(Trust.CAUTION, f"the record has {cycles:.2g} cycles")
    if share > MOST_LEFT and _force_is_reversed(fit):
        yield Reason(Trust.NO, "the sign of the force is wrong: reversed, it fits far better; add force_gain=-1")
    if count := outliers(fit):
        yield Reason(Trust.CAUTION, f"{count} outlier{'s' * (count > 1)}")


def _chance_of_noise(fit: LinearisedFit, signals: Sequence[np.ndarray]) -> float:
    """Return the p-value of the fit under white noise, corrected for the choice among all frequencies."""
    from scipy.stats import f as f_distribution

    n, used = fit.residuals.size, max(fit.used, 1.0)
    constants = sum(float(np.sum((values - np.mean(values)) ** 2)) for values in signals)
    left = float(fit.residuals @ fit.residuals)
    if n - used < 1 or left <= 0:
        return 0.0
    statistic = max(constants - left, 0.0) / used / (left / (n - used))
    return min(1.0, n / 2.0 * float(f_distribution.sf(statistic, used, n - used)))


def _cycles(fit: LinearisedFit) -> float:
    """Return the number of cycles in the first record, from the estimate or else the fitted motion."""
    channel = fit.model.channels[0][1]
    fitted = fit.model.data[: channel.n] - fit.residuals[: channel.n]
    return fit.model.problem.records[0].duration * (natural_frequency(fit) or dominant_frequency(channel.times, fitted))


def outliers(fit: LinearisedFit) -> int:
    """Count outliers by the median absolute deviation; 0 if they are more than ``MOST_OUTLIERS`` of the samples."""
    count = 0
    for rows in fit.channels:
        distance = np.abs(fit.residuals[rows] - np.median(fit.residuals[rows]))
        scale = 1.4826 * float(np.median(distance))
        count += int(np.count_nonzero(distance > OUTLIER * scale)) if scale > 0 else 0
    return count if count <= MOST_OUTLIERS * fit.residuals.size else 0


def _lines(fit: LinearisedFit, problem: Problem) -> tuple[list[Reason], tuple[OfferedMode, ...]]:
    """Detect a line in the residuals, or an alias of the frequency of a free motion; return reasons and modes."""
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
            harmonic = f"a harmonic at {ratio:.3g} times the natural frequency is {second.share:.0%} of the signal"
            return [Reason(Trust.NO, f"{harmonic}: a clipped sensor or a strongly nonlinear spring")], ()
        if len(modes) < 2:
            return reasons, ()
        names = " and ".join(
            f"{mode.frequency:.4g} Hz (damping ratio {100.0 * mode.damping_ratio + 0.0:.3g} %)" for mode in modes
        )
        text = f"the record has modes at {names}: add modes={len(modes)}; {reasons[0].text}"
        return [Reason(reasons[0].verdict, text)], modes
    frequency = (natural_frequency(fit) or 0.0) / problem.natural_units().time
    rate = (channel.n - 1) / float(np.ptp(channel.times))
    if not rate / FEW_SAMPLES < frequency < rate or channel.n < 12:
        return reasons, ()
    modes = modes_of(channel.times, channel.values, count=1)
    alias = alias_of(modes[0], channel.times) if modes else None
    if alias is None:
        return reasons, ()
    per_cycle = rate / modes[0].frequency
    text = (
        f"{modes[0].frequency:.4g} Hz and {alias.frequency:.4g} Hz fit the samples equally well ({per_cycle:.2g} per "
        f"cycle of the lower): a sampling rate above {2 * alias.frequency:.3g} Hz excludes the alias"
    )
    return [*reasons, Reason(Trust.NO if per_cycle < AMBIGUOUS else Trust.CAUTION, text)], (modes[0], alias)


def _line(fit: LinearisedFit) -> tuple[list[Reason], bool]:
    """Detect a line in the residuals of a channel; return the reason, and whether the line may be a mode."""
    for rows, (_, channel) in zip(fit.channels, fit.model.channels, strict=True):
        if not even_times(channel.times) or rows.size < 16:
            continue
        frequency, share = line(channel.times, fit.residuals[rows], fit.model.data[rows] - fit.residuals[rows])
        harmonic = frequency / (natural_frequency(fit) or dominant_frequency(channel.times, channel.values))
        if share > SECOND_MODE and abs(harmonic - 1.0) > SAME_LINE:
            text = f"the residuals have a line at {harmonic:.2f} times the natural frequency, {share:.0%} of the motion"
            slow = "drift of the sensor or another slow motion; detrend=true removes a linear drift"
            source = "a second mode" if harmonic > SLOW else slow
            return [Reason(Trust.NO if share > MOST_LEFT else Trust.CAUTION, f"{text}: {source}")], harmonic > SLOW
    return [], False


def line(times: np.ndarray, residuals: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Test for a line in the residuals (R. A. Fisher, Proc. R. Soc. A 125:54, 1929).

    It is sought in the whole record and in its beginning, where heavily damped modes are stronger.

    Args:
        times: Times, shape (n,).
        residuals: Residuals, shape (n,).
        values: Fitted motion, shape (n,).

    Returns:
        Frequency (1/time) of the largest line, and its root mean square over that of the motion; 0 if not significant.
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
    """Detect a steady-state response to a sine, from which m, c and k cannot be determined.

    Args:
        problem: The records, in the user's units.
        left: Ratio of the residuals of a fit to the motion; without it, the motion is steady if the residuals of a
            sine have no significant line.

    Returns:
        A sentence that states the response; empty if the records are not of this kind.
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
    share = float(np.std(rest) / (np.std(channel.values) or 1.0))
    if line(channel.times, rest, channel.values)[1] > 0 if left is None else share > SETTLED * left:
        return ""
    ratio = response / push
    return (
        f"the record is a steady-state response to a sine of {frequency:.4g} Hz, {abs(ratio):.4g} {channel.unit}/N at "
        f"{np.degrees(np.angle(ratio)):.3g}°: m, c and k are not identifiable; record the transient or more frequencies"
    )


def _sine(times: np.ndarray, values: np.ndarray, frequency: float) -> tuple[complex, np.ndarray]:
    """Fit a sine and a constant to values (n,); return the complex amplitude and the residuals."""
    phase = 2 * np.pi * frequency * times
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones(times.size)])
    sizes = np.linalg.lstsq(basis, values, rcond=None)[0]
    return complex(sizes[0], -sizes[1]), values - basis @ sizes


def growth_of(signals: Iterable[np.ndarray]) -> float:
    """Return the ratio of the standard deviations of the last and first third, the largest of several signals."""
    thirds = [[float(np.std(third)) for third in np.array_split(values, 3)] for values in signals]
    return max((last / (first or 1.0) for first, _, last in thirds), default=0.0)


def start_up(residuals: Iterable[np.ndarray], values: Iterable[np.ndarray]) -> list[Reason]:
    """Return a reason for caution if the residuals of the first tenth of a channel are far larger than the others.

    Args:
        residuals: Residuals of each channel.
        values: Samples of each channel.
    """
    for left, samples in zip(residuals, values, strict=True):
        n = max(left.size // 10, 5)
        if left.size < 4 * n:
            continue
        early, rest = np.std(left[:n]), np.std(left[n:])
        share = early / (np.std(samples) or 1.0)
        if early > START_UP * rest and share > START_UP_SHARE:
            text = f"residuals of the first tenth of the record are {early / (rest or 1.0):.2g} times those of the rest"
            return [Reason(Trust.CAUTION, f"{text}: exclude a start-up with from=")]
    return []


def _force_is_reversed(fit: LinearisedFit) -> bool:
    """Return whether a linear equation of motion describes the first record far better with a force of opposite sign.

    The equation integrated twice, ``x = -c/m I x - k/m I² x + 1/m I² f + a + b t + d t²`` with an offset of x, is
    linear in all unknowns and insensitive to noise. For velocities the force is integrated once, for accelerations not.
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
    return bool(coefficients[0] < 0 and np.std(left) < REVERSED * np.std(fit.residuals[fit.channels[0]]))


def part_of_signal(fit: LinearisedFit) -> float:
    """Compute the ratio of residuals to signal (root mean square about the mean) over all channels."""
    total, left = 0.0, 0.0
    for rows, (_, channel) in zip(fit.channels, fit.model.channels, strict=True):
        size = float(np.std(channel.values)) or 1.0
        total += rows.size
        left += float(np.sum((fit.residuals[rows] / size) ** 2))
    return float(np.sqrt(left / total))


def whiteness_level(fit: LinearisedFit) -> float:
    """Compute the smallest p-value of the channels in the Ljung-Box test that residuals are white."""
    levels = [1.0]
    for rows in fit.channels:
        if rows.size >= 12 and rows.size > fit.theta.size + 2:
            kept = rows[:2000]  # the test simulates white noise of this length
            levels.append(float(whiteness(fit.residuals[kept][None], fit.slopes[kept])[0]))
    return min(levels)


def natural_frequency(fit: LinearisedFit) -> float | None:
    """Compute the natural frequency from k/m (cycles per natural unit of time); None for a system without k or m."""
    p = fit.model.parameters(fit.theta)
    if not {"k", "m"} <= set(p):
        return None
    return float(np.sqrt(p["k"] / p["m"]) / (2 * np.pi))
