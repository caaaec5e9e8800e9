"""What pictures are drawn from: the cells of a store, those of one scenario side by side."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from bench.reporting.family import changed_settings, is_variant
from bench.reporting.figures.style import Look, looks
from bench.reporting.frame import Result, drawn_questions
from bench.reporting.labels import in_order
from bench.store.store import Store

USUAL_SNR = 20.0
"""The noise level (dB) that pictures of a single one show, or the nearest there is: that of the paper's figures."""
MOST_NAMED = 4
Told = Literal["known", "unknown"]


class Nothing(Exception):
    """Why a picture cannot be drawn from a store: a sentence."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A chart of Altair's, or a figure of matplotlib's, and the text that says what to see in it.

    ``name`` is that of its files, if not its own; ``half``: a chart half as wide as a page.
    """

    figure: Any
    caption: str
    name: str = ""
    half: bool = False


class Gallery:
    """All cells of a store but those of drawn scenarios and variants of a family, and the look of every method.

    Of cells that differ in nothing but a method's settings or the number of replicates one is kept: with the settings
    that this method has most often in the store, then of most replicates.
    """

    def __init__(self, store: Store) -> None:
        self.store = store
        every = (one for one in map(Result.of_stored, store) if not is_variant(one))
        kept = [one for one in every if one.question not in drawn_questions()]
        found = [(json.dumps(changed_settings(one), sort_keys=True), one) for one in kept]
        often = Counter((one.label, settings) for settings, one in found)
        found.sort(key=lambda pair: (-often[pair[1].label, pair[0]], -pair[1].n, pair[1].identity))
        best: dict[tuple[Any, ...], Result] = {}
        for _, one in found:
            best.setdefault((one.series, one.snr_db, one.initial_state, one.label), one)
        order = {label: i for i, label in enumerate(in_order(one.label for one in best.values()))}
        self.cells = sorted(
            best.values(), key=lambda one: (order[one.label], one.series, -one.snr_db, one.initial_state)
        )
        self.looks: dict[str, Look] = looks(order)

    def name(self, label: str) -> str:
        """What a chart calls a method."""
        return self.looks[label].title.replace(r"\$", "$")

    def arrays(self, cell: Result) -> dict[str, np.ndarray]:
        """The arrays kept of a cell's replicate 0, as double precision; none where they are missing."""
        return cell.arrays()

    @cached_property
    def main(self) -> list[Result]:
        """The cells of the scenario that the store has most of, at its usual noise levels and at either start.

        A noise level with fewer than half as many methods as another is somebody's own question, not the sweep's.
        """
        cells = self.largest(self.cells)
        methods: dict[float, set[str]] = {}
        for one in cells:
            methods.setdefault(one.snr_db, set()).add(one.label)
        most = max(map(len, methods.values()))
        return [one for one in cells if 2 * len(methods[one.snr_db]) >= most]

    def largest(self, cells: Iterable[Result]) -> list[Result]:
        """The largest group of cells that differ in method, noise level and start alone; undisturbed before others."""
        groups: dict[str, list[Result]] = {}
        for one in cells:
            groups.setdefault(one.series, []).append(one)
        if not groups:
            raise Nothing("no such cell is stored")
        return min(groups.values(), key=lambda own: (-len(own), bool(own[0].disturbance), own[0].series))

    def scene(self, cells: Sequence[Result], told: Told, snr: float = USUAL_SNR) -> list[Result]:
        """The cells at the noise level nearest to ``snr``, one a method, with the start as wanted.

        With the other start where that has more than twice as many methods.
        """
        level = min({one.snr_db for one in cells}, key=lambda own: (abs(own - snr), own))
        own = [one for one in cells if one.snr_db == level]
        wanted = [one for one in own if one.initial_state == told]
        others = [one for one in own if one.initial_state != told]
        return wanted if 2 * len(wanted) >= len(others) else others


def methods_only(cells: Iterable[Result]) -> list[Result]:
    """Without the reference rows."""
    return [one for one in cells if not one.is_reference]


def where(cell: Result) -> str:
    """A cell's scenario in words, for captions."""
    disturbed = f", disturbance {cell.disturbance.replace('_', ' ')}" if cell.disturbance else ""
    drawn = ", truth drawn" if cell.truth_drawn else ""
    return f"{cell.system}, {cell.snr_db:.4g} dB, initial state {cell.initial_state}{disturbed}{drawn}"


def best_first(excesses: Mapping[str, Sequence[float]]) -> list[str]:
    """Methods by the median of their logarithmic excess, to a tenth; those that tie stay in the order given.

    Below 1 there is nothing to be won: no unbiased method can be there.
    """
    middle = {
        label: round(float(np.median(np.log(np.maximum(own, 1.0)))), 1) for label, own in excesses.items() if len(own)
    }
    return sorted(middle, key=middle.__getitem__)


def named(titles: Sequence[str]) -> str:
    """Methods in a sentence: by name, or how many they are where that would be long."""
    return "; ".join(titles) if len(titles) <= MOST_NAMED else f"{len(titles)} of them"


def counts(cells: Iterable[Result]) -> str:
    """How many replicates cells have, for captions."""
    numbers = sorted({one.n for one in cells})
    return f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
