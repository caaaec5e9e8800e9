"""A submission: stored cells of one method in one file, with what is needed to verify them.

It is a zip of a store, as :class:`bench.store.store.Store` writes one, beside ``manifest.json``: which method,
versions, hashes and seeds, and the SHA-256 of every other file. The manifest guards against damage; what a cell is
worth is told by running some of it again (``python -m bench.merge``).
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from bench.errors import InputError
from bench.store.store import Store
from bench.store.stored import StoredCell

FORMAT = 1
ENDING = ".submission"
MANIFEST = "manifest.json"
ROWS = "rows"
LARGEST = 2**31
"""Bytes that a submission may unpack to."""
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
        "computed_by": stored.version.get("digest"),
        "packages": stored.version.get("packages"),
        "data": stored.provenance.get("data"),
    }


def unpack(path: Path, folder: Path) -> tuple[dict[str, Any], Store]:
    """The manifest of a submission, and a store of its cells in a folder.

    Raises InputError for a file that is damaged, of another format, or no submission.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            manifest = json.loads(archive.read(MANIFEST))
            if manifest["format"] != FORMAT:
                remedy = f"a submission of format {manifest['format']}, this version reads {FORMAT}"
                raise InputError("submission", path, remedy)
            if sum(item.file_size for item in archive.infolist()) > LARGEST:
                raise InputError("submission", path, f"it would unpack to more than {LARGEST / 2**30:g} GB")
            if {*archive.namelist()} != {MANIFEST, *manifest["files"]}:
                raise InputError("submission", path, DAMAGED)
            for name, digest in manifest["files"].items():
                _extract(archive, name, digest, folder, path)
    except InputError:
        raise
    except OSError as error:
        raise InputError("submission", path, f"cannot be read ({error.strerror or error})") from None
    except (zipfile.BadZipFile, ValueError, KeyError, TypeError, AttributeError):
        raise InputError("submission", path, DAMAGED) from None
    return manifest, Store(folder / ROWS)


def _extract(archive: zipfile.ZipFile, name: str, digest: str, folder: Path, path: Path) -> None:
    parts = PurePosixPath(name).parts
    if parts[0] != ROWS or ".." in parts or "\\" in name:  # never outside the folder
        raise InputError("submission", path, f"it holds a file {name!r}, which belongs in none")
    content = archive.read(name)
    if hashlib.sha256(content).hexdigest() != digest:
        raise InputError("submission", path, f"{name} is damaged; have it sent again")
    target = folder.joinpath(*parts)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(content)
