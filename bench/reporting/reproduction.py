"""Verdicts on the paper's 59 numbers, and what they rest on.

The paper leaves open how long its records are, whether the start is known, what prior it uses and how it defines the
signal-to-noise ratio. Each number, and what the numbers imply of k/m and c/m, is judged under the reading of the
protocol and under every other one declared here; a verdict that changes is not firm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from bench.config.experiment import Experiment, sweep
from bench.reporting.frame import Result
from bench.reporting.labels import beside_paper, in_order
from bench.reporting.paper import Printed, printed, row_name
from bench.reporting.ratios import implied, judged
from bench.scenario.scenario import PriorSpec, Scenario
from bench.scoring.statistics import holm
from bench.scoring.verdict import decided, mean_p_value
from bench.store.cell import Cell


def _prior(name: str) -> PriorSpec:
    cell = sweep({"method": ["prior"], "prior": [name]})[0].cell()
    assert cell.scenario.prior is not None
    return cell.scenario.prior


def _peak(scenario: Scenario) -> Scenario:
    """The noise that the same number of decibels means if it is counted from the largest displacement."""
    clean = scenario.sigmas(0) * 10.0 ** (scenario.snr_db / 20.0)  # root mean square of the clean samples
    peak = float(np.max(np.abs(scenario.initial[0])))
    return replace(scenario, snr_db=scenario.snr_db - 20.0 * math.log10(peak / float(clean[0])))


WIDE_MASS = "mass known to 10 %"
ASSUMPTIONS: dict[str, Callable[[Scenario], Scenario]] = {
    "as in the protocol": lambda scenario: scenario,
    "records of 5 s": lambda scenario: replace(scenario, duration=5.0),
    "records of 20 s": lambda scenario: replace(scenario, duration=20.0),
    "start unknown": lambda scenario: replace(scenario, initial_state="unknown"),
    "handbook prior": lambda scenario: replace(scenario, prior=_prior("handbook")),
    WIDE_MASS: lambda scenario: replace(scenario, prior=_prior("wide_mass")),
    "SNR from the peak": _peak,
}
"""Readings of what the paper leaves open; the first is the protocol's: 10 s, start known, nominal prior, mean square"""


Place = tuple[int, str, str]
"""Table, row and label of a method."""


@cache
def judged_labels() -> dict[str, str]:
    """By the paper's name of a method, the method of ours that is judged under every reading, in order.

    A variant that has the paper's own training is judged under the first reading only: it has the same minimum to find,
    from the same residuals, at fifty times the cost.
    """
    found = {p.method: beside_paper(p.method)[0] for p in printed()}
    return {name: label for label in in_order(found.values()) for name, own in found.items() if own == label}


def training_label(method: str) -> str:
    """The variant that stands beside a method of the paper too; empty where there is none."""
    return next(iter(beside_paper(method)[1:]), "")


def base_cells() -> dict[Place, Cell]:
    """The cells of the tables, as in the protocol, of all that stands beside the paper's methods, and the oracle."""
    wanted = {"oracle", *(label for name in judged_labels() for label in beside_paper(name))}
    found = {}
    for table in dict.fromkeys(p.table for p in printed()):
        for cell in Experiment(f"table{table}").cells():
            if cell.scenario.initial_state == "known" and cell.label in wanted:
                found[table, row_name(table, cell.scenario.label, cell.scenario.snr_db), cell.label] = cell
    return found


def all_cells() -> dict[str, dict[Place, Cell]]:
    """The cells of every reading."""
    base, labels = base_cells(), judged_labels()
    needed = {(p.table, p.row, labels[p.method]) for p in printed()}
    needed |= {(table, row, "oracle") for table, row, _ in needed}
    varied = {place: cell for place, cell in base.items() if place in needed}
    return {
        name: {place: replace(cell, scenario=change(cell.scenario)) for place, cell in (varied if i else base).items()}
        for i, (name, change) in enumerate(ASSUMPTIONS.items())
    }


def verdicts(stored: Mapping[str, Mapping[Place, Result]]) -> pd.DataFrame:
    """Return a line a printed number: the verdicts under every reading, whether they agree, and Holm's p of means.

    ``p`` is two-sided, of the paper's number as another mean of as many runs as ours; NaN for Table 2's one estimate.
    """
    first, labels, lines = next(iter(ASSUMPTIONS)), judged_labels(), []
    for place in printed():
        pair = _own_and_oracle(place, labels[place.method], stored[first])
        training = _own_and_oracle(place, training_label(place.method), stored[first])
        errors = pair[0].errors(place.metric) if pair else np.empty(0)
        lines.append(
            {
                "table": place.table, "row": place.row, "method": place.method, "metric": place.metric,
                "paper": place.value, **_readings(place, stored),
                "p": math.nan if place.table == 2 else mean_p_value(place.value, errors) if pair else 1.0,
                "paper's training": judged(place, *training).text if training else "",
            }
        )  # fmt: skip
    data = _with_standing(lines)
    data.insert(7, "p", data.pop("p"))
    means = data["p"].notna()
    data.loc[means, "p (Holm)"] = holm(data["p"][means].tolist())
    return data


def ratio_verdicts(stored: Mapping[str, Mapping[Place, Result]]) -> pd.DataFrame:
    """Return a line a ratio that the paper implies: the verdicts under every reading, and whether they agree."""
    return _with_standing([{**vars(place), **_readings(place, stored)} for place in implied()])


def _readings(place: Printed, stored: Mapping[str, Mapping[Place, Result]]) -> dict[str, Any]:
    """Return the verdict under every reading, and our median error."""
    line: dict[str, Any] = {}
    for name in ASSUMPTIONS:
        pair = _own_and_oracle(place, judged_labels()[place.method], stored[name])
        line[name] = judged(place, *pair).text if pair else "not run"
        line[f"{name}: median"] = float(np.median(pair[0].errors(place.metric))) if pair else math.nan
    return line


def _own_and_oracle(place: Printed, label: str, stored: Mapping[Place, Result]) -> tuple[Result, Result] | None:
    own, oracle = (stored.get((place.table, place.row, name)) for name in (label, "oracle"))
    return (own, oracle) if own and oracle and own.stored and oracle.stored else None


def _with_standing(lines: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Add whether a verdict decides anything under the first reading, and if so, whether it is the same under all."""
    data = pd.DataFrame(lines)
    readings = data[list(ASSUMPTIONS)]
    data["decided"] = readings.iloc[:, 0].map(decided) & ~readings.eq("not run").any(axis=1)
    data["firm"] = data["decided"] & (readings.map(simple).nunique(axis=1) == 1)
    return data


def simple(text: str) -> str:
    """A verdict without its percentage."""
    return text.partition(" (")[0] if text.startswith("not decidable") else text
