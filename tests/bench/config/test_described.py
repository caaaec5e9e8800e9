"""A stored cell's description is enough to ask its question again."""

import pytest

from bench.config.experiment import expand
from bench.store.cell import stored_as_cell
from bench.store.stored import StoredCell


@pytest.mark.parametrize("system", ["chain2_first", "sdof_added_mass", "sdof_noise", "bouc_wen", "duffing_forced"])
def test_every_kind_of_scenario_is_found_again_from_its_description(system):
    """Sensors, added masses and forces are part of the question: the stored description gives the same identity."""
    cell = expand(["method=ls", f"system={system}"], multirun=False)[0].cell()
    what = {**cell.description(), "label": "ls", "system": system}
    assert stored_as_cell(StoredCell(cell.identity, what, (), {}, {}, {}, 0.0)).identity == cell.identity


def test_a_truth_that_is_drawn_is_drawn_again():
    """The prior of such a scenario names the parameters in the system's order, which the stored one has sorted."""
    cell = expand(["method=ls", "prior=drawn_truth"], multirun=False)[0].cell()
    what = {**cell.description(), "label": "ls", "system": "sdof"}
    again = stored_as_cell(StoredCell(cell.identity, what, (), {}, {}, {}, 0.0))
    ours, theirs = (one.scenario.replicates(one.seed, 1)[0][0] for one in (cell, again))
    assert list(ours.records[0].channels[0].values) == list(theirs.records[0].channels[0].values)
