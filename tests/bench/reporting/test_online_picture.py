"""The picture of the online track: trackers keep their colours, the nearest lead, and no end is off the panel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.config.online import online_scenario
from bench.online.follow import Followed

pytest.importorskip("matplotlib")

from bench.reporting.figures import online
from bench.reporting.figures.online import SHOWN, ShownTrack, caption, draw_online, tracker_colours


def shown(scenario: str, excesses: dict[str, float], off: float = 0.0) -> ShownTrack:
    """A record with trackers that are off by so many in the logarithm."""
    stream = online_scenario(scenario).stream(0, 0)
    quantities = stream.layout.quantities
    true = np.log(np.stack([q.value(stream.truth.parameters) * np.ones(len(stream.times)) for q in quantities], axis=1))
    none = np.zeros(len(true))
    path = Followed(true + off, np.full(true.shape, 0.01), none, none, none, 0)
    variances = {q.name: np.full(len(true), 1e-4) for q in quantities}
    return ShownTrack(
        scenario, stream, variances, "k_over_m", {name: (path, excess) for name, excess in excesses.items()}
    )


def test_a_tracker_has_the_same_colour_in_every_panel_and_the_nearest_is_named_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = []
    monkeypatch.setattr(online, "save_figure", lambda figure, *_: kept.append(figure) or [])
    draw_online(
        [shown("ramp", {"a": 3.0, "b": 1.0, "c": 2.0, "d": 9.0}), shown("sinusoid", {"a": 1.0, "b": 2.0})], tmp_path
    )
    first, second = kept[0].axes
    assert [text.get_text() for text in first.texts] == ["b", "c", "a"]
    assert [text.get_text() for text in second.texts] == ["a", "b"]
    colours = {text.get_text(): text.get_color() for text in first.texts}
    assert {text.get_text(): text.get_color() for text in second.texts} == {name: colours[name] for name in "ab"}
    assert len(set(colours.values())) == SHOWN == len(tracker_colours("bca"))
    assert first.get_lines()[-1].get_color() == colours["b"]  # the nearest on top


def test_estimates_that_end_far_off_are_on_the_panel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = []
    monkeypatch.setattr(online, "save_figure", lambda figure, *_: kept.append(figure) or [])
    draw_online([shown("ramp", {"a": 3.0}, off=-0.9)], tmp_path)
    axis = kept[0].axes[0]
    line = axis.get_lines()[-1].get_ydata()
    assert axis.get_ylim()[0] <= np.quantile(line[-len(line) // 4 :], 0.2)


def test_the_leader_is_counted_and_a_tie_is_called_one() -> None:
    one, other = shown("ramp", {"a": 1.0, "b": 2.0}), shown("sinusoid", {"a": 2.0, "b": 1.0})
    assert caption([one, one, other]).startswith("a is most often nearest to the bound, in 2 of 3 scenarios.")
    assert caption([one, other]).startswith("a and b are most often nearest to the bound, in 1 of 2 scenarios each.")
