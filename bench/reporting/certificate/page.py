"""A certificate as one page without network: its contents, pictures and tables put into the template."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bench.records.intervals import HALF
from bench.reporting.answer import MEANING, ends_text, in_shown_unit, modes_table, runs_table, value_text, values_table
from bench.reporting.certificate.figures import pictures
from bench.reporting.grid import Grid, rendered, style
from bench.reporting.page.words import joined, number, seconds
from bench.reporting.rounding import readable
from bench.scoring.statistics import wilson_interval

MARKS = {"primary": "level", "off": "off"}
"""Style of the row of a method by its agreement."""


def page(shown: Mapping[str, Any]) -> str:
    """Return the page of a certificate's contents, of :func:`bench.reporting.certificate.contents.contents`."""
    return rendered(
        "certificate/certificate.html.j2",
        style=style(),
        shown=shown,
        meaning=MEANING,
        pictures=pictures(shown),
        values=values_table(shown["values"], shown["withdrawn"]),
        modes=modes_table(shown["modes"]),
        runs=runs_table(shown["runs"]),
        classes=classes_grid(shown["classes"]),
        methods=methods_grid(shown),
        off=disagreement(shown),
        silent=silent(shown),
        replicas=replicas_grid(shown),
        what_if=what_if_grid(shown["what_if"]),
        facts=facts(shown),
    )


def classes_grid(classes: Sequence[Mapping[str, Any]]) -> Grid:
    """Tabulate the model classes, the best first; those that the record does not tell from it are marked."""
    rows = []
    for model in classes:
        zero = model["zero"].items()
        limits = [f"{readable(name)}/m ≤ {number(limit['most'])} {limit['unit']}" for name, limit in zero]
        difference, error = model["criterion_difference"], HALF * model["criterion_difference_error"]
        digits = 1 if difference < 100 else 0
        text = f"{difference:.{digits}f}" + (f" ± {error:.{digits}f}" if round(error, digits) > 0 else "")
        rows.append((model["name"], text, f"{model['residual_pct']:.2g}", "; ".join(limits)))
    headers = ("Model", "ΔBIC", "Residual RMS (% of amplitude)", "Not needed, upper limit")
    return Grid(headers, tuple(rows), tuple("" if model["told_apart"] else "level" for model in classes))


def fit_text(value: float) -> str:
    """Return a FIT in percent; one that is far below zero says no more than that."""
    if math.isnan(value):
        return "–"
    return f"{value:.1f}" if value > -100 else "below −100"


def methods_grid(shown: Mapping[str, Any]) -> Grid:
    """Tabulate the methods that state something, the primary first."""
    names, rows, marks = shown["compared"], [], []
    units: dict[str, str] = {}
    for method in (method for method in shown["methods"] if method["values"]):
        cells: list[str] = []
        for interval in (method["values"].get(name) for name in names):
            cells += (value_text(interval), ends_text(interval)) if interval else ("–", "")
        units |= {name: interval["unit"] for name, interval in method["values"].items()}
        agreements = method["agreement"].values()
        worst = next((text for text in ("off", "tied", "agrees", "primary") if text in agreements), "-")
        rows.append((method["method"], method["verdict"], *cells, worst, seconds(method["wall_s"])))
        marks.append(MARKS.get(worst, ""))
    headers = [text for name in names for text in (f"{readable(name)} ({units.get(name, '-')})", "95 % interval")]
    return Grid(("Method", "Verdict", *headers, "Agreement", "Fit time"), tuple(rows), tuple(marks))


def disagreement(shown: Mapping[str, Any]) -> list[str]:
    """State which methods agree with the primary one, and which are off in what."""
    if not shown["values"]:
        return []
    others = [method for method in shown["methods"][1:] if method["values"]]
    off = {
        method["method"]: [readable(name) for name, text in method["agreement"].items() if text == "off"]
        for method in others
    }
    agree = [method for method, names in off.items() if not names]
    apart = [f"{method} ({joined(names)})" for method, names in off.items() if names]
    said = [f"Consistent with {shown['method']}: {joined(agree)}."] if agree else []
    return said + ([f"Inconsistent: {joined(apart)}."] if apart else [])


def silent(shown: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return methods without stated values, with the reason; methods with one reason stand together."""
    methods: dict[str, list[str]] = {}
    for method in (method for method in shown["methods"] if not method["values"]):
        reason = [*method["reasons"], method["message"] or method["status"]][0]
        methods.setdefault(reason, []).append(method["method"])
    return [(", ".join(names), reason) for reason, names in methods.items()]


def replicas_grid(shown: Mapping[str, Any]) -> Grid:
    """Tabulate how the intervals cover the true values of replicas."""
    rows = []
    for line in shown["replicas"]:
        interval, corrected = shown["values"].get(line["quantity"]), "–"
        low, high = (100.0 * end for end in wilson_interval(round(line["covered"] * line["n"]), line["n"]))
        if line["corrected"] and interval:
            ends = dict(zip(("record_low", "record_high"), line["corrected"], strict=True))
            corrected = ends_text(in_shown_unit(line["quantity"], {**interval, **ends}), "record_")
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
    today = changes[0]["today"]
    cases = [("this record", today), *((change["change"], change["relative_errors"]) for change in changes)]
    rows = [(change, *(f"{100 * errors[n]:.2g}" if n in errors else "–" for n in today)) for change, errors in cases]
    return Grid(("Standard error (%)", *map(readable, today)), tuple(rows))


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
