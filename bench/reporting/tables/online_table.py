"""Table 10: the online track, how trackers follow parameters that change, beside the bound along the path."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from bench.online.score import AFTER, LEVELS, SCORED_FROM, Score
from bench.reporting.frame import Line, group
from bench.reporting.rounding import answered, excess_text, number, percent, readable
from bench.reporting.tables.render import MISSING, Panel, Rows, Texts, each, files, measured

BEHIND = {f"excess_after_{low}_{high}": f"after {low}-{high}" for low, high in AFTER}
"""Columns of the excess behind a step, and what stands over them."""
COLUMNS = (
    "scenario", "method", "quantity", "excess", "rms_pct", "share_told", "coverage_pct", *BEHIND, "delay", "ok",
    "replicates", "micros_median", "micros_99", "micros_largest", "held_bytes", "message",
)  # fmt: skip
BOUND = "bound"
"""The row of the bound, among the methods."""
NOTHING: Line = {"ok": 0, "replicates": 0, "held_bytes": 0, "message": ""}
CONSTANT, STEP = "constant_multisine", "step10_multisine"
HEAD = f"""# Table 10. The online track

Parameters that change, followed sample by sample from the past alone. **rms**: root mean square error of the logarithm
in percent, pooled over samples and replicates behind the first {SCORED_FROM:.0%} of the record. **excess**: that over
the posterior Cramér-Rao bound along the path. The bound is that of who is told when a parameter may change, and which
one, and by how much about. A tracker has to find that out, so where a parameter changes none can be expected to reach
it. Of as many replicates, methods stand in the order of the excess that is farther from the bound. **told**: the part
of those samples for which there is a belief at all. **cov.**: 95 % intervals that hold the truth. **after**: excess by
samples since a step. **delay**: median samples from a step until the 95 % interval excludes the old value; in the
bound's row, until the bound would allow it. **µs**: median and 99 % wall time of a sample, on the machine that made the
table, with as many processes side by side as it has cores. A method that cannot take a scenario says why below it."""
CURVE = """Where the interval is wider or narrower than 95 %: false alarms in 1000 samples of the constant multisine
record (times that the interval begins to exclude the true value) / median delay (samples) behind the step under a
multisine, by the half-width of the interval in standard deviations."""


def tracked(what: Line, scores: Mapping[str, Score]) -> list[Line]:
    """A line a quantity of a method on a scenario; ``what`` says which, with its title, counts and costs."""
    return [
        {
            **NOTHING, **what, "quantity": name, "excess": score.excess, "rms_pct": score.rms,
            "share_told": score.share, "coverage_pct": 100.0 * score.coverage, "delay": score.delay,
            "curve": score.curve, **dict(zip(BEHIND, score.after, strict=True)),
        }
        for name, score in scores.items()
    ]  # fmt: skip


def table(lines: Sequence[Line], described: Mapping[str, str], command: str) -> Mapping[str, str]:
    """The files of the table by name; a method that has no scores on a scenario is a line with a message."""
    parts: list[str | Rows] = [HEAD]
    scored = [line for line in lines if "quantity" in line]
    for scenario, sentence in described.items():
        shown = [line for line in scored if line["scenario"] == scenario]
        parts += [f"## {readable(scenario)}", sentence]
        parts += [SHOWN.rows(in_order(shown))] if {line["method"] for line in shown} - {BOUND} else []
        others = [line for line in lines if line["scenario"] == scenario and "quantity" not in line]
        refused = group(others, lambda line: line["message"])
        parts += [f"Not there: {', '.join(line['title'] for line in its)}: {said}." for said, its in refused.items()]
    curve = false_alarms(scored)
    parts += ["## Delay against false alarms", CURVE, curve] if any(curve) else []
    return files("table10", [*parts, f"Regenerate: `{command}`"], ({**NOTHING, **one} for one in lines), COLUMNS)


def in_order(lines: Sequence[Line]) -> list[Line]:
    """The bound, then those of most replicates by their largest excess, so that no quantity is bought with another."""
    largest: dict[str, float] = {}
    for line in lines:
        size = line["excess"] if math.isfinite(line["excess"]) else math.inf
        largest[line["method"]] = max(size, largest.get(line["method"], -math.inf))
    return sorted(lines, key=lambda line: (line["method"] != BOUND, -line["ok"], largest[line["method"]]))


def last(lines: Sequence[Line]) -> Texts:
    """What follows a step in the first quantity, and what a sample costs."""
    line = lines[0]
    steps = {f"{readable(line['quantity'])} {heading}": excess_text(line[name]) for name, heading in BEHIND.items()}
    costs = {"µs": MISSING, "kB held": MISSING}
    if line["method"] != BOUND:
        held = "<0.1" if line["held_bytes"] < 100 else f"{line['held_bytes'] / 1000:.1f}"
        costs = {"µs": f"{line['micros_median']:.0f} / {line['micros_99']:.0f}", "kB held": held}
    return {**steps, "delay": _samples(line["delay"]), **costs, "ok": answered(line["ok"], line["replicates"])}


def _samples(delay: float) -> str:
    return MISSING if math.isnan(delay) else "never" if math.isinf(delay) else f"{delay:.0f}"


SHOWN = Panel(
    each(
        measured,
        {
            "rms %": lambda line: number(line["rms_pct"]), "excess": lambda line: excess_text(line["excess"]),
            "told": lambda line: f"{line['share_told']:.2f}",
            "cov. %": lambda line: percent(line["coverage_pct"] / 100.0),
        },
    ),
    lambda line: {"method": line["title"]}, last,
)  # fmt: skip


def false_alarms(lines: Iterable[Line]) -> Rows:
    """A method a row, of those that have both scenarios, by the first quantity of each; half-widths side by side."""
    members = group(lines, lambda line: (line["title"], line["scenario"]))
    curves = {key: its[0]["curve"] for key, its in members.items()}
    titles = [title for title, scenario in curves if scenario == CONSTANT and (title, STEP) in curves]
    points = [
        (title, f"{width:g} sd", f"{constant[0]:.2g} / {_samples(step[1])}")
        for title in titles
        for width, constant, step in zip(LEVELS, curves[title, CONSTANT], curves[title, STEP], strict=True)
    ]
    return Panel(lambda point: {point[1]: point[2]}, lambda point: {"method": point[0]}).rows(points)
