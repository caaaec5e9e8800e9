"""One line that says what a cell's table shows: is the method on the bound, and do its intervals hold?

Errors far below the bound are never called good: no honest method has them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from scipy.special import bdtr, chdtri  # scipy.stats takes a quarter of a second to import

from bench.reporting.rounding import excess_text, readable
from bench.scoring.summary import below_chance
from bench.store.stored import StoredCell

NEAR = 1.2
"""On the bound: a root mean square error within so many times it."""
LEVEL = 0.95
ON_THE_BOUND, HOLD = "on the bound", "intervals hold"
FEWEST = 5
"""Replicates, fewer than which say nothing of either."""


def verdict(stored: StoredCell) -> str:
    """The verdict over the quantities that the data identify, the worst named; a reason where there is none.

    A root mean square of so few errors is itself uncertain: a method is off the bound where the lower limit of its 95 %
    interval (chi-square, of normal errors) is above :data:`NEAR`. Intervals fail where the count of those that hold
    the truth is below the binomial 95 % interval of their level.
    """
    n, silent = stored.n_ok, len(stored.rows) - stored.n_ok
    if n < FEWEST:
        return f"no verdict: {n} of {len(stored.rows)} fits have an answer, and it takes {FEWEST}"
    told = {name: own for name, own in _scored(stored).items() if stored.identifiable.get(name, True)}
    if not told:
        return "no verdict: nothing is identifiable from these data"
    small = suspicious(stored)
    accuracy = (
        below([readable(name) for name in small])
        if small
        else _accuracy({name: float(own["excess"]) for name, own in told.items()}, n)
    )
    parts = [accuracy, _intervals(stored, told, n)]
    ambiguous = sum(math.isfinite(row.scores.get("other_basins_pct", math.nan)) for row in stored.rows)
    parts += [f"{ambiguous} of {n} answers name another basin that fits"] if ambiguous else []
    parts += [f"{silent} of {len(stored.rows)} fits have no answer"] if silent else []
    return "; ".join(part for part in parts if part)


def suspicious(stored: StoredCell) -> list[str]:
    """Return the quantities whose errors are smaller than the bound allows by chance."""
    scored = _scored(stored) if stored.n_ok >= FEWEST else {}
    return [
        name
        for name, own in scored.items()
        if below_chance(float(own["excess"]), float(own.get("bound", math.nan)), stored.n_ok)
    ]


def below(names: Sequence[str]) -> str:
    """Say that errors are too small to be chance: of quantities, or of methods."""
    listed = ", ".join(names)
    return (
        f"below the bound by more than chance allows ({listed}): check the method for use of the truth or of the prior"
    )


def good(said: str) -> bool:
    """Whether a verdict has nothing against the method."""
    return said == f"{ON_THE_BOUND}; {HOLD}"


def _scored(stored: StoredCell) -> dict[str, Mapping[str, Any]]:
    """The summaries of the errors of quantities, by quantity."""
    suffix = "_error_pct"
    found = {name.removesuffix(suffix): own for name, own in stored.summary.items() if name.endswith(suffix)}
    return {name: own for name, own in found.items() if math.isfinite(own.get("excess", math.nan))}


def _accuracy(excess: Mapping[str, float], n: int) -> str:
    least = {name: value * math.sqrt(n / float(chdtri(n, 0.025))) for name, value in excess.items()}
    worst = max(excess, key=lambda name: excess[name])
    if max(least.values()) <= NEAR:
        return ON_THE_BOUND
    off = f"{excess_text(excess[worst])} times the bound in {readable(worst)}"
    return off if len(excess) == 1 or min(least.values()) > NEAR else f"{off}, on it in others"


def _intervals(stored: StoredCell, told: Mapping[str, Any], n: int) -> str:
    shares = {name: stored.summary.get(f"{name}_coverage_95", {}).get("mean", math.nan) for name in told}
    known = {name: share for name, share in shares.items() if math.isfinite(share)}
    if not known:
        return "no intervals are told"
    worst = min(known, key=lambda name: known[name])
    holds = bool(bdtr(round(known[worst] * n), n, LEVEL) >= 0.025)
    return HOLD if holds else f"95 % intervals of {readable(worst)} hold in {100 * known[worst]:.0f} %"
