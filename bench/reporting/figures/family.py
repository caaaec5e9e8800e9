"""How the variants of a family get to their answer: the error of k/m over the bound against processor seconds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.config.experiment import Experiment
from bench.reporting.family import Family, FamilyRow, Section, any_stored, family_of
from bench.reporting.figures.beside import LINE, spread
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, where
from bench.reporting.figures.style import MORE_COLOURS, SMALL, panels, plain_logarithmic, wrapped
from bench.reporting.frame import ERROR, Frame, Result, experiment_frame, table_experiments
from bench.reporting.tables.family_numbers import GROUP, PLACE, moment_score
from bench.reporting.tables.pooling import root_mean_square
from bench.scoring.traces import MOMENTS

PANELS = (("optimizer", 0), ("optimizer", 1), ("weighting", 0), ("architecture", 0))
"""The setting that a panel varies, and around which base."""
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)))
COLOURS = (*MORE_COLOURS, "#8C564B", "#777777")
"""Eleven, so that no two rows of a panel have the same; and another dash in the next row."""
BASE = ("black", "-")
NEAR = 1.5
"""A training is said to be near the bound whose error at the end is at most so many times the bound."""
LABEL = 37.0
"""Width of the column of names beside a panel (mm)."""


@dataclass(frozen=True, eq=False)
class Curve:
    """The error of k/m over the bound (n,) at moments (n,) in s; ``end``: when the longest of the trainings ended."""

    row: FamilyRow
    seconds: np.ndarray
    ratios: np.ndarray
    end: float


def draw_family(gallery: Gallery) -> Picture:
    """A panel a factor and base, a line a row, its name at its end."""
    for name in table_experiments():
        if Experiment(name).table.get("form") == "family":
            return family_picture(experiment_frame(name, gallery.store))
    raise Nothing("no experiment has a family")


def family_picture(frame: Frame) -> Picture:
    """The picture of an experiment's family; raises Nothing where no training is stored."""
    if not any_stored(frame):
        raise Nothing("no training of a family is stored")
    family = family_of(frame)
    found = [(section, own) for section in _sections(family) if (own := list(curves(section)))]
    if not found:
        raise Nothing("no training of a family is stored")
    names = {section: {curve.row: wrapped(curve.row.title, LABEL) for curve in own} for section, own in found}
    lines = max(sum(name.count("\n") + 1 for name in own.values()) for own in names.values())
    height = max(52.0, LINE * lines + 16.0)
    figure, axes = panels(len(found), 2, height, "processor time (s)", sharex=True, sharey=True)
    looks = _looks([section for section, _ in found])
    _limits(axes[0], [curve for _, own in found for curve in own])
    for axis, (section, own) in zip(axes, found, strict=True):
        for curve in own:
            _line(axis, curve, *looks[section.heading, curve.row.title])
        _name_lines(axis, own, names[section], (height - 14.0), looks, section.heading)
        axis.set_title(f"{section.heading}, {section.base}", loc="left")
        axis.grid()
    for axis in axes[::2]:
        axis.set_ylabel("error of k/m / bound (−)")
    ends = [curve.ratios[-1] for _, own in found for curve in own]
    scene = next(curve.row.member.cells[PLACE] for _, own in found for curve in own)
    return Picture(
        figure,
        f"{sum(end <= NEAR for end in ends)} of {len(ends)} trainings end within {NEAR:g} times the bound. In a panel, "
        f"all on the same data sets ({where(scene)}): root mean square error of k/m of the answer so far over its "
        "Cramér-Rao bound (grey line) against processor time. A dot is where the longest training ended; black is the "
        "base, from which each of the others differs in one thing. Names stand in the order of the errors at the end.",
        family.method,
    )


def _sections(family: Family) -> Iterator[Section]:
    found = (family.section(setting, base) for setting, base in PANELS)
    return (section for section in found if section)


