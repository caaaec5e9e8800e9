"""Table 10, the online track: trackers of changing parameters, compared with the bound along the path."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from bench.online.score import AFTER, LEVELS, SCORED_FROM, Score
from bench.reporting.frame import Line, group
from bench.reporting.rounding import answered, excess_text, number, percent, readable
from bench.reporting.tables.render import MISSING, Panel, Rows, Texts, each, files, measured, scenario_sections

BEHIND = {f"excess_after_{low}_{high}": f"after {low}-{high}" for low, high in AFTER}
"""Headings of the columns of the excess after a step."""
COLUMNS = (
    "scenario", "method", "quantity", "excess", "rms_pct", "share_told", "coverage_pct", *BEHIND, "delay", "ok",
    "replicates", "micros_median", "micros_99", "micros_largest", "held_bytes", "message",
)  # fmt: skip
BOUND = "bound"
"""Name of the row of the bound."""
EMPTY: Line = {"ok": 0, "replicates": 0, "held_bytes": 0, "message": ""}
CONSTANT, STEP = "constant_multisine", "step10_multisine"
HEAD = f"""# Table 10. The online track

Changing parameters, tracked sample by sample from past data alone. **rms**: root mean square error of the logarithm in
percent, pooled over replicates and over the samples after the first {SCORED_FROM:.0%} of the record. **excess**: rms
over the posterior Cramér-Rao bound along the path. The bound assumes that it is known which parameter may change, when,
and by about how much; trackers have to estimate this, so where a parameter changes none can be expected to reach the
bound. Methods with as many replicates are in the order of their largest excess. **available**: share of those samples
with an estimate. **cov.**: coverage of the 95 % intervals. **after**: excess by samples since a step. **delay**: median
number of samples from a step until the 95 % interval excludes the old value (never: in most replicates); in the bound's
row, until the bound allows it. After and delay are of the first quantity. **µs**: median and 99 % quantile of the wall
time per sample, with one process per core on the machine that made the table. Methods that do not apply to a scenario
are listed below it."""
CURVE = """With intervals wider or narrower than 95 %: false alarms in 1000 samples of the constant multisine record
(times that the interval begins to exclude the true value) / median delay (samples) after the step under a multisine,
by the half-width of the interval in standard deviations."""


def tracked(facts: Line, scores: Mapping[str, Score]) -> list[Line]:
    """Return one line per quantity of a method on a scenario.

    Args:
        facts: Scenario, method, title, counts and costs.
        scores: Scores by quantity.
    """
    return [
        {
            **EMPTY, **facts, "quantity": name, "excess": score.excess, "rms_pct": score.rms,
            "share_told": score.share, "coverage_pct": 100.0 * score.coverage, "delay": score.delay,
            "curve": score.curve, **dict(zip(BEHIND, score.after, strict=True)),
        }
        for name, score in scores.items()
    ]  # fmt: skip


def table(lines: Sequence[Line], described: Mapping[str, str], command: str) -> Mapping[str, str]:
    """Return the files of the table by name, from the arguments of :func:`scenario_sections`."""
    sections, _ = scenario_sections(lines, described, SHOWN, in_order)
    curve = false_alarms(line for line in lines if "quantity" in line)
    curves: list[str | Rows] = ["## Delay against false alarms", CURVE, curve] if any(curve) else []
    parts = [HEAD, *sections, *curves, f"Regenerate: `{command}`"]
    return files("table10", parts, ({**EMPTY, **line} for line in lines), COLUMNS)


def in_order(lines: Sequence[Line]) -> list[Line]:
    """Sort lines: the bound first, then by number of replicates and by the largest excess over the quantities."""
    largest: dict[str, float] = {}
    for line in lines:
        size = line["excess"] if math.isfinite(line["excess"]) else math.inf
        largest[line["method"]] = max(size, largest.get(line["method"], -math.inf))
    return sorted(lines, key=lambda line: (line["method"] != BOUND, -line["ok"], largest[line["method"]]))


def last(lines: Sequence[Line]) -> Texts:
    """Return the excess after a step in the first quantity, the delay, and the costs per sample."""
    line = lines[0]
    steps = {f"{readable(line['quantity'])} {heading}": excess_text(line[name]) for name, heading in BEHIND.items()}
    costs = {"µs": MISSING, "memory (kB)": MISSING}
    if line["method"] != BOUND:
        memory = "<0.1" if line["held_bytes"] < 100 else f"{line['held_bytes'] / 1000:.1f}"
        costs = {"µs": f"{line['micros_median']:.0f} / {line['micros_99']:.0f}", "memory (kB)": memory}
    return {**steps, "delay": _samples(line["delay"]), **costs, "ok": answered(line["ok"], line["replicates"])}


def _samples(delay: float) -> str:
    return MISSING if math.isnan(delay) else "never" if math.isinf(delay) else f"{delay:.0f}"


def _alarms(count: float) -> str:
    return MISSING if math.isnan(count) else f"{count:.2g}"


SHOWN = Panel(
    each(
        measured,
        {
            "rms %": lambda line: number(line["rms_pct"]), "excess": lambda line: excess_text(line["excess"]),
            "available": lambda line: f"{line['share_told']:.2f}",
            "cov. %": lambda line: percent(line["coverage_pct"] / 100.0),
        },
    ),
    lambda line: {"method": line["title"]}, last,
)  # fmt: skip


def false_alarms(lines: Iterable[Line]) -> Rows:
    """Return one row per method with both scenarios, for its first quantity, and one column per half-width."""
    groups = group(lines, lambda line: (line["title"], line["scenario"]))
    curves = {key: members[0]["curve"] for key, members in groups.items()}
    titles = [title for title, scenario in curves if scenario == CONSTANT and (title, STEP) in curves]
    points = [
        (title, f"{width:g} sd", f"{_alarms(constant[0])} / {_samples(step[1])}")
        for title in titles
        for width, constant, step in zip(LEVELS, curves[title, CONSTANT], curves[title, STEP], strict=True)
    ]
    return Panel(lambda point: {point[1]: point[2]}, lambda point: {"method": point[0]}).rows(points)
