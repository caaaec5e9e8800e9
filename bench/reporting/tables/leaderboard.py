"""The leaderboard: the one ranking (:mod:`bench.reporting.ranking`) on the open split, on which nothing was tuned."""

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
LEGEND = """On the [open split](open.md): scenarios drawn at random, on which nothing was tuned, one data set each, the
same for all. **Error over bound**: of each fit the root mean square, over the quantities that its data determine, of
error over Cramér-Rao bound; at least 1, for within the bound is luck, and at most {cap:g}; {cap:g} for an outlier fit
(a quantity beyond {gross:g} times its bound), for no answer, and for a refusal of what the method says it serves. Shown
is the geometric mean over the scenarios with its 95 % bootstrap interval; of normal errors on the bound it is about
{on_bound:.2f} (of two quantities). **Tier**: the methods that these scenarios cannot tell apart. The worst is left out
of the first as long as it is farther from the best, and by more than 2 %, than equal methods would be in 95 % of
resamples of the scenarios (a model confidence set); the second is found likewise among the rest, and so on. So equally
good methods share a tier with 95 % probability. A tier has no winner: its methods stand in a fixed order. **Lost**:
fits that count as {cap:g}. A method that does not serve every scenario stands beside the tiers, with the error of the
first tier on the scenarios that it serves. Nyquist: two samples a natural period, on average. Time: processor time of
the median fit that gave an answer."""


def parts(results: Sequence[Result]) -> dict[str, list[Result]]:
    """Return the scenarios with more than two samples a cycle, on average, and the others."""
    beyond = group(results, beyond_nyquist)
    return {part: beyond.get(i == 1, []) for i, part in enumerate(PARTS)}


def beyond_nyquist(result: Result) -> bool:
    """Return whether one mass is sampled no more than twice a natural period on average."""
    p = result.parameters
    return result.samples / result.duration <= math.sqrt(p["k"] / p["m"]) / math.pi


def lines(results: Sequence[Result]) -> list[Line]:
    """Return one line a part and method, the first tier first; those that stand beside the tiers come last."""
    return [
        {"part": part, **asdict(row), "method": row.label, "median_cpu_s": median_time(by_method[row.label])}
        for part, own in parts(results).items()
        for by_method in [group(own, lambda result: result.label)]
        for row in ranking(own)
    ]


def leaderboard(frame: Frame) -> Mapping[str, str]:
    """Return the files by name, from the frame of the open split; none where the store holds no cell of it."""
    if not any(result.stored for result in frame):
        return {}
    data = lines(frame.results)
    shown: list[str | Rows] = ["# Leaderboard", LEGEND.format(cap=CAP, gross=OUTLIER_FACTOR, on_bound=ON_BOUND)]
    for part, own in group(data, lambda line: line["part"]).items():
        shown += [f"## {part[0].upper()}{part[1:]}: {own[0]['scenarios']} scenarios"]
        shown += [listing((line for line in own if line["tier"]), {**TIER, **NAMED, **NUMBERS})]
        beside = [line for line in own if not line["tier"]]
        shown += ["Beside the tiers:", listing(beside, {**NAMED, **SERVED, **NUMBERS})] if beside else []
    too_good = sorted({title(line["method"]) for line in data if line["too_good"]})
    verifications = {result.title: result.verification for result in frame if result.verification}
    shown += [f"Errors are {below(too_good)}." if too_good else ""]
    shown += ["\n".join(f"- {name}: {said}" for name, said in verifications.items())]
    return files("leaderboard", [*shown, frame.footer], data, COLUMNS, 5)


TIER: Columns[Line] = {"tier": lambda line: str(line["tier"])}
NAMED: Columns[Line] = {"method": lambda line: title(line["method"])}
SERVED: Columns[Line] = {
    "serves": lambda line: f"{line['served']} of {line['scenarios']}",
    "first tier there": lambda line: f"{line['first_tier']:.2f}",
}
NUMBERS: Columns[Line] = {
    "error over bound": lambda line: f"{line['typical']:.2f} ({line['low']:.2f} to {line['high']:.2f})",
    "lost": lambda line: f"{line['lost']} of {line['fits']}",
    "time (s)": lambda line: MISSING if math.isnan(line["median_cpu_s"]) else f"{line['median_cpu_s']:.2g}",
}
