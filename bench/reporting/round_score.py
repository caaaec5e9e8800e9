"""The score of a file of predictions of a round: by kind of problem, and ranked beside this project's methods."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bench import __version__
from bench.reporting.answer import Grid
from bench.reporting.certificate.template import rendered
from bench.reporting.labels import title
from bench.reporting.ranking import CAP, ON_BOUND, Ranked, log_sizes, ranked
from bench.reporting.rounding import answered, excess_text, number, percent, percent_between
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
RANKING = ("tier", "method", "problems served", "error over bound", "first tier there", "lost")
LEGEND = {
    "answered": "problems with a value for every quantity asked for",
    "outliers": f"answered problems with an error beyond {OUTLIER_FACTOR:g} bounds",
    "error over bound": "geometric mean over problems of the root mean square, over quantities, of error over "
    f"Cramér-Rao bound: at least 1, at most {CAP:g}, as for an outlier or no answer; efficient estimators have about "
    f"{ON_BOUND:.2f}. Of {' and '.join(DISTURBED)} the bound is that of white noise alone",
    "tier": "methods that these problems do not tell apart, without a winner; beside the tiers stands what has no "
    "answer at all to the problems of a kind that ask for the same quantities: it does not serve these",
    "excess": "root mean square of error over bound, of the values given; a few outliers decide it",
    "95 % cover": "share (%) of the 95 % intervals, of so many, that contain the true value",
    "interval score": "mean of width and 40 times the miss over that of ideal intervals, each at most "
    f"{MOST_SCORE:g}: 1 is ideal, too wide and too narrow intervals have more",
    "time": "median of the seconds in the file, as stated by its author",
    "first tier there": "its error over bound on the problems that a method serves",
    "lost": "outliers, and problems served without an answer",
}
"""Meaning of the columns."""
ALONE = "no method to compare with: python -m bench round solve --help"


@dataclass(frozen=True)
class RoundReport:
    """Report on predictions called ``name``: ``answer`` in a few words, ``sentences``, and two tables."""

    name: str
    answer: str
    sentences: list[str]
    kinds: Grid
    ranking: Grid

    @property
    def compared(self) -> bool:
        """Return whether other methods are in the ranking."""
        return "" in self.ranking.classes

    def line(self, round_name: str, commitment: str) -> str:
        """Return one line of Markdown to cite."""
        of = f"{round_name} of vibration-bench {__version__}, commitment `{commitment[:12]}`"
        return f"**{self.name}** ({of}): {self.answer}. {' '.join(self.sentences)}"

    def text(self) -> str:
        """Return the report for a terminal."""
        head = "\n".join([wrapped(f"{self.name}: {self.answer}"), *map(wrapped, self.sentences)])
        ranking = table(self.ranking.rows, RANKING, (0, 1)) if self.compared else ALONE
        tables = table(self.kinds.rows, KINDS), ranking
        legend = [f"{name}: {LEGEND[name]}" for name in ("error over bound", "tier", "interval score")]
        return "\n\n".join([head, *tables, "\n".join(map(wrapped, legend))])

    def page(self, line: str, origin: Mapping[str, str]) -> str:
        """Return the report as a page; ``origin`` says what was scored on what."""
        return rendered("score.html.j2", report=self, line=line, origin=origin, legend=LEGEND, alone=ALONE)


def round_report(name: str, scored: Mapping[str, pd.DataFrame]) -> RoundReport:
    """Report the predictions called ``name`` among the rows of all methods, of ``bench.rounds.scoring.score_rows``."""
    rows, fits = scored[name], {label: _fits(each) for label, each in scored.items()}
    kind_of = list(rows.groupby("scenario")["kind"].first())
    kinds = sorted(set(kind_of))

    def places(chosen: Collection[str]) -> dict[str, Ranked]:
        """Rank methods on the problems of some kinds; one without any answer has no place."""
        parts = {
            label: [fit for fit, kind in zip(each, kind_of, strict=True) if kind in chosen]
            for label, each in fits.items()
        }
        return {place.label: place for place in ranked(parts)}

    shown = [_kind_row(kind, places([kind]).get(name), rows[rows["kind"] == kind]) for kind in kinds]
    every, exact = places(kinds), places([kind for kind in kinds if kind not in DISTURBED]).get(name)
    marks = ["level" if label == name else "" for label in every]
    ranking = Grid(RANKING, [_ranking_row(place) for place in every.values()], marks)
    sentences = _sentences(summarise_rows(rows))
    if exact and exact.too_good:
        sentences.append(f"Errors are {below([name])}.")
    by_kind = Grid(KINDS, [*shown, _kind_row("all", every.get(name), rows)])
    return RoundReport(name, _answer(name, every), sentences, by_kind, ranking)


def _fits(rows: pd.DataFrame) -> list[np.ndarray]:
    """Return log error over bound of each problem (1,); none (0,) of one that the method does not serve.

    Where no other problem of a kind asks for the same quantities, answers to others of the kind say that it is served.
    """
    asked = rows.groupby("scenario")["quantity"].transform(" ".join)
    alike = rows.groupby([rows["kind"], asked])
    alone = alike["scenario"].transform("nunique") == 1
    served = (alike["value"].transform("count") > 0) | (alone & (rows.groupby("kind")["value"].transform("count") > 0))
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
    tier = f"tier {place.tier} of {max(in_tiers)} among {len(in_tiers)} methods" if place.tier else "beside the tiers"
    return f"error {_typical(place)} times the Cramér-Rao bound{served}" + (f", {tier}" if len(places) > 1 else "")


def _sentences(scores: RoundScores) -> list[str]:
    """Say how many problems were answered, how well, and what the intervals are worth."""
    many = f"{scores.answered} of {scores.problems} problems answered, outlier fits: {scores.outliers}; "
    errors = f"{many}root mean square of error over bound (excess) {excess_text(scores.excess)}."
    if not scores.intervals:
        return [errors, "No intervals: their coverage is not stated."]
    ends = wilson_interval(scores.covered, scores.intervals)
    cover = percent_between(scores.covered / scores.intervals, *ends)
    score = f"interval score {excess_text(scores.interval_score)} times the ideal"
    return [errors, f"95 % intervals cover {cover} % of {scores.intervals} values; {score}."]
