"""A fit drawn with letters, for reading in a terminal: samples as dots, the fitted response as a line.

A terminal has few columns, so a long record is drawn from its beginning for as many cycles as they can show, where the
motion is largest and a wrong phase is seen.
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

A_CYCLE = 6
"""Columns of a cycle, at least."""
LOWEST, HIGHEST = 10, 24
"""Lines of the plot."""
TICKS = 5
DOT, LINE = "•", "⠤"
PLAIN = str.maketrans("┌┐└┘┤┬├┴┼─│•", "+++++++++-|o") | dict.fromkeys(range(0x2800, 0x2900), ".")
"""What stands for the letters of a plot where the output does not hold them: any of braille is a point."""


def wanted(plot: str, stream: TextIO) -> bool:
    """Return whether a plot goes to a stream: ``always``, ``never``, or with ``auto`` where it is a terminal."""
    return plot == "always" or (plot == "auto" and stream.isatty() and os.environ.get("TERM") != "dumb")


def plotted(response: Response) -> str:
    """Return the plot with a legend and the residual's size in words, in the width of the terminal."""
    fit, end = response.fit, float(response.times[-1])
    until = min(end, float(response.times[0]) + columns() / A_CYCLE / response.frequency)
    doubt = "" if response.trust is Trust.TRUST else f" ({response.trust.value})"
    found = f"  {LINE} fitted by {response.method}{doubt}" if fit else f"; {response.method} found no fit to draw"
    lines = [_drawn(response, until), wrapped(f"{DOT} measured{found}")]
    if until < end:
        lines.append(wrapped(f"drawn to {number(until)} s of {number(end)} s"))
    if fit is not None:
        rms, part = f"{number(fit.residuals.rms)} {response.unit}", f"{100 * fit.residuals.part_of_signal:.2g} %"
        lines.append(wrapped(f"residual: rms {rms}, {part} of the signal"))
    text = "\n".join(lines)
    return text if holds_letters(sys.stdout) else text.translate(PLAIN)


def holds_letters(stream: TextIO) -> bool:
    """Return whether a stream's encoding has the letters of a plot."""
    try:
        (DOT + LINE + "┤").encode(stream.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _drawn(response: Response, until: float) -> str:
    import plotext  # its functions draw on one figure, which is cleared before

    places = columns() - 1  # a full line would make some terminals begin another
    plotext.clear_figure()
    plotext.limit_size(False, False)
    plotext.plot_size(places, min(HIGHEST, max(LOWEST, places // 4)))
    plotext.theme("clear")
    shown = response.times <= until
    samples = [part.tolist() for part in thinned(response.times[shown], response.values[shown])]
    draws, values = [lambda: plotext.scatter(*samples, marker=DOT)], list(samples[1])
    if response.fit is not None:
        seen = response.fit.times <= until
        curve = [part[seen].tolist() for part in (response.fit.times, response.fit.values)]
        colour = "cyan" if colour_shown() else None
        # the last that is drawn lies above: so many dots would hide the line
        draws.insert(int(len(samples[0]) > places), lambda: plotext.plot(*curve, marker="braille", color=colour))
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
