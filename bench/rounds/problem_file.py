"""A problem as two files that any program reads: ``P001.csv``, the samples, and ``P001.json``, what is known.

Samples have seven significant digits, far below any noise, and times and forces nine: what a computer's last digits
could tell of the clean motion is cut off.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.contract.prior import Prior
from bench.contract.problem import Channel, Force, InitialState, Problem, Record
from bench.errors import InputError
from bench.systems import System, make_system

SAMPLE, EXACT = ".7g", ".9g"
"""Formats of what is measured, and of what is known."""
LETTERS = {"displacement": "x", "velocity": "v", "acceleration": "a"}
NOISE = (
    "Noise of zero mean and unknown level on every sample. In some problems of a round it is correlated from sample to "
    "sample, or the sensor drifts; which they are is not said."
)


def equations(system: System, driven: Collection[int] = ()) -> list[str]:
    """Return the equations of motion as text: x'' acceleration, x' velocity, f force on a driven DOF."""
    from sympy import Integer, Symbol

    from bench.dynamics.ops import sympy_ops

    n = system.n_dof
    names = [""] if n == 1 else [str(i + 1) for i in range(n)]
    p: dict[str, Any] = {name: Symbol(name) for name in system.names}
    x, v, a = ([Symbol(f"x{i}{dashes}") for i in names] for dashes in ("", "'", "''"))
    f = [Symbol(f"f{i}") if dof in driven else Integer(0) for dof, i in enumerate(names)]
    z, ops = [Symbol("z")] * system.n_hidden, sympy_ops()
    rates = system.hidden_rates(p, x, v, f, z, ops)
    text = [f"{residual} = 0" for residual in system.residual(p, x, v, a, f, z, ops)]
    return [line.replace("**", "^") for line in [*text, *(f"z' = {rate}" for rate in rates)]]


def short_name(quantity: str) -> str:
    """Return how files name a quantity: ``k/m`` for ``k_over_m``."""
    return quantity.replace("_over_", "/")


def problem_files(name: str, problem: Problem, asked: Sequence[str]) -> dict[str, str]:
    """Return the files of a problem by name; raises InputError for one that two files do not hold."""
    record, system = problem.records[0], problem.system
    if len(problem.records) > 1 or record.added_mass is not None or len(record.forces) > 1:
        raise InputError("problem", name, "one record, at most one force, no added mass")
    times, start = record.channels[0].times, record.initial_state
    columns = {"t [s]": [format(time, EXACT) for time in times]}
    for channel in record.channels:
        columns[_column(system, channel)] = [format(value, SAMPLE) for value in channel.values]
    known: dict[str, Any] = {
        "scenario": name,
        "equations": equations(system, [force.dof for force in record.forces]),
        "system": {"kind": system.name, "options": asdict(system) if is_dataclass(system) else {}},
        "parameters": {parameter.name: parameter.unit for parameter in system.parameters},
        "asked": {short_name(quantity): system.quantity(quantity).unit for quantity in asked},
        "initial_state": "unknown" if start is None else {
            "displacement": _rounded(start.displacement), "velocity": _rounded(start.velocity)
        },
        "prior": {
            parameter: {"nominal": float(format(value, EXACT)), "log_sd": problem.prior.log_sd[parameter]}
            for parameter, value in problem.prior.nominal.items()
        } if problem.prior else None,
        "force": None,
        "noise": NOISE,
    }  # fmt: skip
    files: dict[str, str] = {}
    for force in record.forces:
        pushes = {"t [s]": [format(time, EXACT) for time in force.times],
                  "f [N]": [format(value, EXACT) for value in force.values]}  # fmt: skip
        together = pushes["t [s]"] == columns["t [s]"]
        file = f"{name}.csv" if together else f"{name}_force.csv"
        known["force"] = {"file": file, "mass": force.dof + 1, "between_samples": force.hold}
        columns |= pushes if together else {}
        files |= {} if together else {file: _csv(pushes)}
    return {
        f"{name}.csv": _csv(columns),
        f"{name}.json": json.dumps(known, indent=1, ensure_ascii=False) + "\n",
        **files,
    }


def read_problem(folder: Path, name: str) -> tuple[Problem, list[str]]:
    """Return a problem and the quantities that are asked for; raises InputError for files that are none."""
    try:
        known = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        system = make_system(known["system"]["kind"], {
            key: tuple(map(tuple, value)) if isinstance(value, list) else value
            for key, value in known["system"]["options"].items()
        })  # fmt: skip
        columns, forces = _columns(folder / f"{name}.csv"), []
        times = columns["t [s]"]
        channels = [
            Channel(times, columns[column], measures, dof, unit)
            for dof in range(system.n_dof) for measures, unit in _UNITS.items()
            if (column := _named(system, measures, dof, unit)) in columns
        ]  # fmt: skip
        if known["force"]:
            pushes = _columns(folder / known["force"]["file"])
            hold, dof = known["force"]["between_samples"], known["force"]["mass"] - 1
            forces = [Force(pushes["t [s]"], pushes["f [N]"], hold, dof)]
        start = None if known["initial_state"] == "unknown" else InitialState(**known["initial_state"])
        prior = known["prior"] and Prior(*({key: known["prior"][key][part] for key in system.names}
                                           for part in ("nominal", "log_sd")))  # fmt: skip
        asked = [q.name for q in system.quantities if short_name(q.name) in known["asked"]]
        return Problem(system, (Record(tuple(channels), tuple(forces), start),), prior, name), asked
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError("round", folder / name, f"its files are damaged ({error})") from None


_UNITS: Mapping[Any, str] = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s²"}


def _named(system: System, measures: str, dof: int, unit: str) -> str:
    return f"{LETTERS[measures]}{'' if system.n_dof == 1 else dof + 1} [{unit}]"


def _column(system: System, channel: Channel) -> str:
    return _named(system, channel.measures, channel.dof, channel.unit)


def _rounded(values: np.ndarray) -> list[float]:
    return [float(format(value, EXACT)) for value in values]


def _csv(columns: Mapping[str, Sequence[str]]) -> str:
    lines = [",".join(columns), *map(",".join, zip(*columns.values(), strict=True))]
    return "\n".join(lines) + "\n"


def _columns(path: Path) -> dict[str, np.ndarray]:
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    table = np.array([[float(value) for value in line.split(",")] for line in lines])
    return dict(zip(header.split(","), table.T, strict=True))
