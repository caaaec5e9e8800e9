"""Who is best in a scenario, who is level with the best, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.page.gather import Panel, label_of
from bench.reporting.tables.tables import errors_of, leads
from bench.scoring.comparison import Comparison, against_best
from bench.store.store import StoredCell

Place = Literal["best", "level", "behind", "alone", "all failed"]


@dataclass(frozen=True)
class Ranking:
    """Of one scenario and metric: the ``best`` method, every method's place, and its comparison with the best.

    ``weak``: level with the best on fewer replicates than the best has, so that less could have been told.
    """

    best: str
    places: Mapping[str, Place]
    comparisons: Mapping[str, Comparison]
    weak: frozenset[str]

    @property
    def level(self) -> list[str]:
        """The best and all that are level with it."""
        return [label for label, place in self.places.items() if place in ("best", "level", "alone")]


def rank(panel: Panel, metric: str) -> Ranking | None:
    """The methods of a scenario by one metric, by the rules of the tables; None where none has it."""
    own = {label_of(cell): cell for cell in panel.methods if metric in cell.summary}
    values = {label: _errors(cell, metric) for label, cell in own.items()}
    values = {label: errors for label, errors in values.items() if errors.size}
    if not values:
        return None
    if not any(np.isfinite(errors).any() for errors in values.values()):
        return Ranking("", dict.fromkeys(values, "all failed"), {}, frozenset())
    if len(values) == 1:
        return Ranking(next(iter(values)), dict.fromkeys(values, "alone"), {}, frozenset())
    best, found = against_best(values)
    comparisons = {c.a: c for c in found}
    excess = {label: cell.summary[metric]["excess"] for label, cell in own.items()}
    places: dict[str, Place] = {}
    for label in values:
        failed = not np.isfinite(values[label]).any()
        tie = leads((best, found), label, excess)
        places[label] = "best" if label == best else "all failed" if failed else "level" if tie else "behind"
    fewer = {label for label in values if places[label] == "level" and values[label].size < values[best].size}
    return Ranking(best, places, comparisons, frozenset(fewer))


def _errors(cell: StoredCell, metric: str) -> np.ndarray:
    errors = errors_of(cell, metric)
    return np.where(np.isnan(errors), math.inf, errors)


def fit_seconds(cell: StoredCell) -> float:
    """Median processor time of a fit that succeeded (s); NaN where none did."""
    times = [row.cpu_s for row in cell.rows if row.status is Status.OK and math.isfinite(row.cpu_s)]
    return float(np.median(times)) if times else math.nan
