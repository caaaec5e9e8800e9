"""The page and the CSV of what was measured; every sentence about a number is made from the number."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
import pandas as pd

from bench.reporting import labels
from bench.reporting.rounding import number
from bench.reporting.tables.render import markdown_table
from tests.studies.engines.peers import Peer
from tests.studies.engines.picture import caption
from tests.studies.engines.results import LARGE, Growth, Result, same_answers
from tests.studies.engines.rivals import SOLVED

TEXT = """Regenerate: `python -m tests.studies.engines` (`before=<folder>` for the times of an earlier checkout beside \
these, in the same run; `rows=<a,b>` for some rows only).

Processor seconds per fit without imports, one thread; each row in separate processes, of this code and of the earlier
in turn, the best of several runs on the same data. Initial state known, nominal prior, 20 dB unless stated otherwise;
chains are those of [chains](chains.md). *Together*: data sets fitted in one call. Limits: {limit:g} s of processor time
a run, and 8 GB of address space. *Largest difference*: of the logarithm of any parameter (or group) between both codes,
over its standard error; of a bound, of its own logarithm. *Memory*: the most that the process held, all its imports
included. Measured on {cores} cores ({machine}), Python {python}, numpy {numpy}."""
RIVALS = """One mass, 20 dB, the data of the first row. The others fit damping and stiffness, with known mass and
initial state, by plain residuals; *scan*: from the initial guess of this project's search, so that only the engines
differ, and without the time of that search; *nominal*: from the prior's nominal values. Ours takes the
prior and the noise into account and gives the covariance, too, and its time has the search for its starts in it.
CasADi's problem is built anew for each record, as one writes it. *Solved*: damping and stiffness over mass within
{solved:g} of our standard errors of our answer. Median over the data sets of the best of two fits."""


def milliseconds(seconds: float) -> str:
    """A time as tables show it: three digits, or all before the point."""
    return number(1e3 * seconds) if not seconds >= 1.0 else f"{1e3 * seconds:.0f}"


def seconds_text(outcome: Any) -> str:
    """A time in ms, or why there is none."""
    if outcome is None:
        return "-"
    if outcome.failure:
        return str(outcome.failure)
    failed = f" ({outcome.failed} of {len(outcome.answers)} without an estimate)" if outcome.failed else ""
    return milliseconds(outcome.best) + failed


@dataclass(frozen=True)
class Study:
    """All that was measured."""

    results: Sequence[Result]
    growths: Sequence[Growth]
    peers: Sequence[Peer]
    limit_s: float


def line(result: Result) -> list[str]:
    """A row of the table."""
    row, now = result.row, result.now
    goal = milliseconds(row.goal_s) + (f", {row.goal_mb:g} MB" if not math.isnan(row.goal_mb) else "")
    held = {True: "yes", False: "no", None: "-"}[result.held]
    return [
        row.title, f"{row.together}", seconds_text(now), goal, held, seconds_text(result.before),
        result.ratio_text, same_answers(result), number(now.peak_mb),
    ]  # fmt: skip


COLUMNS = (
    "what", "together", "time (ms)", "goal (ms)", "held", "before (ms)", "before / now", "largest difference",
    "memory (MB)",
)  # fmt: skip


def said_of_rows(results: Sequence[Result]) -> str:
    """Return how many goals are held, and what became slower."""
    asked = [result for result in results if result.held is not None]
    sentence = f"{sum(bool(result.held) for result in asked)} of {len(asked)} goals are held."
    ratios = [result.ratio for result in results if not math.isnan(result.ratio)]
    if not ratios:
        return sentence
    slower = ", ".join(result.row.title for result in results if result.ratio < 1.0 / LARGE) or "none"
    return (
        f"{sentence} The earlier code takes {min(ratios):.3g} to {max(ratios):.3g} times as long, {median(ratios):.3g} "
        f"in the median of {len(ratios)}; slower now by more than a tenth: {slower}."
    )


def said_of_growth(growths: Sequence[Growth]) -> str:
    """The exponents, what is more than linear and why, and where a curve ends early."""
    lines = ["Exponents of a power law over the upper half of the sizes, as they stand at the lines.", ""]
    for growth in growths:
        curve = growth.curve
        head = f"- {labels.title(curve.method)} against {AXES[curve.axis]}: exponent {growth.exponent:.2f}"
        more = f", more than linear: {curve.more}" if growth.exponent > LARGE else ""
        ended = f"; {growth.failure}" if growth.failure else ""
        lines.append(f"{head}{more}{ended}.")
    return "\n".join(lines)


AXES = {
    "together": "data sets together (time of all)",
    "samples": "samples (time of a fit)",
    "masses": "masses (time of a fit)",
}


def peer_line(peer: Peer, ours: float) -> list[str]:
    """A row of the table of rivals."""
    solved = f"{peer.solved}/{peer.sets}" if peer.sets else "-"
    ratio = peer.seconds / ours
    return [
        peer.title, peer.start, peer.failure or milliseconds(peer.seconds),
        "-" if math.isnan(ratio) else f"{ratio:.3g} ×", solved,
    ]  # fmt: skip


def page(study: Study) -> str:
    """The whole page."""
    text = TEXT.format(
        limit=study.limit_s, cores=os.cpu_count(), machine=platform.machine(), python=platform.python_version(),
        numpy=np.__version__,
    )  # fmt: skip
    parts = ["# What the engines cost", text]
    if study.results:
        table = markdown_table([line(result) for result in study.results], COLUMNS)
        parts += [said_of_rows(study.results), table]
    if study.growths:
        image = "![Time against size](figures/engines_scaling.png)"
        parts += ["## Growth", image, caption(study.growths), said_of_growth(study.growths)]
    if study.peers:
        own = study.peers[0].seconds
        columns = ("engine", "start", "time (ms)", "over ours, alone", "solved")
        table = markdown_table([peer_line(peer, own) for peer in study.peers], columns)
        parts += ["## Other engines", RIVALS.format(solved=SOLVED), table]
    return "\n\n".join(parts) + "\n"


def tidy(study: Study) -> pd.DataFrame:
    """All numbers, one line a measurement."""
    lines: list[dict[str, Any]] = []
    for result in study.results:
        row = result.row
        for code, outcome in (("now", result.now), ("before", result.before)):
            if outcome is not None:
                lines.append({
                    "part": "rows", "name": row.name, "code": code, "size": row.together, "seconds": outcome.best,
                    "first_s": next(iter(outcome.seconds), math.nan), "failure": outcome.failure,
                    "without_estimate": outcome.failed, "evaluations": outcome.evaluations,
                    "goal_s": row.goal_s, "peak_mb": outcome.peak_mb,
                })  # fmt: skip
    for growth in study.growths:
        name = f"{growth.curve.method} {growth.curve.axis}"
        for size, seconds in zip(growth.sizes, growth.seconds, strict=True):
            lines.append({"part": "growth", "name": name, "code": "now", "size": size, "seconds": seconds})
    for peer in study.peers:
        name = f"{peer.name} {peer.start}"
        lines.append({"part": "engines", "name": name, "seconds": peer.seconds, "failure": peer.failure})
    return pd.DataFrame(lines)
