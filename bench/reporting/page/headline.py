"""The first screen: which methods are best, whether that is sure, and what nobody can find from such data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

from bench.reporting.frame import ERROR, Result
from bench.reporting.labels import title
from bench.reporting.page.leaderboard import Rankings
from bench.reporting.page.reading import Panel, Reading
from bench.reporting.page.standing import Ranking, fit_seconds
from bench.reporting.page.typical import SNR_DB
from bench.reporting.page.words import joined, number, percent, quantity, seconds
from bench.scoring.comparison import LEVEL, Comparison


@dataclass(frozen=True)
class Winner:
    """A method that is best or level with the best by every quantity that the data decide; ``n`` data sets."""

    name: str
    method: str
    errors: str
    time: str
    n: int


@dataclass(frozen=True)
class Answer:
    """What is said of one scenario: ``winners``, fastest first, and those ``undecided``, level on fewer data sets.

    ``behind``: of both, those that the pooled table, over more data, finds behind the best. ``astray``: level here, but
    in another scenario of one mass they run away, so that none is recommended; with the scenario.
    """

    panel: Panel
    start: str
    winners: tuple[Winner, ...]
    undecided: tuple[Winner, ...]
    behind: tuple[str, ...]
    real: tuple[str, ...]
    astray: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Hidden:
    """What the data of the headline's scenario do not tell: sentences, and the share of the prior by quantity."""

    why: str
    told: str
    shares: tuple[tuple[str, str], ...]


def headline_places(reading: Reading) -> list[int]:
    """The panels of the first screen: one system at 20 dB, undisturbed, by both readings of the start.

    The first such system in the order of the tables; where no cell is at 20 dB, the scenario with the most methods.
    """
    panels = reading.panels
    wanted = [i for i, p in enumerate(panels) if p.plain and p.facts.snr_db == SNR_DB and p.methods]
    if not wanted:
        most = max(range(len(panels)), key=lambda i: (len(panels[i].methods), panels[i].plain, -i))
        return [most]
    first = panels[wanted[0]]
    by_start: dict[str, int] = {}
    for i in wanted:
        if (panels[i].facts.system, panels[i].experiments) == (first.facts.system, first.experiments):
            by_start.setdefault(panels[i].facts.initial_state, i)
    return list(by_start.values())


def runaways(panels: Sequence[Panel], ranked: Rankings) -> dict[str, str]:
    """Methods that make gross errors in some undisturbed scenario of one linear mass, by label, with the first of them.

    More often than the method that makes fewest there, at 5 % over all these scenarios and quantities (Bonferroni). A
    scenario counts that is one of a table's.
    """
    places = [
        (panel, ranking)
        for i, panel in enumerate(panels)
        for metric in panel.ranked
        if panel.plain and panel.experiments and _one_linear_mass(panel) and (ranking := ranked.get((i, metric)))
    ]
    found: dict[str, str] = {}
    for panel, ranking in places:
        for label, p in ranking.p_gross.items():
            if p <= LEVEL / len(places):
                found.setdefault(label, panel.title())
    return found


def _one_linear_mass(panel: Panel) -> bool:
    model = panel.facts.known_model
    return model is not None and model.linear and model.n_dof == 1


def answer(
    place: int,
    panel: Panel,
    ranked: Rankings,
    separated: AbstractSet[str] = frozenset(),
    astray: Mapping[str, str] | None = None,
) -> Answer:
    """Winners and whether they really are.

    Args:
        place: That of the panel in the page.
        panel: The scenario.
        ranked: All rankings.
        separated: Labels that more data find behind the best.
        astray: Labels that run away elsewhere, and where (:func:`runaways`): level, but not recommended.
    """
    own = {metric: ranking for metric in panel.ranked if (ranking := ranked.get((place, metric))) is not None}
    cells = {result.label: result for result in panel.methods}
    level = [label for label in cells if own and all(label in ranking.level for ranking in own.values())]
    weak = {label for label in level if any(label in ranking.weak for ranking in own.values())}
    order = sorted(level, key=lambda label: (_seconds(fit_seconds(cells[label])), label))
    found = {
        label: Winner(
            title(label),
            cells[label].method,
            joined([f"{quantity(m)} {_error(m, cells[label].summary.get(m, {}))}" for m in own]),
            seconds(fit_seconds(cells[label])),
            cells[label].n,
        )
        for label in order
    }
    lost = {label: where for label, where in (astray or {}).items() if label in level}
    order = [label for label in order if label not in lost]
    sure = [label for label in order if label not in weak]
    behind = tuple(title(label) for label in order if label in separated)
    start = {"unknown": "Start unknown, as on a real rig", "known": "Start known"}
    told = panel.facts.initial_state
    said = start.get(told, f"Start {told}")
    winners, undecided = (tuple(found[label] for label in order if (label in weak) == few) for few in (False, True))
    real = tuple(_real(sure, weak | set(lost), own, cells))
    return Answer(panel, said, winners, undecided, behind, real, tuple((title(own), at) for own, at in lost.items()))


