"""Parts of a record, each fitted alone, and what their differences say of the stated interval.

A model that is not quite right has other parameters in each part: damping that falls with the amplitude, a stiffness
that drifts. A part's estimate ``y_i`` with variance ``v_i`` then differs from the others by more than chance (W. G.
Cochran, Biometrics 10:101, 1954: ``Q = sum (y_i - mean)² / v_i``, chi-square with K - 1 degrees of freedom). Where it
does, the interval takes the variance between parts (R. C. Paule, J. Mandel, J. Res. Natl. Bur. Stand. 87:377, 1982), or
the square of the change over the record that a straight line through them shows, whichever is larger: another record
of the same length may differ by as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bench.contract.problem import Channel, Force, InitialState, Problem, Record
from bench.dynamics.simulate import simulate
from bench.likelihood.compiled import compiled_output_error
from bench.likelihood.output_error import OutputError
from bench.records.linearised import Linearised, at_theta
from bench.systems import Quantity

MOST_PARTS = 6
CYCLES = 1.0
"""Least length of a part, in cycles."""
SAMPLES_PER_UNKNOWN = 4
LEVEL = 0.01
"""Of the test that parts differ. A false alarm is dear: the error of a part is many times that of the whole."""
ITERATIONS = 8
FAR_BETTER = 0.25
"""Variance that parts leave over that of the whole, below which the noise of a part is told by its own residuals."""


@dataclass(frozen=True)
class Between:
    """What parts say of one quantity's logarithm: variance to add, its degrees of freedom, level, change of it.

    ``estimates`` are the logarithms by part; ``trend`` their change over the record along a straight line.
    """

    variance: float
    dof: float
    p_value: float
    trend: float
    estimates: tuple[float, ...]


NOTHING = Between(0.0, np.inf, 1.0, 0.0, ())


def parts_of(whole: Linearised, frequency: float) -> list[Linearised]:
    """Fit the parts of a record, or each of several records, alone, from the answer to the whole; below two: none.

    ``frequency``: cycles per unit of the problem's time. Each part has at least a cycle and four samples an unknown.
    """
    if len(whole.model.problem.records) > 1:
        return [alone for i in range(len(whole.model.problem.records)) if (alone := _alone(whole, i)) is not None]
    record = whole.model.problem.records[0]
    smallest = min(channel.n for channel in record.channels)
    number = min(
        MOST_PARTS, int(record.duration * frequency / CYCLES), smallest // (SAMPLES_PER_UNKNOWN * whole.model.size)
    )
    edges = np.linspace(0.0, record.duration, max(number, 1) + 1)
    fitted = [_part(whole, low, high) for low, high in pairwise(edges)] if number > 1 else []
    known = [part for part in fitted if part is not None]
    told = known if _fit_far_better(known, whole) else [replace(part, told=whole.noises) for part in known]
    return [part for part in told if part.coloured is not None]


def _fit_far_better(parts: Sequence[Linearised], whole: Linearised) -> bool:
    """Whether the parts leave so much less than the whole that what is left of the whole is no noise."""
    left = sum(float(part.residuals @ part.residuals) for part in parts)
    spare = sum(part.residuals.size - part.theta.size for part in parts)
    noise = float(whole.residuals @ whole.residuals) / max(whole.residuals.size - whole.theta.size, 1)
    return spare > 0 and left / spare < FAR_BETTER * noise


def _alone(whole: Linearised, number: int) -> Linearised | None:
    """One of several records, fitted alone."""
    model = whole.model
    record = model.problem.records[number]
    one = compiled_output_error(replace(model.problem, records=(record,)), model.gauge)
    if one.free != model.free:
        return None
    start, offsets = model.starts(whole.theta)[number], model.offsets(whole.theta)
    own = [i for i, (of, _) in enumerate(model.channels) if of == number]
    state = [] if isinstance(start, InitialState) else [np.concatenate([np.ravel(part) for part in start])]
    theta = np.concatenate(
        [whole.theta[: len(model.free)], *state, [offsets[i] for i in own if i in model.offset_channels]]
    )
    fitted = _searched(one, theta)
    return None if fitted is None or fitted.coloured is None else fitted


def _part(whole: Linearised, low: float, high: float) -> Linearised | None:
    model = whole.model
    record = model.problem.records[0]
    last = high >= record.duration
    channels = tuple(_cut(channel, low, np.inf if last else high) for channel in record.channels)
    if min(channel.n for channel in channels) < 3:
        return None
    forces = tuple(force for own in record.forces if (force := _shifted(own, low)) is not None)
    piece = Problem(model.system, (replace(record, channels=channels, forces=forces, initial_state=None),))
    part = compiled_output_error(piece, model.gauge)
    p = {name: float(value) for name, value in model.parameters(whole.theta).items()}
    state = _state_at(whole, record, p, low)
    k = len(model.free)
    if not all(np.isfinite(state)) or len(part.free) != k:
        return None
    offsets = whole.theta[-len(model.offset_channels) :] if model.offset_channels else np.zeros(0)
    return _searched(part, np.concatenate([whole.theta[:k], state, offsets]))


def _searched(model: OutputError, theta: np.ndarray) -> Linearised | None:
    start = at_theta(model, theta)
    if start is None:
        return None
    sigma = model.noise(start.residuals, model.size)
    with np.errstate(all="ignore"):
        reached, _ = model.search(model.point(theta[None]), sigma[None], ITERATIONS)
    return at_theta(model, reached.theta[0])


def _cut(channel: Channel, low: float, high: float) -> Channel:
    inside = (channel.times >= low) & (channel.times < high)
    return replace(channel, times=channel.times[inside] - low, values=channel.values[inside])


def _shifted(force: Force, low: float) -> Force | None:
    """The force from ``low`` on, with the sample before it; None where it has ended by then."""
    if force.times[-1] <= low:
        return None
    first = max(int(np.searchsorted(force.times, low, side="right")) - 1, 0)
    return replace(force, times=force.times[first:] - low, values=force.values[first:])


def _state_at(whole: Linearised, record: Record, p: dict[str, float], time: float) -> np.ndarray:
    """Displacement and velocity at a time of the record, as the whole fit has them."""
    start = whole.model.starts(whole.theta)[0]
    if time == 0.0:
        state = start if isinstance(start, InitialState) else InitialState(start[0], start[1])
        return np.concatenate([state.displacement, state.velocity])
    motion = simulate(record.rig(whole.model.system), p, start, np.array([time]), record.forces)
    return np.concatenate([motion.displacement[:, 0], motion.velocity[:, 0]])


def between(parts: Sequence[Linearised], quantity: Quantity) -> Between:
    """What the parts say of a quantity."""
    estimates, variances = [], []
    for part in parts:
        gradient, covariance = part.gradient(quantity), part.coloured
        if covariance is None or part.white is None:
            continue
        variance = max(float(gradient @ covariance @ gradient), float(gradient @ part.white @ gradient))
        if np.isfinite(variance) and variance > 0:
            k = len(part.model.free)
            estimates.append(float(gradient[:k] @ part.theta[:k]))
            variances.append(variance)
    return NOTHING if len(estimates) < 2 else heterogeneity(np.array(estimates), np.array(variances))


def heterogeneity(y: np.ndarray, v: np.ndarray) -> Between:
    """What estimates (K,) with variances (K,) say of the variance between them; see the module."""
    from scipy.stats import chi2

    mean = np.sum(y / v) / np.sum(1.0 / v)
    p_value = float(chi2.sf(np.sum((y - mean) ** 2 / v), y.size - 1))
    if p_value > LEVEL:
        return replace(NOTHING, p_value=p_value, estimates=tuple(map(float, y)))
    scatter = paule_mandel(y, v)
    weights = 1.0 / (v + scatter)
    place = np.arange(y.size) - np.sum(weights * np.arange(y.size)) / np.sum(weights)
    slope = float(np.sum(weights * place * y) / np.sum(weights * place**2))
    trend = slope * y.size
    of_noise = y.size**2 / float(np.sum(place**2 / v))
    variance = max(scatter, trend**2 - of_noise)
    return Between(variance, y.size - 1.0, p_value, trend, tuple(map(float, y)))


def paule_mandel(y: np.ndarray, v: np.ndarray) -> float:
    """The variance between groups at which the weighted sum of squares equals its degrees of freedom; at least 0."""
    from scipy.optimize import brentq

    def excess(variance: float) -> float:
        weights = 1.0 / (v + variance)
        mean = np.sum(weights * y) / np.sum(weights)
        return float(np.sum(weights * (y - mean) ** 2)) - (y.size - 1)

    if excess(0.0) <= 0:
        return 0.0
    high = float(np.sum((y - np.mean(y)) ** 2))
    return float(brentq(excess, 0.0, high, xtol=1e-12 * high, rtol=1e-8))
