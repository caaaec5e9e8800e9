"""The score of predictions for a round: by kind of problem, and ranked among the methods of this project."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bench import __version__
from bench.reporting.labels import title
from bench.reporting.ranking import CAP, ON_BOUND, Ranked, log_sizes, ranked
from bench.reporting.rounding import answered, excess_text, number, percent, percent_between
from bench.reporting.tables.render import markdown_table
from bench.reporting.terminal import table, wrapped
from bench.reporting.verdict import below
from bench.rounds.scoring import DISTURBED, MOST_SCORE, RoundScores, summarise_rows
from bench.scoring.statistics import wilson_interval
from bench.scoring.summary import OUTLIER_FACTOR

if TYPE_CHECKING:
    import pandas as pd

KINDS = (
    "kind", "answered", "outliers", "error over bound", "tier", "excess", "95 % cover", "of", "interval score",
    "time (s)",
)  # fmt: skip
RANKING = ("tier", "method", "problems served", "error over bound", "first tier there", "outlier fits")
LEGEND = {
    "answered": "problems with a value for every requested quantity",
    "outliers": f"answered problems with an error beyond {OUTLIER_FACTOR:g} times the bound",
    "error over bound": "geometric mean over problems of the root mean square, over quantities, of error over "
    f"Cramér-Rao bound, from 1 to {CAP:g} (outliers, no answer); about {ON_BOUND:.2f} for an efficient estimator. For "
    f"{' and '.join(DISTURBED)} the bound assumes white noise",
    "tier": "methods that do not differ significantly on these problems; a method without any answer to the problems "
    "of a kind with the same quantities does not serve these, and has no tier",
    "excess": "root mean square of error over bound, of the values given; a few outliers dominate it",
    "95 % cover": "share of the 95 % intervals that contain the true value; of: number of intervals",
    "interval score": "mean of width and 40 times the miss over that of ideal intervals, each at most "
    f"{MOST_SCORE:g}; 1 is ideal, and too wide or too narrow intervals score more",
    "time": "median of the seconds in the file, as stated by its author",
    "first tier there": "error over bound of the first tier on the problems that a method serves",
    "outlier fits": "outliers, and problems served without an answer",
}
"""Meanings of the columns."""
ALONE = "no method to compare with: python -m bench round solve --help"


@dataclass(frozen=True)
class RoundReport:
    """Report on predictions: the answer in one line, sentences, and the rows of two tables."""

    name: str
    answer: str
    sentences: list[str]
    kinds: list[list[str]]
    ranking: list[list[str]]

    @property
    def compared(self) -> bool:
        """Whether other methods are in the ranking."""
        return any(row[1] != title(self.name) for row in self.ranking)

    def line(self, round_name: str, commitment: str) -> str:
        """Return a line of Markdown for citation."""
        of = f"{round_name} of vibration-bench {__version__}, commitment `{commitment[:12]}`"
        return f"**{self.name}** ({of}): {self.answer}. {' '.join(self.sentences)}"

    def text(self) -> str:
        """Return the report for a terminal."""
        head = "\n".join([wrapped(f"{self.name}: {self.answer}"), *map(wrapped, self.sentences)])
        ranking = table(self.ranking, RANKING, (0, 1)) if self.compared else ALONE
        tables = table(self.kinds, KINDS), ranking
        legend = [f"{name}: {LEGEND[name]}" for name in ("error over bound", "tier", "interval score")]
        return "\n\n".join([head, *tables, "\n".join(map(wrapped, legend))])

    def page(self, line: str, origin: Mapping[str, str]) -> str:
        """Return the report in Markdown, the line to cite first; ``origin`` names the predictions and the round."""
        kinds, ranking = (
            markdown_table([[text.replace("|", r"\|") for text in row] for row in rows], headings)
            for rows, headings in ((self.kinds, KINDS), (self.ranking, RANKING))
        )
        legend, facts = ("\n".join(f"- {name}: {text}" for name, text in of.items()) for of in (LEGEND, origin))
        return "\n\n".join([line, kinds, ranking if self.compared else ALONE, legend, facts]) + "\n"


def round_report(name: str, scored: Mapping[str, pd.DataFrame]) -> RoundReport:
    """Report on predictions.

    Args:
        name: Name of the predictions.
        scored: Rows of :func:`bench.rounds.scoring.score_rows`, by method, these predictions included.
    """
    rows, fits = scored[name], {label: _fits(table) for label, table in scored.items()}
    kind_of = list(rows.groupby("scenario")["kind"].first())
    kinds = sorted(set(kind_of))

    def places(chosen: Collection[str]) -> dict[str, Ranked]:
        """Rank methods on the problems of some kinds; a method without any answer is left out."""
        parts = {
            label: [fit for fit, kind in zip(logs, kind_of, strict=True) if kind in chosen]
            for label, logs in fits.items()
        }
        return {place.label: place for place in ranked(parts)}

    shown = [_kind_row(kind, places([kind]).get(name), rows[rows["kind"] == kind]) for kind in kinds]
    every, exact = places(kinds), places([kind for kind in kinds if kind not in DISTURBED]).get(name)
    ranking = [_ranking_row(place) for place in every.values()]
    sentences = _sentences(summarise_rows(rows))
    if exact and exact.too_good:
        sentences.append(f"Errors are {below([name])}.")
    by_kind = [*shown, _kind_row("all", every.get(name), rows)]
    return RoundReport(name, _answer(name, every), sentences, by_kind, ranking)


def _fits(rows: pd.DataFrame) -> list[np.ndarray]:
    """Return the log error over bound of each problem, shape (1,), or (0,) if the method does not serve it.

    A method serves a problem if it answers any problem of the kind with the same quantities; for a problem without
    such others, if it answers any problem of the kind.
    """
    quantities = rows.groupby("scenario")["quantity"].transform(" ".join)
    similar = rows.groupby([rows["kind"], quantities])
    single = similar["scenario"].transform("nunique") == 1
    of_kind = rows.groupby("kind")["value"].transform("count") > 0
    served = (similar["value"].transform("count") > 0) | (single & of_kind)
    return [
        log_sizes(of["error"].to_numpy()[:, None]) if served[of.index[0]] else np.empty(0)
        for _, of in rows.groupby("scenario")
    ]


def _kind_row(kind: str, place: Ranked | None, rows: pd.DataFrame) -> list[str]:
    scores = summarise_rows(rows)
    typical, tier = (f"{place.typical:.2f}", _tier(place)) if place else ("-", "-")
    cover = percent(scores.covered / scores.intervals if scores.intervals else math.nan)
    return [
        kind, answered(scores.answered, scores.problems), str(scores.outliers), typical, tier,
        excess_text(scores.excess), cover, str(scores.intervals), excess_text(scores.interval_score),
        number(scores.seconds),
    ]  # fmt: skip


def _ranking_row(place: Ranked) -> list[str]:
    partly = place.served < place.scenarios and math.isfinite(place.first_tier)
    there = f"{place.first_tier:.2f}" if partly else ""
    served, lost = f"{place.served} of {place.scenarios}", f"{place.lost} of {place.fits}"
    return [_tier(place), title(place.label), served, _typical(place), there, lost]


def _tier(place: Ranked) -> str:
    return str(place.tier or "-")


def _typical(place: Ranked) -> str:
    limits = f" ({place.low:.2f} to {place.high:.2f})" if math.isfinite(place.high) else ""
    return f"{place.typical:.2f}{limits}"


def _answer(name: str, places: Mapping[str, Ranked]) -> str:
    if name not in places:
        return "no answer to any problem"
    place, in_tiers = places[name], [place.tier for place in places.values() if place.tier]
    served = "" if place.served == place.scenarios else f" on {place.served} of {place.scenarios} problems"
    tier = f"tier {place.tier} of {max(in_tiers)} among {len(in_tiers)} methods" if place.tier else "no tier"
    return f"error {_typical(place)} times the Cramér-Rao bound{served}" + (f", {tier}" if len(places) > 1 else "")


def _sentences(scores: RoundScores) -> list[str]:
    """Summarise the answers and the intervals in sentences."""
    answers = f"{scores.answered} of {scores.problems} problems answered, outlier fits: {scores.outliers}; "
    errors = f"{answers}root mean square of error over bound (excess) {excess_text(scores.excess)}."
    if not scores.intervals:
        return [errors, "No intervals: their coverage is not stated."]
    ends = wilson_interval(scores.covered, scores.intervals)
    cover = percent_between(scores.covered / scores.intervals, *ends)
    score = f"interval score {excess_text(scores.interval_score)} times the ideal"
    return [errors, f"95 % intervals cover {cover} % of {scores.intervals} values; {score}."]
