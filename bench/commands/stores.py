"""The store that a verb reads, from the fields ``store=`` and ``archive=``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import Parsed, folder
from bench.errors import InputError

if TYPE_CHECKING:
    from bench.store.store import Store
    from bench.store.stored_cell import StoredCell

DEFAULT = Path("outputs/rows")
"""The default folder of computed cells, which need not exist where there is a published archive."""
StoreFolder = Annotated[Path, "folder of stored cells"]
ArchiveFolder = Annotated[str | None, "published cells: a folder, or none [that of the checkout]"]


def named_store(store: Path, archive: str | None, filled: bool = False) -> Store:
    """Open the store of two fields.

    Args:
        store: Folder of computed cells.
        archive: Folder of published cells, ``none``, or None for that of the checkout.
        filled: Whether the store must hold a cell.

    Raises:
        InputError: for a named folder that does not exist, and for an empty store where one must be filled.
    """
    from bench.store.store import open_store

    opened = open_store(store, archive and os.path.expanduser(archive))
    if store != DEFAULT or opened.archive is None:
        folder("store", store)
    if filled and not opened.identities():
        raise InputError("store", store, "no cells stored; run python -m bench -m experiment=table5 first")
    return opened


def cell_identity(text: str) -> str:
    """Read the identity of a cell, or its first digits."""
    if set(text) - set("0123456789abcdef"):
        raise ValueError("an identity of hexadecimal digits, or the first of them; python -m bench status")
    return text


CellIdentity = Annotated[str, Parsed(cell_identity), "identity of a stored cell, or its first digits"]


def one_cell(store: Store, text: str) -> StoredCell:
    """Return the stored cell whose identity starts with a text; raises InputError for none or several."""
    identities = [identity for identity in store.identities() if identity.startswith(text)]
    stored = store.load(identities[0]) if len(identities) == 1 else None
    if stored is None:
        reason = f"{len(identities)} cells with these digits" if identities else "no such cell"
        sweep = "python -m bench status -v experiment=<name> lists those of a sweep"
        raise InputError("cell", text, f"{reason} in {store.folder}; {sweep}")
    return stored
