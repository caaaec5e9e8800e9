"""Table 11, the measured track: methods and their intervals on real records."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from bench.config.records import primary_method
from bench.contract.distribution import standard_quantile
from bench.records.intervals import ENDS
from bench.records.sets import MeasuredSet
from bench.records.siblings import KINDS, IntervalScore, compare_siblings, total
from bench.records.verdict import Trust
from bench.reporting.frame import Line
from bench.reporting.rounding import number, readable
from bench.reporting.tables.render import MISSING, Columns, Panel, Rows, Texts, each, files, measured

MAIN = ("k_over_m", "c_over_m")
NOT_MADE = "not made yet"
"""Status of a fit that is not stored."""
SCORES = tuple(f"{name}_{kind}" for kind in KINDS for name in IntervalScore._fields)
COLUMNS = (
    "set", "system", "method", "quantity", "sibling", "status", "trust", *ENDS, "limit", "known", "error_pct", *SCORES,
    "counted", "limits", "withdrawn", "held_out", "wall_s", "message",
)  # fmt: skip
HEAD = """# Table 11. The measured track

Measured records, repeated or cut into parts (siblings), fitted by each method without a prior; initial state and sensor
offset are unknown. The true values are unknown as well, so the estimates from siblings are compared with each other.
**score**: interval score (T. Gneiting, A. E. Raftery) of the logarithm's interval for a repeat against the mean of the
other siblings, over that of the ideal interval, which is as wide as the siblings scatter; one is ideal, and intervals
that are too narrow or too wide score more. **R**: standard deviation between siblings over the median stated standard
error; one is right, more means too narrow intervals. **cov.**: number of siblings whose interval covers the mean of the
others. **x/÷**: median factor by which the interval extends to either side. In brackets the same for the interval of
the record alone that assumes white noise. An interval with one end only (a limit) has no score and is counted.
**error**: median difference from published values, if there are any. **held-out**: the fit 100 (1 - |y - h| / |y - mean
y|) of the last 40 %, predicted from a fit to the first 60 % (median). **verdicts**: estimates by trust / use with
caution / do not trust; the last are rejected: they have no interval and no score. **white/certified**: the interval
assuming white noise over that of a certified value. Parts of a decay have different amplitudes, so they differ by the
error of the model more than repeats of the whole record would."""


@dataclass(frozen=True, eq=False)
class TrackPanel:
    """A measured set fitted with one system.

    Attributes:
        name: Name of the set.
        of: The set.
        system: Name of the system.
        rows: Rows of its fits (:mod:`bench.records.track`). A fit that is not stored has the status :data:`NOT_MADE`;
            a row without a method has the reason why the set is absent as its status.
        free_runs: Models with their errors on the test parts.
    """

    name: str
    of: MeasuredSet
    system: str
    rows: pd.DataFrame
    free_runs: Sequence[tuple[str, Sequence[float]]] = ()

    @staticmethod
    def of_rows(name: str, of: MeasuredSet, system: str, rows: Sequence[Mapping[str, Any]]) -> TrackPanel:
        """Make a panel from the rows of its fits."""
        frame = pd.DataFrame(rows, columns=[*COLUMNS, "offset"]).assign(set=name, system=system)
        return TrackPanel(name, of, system, frame)

    @property
    def absent(self) -> str:
        """Reason why there are no fits; empty if there are any."""
        return str(self.rows["status"].iloc[0]) if self.rows["method"].isna().all() else ""

    @cached_property
    def fits(self) -> pd.DataFrame:
        """One row per fit that was made."""
        return self.rows[self.rows["trust"].notna()].drop_duplicates(["method", "sibling"])

    @cached_property
    def agreements(self) -> pd.DataFrame:
        """One row per method and quantity: the agreement of siblings whose estimates are not rejected.

        The quantities are the main ratios and those with a published value.
        """
        quantities = [name for name in dict.fromkeys([*MAIN, *self.of.known]) if name in set(self.rows["quantity"])]
        head, rows = dict[str, Any](set=self.name, system=self.system, sibling="all", panel=self), []
        for method, made in self.fits.groupby("method", sort=False):
            head |= {"method": method, "withdrawn": made["withdrawn"].sum(), "made": made}
            for name in quantities:
                answers = self.rows[(self.rows["method"] == method) & (self.rows["quantity"] == name)]
                known = self.of.known[name].value if name in self.of.known else None
                agreed = compare_siblings(answers[answers["withdrawn"] == 0], known)
                rows.append({**head, "quantity": name, "known": known, **agreed, "answers": answers})
        return pd.DataFrame(rows, columns=[*COLUMNS, "made", "panel", "answers", "n"])


def track_table(panels: Sequence[TrackPanel], command: str) -> Mapping[str, str]:
    """Return the files of the table by name."""
    agreements = pd.concat([panel.agreements for panel in panels])
    parts = [HEAD, *_summary(panels, agreements), "## All sets", _overview(panels)]
    for panel in panels:
        parts += _section(panel)
    parts.append(f"Every sibling's values and intervals are in the CSV. Regenerate: `{command}`")
    frames = pd.concat([frame for panel in panels for frame in (panel.rows, panel.agreements)])
    by_method = frames.groupby(["set", "system", "method"], sort=False, dropna=False)
    return files("table11", parts, [line for _, rows in by_method for line in rows.to_dict("records")], COLUMNS)


def _section(of_panel: TrackPanel) -> Iterator[str | Rows]:
    """Yield the description of a set, its methods, and published values."""
    of = of_panel.of
    note = f" {of.note[0].upper()}{of.note[1:]}." if of.note else ""
    yield f"## {of_panel.name}, {of_panel.system}"
    yield f"{of.title}. {of.source}; licence: {of.licence}.{note}"
    yield f"{of_panel.absent}." if of_panel.absent else method_rows(of_panel)
    if of.known and not of_panel.absent:
        stated = [f"{readable(name)} {known.value:.6g} ({known.source})" for name, known in of.known.items()]
        yield f"Published values: {'; '.join(stated)}."
    if of_panel.free_runs:
        yield "Free simulation of the test parts, root mean square error (thousandths of the unit: mV, mm):"
        runs = [[model, *map(number, errors), "simulated here"] for model, errors in of_panel.free_runs]
        runs += [[run.model, *map(number, run.errors), f"quoted: {run.source}"] for run in of.quoted]
        yield runs, ["model", *of.tests, "source"]


def _summary(panels: Sequence[TrackPanel], agreements: pd.DataFrame) -> Iterator[str | Rows]:
    """Yield the totals over all sets."""
    primary = primary_method()
    totals: list[Line] = [
        {"methods": who, "quantity": readable(name), "kind": kind, **total(some[some["quantity"] == name], kind)}
        for who, some in ((primary, agreements[agreements["method"] == primary]), ("all", agreements))
        for name in MAIN
        for kind in KINDS
    ]
    yield (
        "Over all sets: median and worst score, covered, R, and x/÷, by the kind of interval: for a repeat, for the "
        "record alone, and for the record assuming white noise."
    )
    kinds = Panel(
        lambda line: {
            line["kind"]: f"{number(line['score'])}, {number(line['worst'])}; {line['covered']}/{line['counted']}; "
            f"{number(line['ratio'])}; {line['width']:.3f}"
        },
        lambda line: {name: line[name] for name in ("methods", "quantity")},
    )
    yield kinds.rows(line for line in totals if line["counted"])
    fits = pd.concat([panel.fits for panel in panels])
    silent, missing = (fits["status"] != "ok").sum(), sum((panel.rows["status"] == NOT_MADE).sum() for panel in panels)
    verdicts = ", ".join(f"{n} {verdict}" for verdict, n in _verdicts(fits).items())
    lines = [f"{len(fits)} fits, {silent} of them failed or refused; of the estimates {verdicts} (rejected)."]
    lines += [f"{missing} fits are not made yet: the same command makes them."] if missing else []
    lines += [f"{panel.name}: {panel.absent}" for panel in panels if panel.absent]
    yield "\n".join(f"- {line}" for line in lines)


def _verdicts(fits: pd.DataFrame) -> dict[str, int]:
    """Count the estimates by verdict."""
    ok = fits["status"] == "ok"
    return {verdict.value: int((ok & (fits["trust"] == verdict.value)).sum()) for verdict in Trust}


# ------------------------------------------------------------------------------------------------ tables


def _overview(panels: Sequence[TrackPanel]) -> Rows:
    """Return one row per set: the scores of the primary method, and of all methods together."""
    lines: list[Line] = []
    for panel in panels:
        agreed = panel.agreements[panel.agreements["method"] == primary_method()]
        shown = agreed[agreed["quantity"].isin(MAIN)].to_dict("records")
        lines += shown or [{"panel": panel, "made": panel.fits[:0]}]
    sets = Panel(
        lambda line: each(measured, {**AGREED, "score, all methods": _pooled})(line) if "n" in line else {},
        lambda line: {
            "set": line["panel"].name, "system": line["panel"].system,
            "siblings": line["panel"].absent or str(line["panel"].fits["sibling"].nunique()),
        },
        lambda lines: {"held-out %": number(lines[0]["made"]["held_out"].median())},
    )  # fmt: skip
    return sets.rows(lines)


def method_rows(of_panel: TrackPanel) -> Rows:
    """Return one row per method: the agreement of siblings on each quantity, time and verdicts."""
    methods = Panel(_answer, lambda line: {"method": line["method"]}, _made)
    return methods.rows(of_panel.agreements.to_dict("records"))


def _answer(line: Line) -> Texts:
    """Return the median estimate, its difference from the published value, and the agreement of siblings."""
    name, known = readable(line["quantity"]), line["panel"].of.known.get(line["quantity"])
    if not line["n"]:
        return {name: MISSING}
    texts = {name: f"{line['value']:.5g}"}
    if known:
        texts[f"{name} error"] = f"{line['error_pct']:.3g} %"
    if known and known.sd:
        widths = line["answers"]["white_high"] - line["answers"]["white_low"]
        certified = 2.0 * float(standard_quantile(0.975, known.dof)) * known.sd
        texts[f"{name} white/certified"] = f"{(widths / certified).median():.4f}"
    return {**texts, **each(measured, AGREED)(line)}


def _covered(line: Line) -> str:
    counted, limits = line["counted"], line["limits"]
    covered = [f"{line['covered_repeat']}/{counted} ({line['covered_white']}/{counted})"] if counted else []
    return ", ".join([*covered, f"{limits} limits"] if limits else covered) or MISSING


def _with_white(line: Line, name: str, text: Callable[[float], str] = number) -> str:
    repeat, white = line[f"{name}_repeat"], line[f"{name}_white"]
    return f"{text(repeat)} ({text(white)})" if math.isfinite(repeat) else MISSING


def _pooled(line: Line) -> str:
    every = line["panel"].agreements
    same = every[every["quantity"] == line["quantity"]]
    return _with_white({f"score_{kind}": total(same, kind)["score"] for kind in KINDS}, "score")


AGREED: Columns[Line] = {
    "score": lambda line: _with_white(line, "score"), "R": lambda line: _with_white(line, "ratio"),
    "cov.": _covered, "x/÷": lambda line: _with_white(line, "width", "{:.3f}".format),
}  # fmt: skip
"""Agreement of siblings: for the interval of a repeat, and in brackets for the interval assuming white noise."""


def _made(lines: Sequence[Line]) -> Texts:
    """Return the prediction, the time and the verdicts of the fits of a method."""
    made = lines[0]["made"]
    failed = made["status"][made["status"] != "ok"].value_counts(sort=False)
    return {
        "held-out %": number(made["held_out"].median()), "s": number(made["wall_s"].median()),
        "verdicts": " / ".join(map(str, _verdicts(made).values())),
        "failed": ", ".join(f"{n} {name}" for name, n in failed.items()),
    }  # fmt: skip
