"""A text plot of a record for the terminal: samples as dots, the fitted response as a line.

A long record is drawn from its beginning, where the motion is largest, for as many cycles as the columns can resolve.
"""

from __future__ import annotations

import os
import sys
from typing import TextIO

import numpy as np

from bench.records.response import Response, thinned
from bench.records.verdict import Trust
from bench.reporting.rounding import number
from bench.reporting.terminal import colour_shown, columns, wrapped

COLUMNS_PER_CYCLE = 6
"""Smallest number of columns per cycle."""
LOWEST, HIGHEST = 10, 24
"""Smallest and largest height of the plot (lines)."""
TICKS = 5
"""Approximate number of ticks per axis."""
DOT, LINE = "•", "⠤"
PLAIN = str.maketrans("┌┐└┘┤┬├┴┼─│•", "+++++++++-|o") | dict.fromkeys(range(0x2800, 0x2900), ".")
"""ASCII substitutes for the characters of a plot; a point for any braille pattern."""


def wanted(plot: str, stream: TextIO) -> bool:
    """Return whether to draw a plot to a stream: ``always``, ``never``, or ``auto``, if it is a terminal."""
    return plot == "always" or (plot == "auto" and stream.isatty() and os.environ.get("TERM") != "dumb")


def plotted(response: Response) -> str:
    """Return the plot in the width of the terminal, with a legend and the size of the residuals."""
    fit, end = response.fit, float(response.times[-1])
    until = min(end, float(response.times[0]) + columns() / COLUMNS_PER_CYCLE / response.frequency)
    verdict = "" if response.trust is Trust.TRUST else f" ({response.trust.value})"
    legend = f"  {LINE} fitted by {response.method}{verdict}" if fit else f"; no fit by {response.method}"
    lines = [_drawn(response, until), wrapped(f"{DOT} measured{legend}")]
    if until < end:
        lines.append(wrapped(f"drawn up to {number(until)} s of {number(end)} s"))
    if fit is not None:
        rms, part = f"{number(fit.residuals.rms)} {response.unit}", f"{100 * fit.residuals.part_of_signal:.2g} %"
        lines.append(wrapped(f"residual RMS: {rms}, {part} of signal RMS"))
    text = "\n".join(lines)
    return text if can_encode(sys.stdout) else text.translate(PLAIN)


def can_encode(stream: TextIO) -> bool:
    """Return whether the encoding of a stream has the characters of a plot."""
    try:
        (DOT + LINE + "┤").encode(stream.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _drawn(response: Response, until: float) -> str:
    import plotext  # its functions draw on one global figure

    width = columns() - 1  # some terminals begin a new line after a full one
    plotext.clear_figure()
    plotext.limit_size(False, False)
    plotext.plot_size(width, min(HIGHEST, max(LOWEST, width // 4)))
    plotext.theme("clear")
    shown = response.times <= until
    samples = [part.tolist() for part in thinned(response.times[shown], response.values[shown])]
    draws, values = [lambda: plotext.scatter(*samples, marker=DOT)], list(samples[1])
    if response.fit is not None:
        drawn = response.fit.times <= until
        curve = [part[drawn].tolist() for part in (response.fit.times, response.fit.values)]
        colour = "cyan" if colour_shown() else None
        # what is drawn last lies on top: more dots than columns would hide the line
        draws.insert(int(len(samples[0]) > width), lambda: plotext.plot(*curve, marker="braille", color=colour))
        values += curve[1]
    for draw in draws:
        draw()
    low, high = min(values), max(values)
    room = 0.02 * (high - low) or 0.1 * abs(high) or 1.0
    for axis, ends in (("x", (float(response.times[0]), until)), ("y", (low - room, high + room))):
        marks = round_numbers(*ends)
        getattr(plotext, f"{axis}lim")(*ends)
        getattr(plotext, f"{axis}ticks")(marks, [f"{mark:.6g}" for mark in marks])
    plotext.title(f"{response.measures} ({response.unit})")
    plotext.xlabel("time (s)")
    text = plotext.build() if colour_shown() else plotext.uncolorize(plotext.build())
    return "\n".join(line.removesuffix("\x1b[0m").rstrip() for line in text.splitlines())


def round_numbers(low: float, high: float) -> list[float]:
    """Return multiples of 1, 2 or 5 times a power of ten from ``low`` to ``high``, about :data:`TICKS` of them."""
    rough = (high - low) / TICKS
    steps = 10.0 ** np.floor(np.log10(rough)) * np.array([1.0, 2.0, 5.0, 10.0])
    step = float(steps[steps >= rough * (1 - 1e-9)][0])
    multiples = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)
    return [float(multiple) * step + 0.0 for multiple in multiples]  # adding zero: no -0
