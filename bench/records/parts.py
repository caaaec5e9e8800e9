"""Parts of a record, each fitted alone: their differences show how far a repeat of the test may differ.

A model that is not quite right has other parameters in each part: damping that falls with the amplitude, a stiffness
that drifts. The parts have equal energy in the fitted motion, so that all of them determine the parameters about as
well; one in which the motion has died out has a large variance and counts for little.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from bench.contract.problem import Channel, Force, InitialState, Problem, Record
from bench.dynamics.simulate import simulate
from bench.likelihood.compiled import compiled_output_error
from bench.likelihood.output_error import OutputError
from bench.records.linearised import Linearised, at_theta

MOST_PARTS = 6
CYCLES, MEAN_CYCLES = 2.0, 3.0
"""Least cycles of a part, and of the parts on average: fewer do not determine a damping."""
SAMPLES_PER_UNKNOWN = 4
ITERATIONS = 8
LARGEST_CHANGE = 0.7
"""A part whose stiffness differs by more than a factor of two from the whole's follows something else."""


def parts_of(whole: Linearised, frequency: float) -> list[Linearised]:
    """Fit the parts of a record, or each of several records, alone, from the answer to the whole; below two: none.

    ``frequency``: cycles per unit of the problem's time.
    """
    records = whole.model.problem.records
    if len(records) > 1:
        fits = [_alone(whole, i) for i in range(len(records))]
    else:
        fits = [_part(whole, low, high) for low, high in pairwise(_edges(whole, frequency))]
    parts = [fit for fit in fits if fit is not None and fit.coloured is not None and _same_mode(fit, whole)]
    return parts if len(parts) > 1 else []


def _same_mode(part: Linearised, whole: Linearised) -> bool:
    kinds = {parameter.name: parameter.kind for parameter in whole.model.system.parameters}
    stiffness = [i for i, name in enumerate(whole.model.free) if kinds[name] == "stiffness"]
    return bool(np.all(np.abs(part.theta[stiffness] - whole.theta[stiffness]) <= LARGEST_CHANGE))


def _edges(whole: Linearised, frequency: float) -> list[float]:
    """Return the times that divide a record into parts of equal energy, none shorter than some cycles."""
    record = whole.model.problem.records[0]
    channel = record.channels[0]
    smallest = min(c.n for c in record.channels)
    count = int(
        min(MOST_PARTS, record.duration * frequency / MEAN_CYCLES, smallest / (SAMPLES_PER_UNKNOWN * whole.model.size))
    )
    motion = (whole.model.data - whole.residuals - whole.model.offsets(whole.theta)[whole.model.channel_of])[
        : channel.n
    ]
    energy = np.cumsum(motion**2 * np.gradient(channel.times))
    least = max(CYCLES / frequency, SAMPLES_PER_UNKNOWN * whole.model.size * record.duration / smallest)
    edges = [0.0]
    for share in range(1, count):
        time = float(np.interp(share / count, energy / (energy[-1] or 1.0), channel.times))
        edges.append(max(time, edges[-1] + least))
    while len(edges) > 1 and edges[-1] + least > record.duration:
        edges.pop()
    return [*edges, record.duration]


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
