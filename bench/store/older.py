"""Cells and files of before they carried checksums, taken as they are on the word of whoever asks for it.

Nothing tells whether such a file is as it was written. So no command reads one, and this is done once: what is written
here has a checksum from then on. The content stays the same to the last byte.
"""

from __future__ import annotations

import os
import re
import uuid
from pathlib import Path

from bench.errors import InputError
from bench.store.seal import OtherFormat, Unsealed, parsed, read_regular, sealed, write_new
from bench.store.store import Store
from bench.store.stored import FORMAT, WITHOUT_SEAL, cell_from_file, cell_from_json, read_arrays

START = re.compile(rf'\{{"format":{WITHOUT_SEAL},(?="identity":)')
"""How such a file of a cell begins; never one that was sealed and has lost a bit of its format."""


def seal_store(store: Store) -> tuple[int, list[str]]:
    """Seal the cells of a store; returns how many had no seal, and why others are not sealed, a line each.

    Raises OSError where the folder cannot be written.
    """
    n, left = 0, []
    for identity in Store(store.folder).identities() if store.folder.is_dir() else []:
        path = store.path(identity)
        try:
            content = read_regular(path)
            if _is_sealed(content):
                continue
            found = _sealed(content.decode(), identity, store.folder)
        except (OSError, UnicodeDecodeError, Unsealed) as reason:
            left.append(str(InputError("store", path, f"left as it is: {getattr(reason, 'strerror', '') or reason}")))
            continue
        temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}.tmp")
        try:
            write_new(temporary, found)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
        n += 1
    return n, left


def _is_sealed(content: bytes) -> bool:
    """Whether a cell's file has a seal that agrees with it; raises Unsealed where it has another."""
    try:
        cell_from_file(content)
    except OtherFormat:
        return False
    return True


def _sealed(text: str, identity: str, folder: Path) -> bytes:
    """A cell's file with a seal; raises Unsealed where it is no whole cell or its arrays are not, OSError likewise."""
    start = START.match(text)
    if not start:
        raise Unsealed(f"no cell of format {WITHOUT_SEAL}")
    body = "{" + text[start.end() :]
    cell = cell_from_json(parsed(body))
    if cell.identity != identity:
        raise Unsealed(f"it holds the cell {cell.identity}")
    if cell.arrays:
        read_arrays(cell.arrays, read_regular(folder / cell.arrays))
    return sealed(FORMAT, body)


def seal_archive(folder: Path) -> list[Path]:
    """Write the files of an archive that have no checksum anew, with the same cells; returns them.

    Raises InputError for a file that is damaged, OSError without room, ValueError where a cell would come back changed.
    """
    from bench.store.archive import checked
    from bench.store.archive.archive import Archive
    from bench.store.archive.bounds import NAME, read_bounds, write_bounds
    from bench.store.archive.part import Entry, write_part

    changed = []
    for part in Archive(folder, older=True).parts.values():
        if not part.checked:
            lines = range(len(part.identities))
            write_part(part.path, [Entry(part.cell(i), part.arrays(i), part.tracebacks(i)) for i in lines])
            changed.append(part.path)
    if (folder / NAME).exists() and not checked.read(folder / NAME, older=True).checked:
        changed.append(write_bounds(folder, read_bounds(folder, older=True)))
    return changed
