"""The verb ``status``: stored, failed, stale and missing cells."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import Others
from bench.commands.log import verbose
from bench.commands.stores import DEFAULT, ArchiveFolder, CellIdentity, StoreFolder, named_store, one_cell
from bench.config.overrides import settable
from bench.contract.estimate import Status
from bench.engine.plan import CellState, cell_state, plan, read_retry
from bench.entrants.registry import method_names
from bench.errors import InputError, shortened
from bench.isolation.machine import usable_cores
from bench.reporting.plan_table import listing
from bench.reporting.terminal import table, wrapped
from bench.reporting.terminal_tables import cell_table
from bench.store.cell import Cell, stored_as_cell
from bench.store.store import Store
from bench.store.stored_cell import CellHead
from bench.store.table_versions import read_versions, tables_without_versions
from bench.store.version import described_version
from bench.systems import registered_systems

MOST_REASONS = 3
FOREIGN = "foreign"
"""The state of a cell whose method or system is not installed."""


def standings(store: Store) -> list[tuple[CellHead, str, str]]:
    """Return every stored cell with its state (done, stale, failed, foreign or damaged) and the reason."""
    return [(head, *_state(head)) for head in store.heads()]


def _state(head: CellHead) -> tuple[str, str]:
    if head.problem:
        return CellState.DAMAGED.value, head.problem
    method, system = str(head.cell.get("method")), str(head.cell.get("data", {}).get("system"))
    for kind, name, known in (("method", method, method_names()), ("system", system, registered_systems())):
        if name not in known:
            return FOREIGN, f"no {kind} {name} is installed here"
    try:
        today = described_version(head.cell)
    except InputError as error:  # a setting that no installed package supplies
        return FOREIGN, str(error)
    state, why = cell_state(head, method, today)
    return state.value, why


def store_page(store: Store) -> str:
    """Count the cells of a store by method and state, and state why cells are not current."""
    cells = standings(store)
    if not cells:
        return f"{store.folder}: no cells yet; python -m bench method=ls computes a first one"
    counts = Counter((head.label, state) for head, state, _ in cells)
    total = Counter(state for _, state, _ in cells)
    order = [state for state in (*(s.value for s in CellState), FOREIGN) if total[state]]
    rows = []
    for label in sorted({label for label, _ in counts}):
        heads = [head for head, _, _ in cells if head.label == label]
        fits, spent = sum(head.replicates for head in heads), sum(head.wall_s for head in heads)
        rows.append([label, *(str(counts[label, state] or "") for state in order), str(fits), f"{spent:.0f}"])
    computed = sum(head.stamp > 0 for head, _, _ in cells)
    lines = [
        table(rows, ["method", *order, "fits", "fit s"]), "",
        wrapped(f"{len(cells)} cells: " + ", ".join(f"{total[state]} {state}" for state in order)),
        f"store: {store.folder} ({computed} cells)",
    ]  # fmt: skip
    if store.archive is not None:
        lines.append(f"published archive: {store.archive.folder} ({len(cells) - computed} cells)")
        lines += tables_lines(store.archive.folder.parent)
    for state in (CellState.STALE.value, CellState.FAILED.value, FOREIGN, CellState.DAMAGED.value):
        reasons = Counter(why for _, cell_state, why in cells if cell_state == state)
        for why, n in reasons.most_common(MOST_REASONS):
            labels = sorted({head.label for head, *reason in cells if reason == [state, why]} - {"?"})[:6]
            named = f" ({', '.join(labels)})" if labels else ""
            lines.append(wrapped(f"{state}: {n} x {shortened(why)}{named}", "    ", "  "))
    return "\n".join(lines)


def tables_lines(folder: Path) -> list[str]:
    """Return lines about tables that are not made of cells: how many there are, and which are stale and why."""
    versions, tables_of = read_versions(folder), defaultdict[str, set[str]](set)
    for line in versions:
        if line.changed:
            tables_of[line.changed].add(line.table)
    if not versions:
        return []
    count = len(set().union(*tables_of.values()))
    lines = [f"tracks and atlas: {len({line.table for line in versions})} table(s), {count or 'none'} stale"]
    for why, tables in sorted(tables_of.items()):
        lines.append(wrapped(f"stale: {why} ({', '.join(sorted(tables))})", "    ", "  "))
    if unstated := tables_without_versions(folder, versions):
        lines.append(wrapped(f"computed before tables stated versions: {', '.join(unstated)}", "    ", "  "))
    return lines


def status(
    sweep: Annotated[Sequence[str], Others(settable), "experiment=, method=, ... as for python -m bench -m: a sweep"],
    store: StoreFolder = DEFAULT,
    archive: ArchiveFolder = None,
    cell: Annotated[CellIdentity | None, "show this cell, with its tracebacks"] = None,
) -> int:
    """Show what is stored, failed, stale and missing, and why.

    Without fields of a sweep: the whole store; with them: the cells of the sweep, and what a run would compute.
    """
    if cell:
        opened = named_store(store, archive)
        stored = one_cell(opened, cell)
        print(cell_table(stored_as_cell(stored), stored))
        print(opened.location(stored.identity), stored.tracebacks, sep="\n")
        return 0
    cells = _sweep(sweep) if sweep else None  # first, so that a misspelt field is reported before a missing store
    opened = named_store(store, archive)
    if cells is None:
        print(store_page(opened))
    else:
        planned = plan(cells[0], opened, cells[1])
        print(listing(planned, opened, usable_cores(), every_cell=verbose()))
    return 0


def _sweep(fields: Sequence[str]) -> tuple[list[Cell], frozenset[Status]]:
    """Return the cells of a sweep, and the statuses that it tries again."""
    from bench.config.experiment import expand

    jobs = expand(fields, multirun=True)
    return [job.cell() for job in jobs], read_retry(jobs[0].config.retry)
