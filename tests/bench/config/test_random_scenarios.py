"""The open split is drawn from the stated ranges by the release's name, and every scenario can be had again."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from bench.config.experiment import Experiment, expand
from bench.config.files import read_yaml
from bench.config.random_scenarios import draw, drawn_scenarios
from bench.errors import InputError
from bench.scenario.scenario import Scenario

STATED: dict[str, Any] = read_yaml("experiment", "open")["draw"]


def test_five_hundred_scenarios_lie_in_the_stated_ranges() -> None:
    found = drawn_scenarios("open")
    assert len(found) == STATED["scenarios"] == 500
    for one in found:
        m, c, k = (one.system["parameters"][name] for name in "mck")
        frequency = math.sqrt(k / m) / (2 * math.pi)
        values = {
            "damping_ratio": c / (2 * math.sqrt(k * m)), "cycles": one.system["duration"] * frequency, "mass": m,
            "frequency_hz": frequency, "samples": one.system["samples"], "snr": one.snr,
        }  # fmt: skip
        for name, value in values.items():
            low, high = STATED[name]
            assert low * (1 - 1e-3) <= value <= high * (1 + 1e-3), (one.name, name)
        assert one.system["samples"] >= 0.6 * values["cycles"] - 0.5, one.name  # rounded to a whole number


def test_a_force_does_not_reveal_the_natural_frequency() -> None:
    """The top of a band is a random multiple of the natural frequency: twice it, by up to a factor of exp(0.4)."""
    tops = []
    for one in drawn_scenarios("open"):
        m, k = (one.system["parameters"][name] for name in "mk")
        if one.system["force"] and "high_hz" in one.system["force"]:
            tops.append(math.log(one.system["force"]["high_hz"] / 2 / (math.sqrt(k / m) / (2 * math.pi))))
    assert len(tops) > 50
    assert -0.4 <= min(tops) < -0.3
    assert 0.3 < max(tops) <= 0.4 + 1e-3


def test_the_release_is_the_seed_and_more_scenarios_keep_the_first() -> None:
    again = draw("open", STATED)
    assert again == drawn_scenarios("open")
    assert draw("open", {**STATED, "scenarios": 5}) == again[:5]
    other = draw("open", {**STATED, "release": "another", "scenarios": 5})
    assert all(one.system != two.system for one, two in zip(other, again, strict=False))


@pytest.mark.parametrize("ranges", [{"mass": [2, 1]}, {"mass": [1]}, {"colour": [1, 2]}])
def test_a_range_that_makes_no_sense_is_refused(ranges: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="two ends"):
        draw("open", {**STATED, **ranges})


def test_cells_are_scenarios_times_methods_and_come_back_from_their_description() -> None:
    named = {"method": ["oracle", "prior"], "system": ["open_001", "open_500"]}
    found = Experiment("open").cells(named)
    assert [cell.scenario.label for cell in found] == ["open_001", "open_001", "open_500", "open_500"]
    for cell in found:
        assert cell.replicates == 1
        assert (cell.scenario.prior is None) == (cell.scenario.force is not None)
        stated = json.loads(json.dumps(cell.scenario.to_dict()))
        assert Scenario.from_dict(stated).to_dict() == cell.scenario.to_dict()
    assert len(Experiment("open").cells({"method": ["oracle"]})) == 500


def test_a_drawn_scenario_can_be_chosen_and_changed_by_name() -> None:
    (job,) = expand(["method=oracle", "system=open_007", "system.samples=33"], False)
    assert job.scenario.label == "open_007"
    assert job.scenario.samples == 33
    with pytest.raises(InputError, match=r"system=open_501: .*open_001 to open_500"):
        expand(["method=oracle", "system=open_501"], False)


def test_development_scenarios_stand_in_no_table() -> None:
    described = Experiment("development")
    assert not described.table
    names = {cell.scenario.label for cell in described.cells()}
    assert len(names) == 12
    for other in ("table3", "forced", "mdof", "nonlinear", "regimes", "robustness", "open", "misspecified"):
        assert not names & {scenario.label for scenario, _ in Experiment(other).scenarios()}
