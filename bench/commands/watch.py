"""A sweep followed while a run computes it, on any machine that shares the store: only the store is looked at."""

from __future__ import annotations

import sys
import time
from collections.abc import Collection, Sequence

from bench.contract.estimate import Status
from bench.engine.plan import FAILURES, plan
from bench.engine.progress import Progress, progress_bar
from bench.reporting.terminal_tables import described
from bench.store.cell import Cell
from bench.store.locks import under_way
from bench.store.store import Store

NO_RUN = "bench: no run is at work on it, or one has just begun: bounds come before the first cell"


def follow(cells: Sequence[Cell], store: Store, retry: Collection[Status], seconds: float) -> None:
    """Show how far a sweep is, as a run shows it, until all of its cells are stored.

    Args:
        cells: the sweep.
        store: where its runs keep cells.
        retry: the failures that its runs try again.
        seconds: between two looks.
    """
    planned = plan(cells, store, retry)
    by_identity = {item.cell.identity: item.cell for item in planned}
    sizes = {identity: cell.replicates for identity, cell in by_identity.items()}
    kinds = {identity: (cell.label, cell.scenario.label) for identity, cell in by_identity.items()}
    progress = Progress("fit", sizes, kinds, task="cell")
    stamps = {item.cell.identity: item.stamp if item.run else -1 for item in planned}
    with progress_bar() as on_look:
        on_look(progress.look())
        while stamps:
            for identity in [identity for identity, before in stamps.items() if store.stamp(identity) != before]:
                del stamps[identity]
                head = store.head(identity)
                failed = sum(n for name, n in head.statuses.items() if name in FAILURES) if head else 0
                cell = by_identity[identity]
                what = f"{cell.label} on {described(cell.scenario)}"
                on_look(progress.add(identity, cell.replicates, head.wall_s if head else 0.0, failed=failed, what=what))
            progress.workers = len(under_way(store.claims).keys() & stamps.keys())
            if stamps and not progress.workers:
                print(NO_RUN, file=sys.stderr)
            progress.workers = max(1, progress.workers)
            if stamps:
                time.sleep(seconds)
