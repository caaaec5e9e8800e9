"""What the data of a situation tell, what they do not, and how well in percent."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.reporting.frame import Result, group
from bench.reporting.page.reading import ScenarioPanel, decibels
from bench.reporting.page.words import joined, number, quantity
from bench.scoring.summary import gross

FEW = 3
"""Quantities that are named; of more, only their range is said."""
USUAL_DB = 20.0
"""The SNR (dB) at which errors are said in percent: the nearest that there is."""


def tells(panels: Sequence[ScenarioPanel]) -> str:
    """What can be found in a situation, whatever the method; by free decay and known force where both occur."""
    kinds = group(panels, lambda panel: panel.facts.forced)
    if len(kinds) == 1:
        return f"tells {_told(panels)}"
    return f"free decay tells {_told(kinds[False])}; known force: {_told(kinds[True])}"


def _told(panels: Sequence[ScenarioPanel]) -> str:
    lost = list(dict.fromkeys(name for panel in panels for name, told in panel.identifiable.items() if not told))
    if not lost:
        return joined(alone(panels[0])) if len({tuple(alone(p)) for p in panels}) == 1 else "every parameter"
    sets = {tuple(quantity(metric) for metric in ranked(panel)) for panel in panels}
    same = next(iter(sets)) if len(sets) == 1 else ()
    if 0 < len(same) <= FEW:
        return f"{joined(same)}, not {joined(lost, 'or')}"
    first = next((name for own in sorted(sets, key=len) for name in own if "/" in name), "")
    return f"ratios such as {first}, no mass" if first else "nothing by itself"


def ranked(panel: ScenarioPanel) -> list[str]:
    """The metrics of the quantities that the data tell."""
    return [metric for metric in panel.ranked if metric != "rmse"]


def alone(panel: ScenarioPanel) -> list[str]:
    """The quantities that the data tell and that are no ratios of others."""
    return [name for name in map(quantity, ranked(panel)) if "/" not in name]


def usual(panels: Sequence[ScenarioPanel]) -> float:
    """The SNR (dB) at which errors are said in percent."""
    return min((p.facts.snr_db for p in panels), key=lambda snr: (abs(snr - USUAL_DB), snr), default=math.nan)


def noise(panels: Sequence[ScenarioPanel]) -> str:
    """Its standard deviation there, in percent of the signal's root mean square."""
    level = usual(panels)
    return f"{number(100 * 10 ** (-level / 20), 2)} %" if math.isfinite(level) else ""


def accuracy(panels: Sequence[ScenarioPanel], label: str) -> str:
    """A method's root mean square error in percent at the usual noise, gross errors left out."""
    level = usual(panels)
    found: dict[str, list[float]] = {}
    for panel in (p for p in panels if p.facts.snr_db == level):
        metrics = ranked(panel)
        own = [m for m in metrics if "/" not in quantity(m)] or metrics
        for cell in (cell for cell in panel.methods if cell.label == label):
            for metric in (metric for metric in own if metric in cell.summary):
                found.setdefault(quantity(metric), []).append(core_error(cell, metric))
    errors = {name: float(np.median(values)) for name, values in found.items() if np.isfinite(values).all()}
    if not errors:
        return ""
    if len(errors) <= FEW:
        said = ", ".join(f"{name} {number(value, 2)} %" for name, value in errors.items())
    else:
        said = f"{number(min(errors.values()), 2)} to {number(max(errors.values()), 2)} %"
    return f"{said} at {decibels(level)} dB"


def core_error(cell: Result, metric: str) -> float:
    """Root mean square of the errors that are not gross; NaN where there is none, or no bound."""
    bound, errors = cell.bound(metric), cell.errors(metric)
    good = errors[~gross(errors, bound)]
    if not (math.isfinite(bound) and bound > 0 and good.size):
        return math.nan
    return float(np.sqrt(np.mean(good**2)))
