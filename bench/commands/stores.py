"""The store that a command reads: named by ``store=`` and ``archive=``, and there."""

from __future__ import annotations

from collections.abc import Mapping

from bench.commands.fields import folder_of, path_of
from bench.errors import InputError
from bench.store.opening import DEFAULT_STORE, NONE, open_store
from bench.store.store import Store

FIELDS = {"store": DEFAULT_STORE, "archive": ""}
"""The fields of every command that reads a store, with their defaults."""


def store_of(fields: Mapping[str, str]) -> Store:
    """The store of the fields; raises InputError for a folder that was named and is not there, or where none is.

    A name with a slip would otherwise be an empty store, in the place of the one that was meant. The usual folder may
    be absent where there is a published archive.
    """
    archive = fields["archive"]
    if archive and archive != NONE:
        archive = str(folder_of("archive", archive))
    store = open_store(path_of(fields["store"]), archive)
    if fields["store"] != DEFAULT_STORE or store.archive is None:
        folder_of("store", fields["store"])
    return store


def filled_store(fields: Mapping[str, str]) -> Store:
    """The same, with a cell in it at least; raises InputError."""
    store = store_of(fields)
    if not store.identities():
        raise InputError("store", fields["store"], "no cell is there; run python -m bench -m experiment=table5 first")
    return store
