"""Scenarios of the online track by name, and those of any system from the command line."""

import numpy as np
import pytest

from bench.config.online import online_scenario, scenario_names, scenarios_from_system


def test_every_scenario_of_the_track_is_one() -> None:
    for name in scenario_names():
        assert online_scenario(name).label == name


def test_courses_compose_with_any_system() -> None:
    found = scenarios_from_system("duffing", {"k": ["step", {"kind": "ramp", "change": -0.2}], "c": ["step"]}, snr=30)
    assert [one.varying["k"].kind for one in found] == ["step", "ramp"]
    assert found[1].varying["k"].change == -0.2
    assert all(one.varying["c"].kind == "step" and one.snr_db == 30 for one in found)
    stream = found[0].stream(0, 0)
    k = stream.truth.parameters["k"]
    assert k[0] == 8.0
    assert k[-1] == pytest.approx(7.2)
    assert np.all(np.isfinite(stream.values))
