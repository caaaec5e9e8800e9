"""Table 11: the measured track, what real records say of the methods and of what is stated of their answers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.config.records import primary_method
from bench.contract.belief import standard_quantile
from bench.records.intervals import ENDS, StatedInterval
from bench.records.sets import Known, MeasuredSet
from bench.records.siblings import KINDS, SiblingAgreement, TotalScore, agreement, total
from bench.records.track import TrackFit
from bench.reporting.rounding import number, readable
from bench.reporting.tables.render import csv, markdown_table

MAIN = ("k_over_m", "c_over_m")
CERTIFIED = "mgh17"
CERTIFIED_DOF = 28
SAME = 1e-3
"""Widths that differ by less agree to three digits."""
VERDICTS = ("trust", "use with caution", "do not trust")
SCORES = ("score", "covered", "ratio", "width")
COLUMNS = (
    "set", "system", "method", "quantity", "sibling", "status", "trust", *ENDS, "limit", "known", "error_pct",
    *(f"{name}_{kind}" for kind in KINDS for name in SCORES), "counted", "limits", "withdrawn", "held_out", "wall_s",
)  # fmt: skip
HEAD = """# Table 11. The measured track

Real records, cut into siblings or repeated, fitted by each method without a prior, the start and a sensor's offset
unknown. There is no truth, so each method is asked whether its answers to siblings agree within what is stated.
**score**: interval score (T. Gneiting, A. E. Raftery) of the logarithm's interval of a repeat against the mean of
the other siblings, over that of the ideal interval, which is as wide as the siblings scatter: one is ideal, and neither
too narrow nor too wide intervals pay. **R**: standard deviation between siblings over the median stated standard error;
one is right, above it the statement is too narrow. **cov.**: how many siblings' intervals hold the mean of the other
siblings. **x/÷**: the median factor by which the interval reaches to either side. In brackets the same for the interval
assuming white noise. An interval with one end only (a limit) has no score and is counted. **error**: median distance to
what others state, where they do. **held-out**: the fit 100 (1 - |y - h| / |y - mean y|) of the last 40 %, predicted
from a fit of the first 60 % (median). **verdicts**: answers by trust / use with caution / do not trust, which is
withdrawn: it has no interval and counts in no score. Parts of a decay have other amplitudes and differ by what the
named system leaves out, more than repeats of the whole record would."""

FREE_RUN = "Free simulation of the test parts, root mean square error (thousandths of the unit: mV, mm):"


@dataclass(frozen=True, eq=False)
class TrackPanel:
    """A set with one system: its fits, and what is said where there are none."""

    name: str
    of: MeasuredSet
    system: str
    fits: Sequence[TrackFit] = ()
    absent: str = ""

    @property
    def methods(self) -> list[str]:
        return list(dict.fromkeys(fit.method for fit in self.fits))

    def own(self, method: str) -> list[TrackFit]:
        """The fits of a method."""
        return [fit for fit in self.fits if fit.method == method]

    @property
    def quantities(self) -> list[str]:
        """What the table shows: the main ratios, and what is known."""
        there = {name for fit in self.fits for name in (*fit.estimates, *fit.withdrawn)}
        return [name for name in dict.fromkeys([*MAIN, *self.of.known]) if name in there]

    def agreement(self, method: str, quantity: str) -> SiblingAgreement:
        """Of the siblings whose answer stands."""
        found = [fit.estimates[quantity] for fit in self.own(method) if quantity in fit.estimates]
        known = self.of.known.get(quantity)
        return agreement(found, known.value if known else None)


@dataclass(frozen=True)
class FreeRun:
    """Errors of a model over the test parts of a set, in thousandths of the record's unit."""

    set: str
    model: str
    errors: tuple[float, ...]
    source: str = "simulated here"


@dataclass(frozen=True, eq=False)
class Track:
    """All that the table shows; ``missing`` fits were asked for and are not made yet."""

    panels: Sequence[TrackPanel]
    free_runs: Sequence[FreeRun] = field(default_factory=list)
    missing: int = 0

    def total(self, quantity: str, kind: str, methods: Sequence[str] | None = None) -> TotalScore:
        """Take agreements on a quantity over all panels with siblings together, of some methods or all."""
        return total(
            (
                panel.agreement(method, quantity)
                for panel in self.panels
                for method in panel.methods
                if methods is None or method in methods
            ),
            kind,
        )


def track_table(track: Track, command: str) -> Mapping[str, str]:
    """The files of the table by name."""
    return {"table11.md": markdown(track, command), "table11.csv": csv(lines(track), columns=COLUMNS)}


def markdown(track: Track, command: str) -> str:
    """The table for reading."""
    parts = [HEAD, summary(track), "## All sets", markdown_table(*overview(track))]
    for panel in track.panels:
        parts += _panel(panel, track.free_runs)
    parts.append(f"Every sibling's values and intervals are in the CSV. Regenerate: `{command}`")
    return "\n\n".join(parts) + "\n"


