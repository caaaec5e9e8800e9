"""Watch a sweep that a run computes, on any machine that shares its store; only the store is read."""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence

from bench.commands.log import LOG
from bench.contract.estimate import Status
from bench.engine.plan import FAILURES, plan
from bench.engine.progress import Progress, progress_bar
from bench.reporting.terminal_tables import described
from bench.store.cell import Cell
from bench.store.locks import active_claims
from bench.store.store import Store

NO_RUN = "no run computes these cells at present, or it still computes the bounds"


def follow(cells: Sequence[Cell], store: Store, retry: Collection[Status], seconds: float) -> None:
    """Show the progress of a sweep until all of its cells are stored.

    Args:
        cells: The cells of the sweep.
        store: The store of the runs that compute it.
        retry: The statuses that these runs try again.
        seconds: Interval between two readings of the store (s).
    """
    planned = plan(cells, store, retry)
    by_identity = {item.cell.identity: item.cell for item in planned}
    sizes = {identity: cell.replicates for identity, cell in by_identity.items()}
    kinds = {identity: (cell.label, cell.scenario.label) for identity, cell in by_identity.items()}
    progress = Progress("fit", sizes, kinds, task="cell")
    stamps = {item.cell.identity: item.stamp if item.run else -1 for item in planned}
    with progress_bar() as on_progress:
        on_progress(progress.state())
        while stamps:
            for identity in [identity for identity, before in stamps.items() if store.stamp(identity) != before]:
                del stamps[identity]
                head = store.head(identity)
                failed = sum(n for name, n in head.statuses.items() if name in FAILURES) if head else 0
                cell = by_identity[identity]
                what = f"{cell.label} on {described(cell.scenario)}"
                on_progress(
                    progress.add(identity, cell.replicates, head.wall_s if head else 0.0, failed=failed, what=what)
                )
            progress.workers = len(active_claims(store.claims).keys() & stamps.keys())
            if stamps and not progress.workers:
                LOG.info(NO_RUN)
            progress.workers = max(1, progress.workers)
            if stamps:
                time.sleep(seconds)
