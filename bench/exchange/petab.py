"""A scenario's data as a PEtab problem: what a method is given, for whatever fits systems of equations elsewhere.

PEtab (Schmiester et al., PLOS Comput. Biol. 17:e1008646, 2021; version 1 of the format): the model in SBML, and tables
of parameters, observables, conditions and measurements. The truth stands apart, in a table of its own.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

from bench.contract.problem import Problem
from bench.dynamics.mechanics import acceleration
from bench.dynamics.symbolic import sympy_ops
from bench.errors import InputError
from bench.scenario.scenario import Scenario
from bench.scenario.truth import Truth
from bench.systems import System

PROBLEM = "problem.yaml"
BOUNDS = ("1e-9", "1e9")
"""Of positive parameters, wide enough for any scenario; start values have those of both signs."""
CONDITION = "record"
DESCRIPTION = """format_version: 1
parameter_file: parameters.tsv
problems:
- condition_files: [conditions.tsv]
  measurement_files: [measurements.tsv]
  observable_files: [observables.tsv]
  sbml_files: [model.xml]
"""


def petab_files(scenario: Scenario, seed: int, replicate: int) -> dict[str, str]:
    """The files of one replicate's problem, by name, and ``truth.tsv``.

    Raises InputError for what has no form there: a known force, or a second record.
    """
    if scenario.force is not None:
        raise InputError("system.force", "known", "a scenario in free vibration: a sampled force has no form in PEtab")
    if scenario.added_mass is not None:
        raise InputError("system.added_mass", list(scenario.added_mass), "a scenario of one record")
    problem, truth = scenario.maker(seed)(replicate)
    return {
        PROBLEM: DESCRIPTION,
        "model.xml": sbml(problem),
        "parameters.tsv": _table(_parameters(problem)),
        "observables.tsv": _table(_observables(problem)),
        "conditions.tsv": _table([{"conditionId": CONDITION}]),
        "measurements.tsv": _table(_measurements(problem)),
        "truth.tsv": _table(_truth(truth)),
    }


def states(system: System) -> list[str]:
    """Names of displacements, velocities and hidden states, numbered from 1."""
    n = range(1, system.n_dof + 1)
    return [*(f"x{i}" for i in n), *(f"v{i}" for i in n), *(f"z{i + 1}" for i in range(system.n_hidden))]


def rates(system: System) -> dict[str, str]:
    """The equation of motion as formulas of SBML level 3: the rate of every state, by its name."""
    import sympy

    names = {name: sympy.Symbol(name, real=True) for name in states(system)}
    p = {name: sympy.Symbol(name, positive=True) for name in system.names}
    n, symbols = system.n_dof, list(names.values())
    x, v, z, none = symbols[:n], symbols[n : 2 * n], symbols[2 * n :], [sympy.Integer(0)] * n
    ops = sympy_ops()
    found = [*v, *acceleration(system, p, x, v, none, z, ops), *system.hidden_rates(p, x, v, none, z, ops)]
    return dict(zip(names, map(formula, found), strict=True))


def formula(expression: Any) -> str:
    """A sympy expression as SBML's text formulas (level 3) have it."""
    from sympy.printing.str import StrPrinter

    class Printer(StrPrinter):  # type: ignore[misc]
        def _print_Abs(self, item: Any) -> str:
            return f"abs({self._print(item.args[0])})"

        def _print_Piecewise(self, item: Any) -> str:
            parts = [self._print(part) for value, when in item.args[:-1] for part in (value, when)]
            return f"piecewise({', '.join([*parts, self._print(item.args[-1][0])])})"

    return str(Printer({"full_prec": False}).doprint(expression)).replace("**", "^")


