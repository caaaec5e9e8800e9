"""Text plots: positions of dots and lines, width, encoding and colour."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest

from bench.records.response import ChannelResiduals, ChannelResponse, Response
from bench.records.verdict import Trust
from bench.reporting.terminal_plot import plotted, wanted


def output(monkeypatch: pytest.MonkeyPatch, encoding: str = "utf-8", width: int = 60) -> None:
    """Set standard output to a file of an encoding, and the width of the terminal."""
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(io.BytesIO(), encoding))
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.delenv("NO_COLOR", raising=False)


def response(times: np.ndarray, values: np.ndarray, curve: np.ndarray | None, frequency: float = 0.1) -> Response:
    difference = values if curve is None else values - curve
    residuals = ChannelResiduals(difference, float(np.sqrt(np.mean(difference**2))), 0.123, 0.0, 0.5, 0.0, "m")
    fit = None if curve is None else ChannelResponse(times, curve, residuals)
    return Response("shooting", Trust.CAUTION, "displacement", "m", times, values, frequency, fit)


def test_dots_and_line_are_at_the_positions_of_the_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples at the bottom left, top centre and bottom right; a rising fit of falling samples."""
    output(monkeypatch, "ascii")
    times = np.linspace(0.0, 1.0, 31)
    three = plotted(response(np.array([0.0, 1.0, 2.0]), np.array([-1.0, 1.0, -1.0]), None))
    rising = plotted(response(times, -times, times - 1.0))
    rows = inside(three)
    dots = [(i, j) for i, row in enumerate(rows) for j, letter in enumerate(row) if letter == "o"]
    bottom, right = len(rows) - 1, len(rows[0]) - 1
    assert dots == [(0, pytest.approx(right / 2, abs=1)), (bottom, 0), (bottom, right)]
    line = [row.index(".") for row in inside(rising) if "." in row]
    assert len(line) > len(rows) / 2
    assert line == sorted(line, reverse=True)
    assert "residual RMS: 0.5" in rising


def inside(text: str) -> list[str]:
    """Return the lines within the frame."""
    lines = [line for line in text.splitlines() if line.endswith("|")]
    return [line[next(i for i, letter in enumerate(line) if letter in "|+") + 1 : -1] for line in lines]


SWEEP = np.linspace(0, 200, 100_000)
CASES = {
    "three": (np.array([0.0, 1.0, 2.0]), np.array([0.0, 1e-9, 0.0])),
    "many": (SWEEP, np.sin(SWEEP)),
    "flat": (np.arange(50.0), np.full(50, 7.0)),
    "zero": (np.arange(50.0), np.zeros(50)),
    "gap": (np.r_[0:10:0.1, 90:100:0.1], np.cos(np.r_[0:10:0.1, 90:100:0.1])),
    "large": (np.arange(50.0), 1e12 * np.cos(np.arange(50.0))),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("width", [40, 200])
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_any_record_is_drawn_in_the_width_and_encoding_of_the_terminal(
    case: str, width: int, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    output(monkeypatch, encoding, width)
    times, values = CASES[case]
    for curve in (None, 0.9 * values):
        text = plotted(response(times, values, curve))
        longest = max(map(len, text.splitlines()))
        assert 0.9 * width <= longest <= width
        text.encode(encoding)
        assert ("•" in text) == (encoding == "utf-8")
        assert ("no fit by shooting" in " ".join(text.split())) == (curve is None)


def test_a_long_record_is_drawn_as_far_as_its_cycles_are_resolved(monkeypatch: pytest.MonkeyPatch) -> None:
    output(monkeypatch)
    times, values = CASES["many"]
    (note,) = (line for line in plotted(response(times, values, values, 1.0)).splitlines() if "drawn up to" in line)
    assert 5 <= 60 / float(note.split()[3]) <= 16  # columns per cycle of 1 s
    assert "drawn up to" not in plotted(response(times, values, values, 0.01))


def test_colour_and_plot_are_for_terminals_that_support_them(monkeypatch: pytest.MonkeyPatch) -> None:
    output(monkeypatch)
    times = np.linspace(0.0, 1.0, 50)
    drawn = response(times, np.sin(times), np.sin(times))
    assert "\x1b" not in plotted(drawn)
    assert [wanted(plot, sys.stdout) for plot in ("auto", "always", "never")] == [False, True, False]
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert "\x1b" in plotted(drawn)
    assert [wanted(plot, sys.stdout) for plot in ("auto", "always", "never")] == [True, True, False]
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b" not in plotted(drawn)
