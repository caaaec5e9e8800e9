"""A certificate as one page without network: its contents, pictures and tables put into the template."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bench.records.intervals import HALF
from bench.reporting.answer import (
    MEANING,
    Rows,
    ends_text,
    in_shown_unit,
    modes_table,
    runs_table,
    value_text,
    values_table,
)
from bench.reporting.certificate.figures import pictures
from bench.reporting.grid import Grid, rendered, style
from bench.reporting.page.words import joined, number, seconds
from bench.reporting.rounding import readable
from bench.scoring.statistics import wilson_interval


def page(shown: Mapping[str, Any]) -> str:
    """Return the page of a certificate's contents, of :func:`bench.reporting.certificate.contents.contents`."""
    return rendered(
        "certificate/certificate.html.j2",
        style=style(),
        shown=shown,
        meaning=MEANING,
        pictures=pictures(shown),
        values=grid_of(values_table(shown["values"], shown["withdrawn"])),
        modes=grid_of(modes_table(shown["modes"])),
        runs=grid_of(runs_table(shown["runs"])),
        classes=classes_grid(shown["classes"]),
        methods=methods_grid(shown),
        off=disagreement(shown),
        silent=silent(shown),
        replicas=replicas_grid(shown),
        what_if=what_if_grid(shown["what_if"]),
        facts=facts(shown),
    )


def grid_of(rows: Rows) -> Grid:
    """Return headers and rows as a table of the page."""
    return Grid(rows[0], tuple(rows[1]))


def classes_grid(classes: Sequence[Mapping[str, Any]]) -> Grid:
    """Tabulate the model classes, the best first; those that the record does not tell from it are marked."""
    rows = []
    for one in classes:
        limits = [f"{readable(name)}/m ≤ {number(own['most'])} {own['unit']}" for name, own in one["zero"].items()]
        error = HALF * one["criterion_difference_error"]
        difference = one["criterion_difference"]
        digits = 1 if difference < 100 else 0
        text = f"{difference:.{digits}f}" + (f" ± {error:.{digits}f}" if round(error, digits) > 0 else "")
        fit = fit_text(one["held_out_pct"])
        rows.append((one["name"], text, f"{one['residual_pct']:.2g}", fit, "; ".join(limits)))
    marks = tuple("" if one["told_apart"] else "level" for one in classes)
    headers = ("Model", "ΔBIC", "Residual RMS (% of signal)", "Prediction FIT (%)", "Not needed, upper limit")
    return Grid(headers, tuple(rows), marks)


def fit_text(value: float | None) -> str:
    """Return a FIT in percent; one that is far below zero says no more than that."""
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.1f}" if value > -100 else "below −100"


def methods_grid(shown: Mapping[str, Any]) -> Grid:
    """Tabulate the methods that state something, the primary first."""
    names, rows, marks = shown["compared"], [], []
    for one in (method for method in shown["methods"] if method["values"]):
        intervals = [one["values"].get(name) for name in names]
        cells = [text for own in intervals for text in ((value_text(own), ends_text(own)) if own else ("–", ""))]
        agreements = [one["agreement"].get(name, "-") for name in names]
        worst = next((text for text in ("off", "tied", "agrees", "primary") if text in agreements), "-")
        rows.append((one["method"], one["verdict"], *cells, worst, seconds(one["wall_s"])))
        marks.append({"primary": "level", "off": "off"}.get(worst, ""))
    units = {name: own["unit"] for one in shown["methods"] for name, own in one["values"].items()}
    headers = [text for name in names for text in (f"{readable(name)} ({units.get(name, '-')})", "95 % interval")]
    return Grid(("Method", "Verdict", *headers, "Agreement", "Fit time"), tuple(rows), tuple(marks))


def disagreement(shown: Mapping[str, Any]) -> list[str]:
    """State which methods agree with the primary one, and which are off in what."""
    if not shown["values"]:
        return []
    others = [one for one in shown["methods"][1:] if one["values"]]
    off = {one["method"]: [n for n, text in one["agreement"].items() if text == "off"] for one in others}
    agree = [method for method, names in off.items() if not names]
    apart = [f"{method} ({joined([readable(n) for n in names])})" for method, names in off.items() if names]
    said = [f"Consistent with {shown['method']}: {joined(agree)}."] if agree else []
    return said + ([f"Inconsistent: {joined(apart)}."] if apart else [])


def silent(shown: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return methods without stated values, with the reason; methods with one reason stand together."""
    methods: dict[str, list[str]] = {}
    for one in shown["methods"]:
        if not one["values"]:
            reason = one["reasons"][0] if one["reasons"] else one["message"] or one["status"]
            methods.setdefault(reason, []).append(one["method"])
    return [(", ".join(names), reason) for reason, names in methods.items()]


def replicas_grid(shown: Mapping[str, Any]) -> Grid:
    """Tabulate how the intervals cover the true values of replicas."""
    rows = []
    for line in shown["replicas"]:
        own = shown["values"].get(line["quantity"])
        low, high = (100.0 * end for end in wilson_interval(round(line["covered"] * line["n"]), line["n"]))
        corrected = "–"
        if line["corrected"] and own:
            ends = dict(zip(("record_low", "record_high"), line["corrected"], strict=True))
            corrected = ends_text(in_shown_unit(line["quantity"], {**own, **ends}), "record_")
        coverage = f"{100 * line['covered']:.0f} ({low:.0f} to {high:.0f})"
        cells = (str(line["n"]), number(line["median_error_pct"]), coverage, number(line["widening"]), corrected)
        rows.append((readable(line["quantity"]), *cells))
    headers = (
        "Quantity", "Replicas", "Median error (%)", "Coverage of 95 % intervals (%)", "Required widening factor",
        "Corrected interval of this record",
    )  # fmt: skip
    return Grid(headers, tuple(rows))


def what_if_grid(changes: Sequence[Mapping[str, Any]]) -> Grid:
    """Tabulate predicted standard errors today and after each change."""
    if not changes:
        return Grid((), ())
    names, today = list(changes[0]["today"]), changes[0]["today"]
    cases = [("this record", today), *((one["change"], one["relative_errors"]) for one in changes)]
    rows = [(change, *(f"{100 * errors[n]:.2g}" if n in errors else "–" for n in names)) for change, errors in cases]
    return Grid(("Standard error (%)", *map(readable, names)), tuple(rows))


def facts(shown: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what the record is, in pairs of name and text."""
    record, residuals = shown["record"], shown["residuals"]
    pairs = [
        ("Samples", f"{record['samples']} over {number(record['seconds'])} s"),
        ("Sampling rate", f"{record['rate']:.4g} Hz"),
        ("Force", "known" if record["forced"] else "none: free vibration"),
        ("System", shown["system"]),
    ]
    if residuals:
        rms = f"{number(residuals['rms'])} {residuals['unit']}"
        part = f"{100 * residuals['part_of_signal']:.2g} % of signal RMS"
        white = f"p = {residuals['whiteness']:.2g}, lag-1 autocorrelation {residuals['lag1_autocorrelation']:.2f}"
        pairs += [("Residual RMS", f"{rms} ({part})"), ("Residual whiteness", white)]
        pairs.append(("Sensor offset", f"{number(residuals['offset'])} {residuals['unit']}"))
    if shown["prediction"]:
        pairs.append(("Prediction FIT of the last 40 %", f"{fit_text(shown['prediction']['fit_pct'])} %"))
    return pairs
