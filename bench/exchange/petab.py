"""Export the data of a scenario as a PEtab problem, for other programs that fit differential equations.

PEtab (Schmiester et al., PLOS Comput. Biol. 17:e1008646, 2021; version 1 of the format) consists of the model in SBML,
and of tables of parameters, observables, conditions and measurements. The true values are in a separate table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from bench.contract.problem import Problem
from bench.dynamics.mechanics import acceleration
from bench.dynamics.ops import sympy_ops
from bench.errors import InputError
from bench.scenario.scenario import Scenario
from bench.scenario.truth import Truth
from bench.systems import System

LEAST, MOST = 1e-9, 1e9
"""Bounds of positive parameters, wide enough for any scenario; an initial state may be negative."""
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
    """Return the files of one replicate's problem, by name, and ``truth.tsv``.

    Raises:
        InputError: For a known force or a second record, which have no form in PEtab.
    """
    if scenario.force is not None:
        raise InputError("system.force", "known", "a scenario in free vibration: a sampled force has no form in PEtab")
    if scenario.added_mass is not None:
        raise InputError("system.added_mass", list(scenario.added_mass), "a scenario of one record")
    problem, truth = scenario.maker(seed)(replicate)
    channels = problem.records[0].channels
    observables = [
        {"observableId": f"displacement{channel.dof + 1}", "observableFormula": f"x{channel.dof + 1}",
         "noiseFormula": f"noise_displacement{channel.dof + 1}", "noiseDistribution": "normal"}
        for channel in channels
    ]  # fmt: skip
    measurements = [
        {"observableId": f"displacement{channel.dof + 1}", "simulationConditionId": CONDITION,
         "measurement": value, "time": time}
        for channel in channels
        for time, value in zip(channel.times, channel.values, strict=True)
    ]  # fmt: skip
    return {
        "problem.yaml": DESCRIPTION,
        "model.xml": sbml(problem.system),
        "parameters.tsv": _table(_parameters(problem)),
        "observables.tsv": _table(observables),
        "conditions.tsv": _table([{"conditionId": CONDITION}]),
        "measurements.tsv": _table(measurements),
        "truth.tsv": _table(_truth(truth)),
    }


def states(system: System) -> list[str]:
    """Return the names of displacements, velocities and hidden states, numbered from 1."""
    n = range(1, system.n_dof + 1)
    return [*(f"x{i}" for i in n), *(f"v{i}" for i in n), *(f"z{i + 1}" for i in range(system.n_hidden))]


def rates(system: System) -> dict[str, str]:
    """Return the equation of motion as formulas of SBML level 3: the rate of every state, by its name."""
    import sympy

    names = {name: sympy.Symbol(name, real=True) for name in states(system)}
    p = {name: sympy.Symbol(name, positive=True) for name in system.names}
    n, symbols = system.n_dof, list(names.values())
    x, v, z, none = symbols[:n], symbols[n : 2 * n], symbols[2 * n :], [sympy.Integer(0)] * n
    ops = sympy_ops()
    expressions = [*v, *acceleration(system, p, x, v, none, z, ops), *system.hidden_rates(p, x, v, none, z, ops)]
    return dict(zip(names, map(formula, expressions), strict=True))


def formula(expression: Any) -> str:
    """Return a sympy expression as a text formula of SBML (level 3)."""
    from sympy.printing.str import StrPrinter

    class Printer(StrPrinter):  # type: ignore[misc]
        def _print_Abs(self, item: Any) -> str:
            return f"abs({self._print(item.args[0])})"

        def _print_Piecewise(self, item: Any) -> str:
            parts = [self._print(part) for value, when in item.args[:-1] for part in (value, when)]
            return f"piecewise({', '.join([*parts, self._print(item.args[-1][0])])})"

    return str(Printer({"full_prec": False}).doprint(expression)).replace("**", "^")


def sbml(system: System) -> str:
    """Return the model, with a parameter for each parameter, each state (with a rate rule) and each initial value."""
    import libsbml

    document = libsbml.SBMLDocument(3, 1)
    model = document.createModel()
    model.setId(system.name)

    def add(name: str, value: float, constant: bool) -> None:
        parameter = model.createParameter()
        parameter.setId(name)
        parameter.setConstant(constant)
        parameter.setValue(value)

    for name in system.names:
        add(name, 1.0, True)
    for name, text in rates(system).items():
        add(f"{name}_start", 0.0, True)
        add(name, 0.0, False)
        rule, initial = model.createRateRule(), model.createInitialAssignment()
        rule.setVariable(name)
        initial.setSymbol(name)
        initial.setMath(libsbml.parseL3Formula(f"{name}_start"))
        if (parsed := libsbml.parseL3Formula(text)) is None:
            raise InputError("export", "petab", f"the equation has no form in SBML: {text}")
        rule.setMath(parsed)
    return str(libsbml.writeSBMLToString(document))


def _parameters(problem: Problem) -> list[dict[str, Any]]:
    """Return what is estimated: the parameters with the prior, an unknown initial state, and the noise."""
    prior, start = problem.prior, problem.records[0].initial_state
    lines = [_parameter(name, "log", 1.0, True) for name in problem.system.names]
    for line in lines if prior is not None else ():
        assert prior is not None
        name = line["parameterId"]
        mean, sd = prior.log_mean[prior.names.index(name)], prior.log_sd[name]
        line |= {"nominalValue": prior.nominal[name], "objectivePriorType": "logNormal",
                 "objectivePriorParameters": f"{mean:.17g};{sd:.17g}"}  # fmt: skip
    names = states(problem.system)
    motion = names[: 2 * problem.system.n_dof]
    values = dict.fromkeys(names, 0.0)  # hidden states start at 0
    if start is not None:
        values |= dict(zip(motion, [*start.displacement, *start.velocity], strict=True))
    lines += [_parameter(f"{name}_start", "lin", values[name], start is None and name in motion) for name in names]
    dofs = sorted({channel.dof for channel in problem.records[0].channels})
    return lines + [_parameter(f"noise_displacement{dof + 1}", "log", 1.0, True) for dof in dofs]


def _parameter(name: str, scale: str, nominal: float, estimated: bool) -> dict[str, Any]:
    return {
        "parameterId": name, "parameterScale": scale, "lowerBound": LEAST if scale == "log" else -MOST,
        "upperBound": MOST, "nominalValue": nominal, "estimate": int(estimated),
    }  # fmt: skip


def _truth(truth: Truth) -> list[dict[str, Any]]:
    start = truth.initial_state
    values: dict[str, float] = dict(truth.parameters)
    for letter, part in (("x", start.displacement), ("v", start.velocity)):
        values |= {f"{letter}{i}_start": value for i, value in enumerate(part, 1)}
    measured = truth.measured if truth.measured is not None else range(len(truth.sigma))
    values |= {f"noise_displacement{dof + 1}": sigma for dof, sigma in zip(measured, truth.sigma, strict=True)}
    return [{"parameterId": name, "value": value} for name, value in values.items()]


def _table(lines: Sequence[Mapping[str, Any]]) -> str:
    return str(pd.DataFrame(lines).to_csv(sep="\t", index=False))
