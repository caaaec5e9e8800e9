"""Table 12, the modal track: several modes from free decays and hammer blows, compared with the bound."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bench.reporting.frame import Line, group
from bench.reporting.rounding import answered, excess_text, number, percent
from bench.reporting.tables.render import Panel, each, files, measured, scenario_sections

COLUMNS = (
    "scenario", "method", "quantity", "excess", "rms_pct", "coverage_pct", "outliers_pct", "right_pct", "wall_ms", "ok",
    "replicates", "message",
)  # fmt: skip
BOUND = "bound"
"""Name of the row of the bound."""
HEAD = """# Table 12. The modal track

Natural frequencies and damping ratios of several modes, whose number no method is given. In brackets after a
frequency: damping ratio, and amplitude or modal constant. Each replicate draws phases, shapes, noise, times and peaks
of blows. **rms**: root mean square of the relative error over replicates and modes. **excess**: root mean square of
error over Cramér-Rao bound (amplitudes, phases and constants unknown; the force of a blow known);
one is the smallest that an unbiased method can reach. **cov.**: coverage of the 95 % intervals. All three are over the
identified modes: within a half-power bandwidth of the true frequency, or within five times the bound. Over all
replicates, **number right**: share with the right number of modes; **outliers**: true modes that were missed, or with
an error beyond five times the bound. **ms**: median time per fit. Methods are in the order of outliers, then of
excess."""


def modal_table(lines: Sequence[Line], described: Mapping[str, str], command: str) -> Mapping[str, str]:
    """Return the files of the table by name, from the arguments of :func:`scenario_sections`."""
    sections, shown = scenario_sections(lines, described, SHOWN, in_order, in_words)
    captioned = [(f"The modal track: {scenario}", rows) for scenario, rows in shown]
    return files("table12", [HEAD, *sections, f"Regenerate: `{command}`"], lines, COLUMNS, latex=captioned)


def larger_excess(lines: Sequence[Line]) -> float:
    """Return the largest excess over the quantities; infinite if no mode was identified."""
    excess = max(line["excess"] for line in lines)
    return math.inf if math.isnan(excess) else float(excess)


def in_order(scored: Sequence[Line]) -> list[Line]:
    """Sort lines: the bound first, then methods by outliers (whole percent) and largest excess."""
    members = group(scored, lambda line: line["method"])
    rank = {
        name: (name != BOUND, round(of[0].get("outliers_pct", 0.0)), larger_excess(of)) for name, of in members.items()
    }
    return sorted(scored, key=lambda line: rank[line["method"]])


def in_words(scored: Sequence[Line]) -> str:
    """Summarise the methods of a scenario in a sentence, in the order of the lines; empty without methods."""
    summaries = []
    for name, of in group([line for line in scored if line["method"] != BOUND], lambda line: line["method"]).items():
        line, limits = of[0], []
        if line["outliers_pct"] > 0.0:
            limits.append(f"{line['outliers_pct']:.1f} % of modes missed or outliers")
        if line["right_pct"] < 100.0:
            limits.append(f"number of modes right in {line['right_pct']:.0f} %")
        behind = f", with {' and '.join(limits)}" if limits else ""
        summaries.append(f"{excess_text(larger_excess(of))} for {name} ({line['replicates']} records{behind})")
    return f"Largest excess: {'; '.join(summaries)}." if summaries else ""


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
