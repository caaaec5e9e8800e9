"""A fitted model simulated freely over a record that no fit has seen, under its force alone, and how far off it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from bench.config.records import primary_method
from bench.contract.problem import Record
from bench.dynamics.ops import numpy_ops
from bench.dynamics.stepper import rk4_step
from bench.records.reading import read_recording
from bench.records.request import request_of
from bench.records.sets import MeasuredSet, SimulatedSpan
from bench.records.track import described
from bench.systems import System

STEPS = 4
"""Runge-Kutta steps a sample of the force."""
FIRST = 20
"""Samples whose spline gives the first state."""


def part_problem(of: MeasuredSet, system: str, part: SimulatedSpan, folder: Path) -> tuple[System, Record]:
    """The system and the whole record of a test part; raises InputError."""
    whole = of.model_copy(update={"first": part.first, "last": part.last})
    path = folder / part.file
    request = request_of(whole.overrides(system, [primary_method()], path, 60.0))
    problem = described(whole, request, read_recording(path, request.options)).problem
    return problem.system, problem.records[0]


def free_run_error(
    system: System, p: Mapping[str, float], record: Record, offset: float = 0.0, unscored: int = 0
) -> float:
    """The root mean square error of a free simulation in the record's unit; NaN where it runs away.

    Args:
        system: of one degree of freedom.
        p: its parameters.
        record: a displacement at the samples of a force; the first samples give the first state.
        offset: of the sensor.
        unscored: so many first samples are left out.
    """
    channel = record.channels[0]
    left = channel.values - offset - simulated(system, p, record, offset)
    error = float(np.sqrt(np.mean(left[unscored:] ** 2)))
    return error if np.isfinite(error) else float("nan")


def simulated(system: System, p: Mapping[str, float], record: Record, offset: float = 0.0) -> np.ndarray:
    """The displacement (n,) at the samples of the record."""
    channel = record.channels[0]
    times = channel.times
    start = CubicSpline(times[:FIRST], channel.values[:FIRST] - offset)
    at = np.arange(2 * STEPS * (times.size - 1) + 1) / (2 * STEPS)
    force = record.forces[0](np.interp(at, np.arange(times.size), times)).tolist()
    lengths = (np.diff(times) / STEPS).tolist()
    path = np.full(times.size, np.nan)
    state = [float(start(times[0])), float(start(times[0], 1))]
    path[0] = state[0]
    try:
        for i, length in enumerate(lengths):
            for j in range(2 * STEPS * i, 2 * STEPS * (i + 1), 2):
                state = rk4_step(system, p, state, length, ([force[j]], [force[j + 1]], [force[j + 2]]), numpy_ops)
            path[i + 1] = state[0]
    except OverflowError:  # it ran away; what follows stays NaN
        pass
    return path
