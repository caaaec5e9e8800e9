"""Two stores in one: every cell that either holds, once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from bench.errors import InputError
from bench.store.cell import stored_as_cell
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.store.submitted import is_submitted


@dataclass(frozen=True)
class Merged:
    """How many cells were added, took the place of one that was there, and stayed as they were."""

    added: int = 0
    replaced: int = 0
    kept: int = 0


def merge(cells: Iterable[StoredCell], source: Store, into: Store) -> Merged:
    """Bring cells of a store, with their arrays and tracebacks, into another.

    Of two answers to one question the better is kept: one's own rather than a submitted one, the present code's rather
    than a stale one, the one with more successful fits; of two that are alike, the one that was there. Raises
    InputError for a damaged cell, or where the store cannot be written.
    """
    added = replaced = kept = 0
    try:
        for stored in cells:
            before = into.load(stored.identity) if into.own(stored.identity) else None
            if before is not None and rank(before) >= rank(stored):
                kept += 1
                continue
            into.save(stored, source.arrays(stored), source.tracebacks(stored))
            added, replaced = added + (before is None), replaced + (before is not None)
    except OSError as error:
        raise InputError("store", into.folder, f"cannot be written ({error.strerror}); make room") from None
    return Merged(added, replaced, kept)


def rank(stored: StoredCell) -> tuple[bool, bool, int]:
    """How good an answer is: one's own, of the present code, and with how many successful fits."""
    try:
        current = stored_as_cell(stored).version.is_that_of(stored.version)
    except InputError:  # its method is not installed, or its configuration means something else now
        current = False
    return not is_submitted(stored), current, stored.n_ok
