"""Table 12: the modal track, several modes from free decays and hammer blows, beside the bound."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bench.reporting.frame import Line, group
from bench.reporting.rounding import answered, excess_text, number, percent, readable
from bench.reporting.tables.render import Panel, Rows, each, files, measured

COLUMNS = (
    "scenario", "method", "quantity", "excess", "rms_pct", "coverage_pct", "outliers_pct", "right_pct", "wall_ms", "ok",
    "replicates", "message",
)  # fmt: skip
BOUND = "bound"
"""The row of the bound, among the methods."""
HEAD = """# Table 12. The modal track

Natural frequencies and damping ratios of several modes, whose number no method is given. In brackets behind a
frequency: damping ratio, and amplitude or modal constant. Each replicate draws phases, shapes, noise, times and peaks
of blows. **rms**: root mean square of the relative error over replicates and modes. **excess**: that of the error
over its Cramér-Rao bound (amplitudes, phases and constants unknown; the force known to be zero outside of a blow);
one is the best that an estimate without bias can do. **cov.**: 95 % intervals that cover the true value. These are of
the modes that were identified: within a half-power bandwidth of the true frequency, or within five bounds. Of all
replicates, **number right**: as many modes as there are; **outliers**: true modes that were missed, or are off by
more than five bounds. **ms**: median time of a fit. Methods stand in the order of outliers, then of excess."""


def modal_table(lines: Sequence[Line], described: Mapping[str, str], command: str) -> Mapping[str, str]:
    """Return the files of the table by name; a method without scores on a scenario is a line with a message."""
    parts: list[str | Rows] = [HEAD]
    captioned: list[tuple[str, Rows]] = []
    for scenario, sentence in described.items():
        here = [line for line in lines if line["scenario"] == scenario]
        scored = in_order([line for line in here if "quantity" in line])
        rows = SHOWN.rows(scored)
        captioned += [(f"The modal track: {readable(scenario)}", rows)] if any(rows) else []
        parts += [f"## {readable(scenario)}", sentence, rows, in_words(scored)]
        refused = group([line for line in here if "quantity" not in line], lambda line: line["message"])
        parts += [f"Not there: {', '.join(line['method'] for line in its)}: {said}." for said, its in refused.items()]
    return files("table12", [*parts, f"Regenerate: `{command}`"], lines, COLUMNS, latex=captioned)


def larger_excess(lines: Sequence[Line]) -> float:
    """Return the excess of the quantity that is farther from the bound, infinite where no mode was identified."""
    excess = max(line["excess"] for line in lines)
    return math.inf if math.isnan(excess) else float(excess)


def in_order(scored: Sequence[Line]) -> list[Line]:
    """Sort lines: the bound, then methods by their outliers in whole percent and their larger excess."""
    members = group(scored, lambda line: line["method"])
    rank = {
        name: (name != BOUND, round(of[0].get("outliers_pct", 0.0)), larger_excess(of)) for name, of in members.items()
    }
    return sorted(scored, key=lambda line: rank[line["method"]])


def in_words(scored: Sequence[Line]) -> str:
    """Say what each method is worth on a scenario, in the order of its lines; nothing without a method."""
    said = []
    for name, of in group([line for line in scored if line["method"] != BOUND], lambda line: line["method"]).items():
        line, limits = of[0], []
        if line["outliers_pct"] > 0.0:
            limits.append(f"{line['outliers_pct']:.1f} % of modes missed or off")
        if line["right_pct"] < 100.0:
            limits.append(f"number of modes right in {line['right_pct']:.0f} %")
        behind = f", with {' and '.join(limits)}" if limits else ""
        said.append(f"{excess_text(larger_excess(of))} times by {name} ({line['replicates']} records{behind})")
    return f"Errors over the bound: {'; '.join(said)}." if said else ""


def _last(lines: Sequence[Line]) -> dict[str, str]:
    line = lines[0]
    if line["method"] == BOUND:
        return {}
    return {
        "number right %": f"{line['right_pct']:.0f}", "outliers %": f"{line['outliers_pct']:.1f}",
        "ms": number(line["wall_ms"]), "ok": answered(line["ok"], line["replicates"]),
    }  # fmt: skip


SHOWN = Panel(
    each(
        measured,
        {
            "rms %": lambda line: number(line["rms_pct"]), "excess": lambda line: excess_text(line["excess"]),
            "cov. %": lambda line: percent(line["coverage_pct"] / 100.0),
        },
    ),
    lambda line: {"method": line["method"]}, _last,
)  # fmt: skip
