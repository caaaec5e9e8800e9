"""The verb ``reproduce``: run a stored cell again."""

from __future__ import annotations

from collections.abc import Sequence

from bench.commands.stores import DEFAULT, ArchiveFolder, CellIdentity, StoreFolder, named_store, one_cell
from bench.exchange.recomputing import SAME, TOLERANCE, recompute, score_differences, widest_limits
from bench.isolation.machine import usable_cores
from bench.scoring.row import Row
from bench.store.cell import Cell, stored_as_cell
from bench.store.provenance import circumstances
from bench.store.stored_cell import StoredCell

MOST_LISTED = 5
"""Number of scores whose differences are listed."""


def reproduce(
    cell: CellIdentity,
    store: StoreFolder = DEFAULT,
    archive: ArchiveFolder = None,
) -> int:
    """Run a stored cell again and compare it with the stored one, which is not changed.

    identical: every score of every replicate agrees; within tolerance: the differences are too small to show in a
    table; drifted: they are not. Differing scores are listed, with changes of code, packages and machine.
    Exit status: 0, 1 where the cell has drifted, 2 for bad input.
    """
    opened = named_store(store, archive)
    stored = one_cell(opened, cell)
    known = stored_as_cell(stored)
    limits = widest_limits([stored], usable_cores())
    again = recompute([(known, range(known.replicates))], limits)[known.identity]
    verdict, lines = compare(stored, again)
    described, origin = stored.cell, stored.provenance
    commit = str(origin.get("commit"))[:10] + (" with changes" if origin.get("dirty") else "")
    print(
        f"{described['label']} on {described['system']}, {described['snr_db']:g} dB, "
        f"initial state {described['initial_state']}, {len(stored.rows)} replicates, "
        f"computed {origin.get('started')} at commit {commit}"
    )
    print("\n  ".join([f"run again: {verdict}", *lines, *changes(stored, known)]))
    print(opened.location(stored.identity))
    return 1 if verdict == "drifted" else 0


def compare(stored: StoredCell, again: Sequence[Row]) -> tuple[str, list[str]]:
    """Return the verdict on a cell that was run again, and the differences on which it rests."""
    gaps = score_differences(stored.rows, again, stored.rows)
    differing = [item for item in gaps.items() if item[1] > SAME]
    worst = sorted(differing, key=lambda item: -item[1])[:MOST_LISTED]
    lines = [f"{name}: relative difference up to {gap:.1g}" for name, gap in worst]
    pairs = list(zip(stored.rows, again, strict=True))
    changed = [f"replicate {old.replicate} was {old.status}, now {new.status}" for old, new in pairs
               if old.status is not new.status]  # fmt: skip
    largest = max(gaps.values(), default=0.0)
    verdict = "drifted" if largest > TOLERANCE or changed else "within tolerance" if largest > SAME else "identical"
    if other_data := sum(old.data != new.data for old, new in pairs):
        changed.append(f"the data of {other_data} replicate(s) differ in their last digits or more")
    return verdict, lines + changed


def changes(stored: StoredCell, cell: Cell) -> list[str]:
    """List what has changed since a cell was computed: versions, packages, machine."""
    now = circumstances(cell.version)
    then = {**{key: stored.provenance.get(key) for key in now}, **stored.provenance.get("packages", {})}
    versions = cell.version.changed_since(stored.version)
    return ([versions] if versions else []) + [
        f"{name} {then.get(name) or 'absent'}, now {value or 'absent'}"
        for name, value in now.items()
        if then.get(name) != value
    ]
