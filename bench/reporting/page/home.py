"""The first screen's table and picture, as text and numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from scipy.stats import beta

from bench.entrants.registry import load_method
from bench.errors import InputError
from bench.reporting.labels import title
from bench.reporting.page.elsewhere import elsewhere
from bench.reporting.page.reading import ScenarioPanel, decibels
from bench.reporting.page.situations import Advice
from bench.reporting.page.told import accuracy, tells
from bench.reporting.page.words import joined, number, percent, seconds
from bench.reporting.ranking import Ranked

MOST_NAMED = 4
"""Methods of a tier that the first screen names; of more it says how many."""


@dataclass(frozen=True)
class HomeRow:
    """A line of the first screen; ``methods`` are names and labels, empty where no page is about one.

    ``more``: how many others there are that are as good. ``fastest``: of those that are. ``tells``: what can be found
    there at all; ``accuracy``: what the error is in percent at the usual noise.
    """

    words: str
    href: str
    basis: str
    methods: tuple[tuple[str, str], ...]
    error: str
    risk: str
    time: str
    needs: str
    more: int = 0
    fastest: str = ""
    tells: str = ""
    accuracy: str = ""


def advice_row(one: Advice) -> HomeRow:
    """The line of a situation: the first tier of its ranking."""
    told = tells(one.panels) if one.panels else ""
    drawn = f"{one.ranking[0].scenarios} scenarios, nothing tuned on them" if one.ranking else ""
    basis = basis_of(one.panels) if one.panels else one.basis or drawn
    if one.hopeless:
        least = min((row.lost / row.fits for row in one.first_tier), default=math.nan)
        risk = f"{percent(least)} at best" if math.isfinite(least) else "–"
        none = (("None: the model has to be mended first", ""),) if one.panels else (("None", ""),)
        return HomeRow(one.words, one.href, basis, none, "–", risk, "–", "–", tells=told)
    tier, fastest = one.first_tier, one.fastest
    named = tuple((title(row.label), row.label) for row in tier[:MOST_NAMED])
    quickest = title(fastest.label) if len(tier) > 1 else ""
    return HomeRow(
        one.words, one.href, basis, named, between([row.typical for row in tier], ratio),
        between([row.lost / row.fits for row in tier], share), seconds(one.seconds[fastest.label]),
        one.needs or needs(method_of(one, fastest)), max(len(tier) - MOST_NAMED, 0), quickest, told,
        accuracy(one.panels, fastest.label) if one.panels else one.error,
    )  # fmt: skip


def method_of(one: Advice, row: Ranked) -> str:
    """The registered name of a ranked method."""
    return next((result.method for result in one.results if result.label == row.label), row.label)


def between(values: Sequence[float], text: Any) -> str:
    """The least and the largest of some values."""
    ends = dict.fromkeys((text(min(values)), text(max(values))))
    return " to ".join(ends)


def basis_of(panels: Sequence[ScenarioPanel]) -> str:
    """How many scenarios, and which noise."""
    levels = sorted({panel.facts.snr_db for panel in panels})
    ends = f"{decibels(levels[0])} to {decibels(levels[-1])}" if len(levels) > 1 else decibels(levels[0])
    return f"{len(panels)} scenario{'s' if len(panels) > 1 else ''}, SNR {ends} dB"


def ratio(value: float) -> str:
    """An error over the bound: its scatter leaves no more than two decimals."""
    return f"{value:.2f}" if abs(value) < 10 else number(value)


def at_most(row: Ranked) -> float:
    """The upper end of the one-sided 95 % interval of the share of lost fits (C. J. Clopper, E. S. Pearson, 1934)."""
    return 1.0 if row.lost == row.fits else float(beta.ppf(0.95, row.lost + 1, row.fits - row.lost))


def lost_text(row: Ranked) -> str:
    """Lost fits counted, and what their rate is at most."""
    rate = f" = {share(row.lost / row.fits)}" if row.lost else ""
    return f"{row.lost:,} of {row.fits:,}{rate} (at most {share(at_most(row))})"


def standing_text(row: Ranked) -> str:
    """Where a method stands."""
    return f"tier {row.tier}" if row.tier else f"beside: serves {row.served} of {row.scenarios} scenarios"


def share(value: float) -> str:
    """A share in percent to two digits."""
    return f"{100 * value:.2g} %" if value < 0.995 else "100 %"


def one_in(share_at_most: float) -> str:
    """A small share as one in so many, rounded down to two digits."""
    many = 1 / share_at_most
    step = 10 ** max(0, math.floor(math.log10(many)) - 1)
    return f"{int(many // step * step):,}"


def needs(name: str) -> str:
    """What a method has to be given, from its card."""
    try:
        method = load_method(name)
    except InputError:
        return "not registered here"
    free = method.card.scale == "groups" or method.serves.free_without_prior
    packages = f"; package {joined(list(method.requires))}" if method.requires else ""
    return ("no prior" if free else "a prior") + packages


def rows(advice: Sequence[Advice], folder: Any) -> list[HomeRow]:
    """The whole table."""
    return [*map(advice_row, advice), *map(advice_row, elsewhere(folder))]
