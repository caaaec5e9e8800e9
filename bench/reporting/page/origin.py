"""Where the cells come from: commits, packages, machines, and when."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.frame import Result
from bench.reporting.page.reading import decibels
from bench.store.stored import StoredCell


def origin(results: Sequence[Result]) -> list[tuple[str, str]]:
    """Lines for the page: name and text; of several values each with the number of its cells."""
    cells = [result.stored for result in results if result.stored]
    packages: dict[str, Counter[str]] = {}
    for cell in cells:
        for name, version in (cell.provenance.get("packages") or {}).items():
            packages.setdefault(name, Counter())[str(version)] += 1
    commits = Counter(_commit(cell) for cell in cells)
    moments = sorted(
        str(cell.provenance[key]) for cell in cells for key in ("started", "finished") if cell.provenance.get(key)
    )
    cpu = sum(float(np.nansum(cell.columns.numbers("cpu_s"))) for cell in cells)
    fits = sum(len(cell.columns) for cell in cells)
    named = [f"{name} {_several(found)}" for name, found in sorted(packages.items())]
    return [
        (
            "Cells (one method, with its settings, on all data sets of one scenario)",
            f"{len(cells)}, of {fits} fits, {cpu / 60:.0f} minutes of processor time",
        ),
        ("Computed", f"{_moment(moments[0])} to {_moment(moments[-1])} UTC" if moments else "not recorded"),
        ("Commit", _several(commits)),
        ("Machine", _several(Counter(_machine(cell) for cell in cells))),
        ("Packages", ", ".join(named) or "not recorded"),
    ]


def _moment(text: str) -> str:
    return text[:16].replace("T", " ")


def _commit(cell: StoredCell) -> str:
    commit = cell.provenance.get("commit")
    if not commit:
        return "not recorded"
    return str(commit)[:12] + (" with changes" if cell.provenance.get("dirty") else "")


def _machine(cell: StoredCell) -> str:
    p = cell.provenance
    parts = [p.get("processor"), f"{p['cores']} cores" if p.get("cores") else "", p.get("system")]
    parts.append(f"Python {p['python']}" if p.get("python") else "")
    return ", ".join(str(part) for part in parts if part) or "not recorded"


def _several(found: Counter[str]) -> str:
    if len(found) == 1:
        return next(iter(found))
    return "; ".join(f"{value} ({n} cell{'s' if n > 1 else ''})" for value, n in sorted(found.items()))


def unsupported(results: Sequence[Result]) -> list[tuple[int, str, str]]:
    """What was not tried, since a method cannot take such data: how many fits, method, reason; most frequent first."""
    counts = Counter(
        (result.title, message[:200])
        for result in results
        for status, message in zip(result.statuses, result.messages, strict=True)
        if status is Status.UNSUPPORTED
    )
    return sorted(((n, *key) for key, n in counts.items()), key=lambda line: (-line[0], line[1:]))


def failures(results: Sequence[Result]) -> list[tuple[int, str, str, str, str]]:
    """What failed: how often, method, status, scenario's system and noise, message; most frequent first.

    Data that a method cannot take are no failure (:func:`unsupported`).
    """
    counts: Counter[tuple[str, str, str, str]] = Counter()
    for result in results:
        where = f"{result.system}, {decibels(result.snr_db)} dB"
        where += f", {result.disturbance.replace('_', ' ')}" if result.disturbance else ""
        for status, message in zip(result.statuses, result.messages, strict=True):
            if status not in (Status.OK, Status.UNSUPPORTED):
                counts[result.title, status.value, where, message[:200]] += 1
    return sorted(((n, *key) for key, n in counts.items()), key=lambda line: (-line[0], line[1:]))
