"""The verb ``reproduce``: a stored cell run again."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from bench.commands.stores import OWN, ArchiveFolder, StoreFolder, cell_identity, named_store
from bench.engine.pool import Limits
from bench.errors import InputError
from bench.exchange.comparison import Verdict, compare_rows
from bench.isolation.cores import usable_cores
from bench.store.cell import stored_as_cell
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.sweep.launch import complete

MOST_NAMED = 5


def compare(old: StoredCell, new: StoredCell) -> Verdict:
    """How a cell that was run again compares with the stored one: statuses, scores, data, and what computed them."""
    verdict = compare_rows(old.rows, new.rows)
    return replace(verdict, changed=(*verdict.changed, *_circumstances(old, new)))


def _circumstances(old: StoredCell, new: StoredCell) -> list[str]:
    lines = [
        f"{name} version {old.version.get(name)}, now {number}"
        for name, number in new.version.items()
        if old.version.get(name) != number
    ]
    then, now = (cell.provenance.get("packages", {}) for cell in (old, new))
    for name in sorted({*then, *now}):
        if then.get(name) != now.get(name):
            lines.append(f"{name} {then.get(name) or 'absent'}, now {now.get(name) or 'absent'}")
    for field in ("python", "system", "processor"):
        before, after = old.provenance.get(field), new.provenance.get(field)
        if before != after:
            lines.append(f"{field} {before}, now {after}")
    return lines


def find(store: Store, text: str) -> StoredCell:
    """The stored cell whose identity starts so; raises InputError for none or several."""
    found = [identity for identity in store.identities() if identity.startswith(text)]
    if len(found) != 1:
        reason = "no such cell" if not found else f"{len(found)} cells start so"
        raise InputError("cell", text, f"{reason} in {store.folder}; python -m bench status lists what is stored")
    stored = store.load(found[0])
    assert stored is not None
    return stored


def run_again(stored: StoredCell) -> StoredCell:
    """Run a stored cell again in a store of its own."""
    cell = stored_as_cell(stored)
    limits = stored.provenance.get("limits", {})
    with tempfile.TemporaryDirectory() as folder:
        fresh = Store(Path(folder) / "rows")
        fresh.prepare()
        complete([cell], fresh, Limits(usable_cores(), limits.get("timeout_s", 600.0)))
        again = fresh.load(cell.identity)
    assert again is not None
    return again


def page(stored: StoredCell, verdict: Verdict) -> str:
    """The verdict in a few lines."""
    what, come = stored.cell, stored.provenance
    commit = str(come.get("commit"))[:10] + (" with changes" if come.get("dirty") else "")
    lines = [
        f"{what['label']} on {what['system']}, {what['snr_db']:g} dB, initial state {what['initial_state']}, "
        f"{len(stored.rows)} replicates, computed {come.get('started')} at commit {commit}",
        f"run again: {verdict.name}",
    ]
    worst = sorted(verdict.differences.items(), key=lambda item: -item[1])[:MOST_NAMED]
    lines += [f"  {name}: relative difference up to {gap:.1g}" for name, gap in worst]
    return "\n".join([*lines, *(f"  {text}" for text in verdict.changed)])


def reproduce(
    cell: Annotated[str, cell_identity, "identity of a stored cell, or its start"],
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
) -> int:
    """Run a stored cell again and compare it with the stored one.

    identical: every score of every replicate agrees; within tolerance: no difference shows in a table; drifted: it
    does, and the worst scores are named, with changes of code, packages and machine. The stored cell is left as it is.
    Exit status: 0, 1 where the cell has drifted, 2 for bad input.
    """
    opened = named_store(store, archive)
    stored = find(opened, cell)
    verdict = compare(stored, run_again(stored))
    print(page(stored, verdict))
    print(opened.whereabouts(stored.identity))
    return 1 if verdict.name == "drifted" else 0
