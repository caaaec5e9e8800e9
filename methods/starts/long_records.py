"""Starts for long records: from a part of each that is short enough to be scanned, carried on to the whole.

A scan costs cycles times samples, and a response whose frequency is off by half a cycle over the record has lost its
phase. So the starts come from the first cycles, thinned, and are fitted again on four times the length, and again, each
time few enough samples: a fit over one length finds the frequency better than the next one needs. Samples left out cost
information, not correctness, for a response is exact at whatever times it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bench import Channel, Force, OutputError, Problem, Record
from methods.starts.common_rates import periodogram

MOST_SAMPLES = 1000
"""Of a channel, that starts are sought on."""
LONG = 3 * MOST_SAMPLES
"""Samples of a channel beyond which a record counts as long."""
FIRST_CYCLES = 40.0
"""Of the strongest oscillation, in the first part."""
LONGER, ITERATIONS = 4.0, 12
"""Ratio of the lengths of successive parts, and the steps of a fit to each."""
STRONGEST_OF = 2**17
"""Samples in which the strongest oscillation is sought."""

Starts = list[dict[str, float]]


def is_long(problem: Problem) -> bool:
    """Return True where a channel has more samples than starts are sought on."""
    return any(c.n > LONG for record in problem.records for c in record.channels)


def starts_of_long(problem: Problem, seek: Callable[[OutputError], Starts]) -> Starts:
    """Return starts of a linear system in natural units; ``seek`` finds those of a short problem."""
    shares = [_first_share(record) for record in problem.records]
    short = thinned(problem, shares)
    units = short.natural_units()
    scales = units.scales(problem.system)
    found = [{name: v * scales[name] for name, v in p.items()} for p in seek(OutputError(short.expressed_in(units)))]
    while min(shares) < 1.0:
        shares = [min(LONGER * share, 1.0) for share in shares]
        found = _fitted(OutputError(thinned(problem, shares)), found)
    return found


def _fitted(model: OutputError, found: Starts) -> Starts:
    """Improve starts by a few output-error steps on a problem; those that diverge are left out."""
    with np.errstate(all="ignore"):
        thetas = np.array([model.vector(p) for p in found])
        good = np.all(np.isfinite(model.predict(thetas)), axis=1)
        thetas = model.settle(thetas[good], 1, ITERATIONS)
    return [{name: float(v) for name, v in model.parameters(theta).items()} for theta in thetas]


def thinned(problem: Problem, shares: Sequence[float] = ()) -> Problem:
    """Return the first share of each record, or all of it, on at most ``MOST_SAMPLES`` a channel."""
    pairs = zip(problem.records, shares or [1.0] * len(problem.records), strict=True)
    return replace(problem, records=tuple(_head(record, share * record.duration) for record, share in pairs))


def _head(record: Record, end: float) -> Record:
    """Return a record until a time, thinned; a force becomes its mean over what is left out."""

    def thinned(c: Channel) -> Channel:
        n = int(np.searchsorted(c.times, end, "right"))
        own = slice(0, n, max(1, -(-n // MOST_SAMPLES)))
        return replace(c, times=c.times[own], values=c.values[own])

    return replace(
        record,
        channels=tuple(thinned(c) for c in record.channels),
        forces=tuple(_averaged(force, end) for force in record.forces),
    )


def _averaged(force: Force, end: float) -> Force:
    """Return a force until a time, as the means over equally many samples each, at their mean times."""
    n = max(2, int(np.searchsorted(force.times, end, "right")))
    size = -(-n // MOST_SAMPLES)
    if size == 1:
        return replace(force, times=force.times[:n], values=force.values[:n])
    whole = n // size * size
    times, values = (own[:whole].reshape(-1, size).mean(axis=1) for own in (force.times, force.values))
    times[0] = force.times[0]
    return replace(force, times=times, values=values, hold="linear")


def _first_share(record: Record) -> float:
    """Return the part of a record with ``FIRST_CYCLES`` of the strongest oscillation that any channel shows."""
    cycles = 0.0
    for channel in record.channels:
        if channel.n > LONG:
            frequencies, power = periodogram(channel, STRONGEST_OF)
            cycles = max(cycles, float(frequencies[np.argmax(power)]) * record.duration)
    return float(min(1.0, FIRST_CYCLES / max(cycles, 1e-9)))
