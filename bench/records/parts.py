"""Parts of a record, each fitted alone: their differences show how far a repeat of the test may differ.

A model that is not quite right has other parameters in each part: damping that falls with the amplitude, a stiffness
that drifts. The parts have equal energy in the fitted motion, so that all of them determine the parameters about as
well; one in which the motion has died out has a large variance and counts for little.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from bench.contract.problem import Problem, Record
from bench.dynamics.simulate import simulate
from bench.likelihood.compiled import compiled_output_error
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
    model, theta = whole.model, whole.theta
    records, offsets = model.problem.records, model.offsets(theta)
    if len(records) > 1:
        states = [np.zeros(0) if r.initial_state is not None else model.states(theta)[i] for i, r in enumerate(records)]
        places = [[j for j in model.offset_channels if model.channels[j][0] == i] for i in range(len(records))]
        pieces = [(r, s, offsets[own]) for r, s, own in zip(records, states, places, strict=True)]
    else:
        own = offsets[list(model.offset_channels)]
        spans = pairwise(_edges(whole, frequency))
        pieces = [(_cut(records[0], low, high), _state_at(whole, low), own) for low, high in spans]
    fits = [_fitted(whole, *piece) for piece in pieces]
    parts = [fit for fit in fits if fit is not None and fit.coloured is not None and _same_mode(fit, whole)]
    return parts if len(parts) > 1 else []


def _fitted(whole: Linearised, record: Record, state: np.ndarray, offsets: np.ndarray) -> Linearised | None:
    """Fit a record alone from the parameters of the whole; None where it determines others or gives no response."""
    model, k = whole.model, len(whole.model.free)
    if not np.all(np.isfinite(state)) or min(channel.n for channel in record.channels) < 3:
        return None
    part = compiled_output_error(Problem(model.system, (record,)), model.gauge)
    if part.free != model.free:
        return None
    start = at_theta(part, np.concatenate([whole.theta[:k], state, offsets]))
    if start is None:
        return None
    with np.errstate(all="ignore"):
        reached, _ = part.search(
            part.point(start.theta[None]), part.noise(start.residuals, part.size)[None], ITERATIONS
        )
    return at_theta(part, reached.theta[0])


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


def _cut(record: Record, low: float, high: float) -> Record:
    """Return a stretch of a record, from time 0 on, whose initial state is unknown."""
    last = np.inf if high >= record.duration else high
    channels = []
    for channel in record.channels:
        inside = (channel.times >= low) & (channel.times < last)
        channels.append(replace(channel, times=channel.times[inside] - low, values=channel.values[inside]))
    forces = []
    for force in record.forces:
        first = max(int(np.searchsorted(force.times, low, side="right")) - 1, 0)
        if force.times[-1] > low:
            forces.append(replace(force, times=force.times[first:] - low, values=force.values[first:]))
    return replace(record, channels=tuple(channels), forces=tuple(forces), initial_state=None)


def _state_at(whole: Linearised, time: float) -> np.ndarray:
    """Return displacement and velocity at a time of the record, as the whole fit has them."""
    record, start = whole.model.problem.records[0], whole.model.starts(whole.theta)[0]
    if time == 0.0:
        return np.asarray(whole.model.states(whole.theta)[0])
    p = {name: float(value) for name, value in whole.model.parameters(whole.theta).items()}
    motion = simulate(record.rig(whole.model.system), p, start, np.array([time]), record.forces)
    return np.concatenate([motion.displacement[:, 0], motion.velocity[:, 0]])
