"""A fit drawn with letters, for reading in a terminal: samples as dots, the fitted response as a line.

A terminal has few columns, so a long record is drawn from its beginning for as many cycles as they can show, where the
motion is largest and a wrong phase is seen.
"""

from __future__ import annotations

import math
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
BRAILLE_DOT, BRAILLE_LINE = "•", "⠤"
ASCII_DOT, ASCII_LINE = "o", "."
FRAME = str.maketrans("┌┐└┘┤┬├┴┼─│", "+++++++++-|")
"""What stands for the letters of the frame where the output holds ASCII alone."""
LINE_COLOUR = "cyan"


def wanted(plot: str, stream: TextIO) -> bool:
    """Whether a plot goes to a stream: ``always``, ``never``, or with ``auto`` where it is a terminal."""
    return plot == "always" or (plot == "auto" and stream.isatty() and os.environ.get("TERM") != "dumb")


def plotted(response: Response) -> str:
    """The plot with a legend and the residual's size in words, in the width of the terminal."""
    until = min(float(response.times[-1]), _last(response))
    fine = holds_braille(sys.stdout)
    lines = [_drawn(response, until, fine), wrapped(_legend(response, fine))]
    if until < float(response.times[-1]):
        lines.append(wrapped(f"drawn to {number(until)} s of {number(float(response.times[-1]))} s"))
    if response.fit is not None:
        residuals = response.fit.residuals
        part = f"{100 * residuals.part_of_signal:.2g} % of the signal"
        lines.append(wrapped(f"residual: rms {number(residuals.rms)} {response.unit}, {part}"))
    return "\n".join(lines)


def holds_braille(stream: TextIO) -> bool:
    """Whether a stream's encoding has the letters of a fine plot."""
    try:
        (BRAILLE_DOT + BRAILLE_LINE + "┤").encode(stream.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _last(response: Response) -> float:
    """The time (s) up to which the cycles can be told apart on the screen."""
    return float(response.times[0]) + columns() / A_CYCLE / response.frequency


def _legend(response: Response, fine: bool) -> str:
    dot, line = (BRAILLE_DOT, BRAILLE_LINE) if fine else (ASCII_DOT, ASCII_LINE)
    if response.fit is None:
        return f"{dot} measured; {response.method} found no fit to draw"
    doubt = "" if response.trust is Trust.TRUST else f" ({response.trust.value})"
    return f"{dot} measured  {line} fitted by {response.method}{doubt}"


def _drawn(response: Response, until: float, fine: bool) -> str:
    import plotext  # its functions draw on one figure, which is cleared before

    dot, line = (BRAILLE_DOT, "braille") if fine else (ASCII_DOT, ASCII_LINE)
    colour = LINE_COLOUR if colour_shown() else None
    seen = response.times <= until
    samples = thinned(response.times[seen], response.values[seen])
    places = columns() - 1  # a full line would make some terminals begin another
    plotext.clear_figure()
    plotext.limit_size(False, False)
    plotext.plot_size(places, min(HIGHEST, max(LOWEST, places // 4)))
    plotext.theme("clear")
    scattered = (samples[0].tolist(), samples[1].tolist())
    curve = ([], []) if response.fit is None else _part(response.fit.times, response.fit.values, until)
    few = samples[0].size <= places
    if not few:  # so many dots would hide the line
        plotext.scatter(*scattered, marker=dot)
    if curve[0]:
        plotext.plot(*curve, marker=line, color=colour)
    if few:
        plotext.scatter(*scattered, marker=dot)
    _axes(plotext, (float(response.times[0]), until), [*scattered[1], *curve[1]])
    plotext.title(f"{response.measures} ({response.unit})")
    plotext.xlabel("time (s)")
    text = str(plotext.build())
    text = text if colour else plotext.uncolorize(text)
    shown = [own.removesuffix("\x1b[0m").rstrip() for own in text.splitlines()]
    return "\n".join(shown if fine else [own.translate(FRAME) for own in shown])


def _part(times: np.ndarray, values: np.ndarray, until: float) -> tuple[list[float], list[float]]:
    seen = times <= until
    return times[seen].tolist(), values[seen].tolist()


def _axes(plotext: object, span: tuple[float, float], values: list[float]) -> None:
    """Round numbers at both axes, whatever the size of the values."""
    low, high = min(values), max(values)
    room = 0.02 * (high - low) or 0.1 * abs(high) or 1.0
    for limit, tick, ends in (("xlim", "xticks", span), ("ylim", "yticks", (low - room, high + room))):
        marks = round_numbers(*ends)
        getattr(plotext, limit)(*ends)
        getattr(plotext, tick)(marks, [f"{mark:.6g}" for mark in marks])


def round_numbers(low: float, high: float) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten from ``low`` to ``high``, about :data:`TICKS` of them."""
    rough = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * own for own in (1.0, 2.0, 5.0, 10.0) if power * own >= rough * (1 - 1e-9))
    return [step * i for i in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
