"""The verb ``status``: what is stored, failed, stale and missing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from bench.commands.declaration import Others, Within
from bench.commands.stores import OWN, ArchiveFolder, CellIdentity, StoreFolder, named_store, one_cell
from bench.commands.watch import follow
from bench.config.overrides import settable
from bench.contract.estimate import Status
from bench.engine.plan import State, plan, read_retry, standing
from bench.entrants.registry import method_names
from bench.errors import InputError
from bench.isolation.machine import usable_cores
from bench.reporting.plan_table import listing
from bench.reporting.terminal import table, wrapped
from bench.reporting.terminal_tables import cell_table
from bench.store.cell import Cell, stored_as_cell
from bench.store.store import Store
from bench.store.stored import Head
from bench.store.version import cell_version
from bench.systems import registered_systems

MOST_REASONS = 3
FOREIGN = "foreign"
"""The state of a cell whose method or system is not installed."""


@dataclass(frozen=True)
class Standing:
    """A stored cell, where it stands and why."""

    head: Head
    state: str
    why: str


def standings(store: Store) -> list[Standing]:
    """Say of every stored cell whether it is current, stale, failed, foreign or damaged."""
    return [Standing(head, *_standing(head)) for head in store.heads()]


def _standing(head: Head) -> tuple[str, str]:
    if head.problem:
        return State.DAMAGED.value, head.problem
    method, system = str(head.cell.get("method")), str(head.cell.get("data", {}).get("system"))
    if method not in method_names():
        return FOREIGN, f"no method {method} is installed here"
    if system not in registered_systems():
        return FOREIGN, f"no system {system} is installed here"
    state, why = standing(head, method, cell_version(method, system))
    return state.value, why


def store_page(store: Store) -> str:
    """Describe the store by method and state, with the reasons of what is not current."""
    found = standings(store)
    if not found:
        return f"{store.folder}: no cells yet; python -m bench method=ls computes a first one"
    total = Counter(one.state for one in found)
    order = [name for name in (*(s.value for s in State), FOREIGN) if total[name]]
    rows = []
    for label in sorted({one.head.label for one in found}):
        own = [one for one in found if one.head.label == label]
        counts = Counter(one.state for one in own)
        fits, spent = sum(one.head.replicates for one in own), sum(one.head.wall_s for one in own)
        rows.append([label, *(str(counts[name] or "") for name in order), str(fits), f"{spent:.0f}"])
    said = f"{len(found)} cells: " + ", ".join(f"{total[name]} {name}" for name in order)
    lines = [table(rows, ["method", *order, "fits", "fit s"]), "", wrapped(said), *_places(found, store)]
    return "\n".join([*lines, *_reasons(found)])


def _places(found: Sequence[Standing], store: Store) -> list[str]:
    """Say which folders the cells lie in."""
    if store.archive is None:
        return [f"store: {store.folder}"]
    own = sum(one.head.stamp > 0 for one in found)
    return [
        f"store: {store.folder} ({own} cells)",
        f"published archive: {store.archive.folder} ({len(found) - own} cells)",
    ]


def _reasons(found: Sequence[Standing]) -> list[str]:
    lines = []
    for state in (State.STALE.value, State.FAILED.value, FOREIGN, State.DAMAGED.value):
        reasons = Counter(one.why for one in found if one.state == state)
        for why, n in reasons.most_common(MOST_REASONS):
            labels = sorted({one.head.label for one in found if one.state == state and one.why == why} - {"?"})[:6]
            said = f"{state}: {n} x {_short(why)}" + (f" ({', '.join(labels)})" if labels else "")
            lines.append(wrapped(said, "    ", "  "))
    return lines


def _short(text: str) -> str:
    return text if len(text) <= 160 else f"{text[:157]}..."


def status(
    sweep: Annotated[Sequence[str], Others(settable), "experiment=, method=, ... as for python -m bench -m: a sweep"],
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
    watch: Annotated[float | None, Within(ge=0.1, le=3600), "seconds between two looks: follow a running sweep"] = None,
    cell: Annotated[CellIdentity | None, "show this cell, with its tracebacks"] = None,
) -> int:
    """Show what is stored, failed, stale and missing, and why.

    Without a sweep: the store. With one: its cells, and what a run would compute. Nothing is computed.
    """
    if cell:
        opened = named_store(store, archive)
        stored = one_cell(opened, cell)
        print(cell_table(stored_as_cell(stored), stored))
        print(opened.whereabouts(stored.identity), stored.tracebacks, sep="\n")
        return 0
    if watch and not sweep:
        raise InputError("watch", watch, "name the sweep: experiment=<name>, or its fields")
    cells = _sweep(sweep) if sweep else None  # first, so that a misspelt field is named whatever the store is
    opened = named_store(store, archive)
    if cells is None:
        print(store_page(opened))
    elif watch:
        follow(cells[0], opened, cells[1], watch)
    else:
        print(listing(plan(cells[0], opened, cells[1]), opened, usable_cores()))
    return 0


def _sweep(fields: Sequence[str]) -> tuple[list[Cell], frozenset[Status]]:
    """The cells of a sweep, and the failures that it tries again."""
    from bench.config.experiment import expand

    jobs = expand(fields, multirun=True)
    return [job.cell() for job in jobs], read_retry(jobs[0].config.retry)
