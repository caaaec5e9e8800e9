"""A model fitted to a record by growing windows: from a cycle or so to the whole, each from the answer to the last.

The phase of a nonlinear vibration runs away from any first guess within a few cycles, and the misfit of the whole
record then has a minimum at every slip. Over a short window it has one, and its answer is near enough for a window
twice as long (H. G. Bock's multiple shooting serves the same end). No method of the benchmark is used, so that a model
class is judged by its own best fit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.contract.problem import Channel, Problem, Record
from bench.likelihood.compiled import compiled_output_error
from bench.likelihood.output_error import OutputError
from bench.records.linearised import Linearised, at_theta
from bench.records.strongest import strongest_frequency
from bench.systems import System

FIRST_CYCLES = 2.0
GROWTH = 2.0
ITERATIONS = 12
LAST_ITERATIONS = 30
DAMPING_RATIO = 0.02
SMALL = 0.03
"""First size of a further term's force over that of the spring."""


def vibration(channel: Channel) -> tuple[float, float]:
    """The strongest angular frequency of a channel, and half of its range."""
    frequency = strongest_frequency(channel.times, channel.values)
    return 2 * np.pi * frequency, float(np.ptp(channel.values)) / 2.0 or 1.0


def first_guess(system: System, rate: float, size: float, mass: float = 1.0) -> dict[str, float]:
    """Parameters of a vibration of angular frequency ``rate`` and amplitude ``size``."""
    k = rate**2
    sizes = {
        "m": 1.0, "k": k, "c": 2 * DAMPING_RATIO * rate, "mu": SMALL * k * size, "c2": SMALL / size,
        "k3": SMALL * k / size**2, "k3s": SMALL * k / size**2, "l": 3.0 * size, "b": SMALL * k * size,
    }  # fmt: skip
    return {q.name: (mass if q.dimension.mass else 1.0) * sizes.get(q.name, 1.0) for q in system.parameters}


def grown_fit(problem: Problem) -> Linearised | None:
    """The least squares on a problem of one record, in natural units; None where no window gave a finite response."""
    record = problem.records[0]
    rate, size = vibration(max(record.channels, key=lambda c: c.n))
    length = FIRST_CYCLES * 2 * np.pi / rate
    start = _first(_within(problem, length), first_guess(problem.system, rate, size))
    return grown_from(start, problem, length)


def grown_from(theta: np.ndarray, problem: Problem, length: float, gauge: float = 1.0) -> Linearised | None:
    """The same from unknowns ``theta`` and a first window of so much time on; ``gauge``: the mass where it is held."""
    while True:
        last = length >= problem.records[0].duration
        model = _within(problem, length, gauge)
        theta = model.settle(theta[None], iterations=LAST_ITERATIONS if last else ITERATIONS)[0]
        if last:
            return at_theta(model, theta)
        length *= GROWTH


def _within(problem: Problem, length: float, gauge: float = 1.0) -> OutputError:
    """The likelihood of the record up to a time."""
    return compiled_output_error(replace(problem, records=(window(problem.records[0], length),)), gauge)


def _first(model: OutputError, p: dict[str, float]) -> np.ndarray:
    """The vector at first parameters; where the start cannot be fitted there, at rest at the first value."""
    with np.errstate(all="ignore"):
        theta = model.vector(p)
    return np.where(np.isfinite(theta), theta, 0.0)


def window(record: Record, length: float) -> Record:
    """The record up to a time, but no shorter than twelve samples a channel."""
    channels = tuple(_first_part(channel, length) for channel in record.channels)
    return replace(record, channels=channels)


def _first_part(channel: Channel, length: float) -> Channel:
    n = max(int(np.searchsorted(channel.times, length, side="right")), min(12, channel.n))
    return replace(channel, times=channel.times[:n], values=channel.values[:n])
