"""Command lines become validated cells before anything runs."""

from __future__ import annotations

from typing import Any

import pandas as pd
import pytest
from conftest import REPOSITORY

from bench import InputError
from bench.config.choices import choices
from bench.config.experiment import Experiment, expand
from bench.config.overrides import read_overrides
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell, stored_as_cell
from bench.store.stored_cell import StoredCell

WRONG_MODELS = {"added_friction", "cubic_spring", "second_mode"}
"""Disturbances of another experiment: the data are of another system."""


def paper_numbers() -> pd.DataFrame:
    """The paper's Tables 2 to 5."""
    return pd.read_csv(REPOSITORY / "bench" / "data" / "paper_tables.csv", comment="#")


def cells(*texts: str, multirun: bool = False) -> list[Cell]:
    return [job.cell() for job in expand(texts, multirun)]


def test_the_defaults_are_the_protocols(reference: Scenario) -> None:
    (cell,) = cells("method=oracle")
    scenario = cell.scenario
    assert scenario.data_identity() == reference.data_identity()
    assert scenario.told_identity() == reference.told_identity()
    assert (cell.replicates, cell.seed, cell.settings) == (20, 0, {})
    assert (scenario.samples, scenario.duration, scenario.dense, scenario.forecast) == (25, 10.0, 1000, 10.0)


def test_the_systems_of_table_4_are_the_papers() -> None:
    numbers = paper_numbers()
    for row, line in numbers[numbers.table == 4].set_index("row").iterrows():
        (cell,) = cells("method=oracle", f"system=table4_{row}")
        assert cell.scenario.parameters == {"m": line.m, "c": line.c, "k": line.k}
        assert cell.scenario.samples == 25
        assert cell.scenario.initial == ((1.0,), (0.0,))


def test_numbers_written_differently_are_one_cell() -> None:
    written = [
        ("snr=10",),
        ("snr=10.0",),
        ("snr=1e1",),
        ("snr=10", "system.duration=10", "prior=nominal", "initial_state=known", "seed=0"),
        ("snr=10", "workers=3", "store=elsewhere", "format=json"),
    ]
    assert len({cells("method=oracle", *texts)[0].identity for texts in written}) == 1


@pytest.mark.parametrize(
    "change",
    ["snr=11", "seed=1", "replicates=21", "initial_state=unknown", "prior=handbook", "prior=none",
     "system.samples=26", "system.parameters.k=9", "system=table4_1", "method=prior",
     "disturbance=bias", "disturbance=outliers"],
)  # fmt: skip
def test_what_changes_the_computation_changes_the_cell(change: str) -> None:
    texts = [] if change.startswith("method") else ["method=oracle"]
    assert cells(*texts, change)[0].identity != cells("method=oracle")[0].identity


def test_a_sweep_is_the_product_of_its_values() -> None:
    found = cells("method=oracle,prior", "snr=40,20,5", "initial_state=known,unknown", multirun=True)
    assert len({cell.identity for cell in found}) == 12
    assert [cell.scenario.snr_db for cell in found[:6:2]] == [40.0, 20.0, 5.0]


@pytest.mark.parametrize(
    ("text", "expected"),
    [("snr=range(5,21,5)", [5.0, 10.0, 15.0, 20.0]), ("snr=choice(3,7)", [3.0, 7.0]), ("snr=20,10.5", [20.0, 10.5])],
)
def test_sweeps_in_hydras_grammar(text: str, expected: list[float]) -> None:
    assert [cell.scenario.snr_db for cell in cells("method=prior", text, multirun=True)] == expected


def test_a_forced_system_has_no_prior_unless_one_is_chosen() -> None:
    (free,), (chosen,) = (
        cells("method=oracle", "system=sdof_forced"),
        cells("method=oracle", "system=sdof_forced", "prior=nominal"),
    )
    assert free.scenario.prior is None
    assert free.scenario.force is not None
    assert chosen.scenario.prior is not None


@pytest.mark.parametrize("system", choices("system"))
def test_every_system_in_conf_makes_data(system: str) -> None:
    (cell,) = cells("method=oracle", f"system={system}")
    problem, _ = cell.scenario.replicates(0, 1)[0]
    assert problem.n == cell.scenario.samples * len(cell.scenario.measured_dofs) * len(problem.records)


@pytest.mark.parametrize("name", choices("prior"))
def test_every_prior_in_conf_is_what_the_protocol_says(name: str) -> None:
    wide = (0.02, 1.0, 0.5)
    protocol = {"nominal": wide, "wrong": wide, "drawn_truth": wide, "handbook": (0.05, 0.3, 0.05),
                "wide_mass": (0.1, 1.0, 0.5), "none": None}  # fmt: skip
    (cell,) = cells("method=oracle", f"prior={name}")
    spec = cell.scenario.prior
    found = None if spec is None else tuple(spec.sd_by_kind[kind] for kind in ("mass", "damping", "stiffness"))
    assert found == protocol[name]
    assert spec is None or spec.wrong == (name == "wrong")
    assert cell.scenario.truth_drawn == (name == "drawn_truth")


