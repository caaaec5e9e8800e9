"""The first screen's table and picture, as text and numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.entrants.registry import load_method
from bench.errors import InputError
from bench.reporting.frame import group
from bench.reporting.labels import title
from bench.reporting.page.board import short
from bench.reporting.page.elsewhere import RecordSummary, TrackerSummary, atlas_order, followed, measured
from bench.reporting.page.reading import ScenarioPanel, decibels
from bench.reporting.page.situations import MOST_EXTRA, Advice, SituationRecord, core_excess
from bench.reporting.page.told import accuracy, tells
from bench.reporting.page.words import joined, number, percent, seconds

MOST_OTHERS = 1


@dataclass(frozen=True)
class HomeRow:
    """A line of the first screen; ``method`` is a label, empty where no page is about it; ``others`` are as good.

    ``tells``: what can be found there at all; ``accuracy``: what the error is in percent at the usual noise.
    """

    situation: str
    href: str
    basis: str
    name: str
    method: str
    error: str
    risk: str
    time: str
    needs: str
    others: tuple[tuple[str, str], ...] = field(default=())
    tells: str = ""
    accuracy: str = ""


def advice_row(one: Advice) -> HomeRow:
    """The line of a situation."""
    situation = one.situation
    href, basis, told = f"situations/{situation.name}.md", basis_of(one.panels), tells(one.panels)
    if one.hopeless:
        best = min(((r.risk, r.label) for r in (*one.advised, *one.behind)), default=(math.nan, ""))
        risk = f"{percent(best[0])} at best" if best[1] else "–"
        none = "None: the model has to be mended first"
        return HomeRow(situation.words, href, basis, none, "", "–", risk, "–", "–", tells=told)
    first = one.advised[0]
    others: dict[str, str] = {}
    for record in one.advised[1:]:
        if record.method not in {first.method, *others.values()}:
            others.setdefault(record.label, record.method)
    named = tuple((title(label), label) for label in list(others)[:MOST_OTHERS])
    return HomeRow(
        situation.words, href, basis, title(first.label), first.label, error_text(first), risk_text(first),
        seconds(first.seconds), needs(first.method), named, told, accuracy(one.panels, first.label),
    )  # fmt: skip


def basis_of(panels: Sequence[ScenarioPanel]) -> str:
    """How many scenarios, and which noise."""
    levels = sorted({panel.facts.snr_db for panel in panels})
    ends = f"{decibels(levels[0])} to {decibels(levels[-1])}" if len(levels) > 1 else decibels(levels[0])
    return f"{len(panels)} scenario{'s' if len(panels) > 1 else ''}, SNR {ends} dB"


def error_text(one: SituationRecord) -> str:
    """Typical and largest error over the bound."""
    return f"{ratio(one.excess)}, worst scenario {ratio(one.worst)}"


def ratio(value: float) -> str:
    """An error over the bound: its scatter leaves no more than two decimals."""
    return f"{value:.2f}" if abs(value) < 10 else number(value)


def risk_text(one: SituationRecord) -> str:
    """Gross errors counted, and what their rate is at most."""
    rate = f" = {share(one.risk)}" if one.gross else ""
    return f"{one.gross:,} of {one.fits:,}{rate} (at most {share(one.risk_at_most)})"


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


def atlas_row(atlas: Mapping[str, SituationRecord], points: int) -> list[HomeRow]:
    """The line of the atlas, where there is one."""
    advised, _ = atlas_order(atlas)
    if not advised:
        return []
    first, *rest = advised
    return [
        HomeRow(
            "One mass, free decay: an atlas of other tests", "results/atlas.md",
            f"{points:,} tests; samples, cycles, damping and SNR vary", title(first.label), first.label,
            ratio(first.excess), risk_text(first), seconds(first.seconds),
            needs(first.method), tuple((title(one.label), one.label) for one in rest[:MOST_OTHERS]),
        )
    ]  # fmt: skip


def measured_row(found: Sequence[RecordSummary]) -> list[HomeRow]:
    """The line of the measured track: there is no truth, so an answer counts that its checks do not withdraw."""
    if not found or not found[0].believed:
        return []
    first, *rest = found
    return [
        HomeRow(
            "A real record of a rig", "results/table11.md", f"{first.fits} records of the measured track",
            title(first.label), first.label, "no truth is known",
            f"{first.fits - first.believed} of {first.fits} answers withdrawn by their own checks",
            seconds(first.seconds),
            needs(first.label), tuple((title(one.label), one.label) for one in rest[:MOST_OTHERS]),
            accuracy=f"predicts {number(first.held_out, 2)} % of what was held out",
        )
    ]  # fmt: skip


def followed_row(found: Sequence[TrackerSummary]) -> list[HomeRow]:
    """The line of the online track."""
    if not found:
        return []
    first, *rest = found
    return [
        HomeRow(
            "Parameters that change while the data arrive", "results/table10.md", f"{first.records} records",
            first.title, "", f"{ratio(first.excess)}, worst {ratio(first.worst)}",
            f"{first.records - first.ok} of {first.records} records lost",
            f"{seconds(first.micros / 1e6)} a sample", "a first guess",
            tuple((one.title, "") for one in rest[:MOST_OTHERS]),
        )
    ]  # fmt: skip


def rows(advice: Sequence[Advice], atlas: Mapping[str, SituationRecord], points: int, folder: Any) -> list[HomeRow]:
    """The whole table."""
    found = [advice_row(one) for one in advice]
    found += [*measured_row(measured(folder)), *followed_row(followed(folder))]
    return [*found[:2], *atlas_row(atlas, points), *found[2:]]


def forest(one: Advice) -> dict[str, Any]:
    """The picture: by method and noise level, the error over the bound, gross ones apart, and how often those are."""
    records = [*one.advised, *one.behind, *one.fragile]
    fragile = {record.label for record in one.fragile}
    levels = group(one.panels, lambda panel: panel.facts.snr_db)
    points, lines = [], []
    for record in records:
        own = {snr: _at(panels, record.label) for snr, panels in levels.items()}
        values = [value for value in own.values() if math.isfinite(value)]
        if not values:
            continue
        elsewhere = record.label in one.elsewhere and record.extra <= MOST_EXTRA
        wrong = "gross in the atlas" if elsewhere else f"gross {share(record.risk)}"
        said = seconds(record.seconds) + (f", {wrong}" if record.label in fragile else "")
        name = title(record.label)
        lines.append(
            {"m": name, "l": short(min(values)), "h": short(max(values)), "t": said, "g": record.label in fragile}
        )
        points += [{"m": name, "d": float(decibels(snr)), "e": short(v)} for snr, v in own.items() if math.isfinite(v)]
    return {"points": points, "lines": lines}


def _at(panels: Sequence[ScenarioPanel], label: str) -> float:
    """The median over scenarios and told quantities at one noise level."""
    cells = [(panel, cell) for panel in panels for cell in panel.methods if cell.label == label]
    values = [core_excess(cell, metric) for panel, cell in cells for metric in panel.ranked if metric in cell.summary]
    finite = [value for value in values if math.isfinite(value)]
    return float(np.median(finite)) if finite else math.nan
