"""Initial guesses for long records: a scan of the first cycles, refitted on successively longer parts.

The cost of a scan is proportional to cycles times samples, and a fit fails from a frequency that is wrong by half a
cycle over the record. The first guesses therefore come from the first cycles, decimated, and are refitted on four times
the length until the record ends; each fit determines the frequency well enough for the next. Samples left out cost
information but cause no bias, since responses are exact at any times.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bench import Channel, Force, OutputError, Problem, Record
from methods.starts.common_rates import periodogram

MOST_SAMPLES = 1000
"""Largest number of samples per channel in each fit."""
LONG = 3 * MOST_SAMPLES
"""Samples of a channel beyond which a record counts as long."""
FIRST_CYCLES = 40.0
"""Cycles of the strongest oscillation in the first part."""
LONGER, ITERATIONS = 4.0, 12
"""Ratio of the lengths of successive parts, and iterations of the fit to each."""
STRONGEST_OF = 2**17
"""Largest number of samples of the periodogram that finds the strongest oscillation."""

Starts = list[dict[str, float]]


def is_long(problem: Problem) -> bool:
    """Return True where a channel has more than ``LONG`` samples."""
    return any(c.n > LONG for record in problem.records for c in record.channels)


def starts_of_long(problem: Problem, seek: Callable[[OutputError], Starts]) -> Starts:
    """Return initial guesses of a linear system in natural units; ``seek`` finds those of a short problem."""
    shares = [_first_share(record) for record in problem.records]
    short = thinned(problem, shares)
    units = short.natural_units()
    scales = units.scales(problem.system)
    guesses = [{name: v * scales[name] for name, v in p.items()} for p in seek(OutputError(short.expressed_in(units)))]
    while min(shares) < 1.0:
        shares = [min(LONGER * share, 1.0) for share in shares]
        guesses = _fitted(OutputError(thinned(problem, shares)), guesses)
    return guesses


def _fitted(model: OutputError, guesses: Starts) -> Starts:
    """Improve guesses by a few output-error iterations; those that diverge are left out."""
    with np.errstate(all="ignore"):
        thetas = np.array([model.vector(p) for p in guesses])
        good = np.all(np.isfinite(model.predict(thetas)), axis=1)
        thetas = model.settle(thetas[good], 1, ITERATIONS)
    return [{name: float(v) for name, v in model.parameters(theta).items()} for theta in thetas]


def thinned(problem: Problem, shares: Sequence[float] = ()) -> Problem:
    """Decimate the first share of each record (default all) to at most ``MOST_SAMPLES`` per channel."""
    pairs = zip(problem.records, shares or [1.0] * len(problem.records), strict=True)
    return replace(problem, records=tuple(_head(record, share * record.duration) for record, share in pairs))


def _head(record: Record, end: float) -> Record:
    """Decimate a record until time ``end``; forces are averaged over the decimation interval."""

    def thinned(c: Channel) -> Channel:
        n = int(np.searchsorted(c.times, end, "right"))
        kept = slice(0, n, max(1, -(-n // MOST_SAMPLES)))
        return replace(c, times=c.times[kept], values=c.values[kept])

    return replace(
        record,
        channels=tuple(thinned(c) for c in record.channels),
        forces=tuple(_averaged(force, end) for force in record.forces),
    )


def _averaged(force: Force, end: float) -> Force:
    """Average a force until time ``end`` over blocks of equally many samples, at the blocks' mean times."""
    n = max(2, int(np.searchsorted(force.times, end, "right")))
    size = -(-n // MOST_SAMPLES)
    if size == 1:
        return replace(force, times=force.times[:n], values=force.values[:n])
    whole = n // size * size
    times, values = (samples[:whole].reshape(-1, size).mean(axis=1) for samples in (force.times, force.values))
    times[0] = force.times[0]
    return replace(force, times=times, values=values, hold="linear")


def _first_share(record: Record) -> float:
    """Return the fraction of a record with ``FIRST_CYCLES`` of the strongest oscillation in any channel."""
    cycles = 0.0
    for channel in record.channels:
        if channel.n > LONG:
            frequencies, power = periodogram(channel, STRONGEST_OF)
            cycles = max(cycles, float(frequencies[np.argmax(power)]) * record.duration)
    return float(min(1.0, FIRST_CYCLES / max(cycles, 1e-9)))
