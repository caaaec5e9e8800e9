"""What methods found in a measured record, for reading in a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.reporting.rounding import number, readable, rounded
from bench.reporting.terminal import table, wrapped

FREE = "free vibration without a prior: m, c and k themselves cannot be told, only their ratios"
WHITE = "white: the interval of the method alone, which takes the noise for white and the model for right"

MODES = ["mode (Hz)", "95 %", "damping ratio", "95 %", "of the signal"]


def record_page(found: Mapping[str, Any], scale_is_free: bool) -> str:
    """One method's answer: the verdict with its reasons, values with intervals, and what is left of the signal.

    ``found`` is what :class:`bench.Identification` holds, as plain values.
    """
    lines = [f"record: {found['data']}"]
    lines += [wrapped(f"note: {note}", "    ", "  ") for note in found["notes"]]
    lines.append(wrapped(f"{found['method']}: {found['samples']} samples, {found['status']}: {found['trust']}"))
    lines += [wrapped(f"- {reason}", "    ", "  ") for reason in found["reasons"]]
    shown = found["estimates"] or found["withdrawn"]
    if shown:
        rows = [_row(name, own, bool(found["estimates"])) for name, own in shown.items()]
        headers = ["", "value", "95 % low", "95 % high", "unit", "white low", "white high"]
        lines += ["", table(rows, headers, (0, 4)), "", wrapped(WHITE)]
        if not found["estimates"]:
            lines.append(wrapped("no interval is stated, since the answer is not to be trusted"))
    if found["modes"]:
        lines += ["", table([_mode(mode) for mode in found["modes"]], MODES, (4,)), ""]
    if shown and scale_is_free:
        lines.append(wrapped(FREE))
    if found["runs"]:
        lines += ["", _runs(found["runs"], [name for name in shown][:2]), ""]
    r = found["residuals"]
    if r:
        said = f"residuals: rms {number(r['rms'])} {r['unit']} ({100 * r['part_of_signal']:.2g} % of the signal)"
        colour = f"lag-1 autocorrelation {r['lag1_autocorrelation']:.2f}, white with p = {r['whiteness']:.2g}"
        lines.append(wrapped(f"{said}, {colour}, offset {number(r['offset'])} {r['unit']}"))
    return "\n".join(lines)


def _row(name: str, own: Mapping[str, Any], stated: bool) -> list[str]:
    value, low, high = rounded(own["value"], own["low"], own["high"])
    white = rounded(own["value"], own["white_low"], own["white_high"])
    return [
        readable(name),
        value if stated else white[0],
        *((low, high) if stated else ("-", "-")),
        own["unit"],
        *white[1:],
    ]


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
    """Several methods side by side: the verdict of each, and the quantities that most of them tell."""
    rows = []
    for own in found:
        cells = []
        for name in names:
            e = own["estimates"].get(name)
            cells.append(" to ".join(rounded(e["value"], e["low"], e["high"])[1:]) if e else "-")
        rows.append([own["method"], own["trust"], *cells, number(own["wall_s"])])
    headers = ["method", "verdict", *(f"{readable(name)}, 95 %" for name in names), "s"]
    doubted = [own for own in found if own["trust"] == "do not trust"]
    lines = [f"record: {found[0]['data']}", "", table(rows, headers, (0, 1)), *([""] if doubted else [])]
    lines += [wrapped(f"{own['method']}: {own['reasons'][0]}", "    ", "  ") for own in doubted]
    return "\n".join(lines)
