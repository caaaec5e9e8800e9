"""``python -m bench.recheck``: which stale cells does a change of the code leave as they are?

A cell is stale when any module that computes it has changed. Where the change was meant to alter nothing, this runs
the first replicates of each stale cell again and compares them with the stored ones, every score to the digits that
are stored. Where all are the same, the cell counts as computed by the present code, and its provenance says by what it
was computed, and on how many replicates the two were compared. Where any differs, or any replicate had failed, the
cell stays stale, for a sweep to compute.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bench.cell import Cell
from bench.cli import read_fields, whole
from bench.errors import InputError
from bench.estimate import Status
from bench.launch import complete
from bench.plan import FAILURES
from bench.reproduce import compare, stored_as_cell
from bench.slots import Limits
from bench.store import Store, StoredCell
from bench.store_archive.opening import DEFAULT_STORE, open_store
from bench.terminal import command

USAGE = f"usage: python -m bench.recheck [replicates=2] [store={DEFAULT_STORE}] [archive=<folder>|none]\n\n"


def stale_cells(store: Store) -> list[tuple[StoredCell, Cell]]:
    """The stored cells that other code computed, none of whose replicates failed, as this version describes them."""
    found = []
    for stored in store:
        if any(row.status in FAILURES or row.status is Status.MISSING_DEPENDENCY for row in stored.rows):
            continue
        try:
            cell = stored_as_cell(stored)
        except InputError:
            continue  # its configuration means something else now
        if cell.version.digest != stored.version.get("digest"):
            found.append((stored, cell))
    return found


def first_replicates(pairs: Sequence[tuple[StoredCell, Cell]], n: int, store: Store, folder: Path) -> Store:
    """The first ``n`` replicates of the cells, computed by the present code into a store of their own."""
    fresh = Store(folder / "rows")
    fresh.prepare()
    if store.bounds.is_dir():
        shutil.copytree(store.bounds, fresh.bounds, dirs_exist_ok=True)
    if store.archive is not None:
        Store(fresh.folder, store.archive).fetch_bounds(store.archive.bounds().keys())
    complete([shortened(cell, n) for _, cell in pairs], fresh, Limits(os.cpu_count() or 1, 600.0))
    return fresh


def shortened(cell: Cell, n: int) -> Cell:
    """The same question for the first replicates alone: their data do not depend on how many there are."""
    return replace(cell, replicates=min(n, cell.replicates))


def confirmed(stored: StoredCell, cell: Cell, again: StoredCell | None) -> StoredCell | None:
    """The cell as one of the present code, where its first replicates came out the same; else None."""
    if again is None:
        return None
    n = len(again.rows)
    if compare(replace(stored, rows=stored.rows[:n]), again).name != "identical":
        return None
    note = {"replicates": n, "computed_by": stored.version.get("digest"), "commit": again.provenance.get("commit")}
    before = [*stored.provenance.get("rechecked", []), note]
    return replace(stored, version=again.version, provenance={**stored.provenance, "rechecked": before})


def main(argv: Sequence[str] | None = None) -> int:
    """Print how many cells were confirmed, and which were not; exit status 2 for bad input."""
    return command("bench.recheck", USAGE + str(__doc__), argv, _main, "interrupted; nothing was changed")


def _main(arguments: Sequence[str]) -> int:
    fields = read_fields(arguments, {"replicates": "2", "store": DEFAULT_STORE, "archive": ""})
    n, store = whole("replicates", fields["replicates"]), open_store(fields["store"], fields["archive"])
    if not store.there():
        raise InputError("store", store.folder, "there is no such folder; run some cells first")
    pairs = stale_cells(store)
    if not pairs:
        print("no cell is stale")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        _keep(pairs, n, store, first_replicates(pairs, n, store, Path(folder)))
    return 0


def _keep(pairs: Sequence[tuple[StoredCell, Cell]], n: int, store: Store, fresh: Store) -> None:
    """Store what is confirmed, and say what is not."""
    kept = 0
    for stored, cell in pairs:
        found = confirmed(stored, cell, fresh.load(shortened(cell, n).identity))
        if found is None:
            where = f"{stored.cell['label']} on {stored.cell['system']}, {stored.cell['snr_db']:g} dB"
            print(f"{stored.identity[:8]}  {where}: comes out otherwise, and stays stale")
            continue
        store.restate(found)
        kept += 1
    print(f"{len(pairs)} stale cells: {kept} come out the same in their first {n} replicates, and are kept")


if __name__ == "__main__":
    sys.exit(main())
