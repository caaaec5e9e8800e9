"""The mark of a cell that somebody else computed: on its label, where every table and page shows it.

A label has no part in a cell's identity. What was verified of the cell stands in its provenance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from bench.store.stored import StoredCell

MARK = " (submitted)"
FIELD = "submitted"


def unmarked(label: str) -> str:
    """The label without the mark."""
    return label.removesuffix(MARK)


def is_submitted(stored: StoredCell) -> bool:
    """Whether a cell came with a submission."""
    return FIELD in stored.provenance


def marked(stored: StoredCell, facts: Mapping[str, Any]) -> StoredCell:
    """The cell as one that was submitted; ``facts`` say whence it came and what was verified of it."""
    cell = {**stored.cell, "label": f"{unmarked(str(stored.cell['label']))}{MARK}"}
    return replace(stored, cell=cell, provenance={**stored.provenance, FIELD: dict(facts)})


def unmarked_cell(stored: StoredCell) -> StoredCell:
    """The cell as its method calls it, without a mark that it came with."""
    provenance = {key: value for key, value in stored.provenance.items() if key != FIELD}
    return replace(stored, cell={**stored.cell, "label": unmarked(str(stored.cell["label"]))}, provenance=provenance)
