"""A certificate as one page without network: its contents, pictures and tables put into the template."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bench.records.intervals import HALF
from bench.reporting.certificate.figures import pictures
from bench.reporting.grid import Grid, rendered, style
from bench.reporting.page.words import joined, number, seconds
from bench.reporting.rounding import readable, rounded

VERDICTS = {"trust": "Trust", "use with caution": "Use with caution", "do not trust": "Do not trust"}
STANDINGS = {
    "primary": "primary", "agrees": "agrees", "level": "level: its own interval holds the primary’s value",
    "off": "off", "-": "–",
}  # fmt: skip
FREE = ("k_over_m", "c_over_m")


def page(shown: Mapping[str, Any]) -> str:
    """The page of a certificate's contents, of :func:`bench.reporting.certificate.contents.contents`."""
    return rendered(
        "certificate/certificate.html.j2",
        style=style(),
        shown=shown,
        verdict=VERDICTS[shown["verdict"]],
        pictures=pictures(shown),
        values=values_grid(shown),
        corrected=bool(corrections(shown)),
        classes=classes_grid(shown["classes"]),
        methods=methods_grid(shown),
        off=off_sentences(shown),
        silent=silent(shown),
        twins=twins_grid(shown["twins"]) if shown["twins"] else None,
        what_if=what_if_grid(shown["what_if"]),
        facts=facts(shown),
    )


def value_text(own: Mapping[str, Any]) -> tuple[str, str]:
    """Value and stated interval."""
    value, low, high = rounded(own["value"], own["low"], own["high"])
    return value, f"{low} to {high}"


def unit_text(unit: str) -> str:
    """A unit; none for a pure number."""
    return "" if unit == "-" else unit


def values_grid(shown: Mapping[str, Any]) -> Grid:
    """The primary method's values with intervals; where they were withdrawn, only what it said itself."""
    stated = bool(shown["values"])
    corrected = corrections(shown)
    headers = ["", "Value", "Unit", "95 % interval", "White noise’s", "Times as wide"]
    rows = []
    for name, own in (shown["values"] or shown["withdrawn"]).items():
        value, interval = value_text(own)
        white = rounded(own["value"], own["white_low"], own["white_high"])
        wider = number((own["high"] - own["low"]) / ((own["white_high"] - own["white_low"]) or math.nan))
        row = [readable(name), value if stated else white[0], unit_text(own["unit"])]
        row += [interval if stated else "not stated", " to ".join(white[1:]), wider if stated else "–"]
        if corrected:
            row.append(value_text(corrected[name])[1] if name in corrected else "–")
        rows.append(tuple(row))
    if corrected:
        headers.append("Corrected by twins")
    return Grid(tuple(headers), tuple(rows))


def corrections(shown: Mapping[str, Any]) -> Mapping[str, Any]:
    """The intervals that twins have corrected; none where too few of them were fitted with the primary method."""
    twins = shown["twins"]
    if not twins or not any(line["method"] == shown["method"] for line in twins["lines"]):
        return {}
    found: Mapping[str, Any] = twins["corrected"]
    return found


def difference_text(value: float, half: float) -> str:
    """A difference of criteria with half of its 95 % interval, where that is not nothing."""
    digits = 1 if value < 100 else 0
    return f"{value:.{digits}f}" + (f" ± {half:.{digits}f}" if round(half, digits) > 0 else "")


def classes_grid(classes: Sequence[Mapping[str, Any]]) -> Grid:
    """The model classes, the best first; those that the record does not tell from it are marked."""
    rows = []
    for one in classes:
        zero = [
            f"{readable(name)}/m: 0, at most {number(own['most'])} {own['unit']}".rstrip()
            for name, own in one["zero"].items()
        ]
        rows.append(
            (
                one["name"],
                difference_text(one["criterion_difference"], HALF * one["criterion_difference_error"]),
                f"{one['residual_pct']:.2g}",
                fit_text(one["held_out_pct"]),
                "; ".join(zero),
            )
        )
    marks = tuple("" if one["told_apart"] else "level" for one in classes)
    headers = ("Class", "Criterion", "Residual (%)", "Held out (%)", "At zero")
    return Grid(headers, tuple(rows), marks)


def fit_text(value: float) -> str:
    """A FIT in percent; one that is far below zero says no more than that."""
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.1f}" if value > -100 else "below −100"


