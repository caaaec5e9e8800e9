"""What pictures are drawn from: the cells of a store, in the order of the ranking."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from bench.entrants.reference import REFERENCES
from bench.reporting.family import changed_settings, is_variant
from bench.reporting.frame import Result, drawn_questions, group
from bench.reporting.labels import in_order, title
from bench.reporting.pictures.style import Nothing
from bench.reporting.ranking import ranking
from bench.store.store import Store

USUAL_SNR = 20.0
"""The noise level (dB) that pictures of a single one show, or the nearest there is: that of the paper's figures."""
K, C, MOTION = "k_over_m", "c_over_m", "displacement"
METRICS = {K: "k_over_m_error_pct", C: "c_over_m_error_pct", MOTION: "rmse"}
Arrays = Mapping[str, np.ndarray]


class Gallery:
    """All cells of a store but those of drawn scenarios and variants of a family.

    Of cells that differ in nothing but a method's settings or the number of replicates one is kept: with the settings
    that this method has most often in the store, then of most replicates.
    """

    def __init__(self, store: Store) -> None:
        self.store = store
        every = [cell for cell in map(Result.of_stored, store) if not is_variant(cell)]
        kept = {
            cell: str(sorted(changed_settings(cell).items()))
            for cell in every
            if cell.question not in drawn_questions()
        }
        often = Counter((cell.label, settings) for cell, settings in kept.items())
        best: dict[tuple[Any, ...], Result] = {}
        for cell in sorted(kept, key=lambda cell: (-often[cell.label, kept[cell]], -cell.n, cell.identity)):
            best.setdefault((cell.series, cell.snr_db, cell.initial_state, cell.label), cell)
        order = {label: i for i, label in enumerate(in_order(cell.label for cell in best.values()))}
        self.cells = sorted(
            best.values(), key=lambda cell: (order[cell.label], cell.series, -cell.snr_db, cell.initial_state)
        )

    @cached_property
    def main(self) -> list[Result]:
        """The cells of the scenario that the store has most of, at its usual noise levels and at either start.

        A noise level with fewer than half as many methods as another is somebody's own question, not the sweep's.
        """
        cells = self.largest(self.cells)
        methods = {level: {cell.label for cell in own} for level, own in group(cells, lambda cell: cell.snr_db).items()}
        most = max(map(len, methods.values()))
        return [cell for cell in cells if 2 * len(methods[cell.snr_db]) >= most]

    @cached_property
    def tiers(self) -> dict[str, int]:
        """By label, the tier of the ranking of the main scenario, the first tier first; 0 stands beside the tiers."""
        return {ranked.label: ranked.tier for ranked in ranking(self.main)}

    def ordered(self, cells: Iterable[Result]) -> list[str]:
        """Return the methods of cells as pictures call them: reference rows first, then by tier."""
        labels = {cell.label for cell in cells}
        ranked = [label for label in self.tiers if label in labels]
        first = [label for label in in_order(REFERENCES) if label in labels]
        return list(map(title, [*first, *ranked, *in_order(labels.difference(first, ranked))]))

    def largest(self, cells: Iterable[Result]) -> list[Result]:
        """Return the largest group of cells that differ in method, noise level and start alone; undisturbed first."""
        groups = group(cells, lambda cell: cell.series)
        if not groups:
            raise Nothing("no such cell is stored")
        return min(groups.values(), key=lambda own: (-len(own), bool(own[0].disturbance), own[0].series))

    def scene(self, cells: Sequence[Result], start: str = "known") -> list[Result]:
        """Return the cells at the noise level nearest to the usual one, one a method, with the start as wanted.

        With the other start where that has more than twice as many methods.
        """
        level = min({cell.snr_db for cell in cells}, key=lambda snr: (abs(snr - USUAL_SNR), snr))
        there = [cell for cell in cells if cell.snr_db == level]
        wanted = [cell for cell in there if cell.initial_state == start]
        others = [cell for cell in there if cell.initial_state != start]
        return wanted if 2 * len(wanted) >= len(others) else others

    def recorded(self, cells: Iterable[Result], *names: str) -> list[tuple[Result, Arrays]]:
        """Return the cells with a stored record and stored arrays of these names, with their arrays."""
        with_arrays: list[tuple[Result, Arrays]] = [(cell, cell.arrays()) for cell in cells if cell.label != "prior"]
        wanted = {"true_displacement", "sample_values", *names}
        complete = [(cell, arrays) for cell, arrays in with_arrays if wanted <= arrays.keys()]
        if not complete:
            raise Nothing(f"no {names[0].replace('_', ' ') if names else 'record'} is stored")
        return complete


def where(cell: Result) -> str:
    """Return a cell's scenario in words, for captions."""
    disturbed = f", disturbance {cell.disturbance.replace('_', ' ')}" if cell.disturbance else ""
    drawn = ", truth drawn" if cell.truth_drawn else ""
    return f"{cell.system}, {cell.snr_db:.4g} dB, initial state {cell.initial_state}{disturbed}{drawn}"


def replicates(cells: Iterable[Result]) -> str:
    """Return how many replicates cells have, for captions."""
    numbers = sorted({cell.n for cell in cells})
    return f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
