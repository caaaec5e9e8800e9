"""A submission: stored cells of one method in one file, with what is needed to verify them.

It is a zip of a store, as :class:`bench.store.store.Store` writes one, beside ``manifest.json``: which method,
versions, hashes and seeds, and the SHA-256 of every other file. The manifest guards against damage; what a cell is
worth is told by running some of it again (``python -m bench share action=merge``).
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.errors import LONGEST_VALUE, InputError
from bench.store.store import Store
from bench.store.stored import StoredCell

FORMAT = 1
ENDING = ".submission"
MANIFEST = "manifest.json"
ROWS = "rows"
BLOCK = 2**20
LARGEST, LARGEST_PACKED_TIGHT, TIGHT = 2**29, 2**26, 100
"""Bytes that a submission may unpack to, and those where it is packed to less than one in so many."""
FILE = re.compile(rf"{ROWS}/[0-9a-f]{{1,64}}\.(json|errors\.txt|[0-9a-f]{{8,64}}\.(npz|errors\.txt))")
"""The name of a file of a cell: none other is unpacked, in this folder or any other."""
STATED = ("method", "class", "benchmark", "by", "made")
"""What a manifest says in words."""
LINE = f"a text of at most {LONGEST_VALUE} letters in one line"
DAMAGED = "not a whole submission; have it sent again"


def pack(path: Path, store: Store, cells: Sequence[StoredCell], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write cells of a store, with their arrays and tracebacks, in one step; returns the manifest.

    Raises InputError where the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        with tempfile.TemporaryDirectory() as folder:
            own = Store(Path(folder) / ROWS)
            own.prepare()
            for stored in cells:
                own.save(stored, store.arrays(stored), store.tracebacks(stored))
            files = {p.relative_to(folder).as_posix(): p for p in sorted(own.folder.rglob("*")) if p.is_file()}
            sums = {name: hashlib.sha256(p.read_bytes()).hexdigest() for name, p in files.items()}
            manifest = {"format": FORMAT, **facts, "cells": [_line(stored) for stored in cells], "files": sums}
            path.parent.mkdir(parents=True, exist_ok=True)
            with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr(MANIFEST, json.dumps(manifest, indent=1, sort_keys=True))
                for name, p in files.items():
                    archive.write(p, name)
        os.replace(temporary, path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        raise InputError("out", path, f"cannot be written ({error.strerror}); name another file") from None
    return manifest


def _line(stored: StoredCell) -> dict[str, Any]:
    """What a manifest says of a cell: which question, which data, and what answered it."""
    return {
        "identity": stored.identity,
        "system": stored.cell["system"],
        "snr_db": stored.cell["snr_db"],
        "seed": stored.cell["seed"],
        "replicates": stored.cell["replicates"],
        "version": stored.version,
        "packages": stored.provenance.get("packages"),
        "data": stored.provenance.get("data"),
    }


def unpack(path: Path, folder: Path) -> tuple[dict[str, Any], Store]:
    """The manifest of a submission, and a store of its cells in a folder.

    Raises InputError for a file that is damaged, of another format, or no submission.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            _check_size(archive, path)
            manifest = json.loads(archive.read(MANIFEST))
            if manifest["format"] != FORMAT:
                remedy = f"a submission of format {manifest['format']}, this version reads {FORMAT}"
                raise InputError("submission", path, remedy)
            for name in STATED:
                if not is_line(manifest.get(name, "")):
                    raise InputError("submission", path, f"the {name} in its manifest must be {LINE}")
            if sorted(archive.namelist()) != sorted([MANIFEST, *manifest["files"]]):
                raise InputError("submission", path, DAMAGED)
            (folder / ROWS).mkdir(parents=True)
            for name, digest in manifest["files"].items():
                _extract(archive, name, digest, folder, path)
    except (InputError, MemoryError):
        raise
    except OSError as error:
        raise InputError("submission", path, f"cannot be read ({error.strerror or error})") from None
    except Exception:  # zipfile, zlib and json raise a dozen kinds
        raise InputError("submission", path, DAMAGED) from None
    return manifest, Store(folder / ROWS)


def is_line(text: object) -> bool:
    """Whether it is a text that a line of a page or a terminal may hold."""
    return isinstance(text, str) and len(text) <= LONGEST_VALUE and text.isprintable()


def _check_size(archive: zipfile.ZipFile, path: Path) -> None:
    """Raise InputError for what would unpack to more than any submission holds, or is packed as no numbers are."""
    size = sum(item.file_size for item in archive.infolist())
    most = LARGEST if size < TIGHT * path.stat().st_size else LARGEST_PACKED_TIGHT
    if size > most:
        raise InputError("submission", path, f"it would unpack to more than {most >> 20} MB")


def _extract(archive: zipfile.ZipFile, name: str, digest: str, folder: Path, path: Path) -> None:
    if not FILE.fullmatch(name):
        raise InputError("submission", path, f"it holds a file {name!r}, which belongs in none")
    found = hashlib.sha256()
    with archive.open(name) as packed, (folder / name).open("xb") as file:
        while block := packed.read(BLOCK):
            found.update(block)
            file.write(block)
    if found.hexdigest() != digest:
        raise InputError("submission", path, f"{name} is damaged; have it sent again")
