"""The table and the picture of a family, from stored cells whose numbers are known beforehand."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from stored import BOUND, trained

from bench.config.experiment import Experiment
from bench.contract.estimate import Status
from bench.entrants.registry import default_settings, load_method
from bench.errors import InputError
from bench.reporting.family import Family, family_of
from bench.reporting.frame import Frame, Result
from bench.reporting.tables.family import arrival, arrived, family_table, oracle_seconds
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.store.cell import Cell
from bench.store.stored_cell import StoredCell

FAMILY = "pinn_family"
CHOICES = load_method(FAMILY).card.choices
TABLE = Experiment("pinn").table
LM: dict[str, Any] = {}
PAPERS = {"optimizer": "adam_lbfgs", "weighting": "paper"}


def cell(scenario: Scenario, rows: Sequence[Row] | None, settings: dict[str, Any] | None, method: str) -> Result:
    """A cell of a method with so much changed; not stored where it has no rows."""
    usual = default_settings(method)
    label = " ".join([method, *(f"{name}={value}" for name, value in (settings or {}).items())])
    own = Cell(scenario, method, {**usual, **(settings or {})}, len(rows or [0]), 1907, label)
    summary = summarise(rows, BOUND) if rows else {}
    return Result.of_cell(own, StoredCell(own.identity, {}, tuple(rows), summary, {}, {}, 1.0) if rows else None)


@pytest.fixture
def place(reference: Scenario) -> Scenario:
    return reference


def frame(*results: Result) -> Frame:
    return Frame("pinn", "The family", TABLE, results)


def steady(error: float) -> list[Row]:
    """Two trainings with this error of k/m (%) from the beginning on."""
    return trained(2, lambda t: error)


def drawn(stiffness: np.ndarray, damping: float) -> list[Row]:
    """Rows with these errors of k/m and this one of c/m (%)."""
    row = trained(1, lambda t: 0.5)[0]
    both = [{"k_over_m_error_pct": float(one), "c_over_m_error_pct": damping} for one in stiffness]
    return [replace(row, replicate=i, scores={**row.scores, **own}) for i, own in enumerate(both)]


def titles(family: Family) -> dict[str, list[str]]:
    return {f"{one.heading}, {one.base}": [row.title for row in one.rows] for one in family.sections}


def panel(text: str, heading: str) -> list[list[list[str]]]:
    """The tables under a heading, each by line and cell."""
    body = text.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    found: list[list[list[str]]] = [[]]
    for line in body.splitlines():
        if line.startswith("|") and not line.startswith("|-"):
            found[-1].append([cell.strip() for cell in line.strip("|").split("|")])
        elif not line and found[-1]:
            found.append([])
    return [table for table in found if table]


# ---- which row stands where


def test_a_row_stands_under_what_it_differs_in_and_the_base_first(place: Scenario) -> None:
    both = {"optimizer": "soap", "collocation": 500}
    kinds: list[dict[str, Any]] = [
        {"weighting": "paper"}, {"architecture": "spline"}, {"collocation": 500}, {"collocation": 50}, LM,
        {"optimizer": "soap"}, PAPERS, {**PAPERS, "architecture": "sine"}, {"start": "exact"}, both,
    ]  # fmt: skip
    cells = [cell(place, None, settings, FAMILY) for settings in kinds]
    found = titles(family_of(frame(*cells, cell(place, None, None, "ls"), cell(place, None, None, "oracle"))))
    optimizer, weighting = CHOICES["optimizer"], CHOICES["weighting"]
    architecture = CHOICES["architecture"]
    assert found == {
        "Reference rows, ": ["oracle"],
        "Optimisers, our base": [optimizer["lm"].title, optimizer["soap"].title],
        # the paper's weights under Levenberg-Marquardt are one thing apart from either base
        "Optimisers, the paper's base": [optimizer["adam_lbfgs"].title, optimizer["lm"].title],
        "Weightings, our base": [weighting["noise"].title, weighting["paper"].title],
        "Functions of time, our base": [
            f"{architecture['tanh'].title}; start in the loss", architecture["spline"].title, "start built in",
        ],
        "Functions of time, the paper's base": [
            f"{architecture['tanh'].title}; start in the loss", architecture["sine"].title
        ],
        "Collocation, our base": [f"200 points; {CHOICES['sampling']['uniform'].title}", "50 points", "500 points"],
        "Collocation, several settings at once": [f"500 points; {optimizer['soap'].title}"],
        "Other packages, ": [load_method("ls").card.title],
    }  # fmt: skip


def test_an_experiment_without_a_family_has_no_table(place: Scenario) -> None:
    with pytest.raises(InputError, match="choices"):
        family_of(frame(cell(place, None, None, "ls")))
    assert family_table(frame(cell(place, None, LM, FAMILY), cell(place, steady(1.0), None, "oracle"))) == {}


def test_settings_combined_stand_in_a_table_of_their_own(place: Scenario) -> None:
    """Errors of k/m of 0.5 % and 1 % over a bound of 0.5 %; a column of none is left out."""
    both = {"optimizer": "soap", "weighting": "paper"}
    third = {"optimizer": "soap", "weighting": "causal", "architecture": "sine"}
    kinds = [(both, steady(0.5)), ({**both, "architecture": "sine"}, steady(1.0)), (third, None)]
    cells = [cell(place, rows, settings, FAMILY) for settings, rows in [(LM, drawn(np.full(5, 0.5), 3.5)), *kinds]]
    text = family_table(frame(*cells))[f"{FAMILY}.md"]
    (table,) = panel(text, "Combinations of optimizer, weighting, architecture")
    assert table[0] == ["optimizer", "architecture", CHOICES["weighting"]["paper"].title]
    assert ["SOAP", CHOICES["architecture"]["sine"].title, "2.00, 1.00 (15 s)"] in table
    assert "several settings at once" not in text


# ---- numbers


def test_errors_are_over_the_bound_and_compared_on_the_same_data_sets(place: Scenario) -> None:
    """The base's errors of k/m are 0.5 % in two data sets and 1.5 % in two more; SOAP's 0.3 % and 0.9 %; bound 0.5 %.

    So sqrt((1 + 9) / 2) = 2.236 times the bound, 1 on the first two, and SOAP sqrt((0.36 + 3.24) / 2) = 1.342.
    """
    base = [replace(row, replicate=i) for i, row in enumerate([*steady(0.5), *steady(1.5)])]
    soap = [replace(row, replicate=i) for i, row in enumerate(trained(1, lambda t: 0.3) + trained(1, lambda t: 0.9))]
    cells = [cell(place, base, LM, FAMILY), cell(place, soap, {"optimizer": "soap"}, FAMILY)]
    files = family_table(frame(*cells))
    known, training = panel(files[f"{FAMILY}.md"], "Optimisers, our base")
    assert [row[:3] for row in known[1:]] == [
        ["Levenberg-Marquardt (base)", "4/4", "2.24"],
        ["the base on 2 data sets", "2", "1.00"],
        ["SOAP", "2/2", "1.34"],
    ]
    minimum = training[0].index("k/m at minimum")  # the error at the minimum is that of the end here
    assert [row[minimum] for row in training[1:]] == ["1.00", "1.34"]
    lines = csv.DictReader(io.StringIO(files[f"{FAMILY}.csv"]))
    (line,) = [one for one in lines if one["row"] == "SOAP" and one["quantity"] == "k_over_m_excess"]
    assert float(line["value"]) == pytest.approx(np.sqrt(0.45) / 0.5, rel=1e-4)
    assert (line["section"], line["base"], line["n_ok"]) == ("Optimisers", "our base", "2")
    assert line["settings"] == '{"optimizer": "soap"}'
    assert "1.34" in files[f"{FAMILY}.tex"]


def test_only_those_that_arrive_are_timed_and_never_is_said(place: Scenario) -> None:
    there, nowhere = trained(1, lambda t: 0.5, 3.0), trained(1, lambda t: 0.5, arrival_s=np.nan)
    half = cell(place, [*there, replace(nowhere[0], replicate=1)], {"optimizer": "soap"}, FAMILY)
    none = cell(place, nowhere, {"optimizer": "muon"}, FAMILY)
    assert (arrived(half), arrival(half)) == (0.5, 3.0)
    text = family_table(frame(cell(place, steady(0.5), LM, FAMILY), half, none))[f"{FAMILY}.md"]
    _, table = panel(text, "Optimisers, our base")
    seconds = table[0].index("s to within 1 % of the minimum")
    assert {row[0]: row[seconds] for row in table[1:]} == {
        "Levenberg-Marquardt (base)": "5", "SOAP": "3 (1/2)", "Muon": "never"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("off", "expected"),
    [
        (lambda t: 0.5, 0.01),
        (lambda t: 0.2 if t < 0.1 else 3.0 if t < 2 else 0.54, 2.0),  # near by luck, off again, near for good
        (lambda t: 0.56, np.inf),
    ],
)
def test_as_good_as_the_oracle_is_for_good(place: Scenario, off: Any, expected: float) -> None:
    """The oracle has an error of 0.5 %, so 0.55 % is near enough; its further replicates do not count."""
    rows = [*trained(2, lambda t: 0.5), replace(trained(1, lambda t: 50.0)[0], replicate=2)]
    assert oracle_seconds(cell(place, trained(2, off), LM, FAMILY), cell(place, rows, None, "oracle")) == expected


def test_what_failed_and_what_is_missing_is_said(place: Scenario) -> None:
    rows = [*trained(1, lambda t: 0.5), Row(1, Status.DIVERGED, "it went away")]
    missing = cell(place, None, {"optimizer": "muon"}, FAMILY)
    files = family_table(frame(cell(place, rows, {"optimizer": "soap"}, FAMILY), missing))
    known, _ = panel(files[f"{FAMILY}.md"], "Optimisers, our base")
    assert ["SOAP", "1/2", "1.00"] in [row[:3] for row in known]
    assert ["Muon", "-", "-"] in [row[:3] for row in known]
    assert "- 1 × SOAP: diverged, it went away" in files[f"{FAMILY}.md"]
    lines = [one for one in csv.DictReader(io.StringIO(files[f"{FAMILY}.csv"])) if one["row"] == "Muon"]
    assert {(one["n"], one["value"]) for one in lines} == {("0", "")}
