"""Submissions: stored cells of one method in one file, with the facts needed to verify them.

A submission is a zip archive of the files of cells and ``manifest.json`` (method, class, benchmark, cells). Every file
has a checksum; merging recomputes some of the rows (``python -m bench share action=merge``).
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.errors import LONGEST_VALUE, InputError
from bench.files import write_whole
from bench.store.cell_file import cell_file, cell_from_file
from bench.store.stored_cell import StoredCell

FORMAT = 2
ENDING = ".submission"
MANIFEST = "manifest.json"
LARGEST, LARGEST_PACKED_TIGHT, TIGHT = 2**29, 2**26, 100
"""Largest size of an unpacked submission (bytes), and the limit for one compressed by more than the third factor."""
STATED = ("method", "class", "benchmark", "by", "made")
"""Fields of a manifest that are texts."""
LINE = f"a text of at most {LONGEST_VALUE} letters in one line"
DAMAGED = "not a whole submission; have it sent again"


def pack(path: Path, cells: Sequence[StoredCell], facts: Mapping[str, Any]) -> None:
    """Write cells into a file; raises InputError if it cannot be written."""
    manifest = {"format": FORMAT, **facts, "cells": [_line(stored) for stored in cells]}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(MANIFEST, json.dumps(manifest, indent=1, sort_keys=True))
        for stored in cells:
            archive.writestr(_name(stored.identity), cell_file(stored))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, buffer.getvalue())
    except OSError as error:
        raise InputError("out", path, f"cannot be written ({error.strerror}); name another file") from None


def _name(identity: str) -> str:
    return f"rows/{identity}.json"


def _line(stored: StoredCell) -> dict[str, Any]:
    """Describe a cell in the manifest: its scenario, data, versions and packages."""
    return {
        "identity": stored.identity,
        **{name: stored.cell[name] for name in ("system", "snr_db", "seed", "replicates")},
        "version": stored.version,
        **{name: stored.provenance.get(name) for name in ("packages", "data")},
    }


def unpack(path: Path) -> tuple[dict[str, Any], list[StoredCell]]:
    """Return the manifest of a submission and its cells, without writing anything.

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
            identities = [line["identity"] for line in manifest["cells"]]
            if not identities:
                raise InputError("submission", path, "it holds no cell")
            names = [MANIFEST, *map(_name, dict.fromkeys(identities))]
            if sorted(archive.namelist()) != sorted(names):
                raise InputError("submission", path, DAMAGED)
            cells = [cell_from_file(archive.read(_name(identity))) for identity in identities]
            if [(stored.identity, len(stored.arrays) >= 0) for stored in cells] != [
                (name, True) for name in identities
            ]:
                raise InputError("submission", path, DAMAGED)
    except MemoryError:
        raise
    except InputError as error:
        raise error if error.field == "submission" else InputError("submission", path, DAMAGED) from None
    except OSError as error:
        raise InputError("submission", path, f"cannot be read ({error.strerror or error})") from None
    except Exception:  # zipfile, zlib and json raise a dozen kinds
        raise InputError("submission", path, DAMAGED) from None
    return manifest, cells


def is_line(text: object) -> bool:
    """Return whether a value is a text that a line of a page or a terminal may hold."""
    return isinstance(text, str) and len(text) <= LONGEST_VALUE and text.isprintable()


def _check_size(archive: zipfile.ZipFile, path: Path) -> None:
    """Raise InputError for what would unpack to more than any submission holds, or is packed as no numbers are."""
    size = sum(item.file_size for item in archive.infolist())
    most = LARGEST if size < TIGHT * path.stat().st_size else LARGEST_PACKED_TIGHT
    if size > most:
        raise InputError("submission", path, f"it would unpack to more than {most >> 20} MB")
