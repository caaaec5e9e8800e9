"""A fit drawn with letters: where dots and lines stand, how wide it is, and which letters and colours it takes."""

from __future__ import annotations

import io
import itertools
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.records.response import ChannelResiduals, ChannelResponse, Response
from bench.records.verdict import Trust
from bench.reporting.terminal_plot import holds_braille, plotted, round_numbers, wanted


def output(monkeypatch: pytest.MonkeyPatch, encoding: str = "utf-8", terminal: bool = False) -> None:
    """An output of an encoding, which is a terminal or is none."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding)
    monkeypatch.setattr(stream, "isatty", lambda: terminal, raising=False)
    monkeypatch.setattr("sys.stdout", stream)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)


def response(
    times: np.ndarray, values: np.ndarray, curve: np.ndarray | None = None, frequency: float = 0.1
) -> Response:
    left = values if curve is None else values - curve
    residuals = ChannelResiduals(left, float(np.sqrt(np.mean(left**2))), 0.123, 0.0, 0.5, 0.0, "m")
    fit = None if curve is None else ChannelResponse(times, curve, residuals)
    return Response("shooting", Trust.TRUST, "displacement", "m", times, values, frequency, fit)


def canvas(text: str) -> list[str]:
    """What stands inside of the frame, line by line."""
    edges = "|+│┤"
    inside = [line for line in text.splitlines() if line.endswith(tuple("|│"))]
    return [line[next(i for i, letter in enumerate(line) if letter in edges) + 1 : -1] for line in inside]


def test_dots_stand_where_the_samples_are(monkeypatch: pytest.MonkeyPatch) -> None:
    output(monkeypatch, "ascii")
    monkeypatch.setenv("COLUMNS", "61")
    rows = canvas(plotted(response(np.array([0.0, 1.0, 2.0]), np.array([-1.0, 1.0, -1.0]))))
    places = [(i, row.index("o"), row.rindex("o")) for i, row in enumerate(rows) if "o" in row]
    (top, middle, same), (bottom, left, right) = places
    assert (top, bottom) == (0, len(rows) - 1)
    assert middle == same == pytest.approx(len(rows[0]) / 2, abs=1)
    assert (left, right) == (0, len(rows[0]) - 1)


def test_the_line_is_the_fit_and_not_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rising fit of falling samples begins at the bottom and ends at the top."""
    output(monkeypatch, "ascii")
    monkeypatch.setenv("COLUMNS", "60")
    times = np.linspace(0.0, 1.0, 30)
    rows = canvas(plotted(response(times, -times, times - 1.0)))
    drawn = [row.index(".") for row in rows if "." in row]
    assert len(drawn) > len(rows) / 2
    assert drawn == sorted(drawn, reverse=True)


CASES = {
    "three": (np.array([0.0, 1.0, 2.0]), np.array([0.0, 1e-9, 0.0])),
    "many": (np.linspace(0, 200, 100_000), np.sin(np.linspace(0, 200, 100_000))),
    "flat": (np.arange(50.0), np.full(50, 7.0)),
    "zero": (np.arange(50.0), np.zeros(50)),
    "gap": (np.r_[0:10:0.1, 90:100:0.1], np.cos(np.r_[0:10:0.1, 90:100:0.1])),
    "large": (np.arange(50.0), 1e12 * np.cos(np.arange(50.0))),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("width", [40, 80, 200])
@pytest.mark.parametrize("fitted", [True, False])
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_any_record_is_drawn_in_the_width_and_letters_of_the_terminal(
    case: str, width: int, fitted: bool, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    output(monkeypatch, encoding)
    monkeypatch.setenv("COLUMNS", str(width))
    times, values = CASES[case]
    text = plotted(response(times, values, 0.9 * values if fitted else None))
    longest = max(map(len, text.splitlines()))
    assert 0.9 * width <= longest < width
    text.encode(encoding)
    assert any(letter in text for letter in "•⠤") == (encoding == "utf-8")
    assert ("found no fit to draw" in " ".join(text.split())) == (not fitted)
    assert len(text.splitlines()) <= 34


def test_a_long_record_is_drawn_as_far_as_its_cycles_can_be_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    output(monkeypatch)
    monkeypatch.setenv("COLUMNS", "80")
    times, values = CASES["many"]
    text = plotted(response(times, values, values, frequency=1.0))
    (said,) = (line for line in text.splitlines() if line.startswith("drawn to"))
    until = float(said.split()[2])
    assert 5 <= 80 / until <= 16  # columns of a cycle of 1 s
    assert "drawn to" not in plotted(response(times, values, values, frequency=0.01))


def test_the_residual_is_said_in_words_and_doubt_beside_the_method(monkeypatch: pytest.MonkeyPatch) -> None:
    output(monkeypatch)
    times = np.linspace(0.0, 1.0, 50)
    own = response(times, np.sin(times), np.sin(times) - 0.25)
    lines = plotted(own).splitlines()
    assert "residual: rms 0.25 m, 12 % of the signal" in lines
    assert "• measured  ⠤ fitted by shooting" in lines
    assert "• measured  ⠤ fitted by shooting (do not trust)" in plotted(replace(own, trust=Trust.NO)).splitlines()


def test_colour_is_for_terminals_that_want_it(monkeypatch: pytest.MonkeyPatch) -> None:
    times = np.linspace(0.0, 1.0, 50)
    own = response(times, np.sin(times), np.sin(times))
    output(monkeypatch)
    assert "\x1b" not in plotted(own)
    output(monkeypatch, terminal=True)
    assert "\x1b" in plotted(own)
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b" not in plotted(own)


@pytest.mark.parametrize(
    ("plot", "terminal", "shown"),
    [("auto", True, True), ("auto", False, False), ("always", False, True), ("never", True, False)],
)
def test_a_plot_goes_to_terminals_unless_told_otherwise(
    plot: str, terminal: bool, shown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    output(monkeypatch, terminal=terminal)
    assert wanted(plot, sys.stdout) is shown


def test_an_output_without_an_encoding_gets_plain_letters() -> None:
    assert not holds_braille(io.StringIO())


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_marks_are_round_numbers_evenly_spread_within_the_axis(low: float, span: float) -> None:
    high = low + span
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        return
    marks = round_numbers(low, high)
    assert 1 <= len(marks) <= 7
    room = 1e-6 * (high - low)
    assert low - room <= marks[0]
    assert marks[-1] <= high + room
    for one, other in itertools.pairwise(marks):
        step = other - one
        mantissa = step / 10.0 ** math.floor(math.log10(step) + 1e-6)
        assert min(abs(mantissa - own) for own in (1.0, 2.0, 5.0)) < 1e-3
