"""A measured record as a Problem: read a CSV, identify, report values, intervals and residuals. There is no truth."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.config.schema import Job
from bench.contract.estimate import Estimate, Status
from bench.contract.prior import Prior
from bench.contract.problem import MIN_SAMPLES, Channel, Force, InitialState, Problem, Record
from bench.dynamics.simulate import fitted_start, measurements
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import make_method, missing_package
from bench.errors import InputError
from bench.measured.fit import Outcome, fit_alone
from bench.scoring.combination import combine_with_prior
from bench.scoring.score import point_parameters
from bench.sweep.workers import Limits
from bench.systems import System, make_system
from bench.systems.linear import SDOF

UNITS = {
    "s": ("t", 1.0), "ms": ("t", 1e-3), "m": ("x", 1.0), "cm": ("x", 1e-2), "mm": ("x", 1e-3), "um": ("x", 1e-6),
    "µm": ("x", 1e-6), "in": ("x", 0.0254), "n": ("f", 1.0), "kn": ("f", 1e3), "mn": ("f", 1e-3), "MN": ("f", 1e6),
}  # fmt: skip
"""Known units of a header, as written or else in lower case: the column they belong to and their size in SI."""
MAX_SAMPLES = 100_000


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of a file: times (s, from the first sample), displacement with its unit, and maybe a force (N)."""

    times: np.ndarray
    displacement: np.ndarray
    force: np.ndarray | None
    unit: str


def read_record(path: Path) -> Table:
    """Read columns t, x and optionally a force, with or without a header such as ``t [s], x [mm], force [N]``.

    Separators may be commas, semicolons, tabs or spaces; lines that start with # or % are comments. Values in a known
    unit are converted to SI; an unknown unit of x is kept as a label. Raises InputError.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise InputError("data", path, f"cannot be read: {reason}") from None
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith(("#", "%"))]
    cells = [_split(line) for line in lines]
    header = cells.pop(0) if cells and not _is_number(cells[0][0]) else []
    _check_length(len(cells), path)
    width = len(header) or len(cells[0])
    if width not in (2, 3):
        raise InputError("data", path, f"{width} columns; write t, x and optionally a force")
    for i, row in enumerate(cells):
        if len(row) != width or not all(_is_number(cell) for cell in row):
            raise InputError("data", f"{path} row {i + 1}", f"{width} numbers are needed, found {', '.join(row)}")
    return _table(np.array(cells, dtype=float), header)


def table_of(times: ArrayLike, displacement: ArrayLike, force: ArrayLike | None = None) -> Table:
    """A record from arrays in SI units, of one length; raises InputError."""
    given = {"times": times, "displacement": displacement, **({} if force is None else {"force": force})}
    columns = {}
    for name, values in given.items():
        try:
            columns[name] = np.array(values, dtype=float)
        except (TypeError, ValueError):
            raise InputError(name, "array", "numbers are needed") from None
        if columns[name].ndim != 1 or columns[name].size != columns["times"].size:
            remedy = "one-dimensional, with a number for each of the times"
            raise InputError(name, f"array of shape {columns[name].shape}", remedy)
    _check_length(columns["times"].size, "arrays")
    shifted = columns["times"] - columns["times"][0]
    return Table(shifted, columns["displacement"], columns.get("force"), "m")


def _check_length(n: int, source: object) -> None:
    if n < MIN_SAMPLES:
        raise InputError("data", source, f"{n} samples; at least {MIN_SAMPLES} are needed")
    if n > MAX_SAMPLES:
        raise InputError("data", source, f"{n} samples; at most {MAX_SAMPLES}, thin the record")


def _split(line: str) -> list[str]:
    for separator in (",", ";", "\t"):
        if separator in line:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
    return line.split()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _table(values: np.ndarray, header: Sequence[str]) -> Table:
    columns, unit = ["t", "x", "f"][: values.shape[1]], "m"
    for i, name in enumerate(header):
        match = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$|_([A-Za-zµ]+)$", name)
        text = next((group for group in match.groups() if group), "") if match else ""
        kind, size = UNITS.get(text, UNITS.get(text.lower(), ("", 1.0)))
        if kind == columns[i]:
            values[:, i] *= size
        elif columns[i] == "x" and text:
            unit = text
        elif text:
            raise InputError(f"data column {name}", text, f"known units: {', '.join(UNITS)}")
    times = values[:, 0]
    return Table(times - times[0], values[:, 1], values[:, 2] if len(columns) == 3 else None, unit)


def measured_problem(job: Job, table: Table | None = None) -> Problem:
    """The problem of a record, that of the job's file unless a table is given.

    No prior and an unknown start unless the user says otherwise; an offset is estimated. Raises InputError.
    """
    config, physics = job.config, job.config.system
    system = make_system(physics["kind"], physics["options"]) if "system" in job.explicit else SDOF()
    if system.n_dof != 1:
        raise InputError("system", physics["label"], "a record with columns t, x is of one DOF")
    source = config.data or Path("arrays")
    table = read_record(source) if table is None else table
    start = _start(job)
    try:
        channel = Channel(table.times, table.displacement, unit=table.unit, offset=start is None)
        forces = () if table.force is None else (Force(table.times, table.force),)
        record = Record((channel,), forces, start)
    except InputError as error:
        raise InputError("data", f"{source} ({error.field} {error.value})", error.remedy) from None
    return Problem(system, (record,), _prior(job, system), name=source.name)


def _start(job: Job) -> InitialState | None:
    config = job.config
    if "initial_state" not in job.explicit or config.initial_state == "unknown":
        return None
    if config.start is None or len(config.start) != 2:
        raise InputError("start", config.start, "initial_state=known needs start=[displacement,velocity] at time 0")
    return InitialState(np.array(config.start[:1]), np.array(config.start[1:]))


def _prior(job: Job, system: System) -> Prior | None:
    spec = job.prior_spec() if "prior" in job.explicit else None
    if spec is None:
        return None
    nominal = job.config.nominal
    if set(nominal) != set(system.names):
        needed = " ".join(f"nominal.{name}=…" for name in system.names)
        raise InputError("nominal", dict(nominal), f"a prior on a measured record needs nominal values: {needed}")
    return Prior(
        {name: nominal[name] for name in system.names},
        {p.name: spec.sd_by_kind[p.kind] for p in system.parameters},
    )


def identify_record(job: Job, table: Table | None = None) -> tuple[Problem, Outcome]:
    """Identify the record of a job, or the one given, with the job's method, in a process of its own."""
    name = job.config.method["name"]
    disturbance = job.config.disturbance["kind"]
    if disturbance != "none":
        raise InputError("disturbance", disturbance, "a measured record is taken as it is; leave it out")
    if name in REFERENCES:
        raise InputError("method", name, "it needs the truth, which a measured record does not have; choose a method")
    problem = measured_problem(job, table)
    lacking = missing_package(name)
    if lacking:
        return problem, Outcome(None, Status.MISSING_DEPENDENCY, lacking)
    method, rng = make_method(name, job.settings()), np.random.default_rng(job.config.seed)
    limits = Limits(1, job.config.timeout_s, job.config.memory_mb)
    return problem, fit_alone(method, problem, problem.records[0].channels[0].times, rng, limits)


