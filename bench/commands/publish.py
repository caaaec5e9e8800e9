"""``python -m bench.publish``: write the published archive anew from a store and what the archive holds already.

A cell of the store takes the place of the archive's, and a cell of an experiment that of one that asked the same with
another number of replicates. A file of the archive holds the cells of one experiment (those of several stand with the
first: tables by number, then the others by name; those of none, in ``other``), and is written only where one of its
cells has changed. An interrupt leaves every file whole; run the command again.

Cells and files of before they carried checksums are refused. ``seal=true`` publishes nothing: it takes those of the
store and of the archive as they are, writes them with a checksum, and says how many. Do this once, with results that
you know to be whole; what is not is named and left.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from bench.commands.fields import flag, path_of, read_fields
from bench.commands.guard import command
from bench.commands.stores import filled_store
from bench.config.choices import choices
from bench.config.drawn import drawn_scenarios
from bench.config.experiment import Experiment
from bench.errors import InputError
from bench.reporting.whole_file import check_folder
from bench.store.archive.archive import Archive
from bench.store.bound_file import bound_text
from bench.store.cell import stored_as_cell
from bench.store.older import seal_archive, seal_store
from bench.store.opening import DEFAULT_STORE, NONE, default_archive
from bench.store.seal import Unsealed, read_regular
from bench.store.store import Store
from bench.store.stored import StoredCell

USAGE = f"usage: python -m bench.publish [store={DEFAULT_STORE}] [archive=results/archive] [seal=true]\n\n"
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
    except InputError:
        return False  # its configuration means something else now: nothing that an experiment asks
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
            entries.append(Entry(cell, both.arrays(cell), both.tracebacks(cell)))
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
    from bench.store.archive.bounds import write_bounds

    known = archive.bounds()
    kept = {name: text for name, text in known.items() if not used or name in used}
    own = [path for path in both.bounds.glob("*.bound") if not used or path.stem in used]
    texts = kept | {path.stem: text for path in own if (text := _bound_text(path))}
    return [] if texts == known else [write_bounds(archive.folder, texts)]


def _bound_text(path: Path) -> str:
    """The text of a bound; nothing where its file is not whole: whoever needs that bound computes it anew."""
    with contextlib.suppress(OSError, Unsealed):
        return bound_text(read_regular(path))
    return ""


def main(argv: Sequence[str] | None = None) -> int:
    """Print the files written, and how large the archive is; exit status 2 for bad input."""
    return command("bench.publish", USAGE + str(__doc__), argv, _main, "interrupted; run it again")


def _main(arguments: Sequence[str]) -> int:
    known = default_archive()
    usual = "results/archive" if known == NONE else known
    fields = read_fields(arguments, {"store": DEFAULT_STORE, "archive": usual, "seal": "false"})
    archive = Archive(path_of(fields["archive"]))
    if flag("seal", fields["seal"]):
        return _seal(Store(path_of(fields["store"])), archive.folder)
    store = filled_store({"store": fields["store"], "archive": NONE})
    check_folder(archive.folder, "archive")
    try:
        changed = publish(store, archive, described())
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError("archive", archive.folder, f"not written whole ({error})") from None
    _print_files(changed, archive.folder)
    return 0


def _seal(store: Store, folder: Path) -> int:
    """Seal what lies in a store and an archive; exit status 1 where some of it is not whole."""
    try:
        n, left = seal_store(store)
        changed = seal_archive(folder)
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError("seal", "true", f"not written whole ({error}); run it again") from None
    print("\n".join([*left, f"{store.folder}: {n} cells taken as they were, and sealed; {len(left)} left"]))
    _print_files(changed, folder)
    return 1 if left else 0


def _print_files(changed: Sequence[Path], folder: Path) -> None:
    for path in changed:
        print(f"{path}: {f'{path.stat().st_size / 1e6:.2f} MB' if path.exists() else 'removed'}")
    sizes = [path.stat().st_size for path in folder.glob("*.parquet")]
    print(f"{len(changed)} of {len(sizes)} files written; the archive takes {sum(sizes) / 1e6:.2f} MB")


if __name__ == "__main__":
    sys.exit(main())
