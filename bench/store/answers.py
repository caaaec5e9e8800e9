"""What a store holds of some cells, as far as a plan asks."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection
from typing import NamedTuple

from bench.errors import InputError
from bench.store.store import Store
from bench.store.stored import StoredCell

FEW = 50
"""So many cells are sooner read themselves than the view of all is loaded, with the packages that read it."""


class Answer(NamedTuple):
    """Why a file is no cell, or nothing; the digest of what computed it; a JSON object of counts of statuses; when the
    file that was read was written (ns; 0 in the archive)."""

    problem: str
    version: str
    statuses: str
    mtime_ns: int


def answers(store: Store, identities: Collection[str]) -> dict[str, Answer]:
    """The stored ones among some cells, by identity."""
    identities = set(identities).intersection(store.identities()) if len(identities) > FEW else identities
    if len(identities) > FEW:
        from bench.store import index

        lines = index.cells(store, Answer._fields)
        lines = lines[lines.index.isin(identities)]
        return {name: Answer(*line) for name, line in zip(lines.index, lines.itertuples(index=False), strict=True)}
    found = {identity: _answer(store, identity) for identity in identities}
    return {identity: answer for identity, answer in found.items() if answer}


def _answer(store: Store, identity: str) -> Answer | None:
    stamp = store.stamp(identity)  # before the look: what is written after it is newer
    try:
        cell = store.load(identity)
    except InputError as error:
        return Answer(str(error), "", "", stamp)
    return None if cell is None else answer_of(cell, stamp)


def answer_of(cell: StoredCell, stamp: int) -> Answer:
    """What a plan asks of a stored cell."""
    statuses = Counter(status.value for status in cell.columns.statuses)
    return Answer("", cell.version.get("digest", ""), json.dumps(statuses), stamp)