def methods_grid(shown: Mapping[str, Any]) -> Grid:
    """The methods that state something, the primary first."""
    names, rows, marks = shown["compared"], [], []
    for one in shown["methods"]:
        if not one["values"]:
            continue
        cells = []
        for name in names:
            own = one["values"].get(name)
            value, interval = value_text(own) if own else ("–", "")
            cells += [value, interval]
        standing = [one["standing"].get(name, "-") for name in names]
        worst = next((s for s in ("off", "level", "agrees", "primary") if s in standing), "-")
        rows.append((one["method"], one["verdict"], *cells, worst, seconds(one["wall_s"])))
        marks.append("level" if worst == "primary" else "off" if worst == "off" else "")
    units = {name: own["unit"] for one in shown["methods"] for name, own in one["values"].items()}
    headers = ["Method", "Verdict"]
    for name in names:
        unit = unit_text(units.get(name, ""))
        headers += [readable(name) + (f" ({unit})" if unit else ""), "95 % interval"]
    return Grid((*headers, "Stands", "Time"), tuple(rows), tuple(marks))


def off_sentences(shown: Mapping[str, Any]) -> list[str]:
    """Who agrees with the primary method, and who is off in what."""
    if not shown["values"]:
        return []
    said, others = [], [one for one in shown["methods"][1:] if one["values"]]
    off = {one["method"]: [n for n, s in one["standing"].items() if s == "off"] for one in others}
    agree = [one["method"] for one in others if not off[one["method"]]]
    if agree:
        said.append(f"No conflict with {shown['method']}: {joined(agree)}.")
    apart = [f"{method} ({joined([readable(n) for n in names])})" for method, names in off.items() if names]
    if apart:
        said.append(f"Off, which means that neither interval holds the other’s value: {joined(apart)}.")
    return said


def silent(shown: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Methods without stated values, with the reason; methods with one reason stand together."""
    found: dict[str, list[str]] = {}
    for one in shown["methods"]:
        if not one["values"]:
            reason = one["reasons"][0] if one["reasons"] else one["message"] or one["status"]
            found.setdefault(reason, []).append(one["method"])
    return [(", ".join(methods), reason) for reason, methods in found.items()]


def twins_grid(twins: Mapping[str, Any]) -> Grid:
    """What the twins show of each method."""
    rows = tuple(
        (
            line["method"], readable(line["quantity"]), str(line["n_ok"]), number(line["median_error_pct"]),
            share(line["coverage_white"]), share(line["coverage_stated"]), number(line["stretch"]),
        )
        for line in twins["lines"]
    )  # fmt: skip
    headers = (
        "Method", "Quantity", "Answers", "Median error (%)", "White-noise interval holds the truth",
        "Stated interval holds it", "Must be so many times as wide",
    )  # fmt: skip
    return Grid(headers, rows)


def share(value: float) -> str:
    """A share of one in percent."""
    return "–" if value is None or math.isnan(value) else f"{100 * value:.0f} %"


def what_if_grid(changes: Sequence[Mapping[str, Any]]) -> Grid:
    """Predicted standard errors today and after each change."""
    if not changes:
        return Grid((), ())
    names = [name for name in changes[0]["today"]]
    rows = [("today", *(_error(changes[0]["today"].get(name)) for name in names))]
    rows += [(one["change"], *(_error(one["relative_errors"].get(name)) for name in names)) for one in changes]
    return Grid(("Standard error (%)", *map(readable, names)), tuple(rows))


def _error(value: float | None) -> str:
    return "–" if value is None or math.isnan(value) else f"{100 * value:.2g}"


def facts(shown: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the record is, in pairs of name and text."""
    record, residuals = shown["record"], shown["residuals"]
    found = [
        ("Samples", f"{record['samples']} over {number(record['seconds'])} s"),
        ("Rate", f"{record['rate']:.4g} a second"),
        ("Force", "known" if record["forced"] else "none: free vibration"),
        ("System", shown["system"]),
    ]
    if residuals:
        rms = f"{number(residuals['rms'])} {residuals['unit']}"
        part = f"{100 * residuals['part_of_signal']:.2g} % of the signal"
        found.append(("Residuals, root mean square", f"{rms} ({part})"))
        white = f"p = {residuals['whiteness']:.2g}; correlation at one sample {residuals['lag1_autocorrelation']:.2f}"
        found.append(("Are they white?", white))
        found.append(("Offset", f"{number(residuals['offset'])} {residuals['unit']}"))
    if shown["prediction"]:
        found.append(("Held-out FIT", f"{fit_text(shown['prediction']['fit_pct'])} %"))
    return found
