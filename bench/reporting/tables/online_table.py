"""Table 10: the online track, how trackers follow parameters that change, beside the bound along the path."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

from bench.online.score import AFTER, LEVELS, SCORED_FROM, Score
from bench.reporting.frame import Line, group
from bench.reporting.rounding import answered, excess_text, number, percent, readable
from bench.reporting.tables.render import MISSING, Columns, Rows, files, listing, panel

BEHIND = tuple(f"excess_after_{low}_{high}" for low, high in AFTER)
COLUMNS = (
    "scenario", "method", "quantity", "excess", "rms_pct", "share_told", "coverage_pct", *BEHIND, "delay", "ok",
    "replicates", "micros_median", "micros_99", "micros_largest", "held_bytes", "message",
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
NOTHING: Line = {"ok": 0, "replicates": 0, "held_bytes": 0, "message": ""}


def tracked(what: Line, scores: Mapping[str, Score]) -> list[Line]:
    """A line a quantity of a method on a scenario; ``what`` says which, with its title, counts and costs."""
    return [
        {
            **NOTHING, **what, "quantity": name, "excess": one.excess, "rms_pct": one.rms, "share_told": one.share,
            "coverage_pct": 100.0 * one.coverage, "delay": one.delay, "curve": one.curve,
            **dict(zip(BEHIND, one.after, strict=True)),
        }
        for name, one in scores.items()
    ]  # fmt: skip


def table(lines: Sequence[Line], described: Mapping[str, str], command: str) -> Mapping[str, str]:
    """The files of the table by name; a method that has no scores on a scenario is a line with a message."""
    parts: list[str | Rows] = [HEAD]
    for scenario, sentence in described.items():
        own = [line for line in lines if line["scenario"] == scenario]
        parts += [f"## {readable(scenario)}", sentence]
        shown = [line for line in own if "quantity" in line]
        if len({line["method"] for line in shown}) > 1:
            parts += [_panel(shown), best_sentence(shown)]
        refused = group((line for line in own if "quantity" not in line), lambda line: line["message"])
        parts += [f"Not there: {', '.join(one['title'] for one in its)}: {said}." for said, its in refused.items()]
    found = _curve(lines)
    parts += ["## Delay against false alarms", CURVE, found] if found[0] else []
    return files("table10", [*parts, f"Regenerate: `{command}`"], ({**NOTHING, **one} for one in lines), COLUMNS)


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
    methods = group(lines, lambda line: line["method"])
    bound = methods.pop(BOUND, None)
    most, n = max(own[0]["ok"] for own in methods.values()), len({line["quantity"] for line in lines})
    asked = [own for own in methods.values() if own[0]["ok"] == most]
    best = min(asked, key=lambda own: max(map(_size, own)) if len(own) == n else math.inf)
    excesses = ", ".join(f"{readable(one['quantity'])} {excess_text(one['excess'])}" for one in best)
    said = f"Nearest to the bound, by the farther of its quantities: **{best[0]['title']}** (excess: {excesses})."
    delay = best[0]["delay"]
    if bound is not None and not math.isnan(delay):
        said += f" Its delay is {_samples(delay)} samples, the bound's {_samples(bound[0]['delay'])}."
    return said


def _size(line: Line) -> float:
    return line["excess"] if math.isfinite(line["excess"]) else math.inf


def _panel(lines: Sequence[Line]) -> Rows:
    """The bound, then the methods by their excess in the first quantity."""
    first = lines[0]["quantity"]
    sizes = {line["method"]: _size(line) for line in lines if line["quantity"] == first}
    stepped: Columns[Sequence[Line]] = {}
    if any(math.isfinite(line[BEHIND[0]]) for line in lines):
        named = {f"{readable(first)} after {low}-{high}": name for name, (low, high) in zip(BEHIND, AFTER, strict=True)}
        after = {heading: partial(_after, name) for heading, name in named.items()}
        stepped = {**after, "delay": lambda own: _samples(own[0]["delay"])}
    return panel(
        lines,
        lambda line: line["method"],
        {"method": lambda own: own[0]["title"]},
        lambda line: line["quantity"],
        lambda line: _quantity(line["quantity"], line["quantity"] == first),
        {**stepped, **COSTS},
        order=lambda methods: sorted(methods, key=lambda name: (name != BOUND, sizes.get(name, math.inf))),
    )


def _quantity(name: str, with_error: bool) -> Columns[Line]:
    error: Columns[Line] = {f"{readable(name)} rms %": lambda line: number(line["rms_pct"])}
    return {
        **(error if with_error else {}),
        f"{readable(name)} excess": lambda line: excess_text(line["excess"]),
        "told": lambda line: f"{line['share_told']:.2f}",
        "cov. %": lambda line: percent(line["coverage_pct"] / 100.0),
    }


def _after(column: str, own: Sequence[Line]) -> str:
    return excess_text(own[0][column])


def _micros(own: Sequence[Line]) -> str:
    line = own[0]
    return MISSING if line["method"] == BOUND else f"{line['micros_median']:.0f} / {line['micros_99']:.0f}"


def _held(own: Sequence[Line]) -> str:
    if own[0]["method"] == BOUND:
        return MISSING
    return "<0.1" if own[0]["held_bytes"] < 100 else f"{own[0]['held_bytes'] / 1000:.1f}"


COSTS: Columns[Sequence[Line]] = {
    "µs": _micros,
    "kB held": _held,
    "ok": lambda own: answered(own[0]["ok"], own[0]["replicates"]),
}


def _samples(delay: float) -> str:
    return "-" if math.isnan(delay) else "never" if math.isinf(delay) else f"{delay:.0f}"


def _curve(lines: Iterable[Line]) -> Rows:
    """A method a row, of those that have both scenarios; the first quantity of each."""
    first = {(own[0]["scenario"], own[0]["method"]): own[0] for own in _by_method(lines)}
    pairs = [
        (line, first[STEP, method])
        for (scenario, method), line in first.items()
        if scenario == CONSTANT and (STEP, method) in first
    ]
    levels: Columns[tuple[Line, Line]] = {f"{level:g} sd": partial(_alarms, i) for i, level in enumerate(LEVELS)}
    return listing(pairs, {"method": lambda pair: pair[0]["title"], **levels})


def _by_method(lines: Iterable[Line]) -> Iterable[list[Line]]:
    scored = (line for line in lines if "quantity" in line)
    return group(scored, lambda line: (line["scenario"], line["method"])).values()


def _alarms(i: int, pair: tuple[Line, Line]) -> str:
    constant, step = (line["curve"][i] for line in pair)
    return f"{constant[0]:.2g} / {_samples(step[1])}"
