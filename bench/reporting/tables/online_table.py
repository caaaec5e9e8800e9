"""Table 10: the online track, how trackers follow parameters that change, beside the bound along the path."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.online.score import AFTER, LEVELS, SCORED_FROM, Score
from bench.reporting.rounding import number, readable
from bench.reporting.tables.common import csv, markdown_table

COLUMNS = (
    "scenario", "method", "quantity", "excess", "rms_pct", "share_told", "coverage_pct",
    *(f"excess_after_{low}_{high}" for low, high in AFTER), "delay", "ok", "replicates", "micros_median", "micros_99",
    "micros_largest", "held_bytes", "message",
)  # fmt: skip
HEAD = f"""# Table 10. The online track

Parameters that change, followed sample by sample from the past alone. **excess**: root mean square error of the
logarithm over the posterior Cramér-Rao bound along the path, pooled over samples and replicates behind the first
{SCORED_FROM:.0%} of the record; 1 is the best that can be expected of who is told when something may change, which no
tracker is. **told**: the part of those samples for which there is a belief at all. **cov.**: 95 % intervals that hold
the truth. **after**: excess by samples since a step. **delay**: median samples from a step until the 95 % interval
excludes the old value. **µs**: median and 99 % wall time of a sample, on the machine that made the table. A method that
cannot take a scenario says why below it."""


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
        if shown:
            parts.append(markdown_table(*_panel(shown)))
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


CURVE = """Where the interval is wider or narrower than 95 %: false alarms in 1,000 samples of the constant multisine
record (times that the interval begins to exclude the true value), and median delay (samples) behind the step of -10 %
under a multisine, by the half-width of the interval in standard deviations."""
CONSTANT, STEP = "constant_multisine", "step10_multisine"


def _panel(lines: Sequence[Line]) -> tuple[list[list[str]], list[str]]:
    quantities = list(dict.fromkeys(name for line in lines for name in line.scores))
    stepped = any(math.isfinite(s.after[0]) for line in lines for s in line.scores.values())
    headers = ["method"]
    for name in quantities:
        headers += [f"{readable(name)} excess", "told", "cov. %"]
    if stepped:
        headers += [f"{readable(quantities[0])} after {low}-{high}" for low, high in AFTER] + ["delay"]
    headers += ["µs", "kB held", "ok"]
    rows = []
    for line in sorted(lines, key=lambda line: _best(line, quantities[0])):
        row = [line.title]
        for name in quantities:
            s = line.scores.get(name)
            row += ["-"] * 3 if s is None else [number(s.excess), f"{s.share:.2f}", f"{100 * s.coverage:.0f}"]
        if stepped:
            s = line.scores[quantities[0]]
            row += [number(value) for value in s.after] + [_samples(s.delay)]
        size = "<0.1" if line.held_bytes < 100 else f"{line.held_bytes / 1000:.1f}"
        rows.append([*row, f"{line.micros[0]:.0f} / {line.micros[1]:.0f}", size, f"{line.ok}/{line.replicates}"])
    return rows, headers


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
