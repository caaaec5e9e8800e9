"""The verb ``reproduce``: a stored cell run again."""

from __future__ import annotations

from collections.abc import Sequence

from bench.commands.stores import OWN, ArchiveFolder, CellIdentity, StoreFolder, named_store, one_cell
from bench.exchange.comparison import SAME_DIGITS, TOLERANCE, score_differences
from bench.exchange.recomputing import recompute, widest_limits
from bench.isolation.machine import usable_cores
from bench.scoring.row import Row
from bench.store.cell import Cell, stored_as_cell
from bench.store.provenance import circumstances
from bench.store.stored import StoredCell

MOST_NAMED = 5


def reproduce(
    cell: CellIdentity,
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
) -> int:
    """Run a stored cell again and compare it with the stored one.

    identical: every score of every replicate agrees; within tolerance: no difference shows in a table; drifted: it
    does, and the worst scores are named, with changes of code, packages and machine. The stored cell is left as it is.
    Exit status: 0, 1 where the cell has drifted, 2 for bad input.
    """
    opened = named_store(store, archive)
    stored = one_cell(opened, cell)
    known = stored_as_cell(stored)
    limits = widest_limits([stored], usable_cores())
    again = recompute([(known, range(known.replicates))], limits)[known.identity]
    verdict, lines = compare(stored, again)
    what, come = stored.cell, stored.provenance
    commit = str(come.get("commit"))[:10] + (" with changes" if come.get("dirty") else "")
    print(
        f"{what['label']} on {what['system']}, {what['snr_db']:g} dB, initial state {what['initial_state']}, "
        f"{len(stored.rows)} replicates, computed {come.get('started')} at commit {commit}"
    )
    print("\n  ".join([f"run again: {verdict}", *lines, *changes(stored, known)]))
    print(opened.whereabouts(stored.identity))
    return 1 if verdict == "drifted" else 0


def compare(stored: StoredCell, again: Sequence[Row]) -> tuple[str, list[str]]:
    """Return the verdict on a cell that was run again, and the differences that lead to it."""
    gaps = score_differences(stored.rows, again, stored.rows)
    worst = sorted((item for item in gaps.items() if item[1] > 0), key=lambda item: -item[1])[:MOST_NAMED]
    lines = [f"{name}: relative difference up to {gap:.1g}" for name, gap in worst]
    pairs = list(zip(stored.rows, again, strict=True))
    changed = [f"replicate {old.replicate} was {old.status}, now {new.status}" for old, new in pairs
               if old.status is not new.status]  # fmt: skip
    largest = max(gaps.values(), default=0.0)
    verdict = (
        "drifted" if largest > TOLERANCE or changed else "within tolerance" if largest > SAME_DIGITS else "identical"
    )
    if other_data := sum(old.data != new.data for old, new in pairs):
        changed.append(f"the data of {other_data} replicate(s) differ in their last digits or more")
    return verdict, lines + changed


def changes(stored: StoredCell, cell: Cell) -> list[str]:
    """Describe what has changed since a cell was computed: versions, packages, machine."""
    now = circumstances(cell.version)
    then = {**{key: stored.provenance.get(key) for key in now}, **stored.provenance.get("packages", {})}
    versions = cell.version.changed_since(stored.version)
    return ([versions] if versions else []) + [
        f"{name} {then.get(name) or 'absent'}, now {value or 'absent'}"
        for name, value in now.items()
        if then.get(name) != value
    ]