def curves(section: Section) -> Iterator[Curve]:
    """The curves of a section's rows that are stored with the way of their training, all on the same data sets."""
    n = section.common(PLACE)
    for row in section.rows:
        one = row.member.at(PLACE)
        if one and one.successful("training_s").size:
            seconds, ratios = errors(one, n)
            if seconds.size:
                yield Curve(row, seconds, ratios, float(one.successful("training_s").max()))


def errors(one: Result, n: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The moments (s) at which every successful fit has an answer, and the error of k/m over the bound there.

    With ``n``, of the first n replicates alone.
    """
    bound, ok = one.bound(GROUP + ERROR), one.ok[:n]
    values = np.array([root_mean_square(one.scores(moment_score(moment))[:n][ok]) / bound for moment in MOMENTS])
    known = np.isfinite(values) & (values > 0)
    return np.array(MOMENTS)[known], values[known]


def _looks(sections: Sequence[Section]) -> Mapping[tuple[str, str], tuple[str, Any]]:
    """By heading and row, colour and dashes: the same in every panel but where the row is the base."""
    found: dict[tuple[str, str], tuple[str, Any]] = {}
    for section in sections:
        for row in section.rows:
            at = sum(heading == section.heading for heading, _ in found)
            look = (COLOURS[at % len(COLOURS)], DASHES[at % len(DASHES)])
            found.setdefault((section.heading, row.title), look)
    return found


def _limits(axis: Any, every: Sequence[Curve]) -> None:
    """Of all panels: from the first answer to the end of the longest training, and all errors."""
    ratios = np.concatenate([curve.ratios for curve in every])
    axis.set(xscale="log", yscale="log")
    axis.set_xlim(0.8 * min(curve.seconds[0] for curve in every), 1.5 * max(curve.end for curve in every))
    axis.set_ylim(0.8 * min(1.0, ratios.min()), 1.25 * max(1.0, ratios.max()))
    plain_logarithmic(axis.xaxis)
    plain_logarithmic(axis.yaxis)


def _line(axis: Any, curve: Curve, colour: str, dashes: Any) -> None:
    """A curve to its end and, thinner, the answer that stays from there to the edge."""
    if curve.row.base:
        colour, dashes = BASE
    axis.axhline(1.0, color="0.6", lw=1.6, zorder=1)
    width = 1.4 if curve.row.base else 1.1
    inside = curve.seconds < curve.end
    seconds, ratios = [*curve.seconds[inside], curve.end], [*curve.ratios[inside], curve.ratios[-1]]
    axis.plot(seconds, ratios, color=colour, ls=dashes, lw=width, zorder=3)
    axis.plot(curve.end, curve.ratios[-1], "o", color=colour, ms=2.6, zorder=4)
    axis.plot([curve.end, axis.get_xlim()[1]], [curve.ratios[-1]] * 2, color=colour, lw=0.4, zorder=2)


def _name_lines(
    axis: Any,
    own: Sequence[Curve],
    names: Mapping[FamilyRow, str],
    height: float,
    looks: Mapping[tuple[str, str], tuple[str, Any]],
    heading: str,
) -> None:
    """The name of every curve right of the panel, as near the curve's height as the others let it."""
    low, high = np.log(axis.get_ylim())
    ends = np.array([(np.log(curve.ratios[-1]) - low) / (high - low) for curve in own])
    sizes = np.array([names[curve.row].count("\n") + 1 for curve in own]) * LINE / height
    for curve, end, at in zip(own, ends, spread(ends, sizes), strict=True):
        colour, dashes = BASE if curve.row.base else looks[heading, curve.row.title]
        kept = {"transform": axis.transAxes, "clip_on": False}
        axis.plot([1.0, 1.04], [end, at], color=colour, lw=0.5, **kept)
        axis.plot([1.04, 1.13], [at, at], color=colour, ls=dashes, lw=1.1, **kept)
        axis.text(1.15, at, names[curve.row], fontsize=SMALL, va="center", transform=axis.transAxes, linespacing=1.0)
