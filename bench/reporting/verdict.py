"""One line about a cell: are the errors at the Cramér-Rao bound, and are the 95 % intervals calibrated?

Errors far below the bound are never called good, since no method that sees only the data reaches them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from scipy.special import bdtr, chdtri  # importing scipy.stats takes a quarter of a second

from bench.reporting.rounding import excess_text, readable
from bench.scoring.summary import below_chance
from bench.store.stored_cell import StoredCell

NEAR = 1.2
"""Largest ratio of a root mean square error to its bound that counts as at the bound."""
LEVEL = 0.95
FEWEST = 5
"""Smallest number of successful fits that a verdict is based on."""
AT_BOUND, CALIBRATED = "at the Cramér-Rao bound", "calibrated"
GOOD = f"accuracy: {AT_BOUND}; 95 % intervals: {CALIBRATED}"
"""The verdict on a cell without a fault."""


def verdict(stored: StoredCell) -> str:
    """Judge accuracy and intervals over the identifiable quantities, and name the worst; or say why it is impossible.

    A root mean square of few errors is itself uncertain: a method is off the bound where the lower limit of the 95 %
    interval (chi-square, for normal errors) exceeds :data:`NEAR`. Intervals are overconfident where the number of them
    that contain the true value is below the binomial 95 % interval.
    """
    n, failed = stored.n_ok, len(stored.rows) - stored.n_ok
    if n < FEWEST:
        return f"no verdict: at least {FEWEST} successful fits required ({n} available)"
    identifiable = {name: line for name, line in _errors(stored).items() if stored.identifiable.get(name, True)}
    if not identifiable:
        return "no verdict: no quantity is identifiable from these data"
    if small := suspicious(stored):
        accuracy = below([readable(name) for name in small])
    else:
        accuracy = _accuracy({name: float(line["excess"]) for name, line in identifiable.items()}, n)
    parts = [f"accuracy: {accuracy}", f"95 % intervals: {_intervals(stored, identifiable, n)}"]
    ambiguous = sum(math.isfinite(row.scores.get("other_basins_pct", math.nan)) for row in stored.rows)
    parts += [f"{ambiguous} of {n} estimates report another minimum that fits the data"] if ambiguous else []
    parts += [f"{failed} of {len(stored.rows)} fits without an estimate"] if failed else []
    return "; ".join(parts)


def suspicious(stored: StoredCell) -> list[str]:
    """Return the quantities whose errors are smaller than the bound allows by chance."""
    errors = _errors(stored) if stored.n_ok >= FEWEST else {}
    return [
        name
        for name, line in errors.items()
        if below_chance(float(line["excess"]), float(line.get("bound", math.nan)), stored.n_ok)
    ]


def below(names: Sequence[str]) -> str:
    """Describe errors that are too small to be chance; ``names`` are quantities or methods."""
    listed = ", ".join(names)
    return (
        f"below the bound by more than chance allows ({listed}): check the method for use of the true values or of "
        "the prior"
    )


def _errors(stored: StoredCell) -> dict[str, Mapping[str, Any]]:
    """Return the summary of the error of each quantity that has a bound."""
    suffix = "_error_pct"
    lines = {name.removesuffix(suffix): line for name, line in stored.summary.items() if name.endswith(suffix)}
    return {name: line for name, line in lines.items() if math.isfinite(line.get("excess", math.nan))}


def _accuracy(excess: Mapping[str, float], n: int) -> str:
    lower = {name: value * math.sqrt(n / float(chdtri(n, 0.025))) for name, value in excess.items()}
    worst = max(excess, key=lambda name: excess[name])
    if max(lower.values()) <= NEAR:
        return AT_BOUND
    text = f"{excess_text(excess[worst])} times the bound in {readable(worst)}"
    return text if len(excess) == 1 or min(lower.values()) > NEAR else f"{text}, at the bound in others"


def _intervals(stored: StoredCell, identifiable: Mapping[str, Any], n: int) -> str:
    shares = {name: stored.summary.get(f"{name}_coverage_95", {}).get("mean", math.nan) for name in identifiable}
    known = {name: share for name, share in shares.items() if math.isfinite(share)}
    if not known:
        return "not stated"
    worst = min(known, key=lambda name: known[name])
    calibrated = bool(bdtr(round(known[worst] * n), n, LEVEL) >= 0.025)
    return CALIBRATED if calibrated else f"overconfident ({100 * known[worst]:.0f} % cover the true {readable(worst)})"