def sbml(problem: Problem) -> str:
    """The model: a parameter for each of the system's, one with a rate rule for each state, and one for its start."""
    try:
        import libsbml
    except ImportError:
        remedy = "needs python-libsbml: pip install 'vibration-bench[exchange]'"
        raise InputError("export", "petab", remedy) from None

    document = libsbml.SBMLDocument(3, 1)
    model = document.createModel()
    model.setId(problem.system.name)
    own, start = list(problem.system.names), [f"{name}_start" for name in states(problem.system)]
    for name, constant in [*((n, True) for n in [*own, *start]), *((n, False) for n in states(problem.system))]:
        parameter = model.createParameter()
        parameter.setId(name)
        parameter.setConstant(constant)
        parameter.setValue(1.0 if name in own else 0.0)
    for name, text in rates(problem.system).items():
        rule = model.createRateRule()
        rule.setVariable(name)
        rule.setMath(_parsed(libsbml, text))
        first = model.createInitialAssignment()
        first.setSymbol(name)
        first.setMath(_parsed(libsbml, f"{name}_start"))
    return str(libsbml.writeSBMLToString(document))


def _parsed(libsbml: Any, text: str) -> Any:
    found = libsbml.parseL3Formula(text)
    if found is None:
        raise InputError("export", "petab", f"the equation has no form in SBML: {text}")
    return found


def _parameters(problem: Problem) -> list[dict[str, Any]]:
    """What is estimated: the system's parameters with the prior, the start where it is not told, the noise."""
    lines = []
    prior = problem.prior
    for name in problem.system.names:
        stated = {} if prior is None else {
            "objectivePriorType": "logNormal",
            "objectivePriorParameters": f"{prior.log_mean[prior.names.index(name)]:.17g};{prior.log_sd[name]:.17g}",
        }  # fmt: skip
        nominal = 1.0 if prior is None else prior.nominal[name]
        lines.append(_line(name, "log", BOUNDS[0], nominal, True) | stated)
    names, told = states(problem.system), problem.records[0].initial_state
    n, known = problem.system.n_dof, {}
    if told is not None:
        known = dict(zip(names, [*told.displacement, *told.velocity], strict=False))
    for i, name in enumerate(names):
        free = told is None and i < 2 * n  # hidden states start at 0
        lines.append(_line(f"{name}_start", "lin", f"-{BOUNDS[1]}", known.get(name, 0.0), free))
    lines += [_line(f"noise_{_observable(i)}", "log", BOUNDS[0], 1.0, True) for i in _measured(problem)]
    return lines


def _line(name: str, scale: str, lower: str, nominal: float, estimated: bool) -> dict[str, Any]:
    return {
        "parameterId": name, "parameterScale": scale, "lowerBound": lower, "upperBound": BOUNDS[1],
        "nominalValue": f"{nominal:.17g}", "estimate": int(estimated),
    }  # fmt: skip


def _measured(problem: Problem) -> list[int]:
    return sorted({channel.dof for channel in problem.records[0].channels})


def _observable(dof: int) -> str:
    return f"displacement{dof + 1}"


def _observables(problem: Problem) -> list[dict[str, Any]]:
    return [
        {
            "observableId": _observable(i), "observableFormula": f"x{i + 1}", "noiseFormula": f"noise_{_observable(i)}",
            "noiseDistribution": "normal",
        }
        for i in _measured(problem)
    ]  # fmt: skip


def _measurements(problem: Problem) -> list[dict[str, Any]]:
    return [
        {
            "observableId": _observable(channel.dof), "simulationConditionId": CONDITION,
            "measurement": f"{value:.17g}", "time": f"{time:.17g}",
        }
        for channel in problem.records[0].channels
        for time, value in zip(channel.times, channel.values, strict=True)
    ]  # fmt: skip


def _truth(truth: Truth) -> list[dict[str, Any]]:
    start = truth.initial_state
    values: dict[str, float] = dict(truth.parameters)
    for letter, part in (("x", start.displacement), ("v", start.velocity)):
        values |= {f"{letter}{i}_start": float(value) for i, value in enumerate(part, 1)}
    measured = truth.measured if truth.measured is not None else range(len(truth.sigma))
    values |= {f"noise_{_observable(i)}": s for i, s in zip(measured, truth.sigma, strict=True)}
    return [{"parameterId": name, "value": f"{value:.17g}"} for name, value in values.items()]


def _table(lines: Sequence[Mapping[str, Any]]) -> str:
    columns = list(dict.fromkeys(name for line in lines for name in line))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, delimiter="\t", lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()
