"""Merge the cells of a submission, or of another store, into a store."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.engine.pool import Limits
from bench.entrants.registry import registered
from bench.errors import InputError
from bench.exchange.recomputing import SAME, difference, miss_probability, recompute
from bench.information.fisher import Bound
from bench.scoring.summary import summarise
from bench.store.cell import Cell, stored_as_cell
from bench.store.store import Store
from bench.store.stored_cell import StoredCell

LEAST_ROWS = 5
OF_MACHINE = (Status.TIMEOUT, Status.KILLED, Status.OOM)
"""Statuses that depend on the machine; their rows are not compared."""
MOST_NAMED = 5
Pair = tuple[StoredCell, Cell]


def understood(stored: StoredCell, manifest: Mapping[str, Any], path: Path) -> Cell:
    """Return the cell of a submitted result.

    Raises InputError if the submission is of another method, or cannot be recomputed by this installation.
    """

    def refused(reason: str) -> InputError:
        return InputError("submission", path, f"cell {stored.identity[:8]} {reason}")

    method = manifest.get("method")
    if stored.cell.get("method") != method:
        raise refused(f"is of {stored.cell.get('method')}, the submission of {method}; have it sent again")
    try:
        cell = stored_as_cell(stored)
    except InputError as error:
        raise refused(f"means nothing here: {error}") from None
    here = registered()[cell.method].value if cell.method in registered() else "a reference row"
    if manifest.get("class", here) != here:
        named = manifest["class"]
        raise refused(f"was computed by {named}, and {cell.method} is {here} here; install what computed it")
    if not cell.version.matches(stored.version):
        changes = cell.version.changed_since(stored.version)
        raise refused(f"has {changes}; install the method and the benchmark that computed it")
    if [row.replicate for row in stored.rows] != list(range(cell.replicates)):
        raise refused(f"lacks some of its {cell.replicates} rows")
    return cell


@dataclass(frozen=True)
class Verification:
    """Result of a verification: recomputed rows by cell, largest relative difference, and cells that differ."""

    compared: Mapping[str, tuple[int, ...]]
    of: int
    largest: float
    different: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of recomputed rows."""
        return sum(map(len, self.compared.values()))

    def facts(self) -> dict[str, Any]:
        """Return the facts that a merged cell stores on its verification."""
        return {
            "rows_compared": self.n, "of_rows": self.of, "largest_difference": float(f"{self.largest:.2g}"),
            "missed_5_percent": miss_probability(self.of, self.n),
        }  # fmt: skip

    def __str__(self) -> str:
        again = f"{self.n} of {self.of} rows computed again"
        if self.different:
            named = "; ".join(self.different[:MOST_NAMED])
            return f"{again}: {len(self.different)} cells come out otherwise ({named})"
        missed = miss_probability(self.of, self.n)
        same = f"{again}, and all come out the same (to {self.largest:.1g})"
        return f"{same}; a change of 5 % of the rows is missed with probability {missed:.2g}"


def draw(pairs: Sequence[Pair], share: float, seed: int) -> dict[str, tuple[int, ...]]:
    """Draw the rows to recompute, by cell: a share of all rows, at least five, each with equal probability."""
    rows = [(stored.identity, row.replicate) for stored, _ in pairs for row in stored.rows
            if row.status not in OF_MACHINE]  # fmt: skip
    n = min(len(rows), max(LEAST_ROWS, math.ceil(share * len(rows))))
    drawn: dict[str, tuple[int, ...]] = {}
    for i in sorted(np.random.default_rng(seed).choice(len(rows), n, replace=False).tolist()):
        identity, replicate = rows[i]
        drawn[identity] = (*drawn.get(identity, ()), replicate)
    return drawn


def verified(pairs: Sequence[Pair], share: float, seed: int, limits: Limits) -> Verification:
    """Recompute some of the rows, and compare every score that does not depend on the speed of the machine."""
    chosen = draw(pairs, share, seed)
    rows = recompute([(cell, chosen[cell.identity]) for _, cell in pairs if cell.identity in chosen], limits)
    differences = {
        stored.identity: difference(
            [stored.rows[i] for i in chosen[stored.identity]], rows[stored.identity], stored.rows
        )
        for stored, _ in pairs
        if stored.identity in chosen
    }
    different = tuple(_named(stored) for stored, _ in pairs if differences.get(stored.identity, 0.0) >= SAME)
    of = sum(len(stored.rows) for stored, _ in pairs)
    return Verification(chosen, of, max(differences.values(), default=0.0), different)


def _named(stored: StoredCell) -> str:
    what = stored.cell
    return f"{stored.identity[:8]} {what['label']} on {what['system']}, {what['snr_db']:g} dB"


def summarised(stored: StoredCell, bound: Bound) -> StoredCell:
    """Return the cell with summary and bound recomputed from its rows."""
    summary = summarise(stored.rows, bound)
    return replace(stored, summary=summary, prior_share=bound.prior_share, identifiable=bound.identifiable)


def add_cells(cells: Iterable[StoredCell], into: Store) -> str:
    """Merge cells into a store; returns how many were added, replaced and kept.

    Of two results for the same cell one is kept: a result that was not submitted, then a current one, then the one with
    more successful fits, then the one already stored. Raises InputError for a damaged cell, or a store that cannot be
    written.
    """
    added = replaced = kept = 0
    try:
        for stored in cells:
            before = into.load(stored.identity) if into.in_folder(stored.identity) else None
            if before is not None and _rank(before) >= _rank(stored):
                kept += 1
                continue
            into.save(stored)
            added, replaced = added + (before is None), replaced + (before is not None)
    except OSError as error:
        raise InputError("store", into.folder, f"cannot be written ({error.strerror}); make room") from None
    return f"{into.folder}: {added} cells added, {replaced} in the place of others, {kept} kept as they were"


def add_store(source: Path, into: Store) -> str:
    """Merge all cells of another store into a store; returns the text of :func:`add_cells`."""
    if source.resolve() == into.folder.resolve():
        raise InputError("store", into.folder, "a store cannot be merged with itself; name another")
    cells = list(Store(source))
    if not cells:
        raise InputError("submission", source, "no cell is stored there")
    into.prepare()
    return add_cells(cells, into)


def _rank(stored: StoredCell) -> tuple[bool, bool, int]:
    """Rank a result: not submitted, computed by the present code, number of successful fits."""
    try:
        current = stored_as_cell(stored).version.matches(stored.version)
    except InputError:  # its method is not installed, or its configuration means something else now
        current = False
    return not stored.submitted, current, stored.n_ok
