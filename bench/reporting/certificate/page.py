"""The page of a certificate: contents, tables and pictures in one HTML file that loads nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.records.intervals import HALF
from bench.reporting.answer import (
    MEANING,
    Grid,
    ends_text,
    in_shown_unit,
    modes_table,
    parameters_table,
    residual_facts,
    runs_table,
    shapes_table,
    value_and_ends,
    values_table,
)
from bench.reporting.certificate.pictures import pictures
from bench.reporting.frame import group
from bench.reporting.rounding import number, readable
from bench.scoring.statistics import wilson_interval

MARKS = {"primary": "level", "off": "off"}
"""Style of the row of a method by its agreement."""


def page(shown: Mapping[str, Any]) -> str:
    """Return the page of a certificate's contents, of :func:`bench.reporting.certificate.contents.contents`."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("bench.reporting.certificate", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    text = templates.get_template("certificate.html.j2").render(
        shown=shown,
        meaning=MEANING,
        silent=_silent(shown["methods"]),
        origin=_origin(shown),
        pictures=pictures(shown),
        values=values_table(shown["values"], shown["withdrawn"]),
        modes=modes_table(shown["modes"]),
        shapes=shapes_table(shown["modes"]),
        parameters=parameters_table(shown["modes"]),
        runs=runs_table(shown["runs"]),
        classes=_classes(shown["classes"]),
        methods=_methods(shown),
        replicas=_replicas(shown),
        what_if=_what_if(shown["what_if"]),
        facts=_facts(shown),
    )
    return f"{text}\n"


def _classes(classes: Sequence[Mapping[str, Any]]) -> Grid:
    """Tabulate the model classes, the best first; those that do not differ significantly from it are marked."""
    rows = []
    for model in classes:
        zero = model["zero"].items()
        limits = [f"{readable(name)}/m ≤ {number(limit['most'])} {limit['unit']}" for name, limit in zero]
        difference, error = model["criterion"], HALF * model["criterion_error"]
        digits = 1 if difference < 100 else 0
        text = f"{difference:.{digits}f}" + (f" ± {error:.{digits}f}" if round(error, digits) > 0 else "")
        rows.append((model["name"], text, f"{100 * model['left']:.2g}", "; ".join(limits)))
    headers = ("Model", "ΔBIC", "Residual RMS (% of amplitude)", "Not needed, upper limit")
    return Grid(headers, rows, ["" if model["told_apart"] else "level" for model in classes])


def _methods(shown: Mapping[str, Any]) -> Grid:
    """Tabulate the methods with stated values, the primary first."""
    names, rows, marks = shown["compared"], [], []
    units: dict[str, str] = {}
    for method in (method for method in shown["methods"] if method["values"]):
        cells = [text for name in names for text in value_and_ends(method["values"].get(name))]
        units |= {name: interval["unit"] for name, interval in method["values"].items()}
        agreement = method["agreement"]
        worst = next((text for text in ("off", "tied", "agrees", "primary") if text in agreement.values()), "-")
        off = ", ".join(readable(name) for name, text in agreement.items() if text == "off")
        rows.append((method["method"], method["verdict"], *cells, f"off: {off}" if off else worst,
                     number(method["wall_s"])))  # fmt: skip
        marks.append(MARKS.get(worst, ""))
    headers = [text for name in names for text in (f"{readable(name)} ({units.get(name, '-')})", "95 % interval")]
    return Grid(("Method", "Verdict", *headers, "Agreement", "Fit time (s)"), rows, marks)


def _silent(methods: Sequence[Mapping[str, Any]]) -> list[str]:
    """List the reasons of methods without stated values, with the methods of each."""
    silent = [method for method in methods if not method["values"]]
    reasons = group(silent, lambda method: next(iter(method["reasons"]), method["message"] or method["status"]))
    return [f"{', '.join(method['method'] for method in same)}: {reason}" for reason, same in reasons.items()]


def _replicas(shown: Mapping[str, Any]) -> Grid:
    """Tabulate the coverage of the intervals on simulated replicas."""
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
    return Grid(headers, rows)


def _what_if(changes: Sequence[Mapping[str, Any]]) -> Grid:
    """Tabulate predicted standard errors of this record and after each change of the test."""
    today = changes[0]["today"] if changes else {}
    cases = [("this record", today)] + [(change["change"], change["relative_errors"]) for change in changes]
    rows = [(change, *(f"{100 * errors[n]:.2g}" if n in errors else "–" for n in today)) for change, errors in cases]
    return Grid(("Standard error (%)", *map(readable, today)), rows if changes else [])


def _facts(shown: Mapping[str, Any]) -> dict[str, str]:
    """Return facts of the record, of the residuals and of the prediction, by name."""
    record, residuals, prediction = shown["record"], shown["residuals"], shown["prediction"]
    facts = {"Lines": str(record["samples"])}
    if record["rate"]:
        facts = {"Samples": f"{record['samples']} over {number(record['seconds'])} s"}
        facts["Sampling rate"] = f"{record['rate']:.4g} Hz"
    facts |= {"Force": "known" if record["forced"] else "none: free vibration", "System": shown["system"]}
    facts |= residual_facts(residuals) if residuals else {}
    if prediction:
        fit = prediction["fit_pct"]
        facts["Prediction FIT of the last 40 %"] = f"{fit:.1f} %" if fit > -100 else "below −100 %"
    return facts


def _origin(shown: Mapping[str, Any]) -> dict[str, str]:
    """Return the check sums of the files and the versions of the packages, by name."""
    sums = {f"{file}, SHA-256": checksum or "none" for file, checksum in shown["record"]["hashes"]}
    return sums | {"Packages": ", ".join(f"{name} {version}" for name, version in shown["packages"].items())}