# ------------------------------------------------------------------------------------------------ totals


def summary(track: Track) -> str:
    """The totals in sentences."""
    found = []
    for who, methods in ((f"{primary_method()} alone", [primary_method()]), ("All methods", None)):
        for name in MAIN:
            totals = {kind: track.total(name, kind, methods) for kind in KINDS}
            if totals["repeat"].counted:
                said = "; ".join(f"{kind} {_total(one)}" for kind, one in totals.items())
                found.append(f"- {who}, {readable(name)}: {said}.")
    fits = [fit for panel in track.panels for fit in panel.fits]
    counts, silent = _verdicts(fits), sum(fit.status != "ok" for fit in fits)
    verdicts = ", ".join(f"{counts[word]} {word}" for word in VERDICTS)
    found.append(f"- {len(fits)} fits, {silent} of them without an answer; of the answers {verdicts} (withdrawn).")
    found += [f"- {track.missing} fits are not made yet: the same command makes them."] if track.missing else []
    found += [f"- {panel.name}: {panel.absent}" for panel in track.panels if panel.absent]
    return "\n".join(found)


def _verdicts(fits: Sequence[TrackFit]) -> Counter[str]:
    """How many answers have each verdict."""
    return Counter(fit.trust for fit in fits if fit.status == "ok")


def _total(one: TotalScore) -> str:
    return (
        f"score {number(one.score)} in the median and {number(one.worst)} at worst, {_share(one.covered, one.counted)} "
        f"covered, R {number(one.ratio)}, x/÷ {one.width:.3f}"
    )


def _share(part: int, whole: int) -> str:
    return f"{part}/{whole} ({part / whole:.0%})" if whole else "-"


def overview(track: Track) -> tuple[list[list[str]], list[str]]:
    """One row a set and system: shooting's, and all methods' together."""
    headers = ["set", "system", "siblings"]
    headers += [f"{readable(name)} {what}" for name in MAIN for what in (*CELLS, "score, all methods")]
    headers += ["held-out %"]
    rows = []
    for panel in track.panels:
        row = [panel.name, panel.system]
        if panel.absent:
            rows.append([*row, panel.absent, *[""] * (len(headers) - 3)])
            continue
        row.append(str(len({fit.sibling for fit in panel.fits})))
        for name in MAIN:
            pooled = [
                total((panel.agreement(m, name) for m in panel.methods), kind).score for kind in ("repeat", "white")
            ]
            row += [*_cells(panel.agreement(primary_method(), name)), _beside(*pooled)]
        rows.append([*row, _median([fit.held_out for fit in panel.own(primary_method())])])
    return rows, headers


CELLS = ("score", "R", "cov.", "x/÷")


def _cells(one: SiblingAgreement) -> list[str]:
    """The cells :data:`CELLS` of an agreement: of a repeat, and assuming white noise."""
    if not one.counted:
        return [f"{one.limits} limits" if one.limits else "-", *["-"] * (len(CELLS) - 1)]
    repeat, white = one.kinds["repeat"], one.kinds["white"]
    covered = f"{repeat.covered}/{one.counted} ({white.covered}/{one.counted})"
    covered += f", {one.limits} limits" if one.limits else ""
    width = f"{repeat.width:.3f} ({white.width:.3f})"
    return [_beside(repeat.score, white.score), _beside(repeat.ratio, white.ratio), covered, width]


def _beside(repeat: float, white: float) -> str:
    return f"{number(repeat)} ({number(white)})" if math.isfinite(repeat) else "-"


def _median(values: Sequence[float]) -> str:
    finite = [value for value in values if math.isfinite(value)]
    return number(float(np.median(finite))) if finite else "-"


# ------------------------------------------------------------------------------------------------ a set


def origin(panel: TrackPanel) -> str:
    """What a set is, where it is from, and what was done to it."""
    of = panel.of
    note = f" {of.note[0].upper()}{of.note[1:]}." if of.note else ""
    return f"{of.title}. {of.source}; licence: {of.licence}.{note}"


def known_values(panel: TrackPanel) -> str:
    """What others state, in a sentence."""
    known = [f"{readable(name)} {one.value:.6g} ({one.source})" for name, one in panel.of.known.items()]
    return f"Known: {'; '.join(known)}."


def _panel(panel: TrackPanel, runs: Sequence[FreeRun]) -> list[str]:
    of = panel.of
    said = origin(panel)
    heading = f"## {panel.name}, {panel.system}"
    if panel.absent:
        return [heading, said, f"{panel.absent}."]
    parts = [heading, said, markdown_table(*method_rows(panel))]
    if of.known:
        parts.append(known_values(panel))
    if panel.name == CERTIFIED:
        parts += ["Against the certified values:", markdown_table(*certified_rows(panel))]
    free = free_runs(panel, runs)
    return [*parts, FREE_RUN, markdown_table(*free)] if free else parts


