"""The methods on a measured Duffing oscillator, as a page."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np

from bench import (
    Estimate,
    InitialState,
    Problem,
    Record,
    Status,
    Steps,
    System,
    compiled_path,
    fit_initial_state,
    simulate,
)
from bench.commands.declaration import OneOf, Within
from bench.config.experiment import expand
from bench.contract.problem import Hold
from bench.engine.pool import Limits
from bench.entrants.registry import make_method, missing_package, registered
from bench.isolation.machine import single_threaded
from bench.records.identification import fit_alone
from bench.reporting.tables.render import markdown_table
from bench.scoring.combination import combine_with_prior
from bench.scoring.score import point_parameters
from tests.studies.common import RESULTS, Out, publish, study, tracked
from tests.studies.silverbox.record import (
    ARROW,
    RATE,
    TEST_MULTISINE,
    TRAINING,
    UNSCORED,
    WITHIN,
    ConstantForce,
    Silverbox,
    read,
    signed,
    training_problem,
)

HOLDS: tuple[Hold, ...] = ("cubic", "linear")
SHORT = 2_000
"""Samples of the test multisine over which the methods of the second table are simulated."""
STEPS = 6
METHODS = (*registered(), "ls_spline")
REFERENCES = (
    ("the same equation, all training samples", 0.404, 0.492, 0.387),
    ("GRU", 1.49, 2.80, 0.95),
    ("LSTM", 1.50, 2.68, 0.96),
    ("OLSTM", 1.52, 2.39, 1.08),
    ("RNN", 1.64, 4.88, 1.73),
    ("FIR-MLP", 18.9, 20.2, 15.3),
)
"""Root mean square errors (mV) elsewhere: test multisine, whole arrow, arrow without extrapolation."""


def fitted(name: str, problem: Problem, timeout_s: float) -> tuple[Estimate, float]:
    """One method on one problem, in a process of its own."""
    cell = expand([f"method={name}"], multirun=False)[0].cell()
    lacking = missing_package(cell.method)
    if lacking:
        return Estimate.failed(problem.system, Status.MISSING_DEPENDENCY, lacking), math.nan
    return fit_alone(make_method(cell.method, dict(cell.settings)), problem, Limits(1, timeout_s))


def free_run(system: System, p: Mapping[str, float], data: Silverbox, part: slice, hold: Hold) -> np.ndarray:
    """Measured minus simulated output (V) after the first samples of a part, which only tell its first state."""
    record = data.record(part, hold)
    if np.sqrt(p["k"] / p["m"]) > np.pi * RATE:
        return np.full(record.n - UNSCORED, np.nan)
    start = fit_initial_state(system, p, data.record(part, hold, UNSCORED))
    return np.asarray(record.channels[0].values - stepped(system, p, start, record))[UNSCORED:]


def stepped(system: System, p: Mapping[str, float], start: InitialState, record: Record) -> np.ndarray:
    """Return the displacement at the samples of a record of one DOF under one continuous force, of any length.

    Runge-Kutta steps of order four, ``STEPS`` a sample: of ``h`` radians they err in phase by ``h^4 / 120`` of it, here
    0.12 rad and 2e-6, over a memory of ``1 / (2 zeta)``, ten radians. Not finite where the motion diverges.
    """
    times, state = record.channels[0].times, [start.displacement[0], start.velocity[0]]
    steps = Steps.over(times, np.full(times.size - 1, STEPS), record.forces, 1)
    return compiled_path(system, p, state, steps, np.arange(times.size))[0]


def millivolts(residuals: np.ndarray) -> float:
    """Their root mean square (mV)."""
    return 1e3 * float(np.sqrt(np.mean(residuals**2)))


def shooting_rows(data: Silverbox, system: ConstantForce, samples: int) -> tuple[list[list[str]], list[list[str]]]:
    """Errors of shooting on the test parts, one row a hold of the input; and its parameters with the first hold."""
    rows: list[list[str]] = []
    values: list[list[str]] = []
    for hold in HOLDS:
        problem = training_problem(data, system, hold, samples)
        estimate, seconds = fitted("shooting", problem, 600.0)
        p = _point(estimate, problem)
        label = f"shooting, {samples:,} samples, {hold} input"
        if p is None:
            rows.append([label, estimate.status.value, "", "", f"{seconds:.0f}"])
            continue
        multisine = free_run(system, p, data, TEST_MULTISINE, hold)
        arrow = free_run(system, p, data, ARROW, hold)
        errors = [millivolts(r) for r in (multisine, arrow, arrow[: WITHIN - UNSCORED])]
        rows.append([label, *(f"{error:.3f}" for error in errors), f"{seconds:.0f}"])
        print("  ".join(rows[-1]), flush=True)
        values = values or _parameters(estimate, system)
    return rows, values


def _point(estimate: Estimate, problem: Problem) -> dict[str, float] | None:
    if estimate.status is not Status.OK:
        return None
    p = point_parameters(combine_with_prior(estimate, problem.prior))
    return None if p is None else {name: float(value) for name, value in p.items()}


def _parameters(estimate: Estimate, system: ConstantForce) -> list[list[str]]:
    units = {"m": "s²", "c": "s", "k": "1", "k3": "1/V²", "u0": "V"}
    rows = []
    for name, unit in units.items():
        marginal = estimate.marginal(system.quantity(name))
        assert marginal is not None
        low, high = marginal.interval(0.95)
        sign = "-" if name == "u0" and system.sign < 0 else ""
        rows.append([name, unit, f"{sign}{marginal.value:.5g}", f"{low:.5g} to {high:.5g}"])
    return rows


def window_row(name: str, data: Silverbox, system: ConstantForce, window: int, timeout_s: float) -> list[str]:
    """Fit a short window; return status, errors (mV) there and on test samples, and seconds."""
    problem = training_problem(data, system, "cubic", window)
    estimate, wall_s = fitted(name, problem, timeout_s)
    p, seconds = _point(estimate, problem), f"{wall_s:.1f}" if np.isfinite(wall_s) else ""
    if p is None:
        return [name, estimate.status.value, "", "", seconds, estimate.message]
    own = _misfit(system, p, problem.records[0])
    test = free_run(system, p, data, slice(TEST_MULTISINE.start, TEST_MULTISINE.start + SHORT), "cubic")
    return [name, estimate.status.value, f"{millivolts(own):.3g}", f"{millivolts(test):.3g}", seconds, estimate.message]


def _misfit(system: System, p: Mapping[str, float], record: Record) -> np.ndarray:
    channel = record.channels[0]
    if np.sqrt(p["k"] / p["m"]) > np.pi * RATE:
        return np.full(channel.n, np.nan)
    start = fit_initial_state(system, p, record)
    return np.asarray(channel.values - simulate(system, p, start, channel.times, record.forces).displacement[0])


def page(
    tables: tuple[list[list[str]], list[list[str]], list[list[str]]], samples: int, window: int, timeout: int
) -> str:
    """Return the page of errors on the test parts, parameters, and errors of every method on a window."""
    rows, values, windows = tables
    elsewhere = [[name, *(f"{error:.3g}" for error in errors), ""] for name, *errors in REFERENCES]
    command = f"python -m tests.studies.silverbox data=<folder> samples={samples} window={window} timeout={timeout}"
    sections = [
        "# Silverbox",
        f"Regenerate: `{command}`. The folder holds `SNLS80mV.csv`, which is not part of this repository (T. Wigren, "
        "J. Schoukens, European Control Conference 2013, pages 2933-2938; nonlinearbenchmark.org). Times are by the "
        "clock, of a whole fit in a process of its own, beside whatever else the machine did.",
        "## Free simulation of the test parts",
        "Root mean square error in mV. Model: `m y'' + c y' + k y + k3 y³ = u + u0` in continuous time, fitted to the "
        f"first {samples:,} of the 65,062 training samples; no prior, start and noise unknown. The sign of u0 is "
        "that of a regression on a spline through the training output. The first 50 samples of a test part give its "
        "first state and are not scored. How the input runs between its samples, a cubic spline or lines, is part of "
        "the model, in the fit and in the simulation alike.",
        markdown_table(rows + elsewhere, ["model", "test multisine", "arrow", "arrow, no extrapolation", "fit s"]),
        "After the rows of `shooting`: the same equation with cubic input, fitted to all training samples by another "
        "program (Runge-Kutta steps, least squares); then networks, from the results published with arXiv:2405.10779.",
        f"Parameters found with {HOLDS[0]} input. The intervals hold for independent residuals; what is left here "
        "is the error of the model, so they are too narrow.",
        markdown_table(values, ["parameter", "unit", "value", "95 % interval of its size"]),
        "## Every method on a short window",
        f"The first {window} training samples ({window / RATE:.2f} s), cubic input, at most {timeout} s a fit, "
        "defaults throughout. Errors in mV: of a simulation over the window from the start that fits it best, and of a "
        f"free simulation over the first {SHORT:,} samples of the test multisine. Methods that are made for free decay "
        "or linear systems say so.",
        markdown_table(windows, ["method", "status", "window", "test", "s", "message"]),
    ]
    return "\n\n".join(sections) + "\n"


def silverbox(
    data: Annotated[Path, "folder of SNLS80mV.csv (nonlinearbenchmark.org)"],
    samples: Annotated[int, Within(ge=100, le=TRAINING.stop - TRAINING.start), "training samples of shooting"] = 4096,
    window: Annotated[int, Within(ge=50, le=SHORT), "training samples of every other method"] = 300,
    timeout: Annotated[int, Within(ge=1, le=3600), "s, limit of a fit to the window"] = 40,
    method: Annotated[tuple[str, ...], OneOf(METHODS), "methods on the window; left out: all"] = (),
    out: Out = RESULTS,
) -> int:
    """Measure the methods on the Silverbox, a measured Duffing oscillator: silverbox.md.

    Shooting fits a stretch of the training part, then is simulated freely over the official test parts. The other
    methods get a short window, and are simulated over the first samples of the test multisine.
    """
    single_threaded()
    record = read(data)
    system = signed(record)
    rows, values = shooting_rows(record, system, samples)
    windows = [
        window_row(name, record, system, window, float(timeout)) for name in tracked(method or METHODS, "method")
    ]
    publish(out / "silverbox.md", page((rows, values, windows), samples, window, timeout))
    return 0


main = partial(study, silverbox, "tests.studies.silverbox")

if __name__ == "__main__":
    sys.exit(main())
