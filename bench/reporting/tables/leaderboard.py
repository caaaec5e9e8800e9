"""The leaderboard: the ranking (:mod:`bench.reporting.ranking`) of methods on the open split."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from bench.reporting.frame import Frame, Line, Result, group
from bench.reporting.labels import title
from bench.reporting.ranking import CAP, ON_BOUND, median_time, ranking
from bench.reporting.tables.render import MISSING, Columns, Rows, files, listing
from bench.reporting.verdict import below
from bench.scoring.summary import OUTLIER_FACTOR

COLUMNS = (
    "part", "method", "tier", "served", "scenarios", "typical", "low", "high", "first_tier", "lost", "fits",
    "median_cpu_s",
)  # fmt: skip
PARTS = ("below Nyquist", "beyond Nyquist")
LEGEND = """The methods on the [open split](open.md): scenarios drawn at random, on which no setting was tuned, with one
data set each; those without an identifiable quantity are left out. **Error over bound**: root mean square, over the
identifiable quantities, of error over Cramér-Rao bound, limited to the range from 1 (a smaller error is chance) to
{cap:g}; shown is the geometric mean over the scenarios, with its 95 % bootstrap interval. Normal errors at the bound
give about {on_bound:.2f} (two quantities). **Outlier fits**: an error beyond {gross:g} times the bound, a failed fit,
or a refusal of data that the method claims to serve; they count as {cap:g}. **Tier**: methods that do not differ
significantly. The first tier is a model confidence set: the worst method is removed as long as it differs from the best
by more than 2 %, and by more than equal methods would in 95 % of resamples of the scenarios; the second tier is the
confidence set of the rest, and so on. Equally good methods share a tier with 95 % probability; within a tier their
order means nothing. A method that does not serve every scenario has no tier; it is listed with the error of the first
tier on the scenarios that it serves. Nyquist: two samples per natural period, on average. Time: median processor time
of a successful fit."""


def parts(results: Sequence[Result]) -> dict[str, list[Result]]:
    """Split scenarios into those with more than two samples per cycle, on average, and the others."""
    split = group(results, beyond_nyquist)
    return {part: split.get(i == 1, []) for i, part in enumerate(PARTS)}


def beyond_nyquist(result: Result) -> bool:
    """Return whether one mass is sampled at most twice per natural period, on average."""
    p = result.parameters
    return result.samples / result.duration <= math.sqrt(p["k"] / p["m"]) / math.pi


def lines(results: Sequence[Result]) -> list[Line]:
    """Return one line per part and method, the first tier first, methods without a tier last."""
    return [
        {"part": part, **asdict(row), "method": row.label, "median_cpu_s": median_time(by_method[row.label])}
        for part, members in parts(results).items()
        for by_method in [group(members, lambda result: result.label)]
        for row in ranking(members)
    ]


def leaderboard(frame: Frame) -> Mapping[str, str]:
    """Return the files of the leaderboard by name, from the frame of the open split; none if nothing is stored."""
    if not any(result.stored for result in frame):
        return {}
    data = lines(frame.results)
    shown: list[str | Rows] = ["# Leaderboard", LEGEND.format(cap=CAP, gross=OUTLIER_FACTOR, on_bound=ON_BOUND)]
    for part, members in group(data, lambda line: line["part"]).items():
        shown += [f"## {part[0].upper()}{part[1:]}: {members[0]['scenarios']} scenarios"]
        shown += [listing((line for line in members if line["tier"]), {**TIER, **NAMED, **NUMBERS})]
        partial = [line for line in members if not line["tier"]]
        heading = "Methods that do not serve every scenario:"
        shown += [heading, listing(partial, {**NAMED, **SERVED, **NUMBERS})] if partial else []
    too_good = sorted({title(line["method"]) for line in data if line["too_good"]})
    verifications = {result.title: result.verification for result in frame if result.verification}
    shown += [f"Errors are {below(too_good)}." if too_good else ""]
    shown += ["\n".join(f"- {name}: {sentence}" for name, sentence in verifications.items())]
    return files("leaderboard", [*shown, frame.footer], data, COLUMNS, 5)


TIER: Columns[Line] = {"tier": lambda line: str(line["tier"])}
NAMED: Columns[Line] = {"method": lambda line: title(line["method"])}
SERVED: Columns[Line] = {
    "serves": lambda line: f"{line['served']} of {line['scenarios']}",
    "first tier there": lambda line: f"{line['first_tier']:.2f}",
}
NUMBERS: Columns[Line] = {
    "error over bound": lambda line: f"{line['typical']:.2f} ({line['low']:.2f} to {line['high']:.2f})",
    "outlier fits": lambda line: f"{line['lost']} of {line['fits']}",
    "time (s)": lambda line: MISSING if math.isnan(line["median_cpu_s"]) else f"{line['median_cpu_s']:.2g}",
}
