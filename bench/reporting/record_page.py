"""What methods found in a measured record, for reading in a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.reporting.answer import MEANING, answer, ends_text, in_shown_unit, unit_text, value_text
from bench.reporting.rounding import number, readable, rounded
from bench.reporting.terminal import table, wrapped

FREE = "free vibration without a prior: m, c and k are not individually identifiable, only k/m and c/m"
WHITE = "White-noise interval: assumes white noise and a correct model."

MODES = ["mode (Hz)", "95 %", "damping ratio", "95 %", "of the signal"]


def record_page(found: Mapping[str, Any], scale_is_free: bool) -> str:
    """Return one method's answer: values, verdict with its reasons, a table of intervals, and the residuals.

    ``found`` is what :class:`bench.Identification` holds, as plain values.
    """
    stated = bool(found["estimates"])
    first = f"{answer(found['estimates'])} (95 % interval of a repeat)" if stated else "no value can be stated"
    lines = [wrapped(first), wrapped(f"{found['method']}: {found['trust']}")]
    lines += [wrapped(f"- {reason}", "    ", "  ") for reason in found["reasons"]]
    lines.append(wrapped(f"record: {found['data']}, {found['samples']} samples"))
    lines += [wrapped(f"note: {note}", "    ", "  ") for note in found["notes"]]
    shown = found["estimates"] or found["withdrawn"]
    if shown:
        rows = [_row(name, interval, stated) for name, interval in shown.items()]
        headers = ["", "value", "unit", "95 % interval of a repeat", "of this record", "white-noise interval"]
        lines += ["", table(rows, headers, (0, 2)), "", wrapped(f"Intervals {MEANING}. {WHITE}")]
        if not stated:
            lines.append(wrapped("no interval is stated, since the answer is not to be trusted"))
    if found["modes"]:
        lines += ["", table([_mode(mode) for mode in found["modes"]], MODES, (4,)), ""]
    if shown and scale_is_free:
        lines.append(wrapped(FREE))
    if found["runs"]:
        lines += ["", _runs(found["runs"], [name for name in shown][:2]), ""]
    r = found["residuals"]
    if r:
        size = f"residual RMS: {number(r['rms'])} {r['unit']} ({100 * r['part_of_signal']:.2g} % of signal RMS)"
        colour = f"lag-1 autocorrelation {r['lag1_autocorrelation']:.2f}, whiteness p = {r['whiteness']:.2g}"
        lines.append(wrapped(f"{size}, {colour}, offset {number(r['offset'])} {r['unit']}"))
    return "\n".join(lines)


def _row(name: str, interval: Mapping[str, Any], stated: bool) -> list[str]:
    shown = in_shown_unit(name, interval)
    white = rounded(shown["value"], shown["white_low"], shown["white_high"])[0]
    texts = [ends_text(shown), ends_text(shown, "record_")] if stated else ["-", "-"]
    value = value_text(shown) if stated else white
    return [readable(name), value, unit_text(shown["unit"]), *texts, ends_text(shown, "white_")]


def _mode(mode: Mapping[str, Any]) -> list[str]:
    frequency, *ends = rounded(mode["frequency"], mode["frequency_low"], mode["frequency_high"])
    ratio, *bounds = rounded(mode["damping_ratio"], mode["damping_ratio_low"], mode["damping_ratio_high"])
    what = "alias" if mode["alias"] else f"{100 * mode['share']:.0f} %"
    return [frequency, " to ".join(ends), ratio, " to ".join(bounds), what]


def _runs(runs: Mapping[str, Mapping[str, Any]], names: Sequence[str]) -> str:
    """Return a table of what each run says alone, with its own 95 % interval."""
    rows = []
    for name, run in runs.items():
        own = [run["estimates"].get(quantity) for quantity in names]
        cells = [said for e in own for said in (_alone(e) if e else ("-", "-"))]
        rows.append([name, *cells, "left out" if run["left_out"] else ""])
    headers = [text for quantity in names for text in (readable(quantity), "95 %")]
    return table(rows, ["run alone", *headers, ""], (0, 2 * len(names) + 1))


def _alone(own: Mapping[str, Any]) -> tuple[str, str]:
    if own["limit"]:
        return "-", f"{own['limit']} {number(own['high' if own['limit'] == 'at most' else 'low'])}"
    value, low, high = rounded(own["value"], own["record_low"], own["record_high"])
    return value, f"{low} to {high}"


def methods_page(found: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    """Return several methods side by side: the verdict of each, and the quantities that most of them determine."""
    rows = []
    for result in found:
        intervals = [result["estimates"].get(name) for name in names]
        cells = [ends_text(interval) if interval else "-" for interval in intervals]
        rows.append([result["method"], result["trust"], *cells, number(result["wall_s"])])
    headers = ["method", "verdict", *(f"{readable(name)}, 95 %" for name in names), "s"]
    doubted = [result for result in found if result["trust"] == "do not trust"]
    lines = [f"record: {found[0]['data']}", "", table(rows, headers, (0, 1)), *([""] if doubted else [])]
    lines += [wrapped(f"{result['method']}: {result['reasons'][0]}", "    ", "  ") for result in doubted]
    return "\n".join(lines)
