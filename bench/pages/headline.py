"""The first screen: which methods are best, whether that is sure, and what nobody can find from such data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bench.compare import Comparison
from bench.pages.board import Rankings
from bench.pages.gather import ERROR, Gathered, Panel, label_of
from bench.pages.standing import fit_seconds
from bench.pages.words import joined, number, percent, quantity, seconds, title_of

SNR_DB = 20.0


@dataclass(frozen=True)
class Winner:
    """A method that nothing beats by any quantity that the data decide."""

    name: str
    errors: str
    time: str
    weak: str


@dataclass(frozen=True)
class Answer:
    """What is said of one scenario; ``place`` is its index in the page, ``rest`` the methods behind."""

    place: int
    panel: Panel
    what: str
    winners: tuple[Winner, ...]
    rest: tuple[str, ...]
    real: tuple[str, ...]


@dataclass(frozen=True)
class Hidden:
    """What the data of the headline's scenario do not tell: a sentence, and the share of the prior by quantity."""

    names: str
    sentence: str
    shares: tuple[tuple[str, str], ...]


def headline_places(gathered: Gathered) -> list[int]:
    """The panels of the first screen: one system at 20 dB, undisturbed, by both readings of the start.

    The first such system in the order of the tables; where no cell is at 20 dB, the scenario with the most methods.
    """
    panels = gathered.panels
    wanted = [i for i, p in enumerate(panels) if p.plain and p.snr_db == SNR_DB and p.methods]
    if not wanted:
        most = max(range(len(panels)), key=lambda i: (len(panels[i].methods), panels[i].plain, -i))
        return [most]
    first = panels[wanted[0]]
    same = [i for i in wanted if panels[i].system == first.system and panels[i].experiments == first.experiments]
    by_told: dict[str, int] = {}
    for i in same:
        by_told.setdefault(panels[i].told, i)
    return list(by_told.values())


def answer(place: int, panel: Panel, ranked: Rankings) -> Answer:
    """Winners and whether they really are."""
    own = {metric: ranking for metric in panel.ranked if (ranking := ranked.get((place, metric))) is not None}
    level = [
        label_of(cell)
        for cell in panel.methods
        if own and all(label_of(cell) in ranking.level for ranking in own.values())
    ]
    cells = {label_of(cell): cell for cell in panel.methods}
    names = sorted(level, key=lambda label: (any(label in r.weak for r in own.values()), _seconds(fit_seconds(cells[label]))))
    winners = []
    for label in names:
        weak = any(label in r.weak for r in own.values())
        errors = [f"{quantity(m)} {_error(m, cells[label].summary.get(m, {}))}" for m in own]
        n = len(cells[label].rows)
        winners.append(
            Winner(
                title_of(label),
                ", ".join(errors),
                seconds(fit_seconds(cells[label])),
                f"on {n} data sets only" if weak else "",
            )
        )
    rest = [label_of(cell) for cell in panel.methods if label_of(cell) not in level]
    what = {"unknown": "Start of the motion unknown, as on a real rig", "known": "Start of the motion known"}
    return Answer(
        place,
        panel,
        what.get(panel.told, f"Start {panel.told}"),
        tuple(winners),
        tuple(sorted(map(title_of, rest), key=str.casefold)),
        tuple(_real(level, own, cells)),
    )


def _seconds(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _error(metric: str, summary: Mapping[str, float]) -> str:
    unit = "m" if metric == "rmse" else "%"
    value = summary.get("median", math.nan)
    return f"{1000 * value:.2g} mm" if unit == "m" and 1e-5 < value < 0.1 else f"{number(value)} {unit}"


def _real(level: Sequence[str], own: Mapping[str, object], cells: Mapping[str, object]) -> list[str]:
    """Sentences on what the replicates could and could not tell apart."""
    from bench.pages.standing import Ranking

    rankings = {metric: r for metric, r in own.items() if isinstance(r, Ranking)}
    if len(cells) < 2:
        return ["Only one method is stored here, so there is nothing to compare it with."]
    said = []
    if len(level) > 1:
        said.append(
            f"Between the {len(level)} best: no. On the same data sets their errors cannot be told apart, or are less "
            "than 2 % apart."
        )
    elif len(level) == 1:
        said.append(f"{title_of(level[0])} is the only method that nothing beats in any quantity.")
    else:
        said.append("No method is best in every quantity; the leaderboard below says which is best in which.")
    behind = [(c, metric) for metric, r in rankings.items() for c in r.comparisons.values() if c.a not in level]
    behind = [(c, metric) for c, metric in behind if not c.tie and c.ratio > 1]
    if behind:
        said.append(_nearest(behind))
    return said


def _nearest(behind: Sequence[tuple[Comparison, str]]) -> str:
    """Of the methods behind, the one whose worst quantity is least bad, and how sure that is."""
    worst: dict[str, tuple[Comparison, str]] = {}
    for c, metric in behind:
        if c.a not in worst or c.ratio > worst[c.a][0].ratio:
            worst[c.a] = (c, metric)
    c, metric = min(worst.values(), key=lambda pair: (pair[0].ratio, pair[0].a))
    size = f"{c.ratio:.2f} times the best's" if math.isfinite(c.ratio) else "infinitely larger: it fails"
    interval = f" (95 %: {c.low:.2f} to {c.high:.2f})" if math.isfinite(c.low) and math.isfinite(c.high) else ""
    return (
        f"To the others: yes. The nearest behind, {title_of(c.a)}, has a typical error of {quantity(metric)} of "
        f"{size}{interval}; the chance of so clear a difference by luck is {_chance(c.adjusted)}."
    )


def _chance(p: float) -> str:
    return "below 1 in 10,000" if p < 1e-4 else f"{100 * p:.2g} %"


def hidden(panel: Panel) -> Hidden | None:
    """What the data of a scenario do not tell by themselves; None where they tell everything."""
    lost = [name for name, told in panel.identifiable.items() if not told]
    if not lost:
        return None
    shares = sorted(((n, panel.prior_share.get(n, math.nan)) for n in lost), key=lambda pair: -_share(pair[1]))
    told = [quantity(m) for m in panel.ranked if m != "rmse"]
    free = panel.data.get("force") is None
    why = (
        "in free vibration, masses, dampers and springs all multiplied by one number move exactly alike"
        if free
        else "other values of them move exactly alike"
    )
    says = f"The motion tells only {joined(told)}." if told else ""
    sentence = f"{joined([quantity(n + ERROR) for n in lost])}: {why}. {says}"
    return Hidden(joined([quantity(n + ERROR) for n in lost]), sentence, tuple((quantity(n + ERROR), percent(s)) for n, s in shares))


def _share(value: float) -> float:
    return -1.0 if math.isnan(value) else value
