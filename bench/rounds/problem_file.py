"""Write and read problems as files: ``P001.csv`` with the samples, and ``P001.json`` with the known quantities.

Samples have seven significant digits, a change far below their noise; times and forces have nine.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.contract.prior import Prior
from bench.contract.problem import Channel, Force, InitialState, Problem, Record
from bench.errors import InputError
from bench.systems import System, make_system

TIME, PUSH = "t [s]", "f [N]"
NOISE = (
    "Noise of zero mean and unknown level on every sample, white or, in some evenly sampled problems of one linear "
    "mass, correlated from sample to sample, or with a slow drift of the sensor; which of these is not said."
)


def equations(system: System, driven: Collection[int] = ()) -> list[str]:
    """Return the equations of motion as text: x'' acceleration, x' velocity, f force, z hidden state."""
    from sympy import Integer, Symbol

    from bench.dynamics.ops import sympy_ops

    names = [""] if system.n_dof == 1 else [str(i + 1) for i in range(system.n_dof)]
    p: dict[str, Any] = {name: Symbol(name) for name in system.names}
    x, v, a = ([Symbol(f"x{i}{dashes}") for i in names] for dashes in ("", "'", "''"))
    f = [Symbol(f"f{i}") if dof in driven else Integer(0) for dof, i in enumerate(names)]
    z, ops = [Symbol("z")] * system.n_hidden, sympy_ops()
    text = [f"{residual} = 0" for residual in system.residual(p, x, v, a, f, z, ops)]
    text += [f"z' = {rate}" for rate in system.hidden_rates(p, x, v, f, z, ops)]
    return [line.replace("**", "^") for line in text]


def short_name(quantity: str) -> str:
    """Return the name of a quantity in files: ``k/m`` for ``k_over_m``."""
    return quantity.replace("_over_", "/")


def problem_files(name: str, problem: Problem, requested: Sequence[str]) -> dict[str, str]:
    """Return the files of a problem by name; raises InputError for a problem that files cannot represent."""
    record, system, prior = problem.records[0], problem.system, problem.prior
    if len(problem.records) > 1 or record.added_mass is not None or len(record.forces) > 1:
        raise InputError("problem", name, "one record, at most one force, no added mass")
    columns = {TIME: _words(record.channels[0].times)}
    columns |= {_column(system, channel.dof): _words(channel.values, 7) for channel in record.channels}
    files: dict[str, str] = {}
    force = None
    for push in record.forces:
        pushed = {TIME: _words(push.times), PUSH: _words(push.values)}
        together = pushed[TIME] == columns[TIME]
        file = f"{name}.csv" if together else f"{name}_force.csv"
        columns, files = (columns | pushed, files) if together else (columns, {file: _csv(pushed)})
        force = {"file": file, "mass": push.dof + 1, "between_samples": push.hold}
    known = {
        "scenario": name,
        "equations": equations(system, [push.dof for push in record.forces]),
        "system": {"kind": system.name, "options": asdict(system) if is_dataclass(system) else {}},
        "parameters": {parameter.name: parameter.unit for parameter in system.parameters},
        "asked": {short_name(quantity): system.quantity(quantity).unit for quantity in requested},
        "initial_state": "unknown" if record.initial_state is None else {
            part: [float(word) for word in _words(getattr(record.initial_state, part))]
            for part in ("displacement", "velocity")
        },
        "prior": prior and {
            parameter: {"nominal": float(f"{value:.9g}"), "log_sd": prior.log_sd[parameter]}
            for parameter, value in prior.nominal.items()
        },
        "force": force,
        "noise": NOISE,
    }  # fmt: skip
    return {f"{name}.csv": _csv(columns), f"{name}.json": json.dumps(known, indent=1, ensure_ascii=False), **files}


def read_problem(folder: Path, name: str) -> tuple[Problem, list[str]]:
    """Return a problem and its requested quantities; raises InputError for damaged files."""
    try:
        known = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        system = make_system(known["system"]["kind"], known["system"]["options"])
        columns, forces, stated = _columns(folder / f"{name}.csv"), [], known["force"]
        sensors = [dof for dof in range(system.n_dof) if _column(system, dof) in columns]
        channels = [Channel(columns[TIME], columns[_column(system, dof)], dof=dof) for dof in sensors]
        if stated:
            pushed = _columns(folder / stated["file"])
            forces = [Force(pushed[TIME], pushed[PUSH], stated["between_samples"], stated["mass"] - 1)]
        start = None if known["initial_state"] == "unknown" else InitialState(**known["initial_state"])
        parts = ({key: known["prior"][key][part] for key in system.names} for part in ("nominal", "log_sd"))
        prior = Prior(*parts) if known["prior"] else None
        requested = [quantity.name for quantity in system.quantities if short_name(quantity.name) in known["asked"]]
        return Problem(system, (Record(tuple(channels), tuple(forces), start),), prior, name), requested
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError("round", folder / name, f"its files are damaged ({error})") from None


def _column(system: System, dof: int) -> str:
    return "x [m]" if system.n_dof == 1 else f"x{dof + 1} [m]"


def _words(values: Iterable[float], digits: int = 9) -> list[str]:
    return [f"{value:.{digits}g}" for value in values]


def _csv(columns: Mapping[str, Sequence[str]]) -> str:
    return "\n".join([",".join(columns), *map(",".join, zip(*columns.values(), strict=True)), ""])


def _columns(path: Path) -> dict[str, np.ndarray]:
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    table = np.array([[float(word) for word in line.split(",")] for line in lines])
    return dict(zip(header.split(","), table.T, strict=True))