def _seconds(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _error(metric: str, summary: Mapping[str, float]) -> str:
    unit = "m" if metric == "rmse" else "%"
    value = summary.get("median", math.nan)
    return f"{1000 * value:.2g} mm" if unit == "m" and 1e-5 < value < 0.1 else f"{number(value)} {unit}"


def _real(
    level: Sequence[str], weak: AbstractSet[str], own: Mapping[str, Ranking], cells: Mapping[str, Result]
) -> list[str]:
    """Sentences on what the replicates could and could not tell apart: ``level`` methods, ``weak`` ones left out."""
    if len(cells) < 2:
        return ["Only one method is stored, so there is nothing to compare it with."]
    said = []
    if len(level) > 1:
        said.append(_among(level, own, cells))
    elif len(level) == 1:
        said.append(f"{title(level[0])} is the only method that is best or level with the best in every quantity.")
    else:
        said.append("No method is best in every quantity; the leaderboard says which is best in which.")
    behind = [(c, metric) for metric, r in own.items() for c in r.comparisons.values() if c.a not in {*level, *weak}]
    lost = sorted({title(label) for label, cell in cells.items() if cell.n_ok == 0}, key=str.casefold)
    behind = [(c, metric) for c, metric in behind if not c.tie and c.ratio > 1 and cells[c.a].n_ok]
    if behind:
        said.append(_nearest(behind))
    if lost:
        said.append(f"{joined(lost)} gave no answer to any of these data sets.")
    return said


def _among(level: Sequence[str], own: Mapping[str, Ranking], cells: Mapping[str, Result]) -> str:
    """That the best cannot be told apart, and how large a difference would have shown."""
    n = max(cells[label].n for label in level)
    shows = [
        (c.resolved, metric) for metric, r in own.items() for c in r.comparisons.values()
        if c.a in level and math.isfinite(c.resolved)
    ]  # fmt: skip
    size = ""
    if shows:  # between fits that agree to three digits the smallest difference would show: the largest of all counts
        ratio, metric = max(shows)
        size = (
            f" An error of {quantity(metric)} {_more(ratio)} would most likely (80 %) have shown in the {n} data sets"
            f"{', and a smaller one in the other quantities' if len(own) > 1 else ''}."
        )
    return f"Between the {len(level)} that tie: no. On the same data sets none can be told from the best.{size}"


def _nearest(behind: Sequence[tuple[Comparison, str]]) -> str:
    """Of the methods behind, the one whose worst quantity is least bad, and how sure that is."""
    worst: dict[str, tuple[Comparison, str]] = {}
    for c, metric in behind:
        if c.a not in worst or c.ratio > worst[c.a][0].ratio:
            worst[c.a] = (c, metric)
    c, metric = min(worst.values(), key=lambda pair: (pair[0].ratio, pair[0].a))
    sure = f"were they equal, luck would show so clear a difference {chance(c.adjusted)}."
    if not math.isfinite(c.ratio):
        return f"To the others: yes. {title(c.a)}, for one, fails on at least half of the data sets; {sure}"
    ends = f" (95 % interval: {c.low:.2f} to {c.high:.2f})" if math.isfinite(c.low) and math.isfinite(c.high) else ""
    return (
        f"To the others: yes. The nearest of them (the least behind in its own worst quantity) is {title(c.a)}: "
        f"its error of {quantity(metric)} is {c.ratio:.2f} times the best’s, by the median of the ratios on the same "
        f"data sets{ends}; {sure}"
    )


def _more(ratio: float) -> str:
    return f"{100 * (ratio - 1):.2g} % above the best’s" if ratio < 2 else f"{ratio:.2g} times the best’s"


def chance(p: float) -> str:
    """A probability as once in so many times, to two digits."""
    times = 1.0 / max(p, 1e-5)
    rounded = round(times, 1 - math.floor(math.log10(times)))
    return "less than once in 10,000 times" if p < 1e-4 else f"about once in {rounded:,.0f} times"


def hidden(panel: Panel) -> Hidden | None:
    """What the data of a scenario do not tell by themselves; None where they tell everything."""
    lost = [name for name, told in panel.identifiable.items() if not told]
    if not lost:
        return None
    shares = sorted(((n, panel.prior_share.get(n, math.nan)) for n in lost), key=lambda pair: -_share(pair[1]))
    ranked = [quantity(m) for m in panel.ranked if m != "rmse"]
    names, plain = joined([word(n) for n in lost]), all(n in WORDS for n in lost)
    first = f"{names[:1].upper()}{names[1:]}" if plain else f"The values of {names}"
    twice = "the mass, damping and stiffness" if plain else "every mass, damping and stiffness"
    free = not panel.facts.forced
    alike = f"in free vibration, a system with twice {twice}" if free else "a system that differs in them"
    why = f"{first}: {alike} moves exactly alike."
    told = f"The motion tells only {joined(ranked)}." if ranked else ""
    given = tuple((word(n), percent(share)) for n, share in shares if math.isfinite(share)) if panel.facts.prior else ()
    return Hidden(why, told, given)


WORDS = {"m": "mass m", "c": "damping c", "k": "stiffness k"}


def word(name: str) -> str:
    """A quantity with what it is, where that is short."""
    return WORDS.get(name, quantity(f"{name}{ERROR}"))


def _share(value: float) -> float:
    return -1.0 if math.isnan(value) else value