def test_an_experiment_sets_its_sweep_and_the_command_line_has_the_last_word(monkeypatch: pytest.MonkeyPatch) -> None:
    described: dict[str, Any] = {
        "replicates": 100,
        "replicates_by_method": {"prior": 7},
        "seed": 3,
        "sweep": {"method": ["prior", "oracle"], "snr": [40, 20]},
        "table": {"number": 5, "title": "T"},
    }
    monkeypatch.setattr(Experiment, "content", property(lambda self: described))
    found = cells("experiment=table5", multirun=True)
    assert [(c.method, c.scenario.snr_db, c.replicates, c.seed) for c in found] == [
        ("prior", 40.0, 7, 3), ("prior", 20.0, 7, 3), ("oracle", 40.0, 100, 3), ("oracle", 20.0, 100, 3),
    ]  # fmt: skip
    found = cells("experiment=table5", "method=prior", "replicates=2", "snr=5", multirun=True)
    assert [(c.method, c.scenario.snr_db, c.replicates) for c in found] == [("prior", 5.0, 2)]


@pytest.mark.parametrize("table", [2, 3, 4, 5])
def test_the_experiments_ask_for_every_row_of_the_papers_table_in_both_readings(table: int) -> None:
    experiment = Experiment(f"table{table}").content
    sweep, numbers = experiment["sweep"], paper_numbers()
    theirs = numbers[numbers.table == table]
    assert set(map(float, sweep["snr"])) == set(theirs.snr_db.astype(float))
    assert set(sweep["initial_state"]) == {"known", "unknown"}
    assert {"prior", "oracle", "pinn", "pinn_adam", "ls", "rls", "ddnn"} <= set(sweep["method"])
    assert experiment["table"]["number"] == table
    assert experiment["replicates"] >= 100
    assert min(experiment["replicates_by_method"].values()) >= 20
    if table == 4:
        assert sweep["system"] == [f"table4_{i}" for i in range(1, 6)]


def test_the_robustness_experiment_tells_the_start_only_where_the_trigger_is_late() -> None:
    found = cells("experiment=robustness", multirun=True)
    kinds = {told: [] for told in ("known", "unknown")}  # type: dict[str, list[str]]
    for cell in found:
        disturbance = cell.scenario.disturbance
        kinds[cell.scenario.initial_state].append(disturbance.kind if disturbance else "none")
        assert cell.replicates == 100
    assert set(kinds["known"]) == {"none", "late_trigger"}
    assert set(kinds["unknown"]) == set(choices("disturbance")) - {"late_trigger", *WRONG_MODELS}
    methods = len({cell.label for cell in found})
    assert len({cell.identity for cell in found}) == len(found) == (9 + 2) * methods  # disturbances times methods


def test_a_further_sweep_of_an_experiment_is_left_out_where_the_command_line_sets_its_fields() -> None:
    for text, kinds, told in [
        ("disturbance=bias", {"bias"}, {"unknown"}),
        ("initial_state=known", set(choices("disturbance")) - {"none", "late_trigger", *WRONG_MODELS}, {"known"}),
    ]:
        found = cells("experiment=robustness", "method=oracle", text, multirun=True)
        assert {c.scenario.disturbance.kind for c in found if c.scenario.disturbance} == kinds
        assert {c.scenario.initial_state for c in found} == told


def test_nominal_values_of_a_measured_record_can_be_set() -> None:
    (job,) = expand(["method=oracle", "data=record.csv", "nominal.m=1.2", "nominal.k=8"], False)
    assert job.config.nominal == {"m": 1.2, "k": 8.0}
    with pytest.raises(InputError, match=r"nominal.m=-1: input should be greater than 0"):
        expand(["method=oracle", "data=record.csv", "nominal.m=-1"], False)
    with pytest.raises(InputError, match=r"nominal.m=1: requires a measured record; add data="):
        expand(["method=oracle", "nominal.m=1"], False)


def test_a_truth_that_is_drawn_is_drawn_again() -> None:
    """The prior of such a scenario names the parameters in the system's order, which the stored one has sorted."""
    cell = cells("method=ls", "prior=drawn_truth")[0]
    what = {**cell.description(), "label": "ls", "system": "sdof"}
    again = stored_as_cell(StoredCell(cell.identity, what, (), {}, {}, {}, 0.0))
    ours, theirs = (one.scenario.replicates(one.seed, 1)[0][0] for one in (cell, again))
    assert list(ours.records[0].channels[0].values) == list(theirs.records[0].channels[0].values)


def test_a_value_may_have_its_unit() -> None:
    assert read_overrides(["snr=20dB"]) == {"snr": [20.0]}
    assert read_overrides(["snr=10dB,15"]) == {"snr": [10.0, 15]}
    assert read_overrides(["snr=20Hz"]) == {"snr": ["20Hz"]}  # refused where the scenario is validated
