"""The store that a verb reads: named by ``store=`` and ``archive=``, and there."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import Parsed, folder
from bench.errors import InputError

if TYPE_CHECKING:
    from bench.store.store import Store
    from bench.store.stored import StoredCell

OWN = Path("outputs/rows")
"""The folder of a user's own cells, which may be absent where there is a published archive."""
StoreFolder = Annotated[Path, "folder of stored cells"]
ArchiveFolder = Annotated[str | None, "published cells: a folder, or none [that of the checkout]"]


def named_store(store: Path, archive: str | None, filled: bool = False) -> Store:
    """Open the store of two fields.

    Raises InputError for a folder that was named and does not exist, since a mistyped name would be an empty store; and
    for a store without a cell, where it has to be ``filled``.
    """
    from bench.store.store import NONE, open_store

    if archive and archive != NONE:
        archive = str(folder("archive", Path(os.path.expanduser(archive))))
    opened = open_store(store, archive)
    if store != OWN or opened.archive is None:
        folder("store", store)
    if filled and not opened.identities():
        raise InputError("store", store, "no cell is there; run python -m bench -m experiment=table5 first")
    return opened


def cell_identity(text: str) -> str:
    """Read the identity of a cell, or its start."""
    if set(text) - set("0123456789abcdef"):
        raise ValueError("an identity of hexadecimal digits, or its start; python -m bench status")
    return text


CellIdentity = Annotated[str, Parsed(cell_identity), "identity of a stored cell, or its start"]


def one_cell(store: Store, text: str) -> StoredCell:
    """Return the stored cell whose identity starts so; raises InputError for none or several."""
    found = [identity for identity in store.identities() if identity.startswith(text)]
    stored = store.load(found[0]) if len(found) == 1 else None
    if stored is None:
        reason = "no such cell" if not found else f"{len(found)} cells start so"
        raise InputError("cell", text, f"{reason} in {store.folder}; python -m bench status lists what is stored")
    return stored
