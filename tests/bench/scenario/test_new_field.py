"""A field that is added to a scenario is declared once: files, command lines, identities and stored cells know it."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest

from bench import InputError
from bench.config.experiment import expand
from bench.scenario import scenario as declared
from bench.scenario.declaration import Within
from bench.scenario.disturbance import kinds
from bench.scenario.force import ForceSpec
from bench.scenario.scenario import PriorSpec, Scenario
from bench.store import cell as stored_cells
from bench.store.cell import Cell
from bench.store.stored_cell import StoredCell


@dataclass(frozen=True)
class Grainy(Scenario):
    """A scenario whose sensor cannot see less than a ``grain`` (m): the noise is never below it."""

    grain: Annotated[float, Within(ge=0.0, lt=1.0)] = 0.0

    def sigmas(self, seed: int, record: int = 0) -> np.ndarray:
        return np.hypot(super().sigmas(seed, record), self.grain)


@pytest.fixture(autouse=True)
def _declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the one line above stood in the declaration of a scenario."""
    for module in (declared, stored_cells):
        monkeypatch.setattr(module, "Scenario", Grainy)


def cell(*texts: str) -> Cell:
    (job,) = expand(["method=ls", *texts], multirun=False)
    return job.cell()


def stored(cell: Cell) -> StoredCell:
    """What the store holds of a cell, as it comes back from JSON."""
    what = json.loads(json.dumps({**cell.description(), "label": cell.label, "system": cell.scenario.label}))
    return StoredCell(cell.identity, what, (), {}, {}, {}, 0.0)


def test_it_is_set_on_a_command_line_and_found_again_in_a_stored_cell() -> None:
    grainy = cell("system.grain=0.2")
    assert isinstance(grainy.scenario, Grainy)
    assert grainy.scenario.grain == 0.2
    assert grainy.description()["data"]["grain"] == 0.2
    assert cell().identity == cell("system.grain=0").identity != grainy.identity
    again = stored_cells.stored_as_cell(stored(grainy))
    assert again.identity == grainy.identity
    assert grainy.scenario.prior is not None
    assert again.scenario == replace(grainy.scenario, prior=replace(grainy.scenario.prior, name="stored"))
    ours, theirs = (one.scenario.replicates(0, 1)[0][0].records[0].channels[0] for one in (grainy, again))
    np.testing.assert_array_equal(ours.values, theirs.values)


def test_its_limits_and_versions_without_it_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"^system\.grain=1: input should be less than 1"):
        cell("system.grain=1")
    newer = stored(cell("system.grain=0.2"))
    monkeypatch.setattr(stored_cells, "Scenario", Scenario)
    with pytest.raises(InputError, match=r"grain=0\.2: not a field"):
        stored_cells.stored_as_cell(newer)


def test_it_is_read_from_a_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "worn.yaml"
    path.write_text("defaults: [sdof]\nlabel: worn\ngrain: 0.1\n")
    found = cell(f"system={path}").scenario
    assert (found.label, found.grain) == ("worn", 0.1)


def test_data_that_differ_in_it_are_paired() -> None:
    """The base noise is the same draw: the two noises are in the ratio of their standard deviations."""
    quiet, grainy = (cell(*texts).scenario for texts in ([], ["system.grain=0.2"]))
    clean = quiet._response(quiet.times, 0)[0]
    noises = [s.replicates(0, 1)[0][0].records[0].channels[0].values - clean for s in (quiet, grainy)]
    ratio = math.hypot(quiet.sigmas(0)[0], 0.2) / quiet.sigmas(0)[0]
    np.testing.assert_allclose(noises[1], ratio * noises[0], rtol=1e-9)


KINDS_OF_PARAMETERS = ("mass", "damping", "stiffness", "other")
BASE = Scenario("sdof", {"k": 9, "m": 1, "c": 0.5}, ((1,), (0,)), 20, duration=4)
CHANGES: dict[str, Any] = {
    "as it is": {},
    "force": {"force": ForceSpec(2, 0.5, 3, kind="swept_sine", noise_db=30)},
    "impulse": {"force": ForceSpec(5, kind="impulse", start_s=0.5, length_s=0.5, hold="cubic")},
    "prior": {"prior": PriorSpec("stored", {"mass": 1, "damping": 0.5, "stiffness": 0.1, "other": 1}, wrong=True)},
    "drawn": {"prior": PriorSpec("stored", dict.fromkeys(KINDS_OF_PARAMETERS, 0.1), draws="truth")},
    "outliers": {"disturbance": kinds()["outliers"](10, 0.1)},
    "bias": {"disturbance": kinds()["bias"](0.1), "initial_state": "unknown"},
    "rig": {"measured": (0,), "added_mass": (1,), "dense": 50, "forecast": 2},
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_scenario_comes_back_from_json_as_it_was(name: str) -> None:
    scenario = replace(BASE, **CHANGES[name])
    text = json.dumps(scenario.to_dict())
    again = Scenario.from_dict(json.loads(text))
    assert again == scenario
    assert json.dumps(again.to_dict()) == text
