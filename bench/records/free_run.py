"""Fitted models simulated freely over records that no fit has seen, under their force alone, and how far off they are.

The test parts are those of the benchmarks at nonlinearbenchmark.org.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from bench.config.records import primary_method
from bench.contract.problem import Record
from bench.dynamics.intervals import Steps
from bench.dynamics.stepper import compiled_path
from bench.records.reading import read_recording
from bench.records.request import AUTO, request_of
from bench.records.sets import MeasuredSet, SimulatedSpan
from bench.records.track import described
from bench.systems import System

STEPS = 4
"""Runge-Kutta steps a sample of the force."""
FIRST = 20
"""Samples whose spline gives the first state."""


def free_runs(
    of: MeasuredSet, system: str, fits: pd.DataFrame, data_root: Path | None
) -> Iterator[tuple[str, list[float]]]:
    """Yield models with their errors over the test parts of a set, in thousandths of the record's unit.

    The models are the primary method's, with the medians over its siblings in ``fits``, rows of the track, and that
    with the parameters that others have published; none with ``system=auto``, whose siblings may differ in class.
    Raises InputError.
    """
    paths = of.paths(data_root)
    if system == AUTO or not (of.tests and paths):
        return
    parts = [part_problem(of, system, part, paths[0].parent) for part in of.tests.values()]
    names = list(parts[0][0].names)
    models = {}
    primary = fits[(fits["method"] == primary_method()) & fits["quantity"].notna() & (fits["withdrawn"] == 0)]
    fitted = primary.pivot(index="sibling", columns="quantity", values="value").reindex(columns=names).dropna()
    if len(fitted):
        offsets = primary[primary["sibling"].isin(fitted.index)].drop_duplicates("sibling")["offset"]
        models[f"{primary_method()}, median of {len(fitted)} siblings"] = dict(fitted.median()), float(offsets.median())
    if set(names) <= set(of.known):
        models["published parameters"] = {name: of.known[name].value for name in names}, 0.0
    for model, (p, offset) in models.items():
        yield model, [1e3 * free_run_error(system, p, record, offset, of.unscored) for system, record in parts]


def part_problem(of: MeasuredSet, system: str, part: SimulatedSpan, folder: Path) -> tuple[System, Record]:
    """Return the system and the whole record of a test part; raises InputError."""
    whole = of.model_copy(update={"first": part.first, "last": part.last})
    path = folder / part.file
    request = request_of(whole.overrides(system, [primary_method()], path, 60.0))
    problem = described(whole, request, read_recording(path, request.options)).problem
    return problem.system, problem.records[0]


def free_run_error(
    system: System, p: Mapping[str, float], record: Record, offset: float = 0.0, unscored: int = 0
) -> float:
    """Compute the root mean square error of a free simulation in the record's unit; NaN where the motion diverges.

    Args:
        system: Of one degree of freedom.
        p: Its parameters.
        record: A displacement at the samples of a force; the first samples give the initial state.
        offset: Of the sensor.
        unscored: Number of first samples that are left out.
    """
    times, values = record.channels[0].times, record.channels[0].values - offset
    start = CubicSpline(times[:FIRST], values[:FIRST])
    state = [np.array(start(times[0], derivative)) for derivative in (0, 1)]
    steps = Steps.over(times, np.full(times.size - 1, STEPS), record.forces, 1)
    motion = compiled_path(system, p, state, steps, np.arange(times.size))[0]
    error = float(np.sqrt(np.mean((values - motion)[unscored:] ** 2)))
    return error if np.isfinite(error) else float("nan")