def free_runs(panel: TrackPanel, runs: Sequence[FreeRun]) -> tuple[list[list[str]], list[str]] | None:
    """The models of a panel simulated over its test parts, and what others have published; None where nothing is."""
    own = [run for run in runs if run.set == f"{panel.name} {panel.system}"]
    if not own:
        return None
    quoted = [FreeRun("", one.model, tuple(one.errors), f"quoted: {one.source}") for one in panel.of.quoted]
    rows = [[one.model, *(number(error) for error in one.errors), one.source] for one in [*own, *quoted]]
    return rows, ["model", *panel.of.tests, "where from"]


def method_rows(panel: TrackPanel) -> tuple[list[list[str]], list[str]]:
    """One row a method: of each quantity the median over siblings and how they agree, then time and verdicts."""
    quantities, rows = panel.quantities, []
    for method in panel.methods:
        own, row = panel.own(method), [method]
        for name in quantities:
            one = panel.agreement(method, name)
            row.append(f"{one.median:.5g}" if one.n else "-")
            if name in panel.of.known:
                row.append(f"{number(one.error)} %" if one.n else "-")
            row += _cells(one)
        counts = _verdicts(own)
        verdicts = " / ".join(str(counts[word]) for word in VERDICTS)
        rows.append([*row, _median([f.held_out for f in own]), _median([f.wall_s for f in own]), verdicts, _why(own)])
    headers = ["method"]
    for name in quantities:
        error = ["error"] if name in panel.of.known else []
        headers += [f"{readable(name)} {what}".rstrip() for what in ("", *error, *CELLS)]
    return rows, [*headers, "held-out %", "s", "verdicts", "without an answer"]


def _why(own: Sequence[TrackFit]) -> str:
    counts = Counter(fit.status for fit in own if fit.status != "ok")
    return ", ".join(f"{n} {status}" for status, n in counts.items())


def certified_rows(panel: TrackPanel) -> tuple[list[list[str]], list[str]]:
    """Digits of the value, and the white interval over Student's t times the certified standard deviation."""
    rows = []
    for fit in panel.fits:
        row = [fit.method]
        for name in MAIN:
            known, one = panel.of.known[name], {**fit.withdrawn, **fit.estimates}.get(name)
            row += ["-", "-"] if one is None else [number(digits(one, known)), _width(one, known)]
        rows.append(row)
    headers = [f"{readable(name)} {what}" for name in MAIN for what in ("digits", "white interval, over certified")]
    return rows, ["method", *headers]


def digits(one: StatedInterval, known: Known) -> float:
    """Digits of a value that match: minus the decimal logarithm of its relative error."""
    return -math.log10(max(abs(one.value / known.value - 1.0), 1e-15))


def certified_ratio(one: StatedInterval, known: Known) -> float:
    """Half of the white interval over Student's t, 28 degrees of freedom, times the certified standard deviation."""
    assert known.sd is not None
    return (one.white_high - one.white_low) / 2.0 / (float(standard_quantile(0.975, CERTIFIED_DOF)) * known.sd)


def _width(one: StatedInterval, known: Known) -> str:
    ratio = certified_ratio(one, known)
    return f"{ratio:.4f}, {'the same' if abs(ratio - 1.0) < SAME else 'other'} to three digits"


# ------------------------------------------------------------------------------------------------ the tidy table


def lines(track: Track) -> list[dict[str, Any]]:
    """One line a sibling and quantity, one a set and quantity (sibling ``all``), and one for a set that is absent."""
    return [line for panel in track.panels for line in _lines(panel)]


def _lines(panel: TrackPanel) -> list[dict[str, Any]]:
    head = {"set": panel.name, "system": panel.system}
    if panel.absent:
        return [{**head, "status": panel.absent}]
    found: list[dict[str, Any]] = []
    for method in panel.methods:
        for fit in panel.own(method):
            what = {"sibling": fit.sibling, "status": fit.status, "trust": fit.trust}
            both = {**fit.withdrawn, **fit.estimates}
            more = {"withdrawn": int(bool(fit.withdrawn)), "held_out": fit.held_out, "wall_s": fit.wall_s}
            found += [
                {**head, "method": method, "quantity": name, **what, **_stated(one), **more}
                for name, one in both.items()
            ] or [{**head, "method": method, **what, **more}]
        withdrawn = sum(bool(fit.withdrawn) for fit in panel.own(method))
        for name in panel.quantities:
            one, known = panel.agreement(method, name), panel.of.known.get(name)
            scores = {f"{what}_{kind}": getattr(own, what) for kind, own in one.kinds.items() for what in SCORES}
            line = {
                **head, "method": method, "quantity": name, "sibling": "all", "value": one.median,
                "known": known.value if known else None, "error_pct": one.error, **scores,
                "counted": one.counted, "limits": one.limits, "withdrawn": withdrawn,
            }  # fmt: skip
            found.append(line)
    return found


def _stated(own: StatedInterval) -> dict[str, Any]:
    return {name: getattr(own, name) for name in (*ENDS, "limit")}
