"""Errors of fitted models in free-run simulation of test records that were not used in the fit.

The test records are those of the benchmarks at nonlinearbenchmark.org.
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
from bench.records.track import problem_of_set
from bench.systems import System

STEPS = 4
"""Runge-Kutta steps per sample of the force."""
FIRST = 20
"""Number of samples whose spline gives the initial state."""


def free_runs(
    measured_set: MeasuredSet, system: str, fits: pd.DataFrame, data_root: Path | None
) -> Iterator[tuple[str, list[float]]]:
    """Yield models with their errors over the test records of a set, in thousandths of the record's unit.

    The models are that of the primary method, with medians over the siblings, and that with published parameters.
    There are none for ``system=auto``, whose siblings may differ in class.

    Args:
        measured_set: The set.
        system: System of the fits.
        fits: Rows of the track.
        data_root: Folder of data that are not part of the package.

    Raises:
        InputError: A test record cannot be read.
    """
    paths = measured_set.paths(data_root)
    if system == AUTO or not (measured_set.tests and paths):
        return
    parts = [span_problem(measured_set, system, span, paths[0].parent) for span in measured_set.tests.values()]
    names = list(parts[0][0].names)
    models = {}
    primary = fits[(fits["method"] == primary_method()) & fits["quantity"].notna() & (fits["withdrawn"] == 0)]
    fitted = primary.pivot(index="sibling", columns="quantity", values="value").reindex(columns=names).dropna()
    if len(fitted):
        offsets = primary[primary["sibling"].isin(fitted.index)].drop_duplicates("sibling")["offset"]
        models[f"{primary_method()}, median of {len(fitted)} siblings"] = dict(fitted.median()), float(offsets.median())
    known = measured_set.known
    if set(names) <= set(known):
        models["published parameters"] = {name: known[name].value for name in names}, 0.0
    for model, (p, offset) in models.items():
        errors = (free_run_error(system, p, record, offset, measured_set.unscored) for system, record in parts)
        yield model, [1e3 * error for error in errors]


def span_problem(measured_set: MeasuredSet, system: str, span: SimulatedSpan, folder: Path) -> tuple[System, Record]:
    """Return the system and the record of a test; raises InputError."""
    whole = measured_set.model_copy(update={"first": span.first, "last": span.last})
    path = folder / span.file
    request = request_of(whole.overrides(system, [primary_method()], path, 60.0))
    problem = problem_of_set(whole, request, read_recording(path, request.options)).problem
    return problem.system, problem.records[0]


def free_run_error(
    system: System, p: Mapping[str, float], record: Record, offset: float = 0.0, unscored: int = 0
) -> float:
    """Compute the root mean square error of a free-run simulation.

    Args:
        system: System of one degree of freedom.
        p: Its parameters.
        record: Displacement at the samples of a force; the first samples give the initial state.
        offset: Offset of the sensor.
        unscored: Number of first samples that are excluded.

    Returns:
        The error in the record's unit, NaN if the motion diverges.
    """
    times, values = record.channels[0].times, record.channels[0].values - offset
    spline = CubicSpline(times[:FIRST], values[:FIRST])
    state = [np.array(spline(times[0], derivative)) for derivative in (0, 1)]
    steps = Steps.over(times, np.full(times.size - 1, STEPS), record.forces, 1)
    motion = compiled_path(system, p, state, steps, np.arange(times.size))[0]
    error = float(np.sqrt(np.mean((values - motion)[unscored:] ** 2)))
    return error if np.isfinite(error) else float("nan")
