"""Table 10: the online track, how trackers follow parameters that change, beside the bound along the path."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.online.score import AFTER, LEVELS, SCORED_FROM, Score
from bench.reporting.rounding import excess_text, number, readable
from bench.reporting.tables.render import csv, markdown_table

COLUMNS = (
    "scenario", "method", "quantity", "excess", "rms_pct", "share_told", "coverage_pct",
    *(f"excess_after_{low}_{high}" for low, high in AFTER), "delay", "ok", "replicates", "micros_median", "micros_99",
    "micros_largest", "held_bytes", "message",
)  # fmt: skip
HEAD = f"""# Table 10. The online track

Parameters that change, followed sample by sample from the past alone. **rms**: root mean square error of the logarithm
in percent, pooled over samples and replicates behind the first {SCORED_FROM:.0%} of the record. **excess**: that over
the posterior Cramér-Rao bound along the path. The bound is that of who is told when a parameter may change, and which
one, and by how much about. A tracker has to find that out, so where a parameter changes none can be expected to reach
it. **told**: the part of those samples for which there is a belief at all. **cov.**: 95 % intervals that hold the
truth. **after**: excess by samples since a step. **delay**: median samples from a step until the 95 % interval excludes
the old value; in the bound's row, until the bound would allow it. **µs**: median and 99 % wall time of a sample, on the
machine that made the table, with as many processes side by side as it has cores. A method that cannot take a scenario
says why below it."""
BOUND = "bound"
"""The row of the bound, among the methods."""


@dataclass(frozen=True, eq=False)
class Line:
    """A method on a scenario: its scores by quantity, or why there are none."""

    scenario: str
    method: str
    title: str
    scores: Mapping[str, Score] = field(default_factory=dict)
    ok: int = 0
    replicates: int = 0
    micros: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    held_bytes: int = 0
    message: str = ""


def table(lines: Sequence[Line], described: Mapping[str, str], command: str) -> Mapping[str, str]:
    """The files of the table by name."""
    return {"table10.md": _markdown(lines, described, command), "table10.csv": csv(_rows(lines), columns=COLUMNS)}


def _markdown(lines: Sequence[Line], described: Mapping[str, str], command: str) -> str:
    parts = [HEAD]
    for scenario, sentence in described.items():
        own = [line for line in lines if line.scenario == scenario]
        parts += [f"## {readable(scenario)}", sentence]
        shown = [line for line in own if line.scores]
        if len(shown) > 1:
            parts += [markdown_table(*_panel(shown)), best_sentence(shown)]
        refused: dict[str, list[str]] = {}
        for line in own:
            if not line.scores:
                refused.setdefault(line.message, []).append(line.title)
        parts += [f"Not there: {', '.join(titles)}: {message}." for message, titles in refused.items()]
    found = _curve(lines)
    if found:
        parts += ["## Delay against false alarms", CURVE, markdown_table(*found)]
    parts.append(f"Regenerate: `{command}`")
    return "\n\n".join(parts) + "\n"


CONSTANT, STEP = "constant_multisine", "step10_multisine"
A_THOUSAND = 1000
"""Samples in which the curve counts false alarms."""
CURVE = f"""Where the interval is wider or narrower than 95 %: false alarms in {A_THOUSAND} samples of the constant
multisine record (times that the interval begins to exclude the true value) / median delay (samples) behind the step
under a multisine, by the half-width of the interval in standard deviations."""


def best_sentence(lines: Sequence[Line]) -> str:
    """Which method is nearest to the bound over all quantities of the panel, and how far its delay is from the bound's.

    The farther of its quantities counts, so that none is bought with another; only methods that answered the most
    replicates are asked.
    """
    quantities = list(dict.fromkeys(name for line in lines for name in line.scores))
    methods = [line for line in lines if line.method != BOUND]
    methods = [line for line in methods if line.ok == max(other.ok for other in methods)]
    best = min(methods, key=lambda line: max(_best(line, name) for name in quantities))
    excesses = ", ".join(f"{readable(name)} {excess_text(best.scores[name].excess)}" for name in best.scores)
    said = f"Nearest to the bound, by the farther of its quantities: **{best.title}** (excess: {excesses})."
    bound = next((line for line in lines if line.method == BOUND), None)
    delay = best.scores[quantities[0]].delay
    if bound is not None and not math.isnan(delay):
        said += f" Its delay is {_samples(delay)} samples, the bound's {_samples(bound.scores[quantities[0]].delay)}."
    return said


def _panel(lines: Sequence[Line]) -> tuple[list[list[str]], list[str]]:
    quantities = list(dict.fromkeys(name for line in lines for name in line.scores))
    stepped = any(math.isfinite(s.after[0]) for line in lines for s in line.scores.values())
    headers = ["method"]
    for i, name in enumerate(quantities):
        headers += [f"{readable(name)} rms %"] * (i == 0) + [f"{readable(name)} excess", "told", "cov. %"]
    if stepped:
        headers += [f"{readable(quantities[0])} after {low}-{high}" for low, high in AFTER] + ["delay"]
    headers += ["µs", "kB held", "ok"]
    rows = []
    for line in sorted(lines, key=lambda line: (line.method != BOUND, _best(line, quantities[0]))):
        row = [line.title]
        for i, name in enumerate(quantities):
            row += _entries(line.scores.get(name), i == 0)
        if stepped:
            s = line.scores[quantities[0]]
            row += [excess_text(value) for value in s.after] + [_samples(s.delay)]
        rows.append([*row, *_costs(line), f"{line.ok}/{line.replicates}"])
    return rows, headers


def _entries(score: Score | None, with_error: bool) -> list[str]:
    if score is None:
        return ["-"] * (4 if with_error else 3)
    coverage = "-" if math.isnan(score.coverage) else f"{100 * score.coverage:.0f}"
    return [number(score.rms)] * with_error + [excess_text(score.excess), f"{score.share:.2f}", coverage]


def _costs(line: Line) -> list[str]:
    if line.method == BOUND:
        return ["-", "-"]
    size = "<0.1" if line.held_bytes < 100 else f"{line.held_bytes / 1000:.1f}"
    return [f"{line.micros[0]:.0f} / {line.micros[1]:.0f}", size]


def _best(line: Line, quantity: str) -> float:
    score = line.scores.get(quantity)
    return score.excess if score is not None and math.isfinite(score.excess) else math.inf


def _samples(delay: float) -> str:
    return "-" if math.isnan(delay) else "never" if math.isinf(delay) else f"{delay:.0f}"


def _curve(lines: Sequence[Line]) -> tuple[list[list[str]], list[str]] | None:
    """Rows of the curve, a method a row; None where neither scenario is there."""
    by = {(line.scenario, line.method): line for line in lines if line.scores}
    rows = []
    for (scenario, method), line in by.items():
        step = by.get((STEP, method))
        if scenario != CONSTANT or step is None:
            continue
        name = next(iter(line.scores))
        alarms = [one[0] for one in line.scores[name].curve]
        delays = [one[1] for one in step.scores[name].curve]
        rows.append([line.title, *(f"{a:.2g} / {_samples(d)}" for a, d in zip(alarms, delays, strict=True))])
    return (rows, ["method", *(f"{level:g} sd" for level in LEVELS)]) if rows else None


def _rows(lines: Sequence[Line]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for line in lines:
        head = {
            "scenario": line.scenario, "method": line.method, "ok": line.ok, "replicates": line.replicates,
            "micros_median": line.micros[0], "micros_99": line.micros[1], "micros_largest": line.micros[2],
            "held_bytes": line.held_bytes, "message": line.message,
        }  # fmt: skip
        for name, s in line.scores.items():
            after = {f"excess_after_{low}_{high}": v for (low, high), v in zip(AFTER, s.after, strict=True)}
            rows.append(
                {**head, "quantity": name, "excess": s.excess, "rms_pct": s.rms, "share_told": s.share,
                 "coverage_pct": 100.0 * s.coverage, "delay": s.delay, **after}
            )  # fmt: skip
        if not line.scores:
            rows.append(head)
    return rows
