"""Numbers and names as the page shows them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from bench.reporting.frame import ERROR
from bench.reporting.rounding import readable


def quantity(metric: str) -> str:
    """``k_over_m_error_pct`` is ``k/m``; the displacement's error is ``displacement``."""
    return "displacement" if metric == "rmse" else readable(metric.removesuffix(ERROR))


def heading(metric: str) -> str:
    """The same with its unit."""
    return f"{quantity(metric)} ({'m' if metric == 'rmse' else '%'})"


def number(value: float, digits: int = 3) -> str:
    """So many significant digits; a dash for what is not there, ``failed`` for an infinite error."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "failed"
    if value == 0 or 1e-3 <= abs(value) < 1000:
        return f"{value:.{digits}g}"
    return f"{value:.{digits - 1}e}"


def percent(share: float) -> str:
    """A share in percent."""
    return "–" if math.isnan(share) else f"{100 * share:.0f} %"


def unbroken(text: str) -> str:
    """The same, no line of which begins with a percent sign or a unit."""
    return re.sub(r"(?<=\d) (?=%|dB)", "\u00a0", text)


def joined(names: Sequence[str], last: str = "and") -> str:
    """``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}" if names else ""


def seconds(value: float) -> str:
    """A time with its unit."""
    if math.isnan(value):
        return "–"
    return f"{1000 * value:.2g} ms" if value < 0.1 else f"{value:.2g} s" if value < 100 else f"{value:.0f} s"
