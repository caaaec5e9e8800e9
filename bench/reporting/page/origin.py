"""Where the cells come from, whether they are current, and what failed."""

from __future__ import annotations

import subprocess
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from bench.contract.estimate import Status
from bench.errors import InputError
from bench.reporting.frame import Result
from bench.reporting.page.reading import decibels
from bench.store.stored import StoredCell
from bench.store.version import settings_version


def origin(results: Sequence[Result]) -> list[tuple[str, str, str]]:
    """Lines for the page: name, text, and what is behind it, folded; of several values each with its cells."""
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
    older = Counter(filter(None, map(changed, cells)))
    machines = Counter(_machine(cell) for cell in cells)
    return [
        ("Results", f"{len(cells):,} cells (a method with its settings on the data sets of a scenario), {fits:,} fits, "
         f"{cpu / 3600:.1f} hours of processor time", ""),
        ("Stale", f"{older.total():,} of {len(cells):,} cells were computed by another version of their "
         "method, system or scoring than today's", _several(older)),
        ("Computed", f"{_moment(moments[0])} to {_moment(moments[-1])} UTC" if moments else "not recorded", ""),
        ("Commits", _commits(cells), _several(commits)),
        ("Machines", str(len(machines)), _several(machines)),
        ("Packages", ", ".join(sorted(packages)) or "not recorded",
         ", ".join(f"{name} {_several(found)}" for name, found in sorted(packages.items()))),
    ]  # fmt: skip


def changed(cell: StoredCell) -> str:
    """Which version has changed since a cell was computed; nothing where none has."""
    method, system = str(cell.cell.get("method")), str((cell.cell.get("data") or {}).get("system"))
    try:
        return settings_version(method, system, cell.cell.get("settings", {})).changed_since(cell.version)
    except InputError:
        return "not installed here"


def _commits(cells: Sequence[StoredCell]) -> str:
    """How many commits, and how many of them the repository of this checkout holds."""
    named = sorted({str(cell.provenance["commit"]) for cell in cells if cell.provenance.get("commit")})
    done = None
    with suppress(OSError):
        command = ["git", "cat-file", "--batch-check"]
        done = subprocess.run(
            command, input="\n".join(named), text=True, capture_output=True, cwd=Path(__file__).parent
        )
    if done is None or done.returncode:
        return str(len(named))
    there = sum(line.split()[1] == "commit" for line in done.stdout.splitlines())
    return f"{len(named)}, of which this repository holds {there}"


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