def report(problem: Problem, outcome: Outcome) -> dict[str, Any]:
    """Values, 95 % intervals and residuals of an identified record, ready for JSON."""
    result: dict[str, Any] = {
        "samples": problem.n,
        "status": outcome.status.value,
        "message": outcome.message,
        "wall_s": outcome.wall_s,
        "estimates": {},
        "residuals": None,
    }
    if outcome.estimate is None or outcome.status is not Status.OK:
        return result
    estimate = combine_with_prior(outcome.estimate, problem.prior)
    for quantity in problem.system.quantities:
        marginal = estimate.marginal(quantity)
        if marginal is not None:
            low, high = marginal.interval(0.95)
            result["estimates"][quantity.name] = {
                "value": marginal.value, "low": low, "high": high, "unit": quantity.unit,
            }  # fmt: skip
    result["residuals"] = _residuals(problem, estimate)
    return result


def _residuals(problem: Problem, estimate: Estimate) -> dict[str, Any] | None:
    """Measured minus identified displacement: root mean square, part of the signal, lag-one autocorrelation."""
    record = problem.records[0]
    channel = record.channels[0]
    if estimate.reconstructions:
        fitted = estimate.reconstructions[0](channel.times)[channel.dof]
    else:
        p = point_parameters(estimate)
        if p is None:
            return None
        fitted = measurements(problem.system, p, fitted_start(problem.system, p, record), record)
    offset = estimate.offsets[0] if estimate.offsets else float(np.mean(channel.values - fitted)) * channel.offset
    r = channel.values - fitted - offset
    spread = float(np.std(channel.values))
    total = float(r @ r)
    return {
        "unit": channel.unit,
        "rms": float(np.sqrt(np.mean(r**2))),
        "part_of_signal": float(np.sqrt(np.mean(r**2))) / spread if spread else float("nan"),
        "lag1_autocorrelation": float(r[:-1] @ r[1:]) / total if total else 0.0,
        "offset": float(offset),
        "values": [float(value) for value in r],
    }
