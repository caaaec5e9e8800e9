"""``python -m bench.publish``: write the published archive anew from a store and what the archive holds already.

A cell of the store takes the place of the archive's, and a cell of an experiment that of one that asked the same with
another number of replicates. A file of the archive holds the cells of one experiment (those of several stand with the
first: tables by number, then the others by name; those of none, in ``other``), and is written only where one of its
cells has changed. An interrupt leaves every file whole; run the command again.
"""

from __future__ import annotations

import os
import sys
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from bench.commands.fields import path_of, read_fields
from bench.commands.guard import command
from bench.commands.stores import filled_store
from bench.config.choices import choices
from bench.config.drawn import drawn_scenarios
from bench.config.experiment import Experiment
from bench.errors import InputError
from bench.reporting.whole_file import check_folder
from bench.store.archive.archive import BOUNDS, Archive
from bench.store.cell import stored_as_cell
from bench.store.opening import DEFAULT_STORE, NONE, default_archive
from bench.store.store import Store
from bench.store.stored import StoredCell

USAGE = f"usage: python -m bench.publish [store={DEFAULT_STORE}] [archive=results/archive]\n\n"
OTHER = "other"


@dataclass(frozen=True)
class Described:
    """What the experiments describe.

    ``places``: the file of each cell by identity. ``questions``: those identities by the cell's question, whatever its
    replicates. ``bounds``: the identities of all their bounds. ``drawn``: the experiments that draw their scenarios, of
    which no curve is shown, and none is published.
    """

    places: Mapping[str, str] = field(default_factory=dict)
    questions: Mapping[str, str] = field(default_factory=dict)
    bounds: Collection[str] = ()
    drawn: Collection[str] = ()


def described() -> Described:
    """Read the experiments: tables by number, then the others by name."""
    numbers = {name: Experiment(name).table.get("number") for name in choices("experiment")}
    places, questions, bounds = dict[str, str](), dict[str, str](), set[str]()
    for name in sorted(numbers, key=lambda own: (numbers[own] is None, numbers[own] or 0, own)):
        for cell in Experiment(name).cells():
            places.setdefault(cell.identity, name)
            questions.setdefault(cell.question, cell.identity)
            bounds.add(cell.bound_identity)
    return Described(places, questions, bounds, [name for name in numbers if drawn_scenarios(name)])


def superseded(stored: StoredCell, own: Described, both: Store) -> bool:
    """Whether a cell of no experiment asks what a stored cell of one asks, with another number of replicates."""
    try:
        cell = stored_as_cell(stored)
    except (InputError, KeyError):
        return False  # its configuration means something else now, or lacks a field: nothing that an experiment asks
    identity = own.questions.get(cell.question, stored.identity)
    return identity != stored.identity and both.holds(identity)


def publish(store: Store, archive: Archive, own: Described) -> list[Path]:
    """Write what has changed of an archive; returns the files that were written or removed.

    Raises InputError for a damaged cell, ValueError where a cell would not come back as it is, OSError without room.
    """
    from bench.store.archive.part import ENDING, Entry, content_digest, write_part

    both = Store(store.folder, archive)
    files: dict[str, list[str]] = {}
    for identity in both.identities():
        name = own.places.get(identity, OTHER)
        stored = both.load(identity) if name == OTHER else None
        if stored is None or not superseded(stored, own, both):
            files.setdefault(name, []).append(identity)
    changed = []
    before = dict(archive.parts)
    for name, identities in sorted(files.items()):
        part = before.get(name)
        if part and sorted(part.identities) == identities and not any(map(both.own, identities)):
            continue
        entries = []
        for identity in identities:
            cell = both.load(identity)
            assert cell is not None
            if name in own.drawn:
                cell = replace(cell, arrays="")
            entries.append(Entry(cell, both.arrays(cell), both.tracebacks(identity)))
        if part is None or part.content != content_digest(entries):
            path = archive.folder / f"{name}{ENDING}"
            write_part(path, entries)
            changed.append(path)
    for name in before.keys() - files.keys():  # last, when their cells stand elsewhere
        path = archive.folder / f"{name}{ENDING}"
        path.unlink()
        changed.append(path)
    return changed + _publish_bounds(both, archive, own.bounds)


def _publish_bounds(both: Store, archive: Archive, used: Collection[str]) -> list[Path]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from bench.store.archive.part import ENDING

    known = archive.bounds()
    kept = {name: text for name, text in known.items() if not used or name in used}
    own = {path.stem: path for path in both.bounds.glob("*.bound") if not used or path.stem in used}
    texts = kept | {name: path.read_text(encoding="utf-8") for name, path in own.items()}
    if texts == known:
        return []
    path = archive.folder / f"{BOUNDS}{ENDING}"
    temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}.tmp")
    table = pa.table({"identity": sorted(texts), "text": [texts[name] for name in sorted(texts)]})
    try:
        pq.write_table(table, temporary, compression="zstd", compression_level=19, store_schema=False)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return [path]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the files written, and how large the archive is; exit status 2 for bad input."""
    return command("bench.publish", USAGE + str(__doc__), argv, _main, "interrupted; run it again")


def _main(arguments: Sequence[str]) -> int:
    known = default_archive()
    usual = "results/archive" if known == NONE else known
    fields = read_fields(arguments, {"store": DEFAULT_STORE, "archive": usual})
    store, archive = filled_store({"store": fields["store"], "archive": NONE}), Archive(path_of(fields["archive"]))
    check_folder(archive.folder, "archive")
    try:
        changed = publish(store, archive, described())
    except (OSError, ValueError) as error:
        raise InputError("archive", archive.folder, f"not written whole ({error})") from None
    for path in changed:
        print(f"{path}: {f'{path.stat().st_size / 1e6:.2f} MB' if path.exists() else 'removed'}")
    sizes = [path.stat().st_size for path in archive.folder.glob("*.parquet")]
    print(f"{len(changed)} of {len(sizes)} files written; the archive takes {sum(sizes) / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
