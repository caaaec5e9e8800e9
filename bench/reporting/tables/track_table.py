"""Table 11: the measured track, what real records say of the methods and of what is stated of their answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import pandas as pd

from bench.config.records import primary_method
from bench.contract.belief import standard_quantile
from bench.records.intervals import ENDS
from bench.records.sets import MeasuredSet
from bench.records.siblings import KINDS, IntervalScore, compare_siblings, total
from bench.records.verdict import Trust
from bench.reporting.rounding import number, readable
from bench.reporting.tables.render import Columns, Rows, files, listing

MAIN = ("k_over_m", "c_over_m")
MISSING = "not made yet"
"""Status of a fit that the store lacks."""
SCORES = tuple(f"{name}_{kind}" for kind in KINDS for name in IntervalScore._fields)
COLUMNS = (
    "set", "system", "method", "quantity", "sibling", "status", "trust", *ENDS, "limit", "known", "error_pct", *SCORES,
    "counted", "limits", "withdrawn", "held_out", "wall_s", "message",
)  # fmt: skip
HEAD = """# Table 11. The measured track

Real records, cut into siblings or repeated, fitted by each method without a prior, the initial state and a sensor's
offset unknown. There is no truth, so each method is asked whether its answers to siblings agree within what is stated.
**score**: interval score (T. Gneiting, A. E. Raftery) of the logarithm's interval of a repeat against the mean of
the other siblings, over that of the ideal interval, which is as wide as the siblings scatter: one is ideal, and neither
too narrow nor too wide intervals pay. **R**: standard deviation between siblings over the median stated standard error;
one is right, above it the statement is too narrow. **cov.**: how many siblings' intervals cover the mean of the other
siblings. **x/÷**: the median factor by which the interval reaches to either side. In brackets the same for the interval
assuming white noise. An interval with one end only (a limit) has no score and is counted. **error**: median distance to
what others state, where they do. **held-out**: the fit 100 (1 - |y - h| / |y - mean y|) of the last 40 %, predicted
from a fit of the first 60 % (median). **verdicts**: answers by trust / use with caution / do not trust, which is
withdrawn: it has no interval and counts in no score. **white/certified**: the interval assuming white noise over that
of a certified value, where there is one. Parts of a decay have other amplitudes and differ by what the named system
leaves out, more than repeats of the whole record would."""


@dataclass(frozen=True, eq=False)
class TrackPanel:
    """A set described by a system.

    ``rows``: of its fits (:mod:`bench.records.track`); one with the status :data:`MISSING` is of a fit that was asked
    for, and one without a method has a status that says why the set is absent. ``free_runs``: models with their errors
    over the test parts.
    """

    name: str
    of: MeasuredSet
    system: str
    rows: pd.DataFrame
    free_runs: Sequence[tuple[str, Sequence[float]]] = ()

    @staticmethod
    def of_rows(name: str, of: MeasuredSet, system: str, rows: Sequence[Mapping[str, Any]]) -> TrackPanel:
        """Return the panel of the rows of its fits."""
        frame = pd.DataFrame(rows, columns=[*COLUMNS, "offset"]).assign(set=name, system=system)
        return TrackPanel(name, of, system, frame)

    @property
    def absent(self) -> str:
        """The reason why there are no fits; empty where there are."""
        return str(self.rows["status"].iloc[0]) if self.rows["method"].isna().all() else ""

    @cached_property
    def fits(self) -> pd.DataFrame:
        """A row for each fit that was made."""
        return self.rows[self.rows["trust"].notna()].drop_duplicates(["method", "sibling"])

    @property
    def quantities(self) -> list[str]:
        """The main ratios, and what is known, as far as there are answers."""
        answered = set(self.rows["quantity"])
        return [name for name in dict.fromkeys([*MAIN, *self.of.known]) if name in answered]

    @cached_property
    def by_method(self) -> list[MethodFits]:
        """The fits that were made, method by method."""
        return [MethodFits(self, method) for method in self.fits["method"].unique()]

    @cached_property
    def agreements(self) -> pd.DataFrame:
        """Return the agreement of siblings, a row for each method and quantity."""
        rows = []
        for fits in self.by_method:
            head = {"set": self.name, "system": self.system, "method": fits.method, "sibling": "all"}
            head["withdrawn"] = fits.made["withdrawn"].sum()
            rows += [{**head, "quantity": name, **fits.agreements[name]} for name in self.quantities]
        return pd.DataFrame(rows, columns=COLUMNS)


@dataclass(frozen=True, eq=False)
class MethodFits:
    """The fits of a panel by a method."""

    panel: TrackPanel
    method: str

    @property
    def made(self) -> pd.DataFrame:
        """A row for each fit."""
        return self.panel.fits[self.panel.fits["method"] == self.method]

    def answers(self, quantity: str) -> pd.DataFrame:
        """Return the rows of a quantity."""
        rows = self.panel.rows
        return rows[(rows["method"] == self.method) & (rows["quantity"] == quantity)]

    @cached_property
    def agreements(self) -> dict[str, dict[str, Any]]:
        """Return the agreement of siblings whose answers are not withdrawn, by quantity."""
        known = {**dict.fromkeys(MAIN), **{name: known.value for name, known in self.panel.of.known.items()}}
        answers = {name: self.answers(name) for name in known}
        return {
            name: {"known": value, **compare_siblings(answers[name][answers[name]["withdrawn"] == 0], value)}
            for name, value in known.items()
        }


def track_table(panels: Sequence[TrackPanel], command: str) -> Mapping[str, str]:
    """Return the files of the table by name."""
    parts: list[str | Rows] = [HEAD, summary(panels), "## All sets", overview(panels)]
    for panel in panels:
        parts += _section(panel)
    parts.append(f"Every sibling's values and intervals are in the CSV. Regenerate: `{command}`")
    frames = pd.concat([frame for panel in panels for frame in (panel.rows, panel.agreements)])
    by_method = frames.groupby(["set", "system", "method"], sort=False, dropna=False)
    return files("table11", parts, [line for _, rows in by_method for line in rows.to_dict("records")], COLUMNS)


def _section(panel: TrackPanel) -> list[str | Rows]:
    """Return what a set is, the tables of its fits, and what others state."""
    of, heading = panel.of, f"## {panel.name}, {panel.system}"
    note = f" {of.note[0].upper()}{of.note[1:]}." if of.note else ""
    parts: list[str | Rows] = [heading, f"{of.title}. {of.source}; licence: {of.licence}.{note}"]
    if panel.absent:
        return [*parts, f"{panel.absent}."]
    parts.append(method_rows(panel))
    if of.known:
        stated = [f"{readable(name)} {known.value:.6g} ({known.source})" for name, known in of.known.items()]
        parts.append(f"Known: {'; '.join(stated)}.")
    if panel.free_runs:
        runs = [[model, *map(number, errors), "simulated here"] for model, errors in panel.free_runs]
        runs += [[run.model, *map(number, run.errors), f"quoted: {run.source}"] for run in of.quoted]
        parts.append("Free simulation of the test parts, root mean square error (thousandths of the unit: mV, mm):")
        parts.append((runs, ["model", *of.tests, "where from"]))
    return parts


def summary(panels: Sequence[TrackPanel]) -> str:
    """Return the totals in sentences."""
    agreements, rows = pd.concat([p.agreements for p in panels]), pd.concat([p.rows for p in panels])
    primary, lines = agreements["method"] == primary_method(), []
    for who, some in ((f"{primary_method()} alone", agreements[primary]), ("All methods", agreements)):
        for name in MAIN:
            named = some[some["quantity"] == name]
            totals = [f"{kind} {_total(total(named, kind))}" for kind in KINDS if named["counted"].any()]
            lines += [f"- {who}, {readable(name)}: {'; '.join(totals)}."] if totals else []
    fits = pd.concat([panel.fits for panel in panels])
    silent, missing = (fits["status"] != "ok").sum(), (rows["status"] == MISSING).sum()
    verdicts = ", ".join(f"{n} {verdict}" for verdict, n in _verdicts(fits).items())
    lines.append(f"- {len(fits)} fits, {silent} of them without an answer; of the answers {verdicts} (withdrawn).")
    lines += [f"- {missing} fits are not made yet: the same command makes them."] if missing else []
    return "\n".join([*lines, *(f"- {panel.name}: {panel.absent}" for panel in panels if panel.absent)])


def _verdicts(fits: pd.DataFrame) -> dict[str, int]:
    """Count the answers of each verdict."""
    answered = fits["status"] == "ok"
    return {verdict.value: int((answered & (fits["trust"] == verdict.value)).sum()) for verdict in Trust}


def _total(scores: Mapping[str, float]) -> str:
    covered, counted = scores["covered"], scores["counted"]
    return (
        f"score {number(scores['score'])} in the median and {number(scores['worst'])} at worst, {covered}/{counted} "
        f"({covered / counted:.0%}) covered, R {number(scores['ratio'])}, x/÷ {scores['width']:.3f}"
    )


# ------------------------------------------------------------------------------------------------ tables


def overview(panels: Iterable[TrackPanel]) -> Rows:
    """Return a row for each panel: the primary method's scores, and all methods' together."""
    columns: dict[str, Callable[[MethodFits], str]] = {
        "set": lambda fits: fits.panel.name,
        "system": lambda fits: fits.panel.system,
        "siblings": lambda fits: fits.panel.absent or str(fits.panel.fits["sibling"].nunique()),
    }
    for name in MAIN:
        columns |= {**_agreement(name), f"{readable(name)} score, all methods": partial(_pooled, name)}
    columns["held-out %"] = partial(_median, "held_out")
    return listing([MethodFits(panel, primary_method()) for panel in panels], columns)


def method_rows(panel: TrackPanel) -> Rows:
    """Return a row for each method: how the siblings agree on each quantity, then time and verdicts."""
    columns: dict[str, Callable[[MethodFits], str]] = {"method": lambda fits: fits.method}
    for name in panel.quantities:
        columns[readable(name)] = partial(_answer, name, "value", "{:.5g}")
        if (known := panel.of.known.get(name)) is not None:
            columns[f"{readable(name)} error"] = partial(_answer, name, "error_pct", "{:.3g} %")
            if known.sd:
                columns[f"{readable(name)} white/certified"] = partial(_beside_certified, name, known.sd, known.dof)
        columns |= _agreement(name)
    columns |= {
        "held-out %": partial(_median, "held_out"),
        "s": partial(_median, "wall_s"),
        "verdicts": lambda fits: " / ".join(map(str, _verdicts(fits.made).values())),
        "without an answer": _failures,
    }
    return listing(panel.by_method, columns)


def _agreement(quantity: str) -> Columns[MethodFits]:
    """Return columns of how siblings agree: for the interval of a repeat, and in brackets assuming white noise."""
    cells: Columns[Mapping[str, Any]] = {
        "score": partial(_beside_white, "score", number),
        "R": partial(_beside_white, "ratio", number),
        "cov.": _covered,
        "x/÷": partial(_beside_white, "width", "{:.3f}".format),
    }
    return {f"{readable(quantity)} {what}": partial(_cell, quantity, show) for what, show in cells.items()}


def _cell(quantity: str, show: Callable[[Mapping[str, Any]], str], fits: MethodFits) -> str:
    return show(fits.agreements[quantity])


def _beside_white(name: str, text: Callable[[float], str], agreed: Mapping[str, Any]) -> str:
    repeat, white = agreed[f"{name}_repeat"], agreed[f"{name}_white"]
    return f"{text(repeat)} ({text(white)})" if math.isfinite(repeat) else "-"


def _covered(agreed: Mapping[str, Any]) -> str:
    counted, limits = agreed["counted"], agreed["limits"]
    parts = [f"{agreed['covered_repeat']}/{counted} ({agreed['covered_white']}/{counted})"] if counted else []
    return ", ".join([*parts, f"{limits} limits"] if limits else parts) or "-"


def _pooled(quantity: str, fits: MethodFits) -> str:
    agreements = fits.panel.agreements
    pooled = agreements[agreements["quantity"] == quantity]
    return _beside_white("score", number, {f"score_{kind}": total(pooled, kind)["score"] for kind in KINDS})


def _answer(quantity: str, what: str, text: str, fits: MethodFits) -> str:
    agreed = fits.agreements[quantity]
    return text.format(agreed[what]) if agreed["n"] else "-"


def _beside_certified(quantity: str, sd: float, dof: float | None, fits: MethodFits) -> str:
    """Return half of the interval assuming white noise over Student's t times the certified standard deviation."""
    answers = fits.answers(quantity)
    ratios = (answers["white_high"] - answers["white_low"]) / 2.0 / (float(standard_quantile(0.975, dof)) * sd)
    return f"{ratios.median():.4f}" if len(answers) else "-"


def _median(name: str, fits: MethodFits) -> str:
    return number(fits.made[name].median())


def _failures(fits: MethodFits) -> str:
    status = fits.made["status"]
    return ", ".join(f"{n} {name}" for name, n in status[status != "ok"].value_counts(sort=False).items())
