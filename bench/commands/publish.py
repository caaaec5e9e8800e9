"""The published archive, written anew from a store and what it holds already.

A cell of the store takes the place of the archive's, and a cell of an experiment that of one that asked the same with
another number of replicates. A file of the archive holds the cells of one experiment (those of several stand with the
first: tables by number, then the others by name; those of none, in ``other``). The files are replaced together once all
of them are written; where that is interrupted, restore the folder (``git restore results/archive``) and run it again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from bench.commands.stores import named_store
from bench.config.choices import choices
from bench.config.drawn import drawn_scenarios
from bench.config.experiment import Experiment
from bench.errors import InputError
from bench.files import read_regular
from bench.reporting.whole_file import check_folder
from bench.store.archive import Archive
from bench.store.cell import stored_as_cell
from bench.store.seal import Unsealed, unsealed_text
from bench.store.store import BOUND_FORMAT, NONE, Store, default_archive
from bench.store.stored import StoredCell

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
    """Write an archive anew, with the cells of a store; returns the files that have changed.

    Raises InputError for a damaged cell, OSError without room.
    """
    from bench.store.publication import write_archive

    both = Store(store.folder, archive)
    experiments: dict[str, list[StoredCell]] = {}
    for identity in both.identities():
        name, cell = own.places.get(identity, OTHER), both.load(identity)
        assert cell is not None
        if name == OTHER and superseded(cell, own, both):
            continue
        experiments.setdefault(name, []).append(replace(cell, arrays={}) if name in own.drawn else cell)
    return write_archive(archive.folder, experiments, _bounds(both, archive, own.bounds))


def _bounds(both: Store, archive: Archive, used: Collection[str]) -> dict[str, str]:
    kept = {name: text for name, text in archive.bounds().items() if not used or name in used}
    own = [path for path in both.bounds.glob("*.bound") if not used or path.stem in used]
    return kept | {path.stem: text for path in own if (text := _bound_text(path))}


def _bound_text(path: Path) -> str:
    """Return the text of a bound; nothing where its file is not whole: whoever needs that bound computes it anew."""
    with contextlib.suppress(OSError, Unsealed):
        return unsealed_text(BOUND_FORMAT, read_regular(path))
    return ""


def publish_cells(folder: Path, archive_folder: Path | None) -> int:
    """Publish the cells of a store, and print the files written and the size of the archive; raises InputError."""
    known = default_archive()
    archive = Archive(archive_folder or Path("results/archive" if known == NONE else known))
    store = named_store(folder, NONE, filled=True)
    check_folder(archive.folder, "archive")
    try:
        changed = publish(store, archive, described())
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError("archive", archive.folder, f"not written whole ({error})") from None
    _print_files(changed, archive.folder)
    return 0


def _print_files(changed: Sequence[Path], folder: Path) -> None:
    for path in changed:
        print(f"{path}: {f'{path.stat().st_size / 1e6:.2f} MB' if path.exists() else 'removed'}")
    sizes = [path.stat().st_size for path in folder.rglob("*.parquet")]
    print(f"{len(changed)} of {len(sizes)} files written; the archive takes {sum(sizes) / 1e6:.2f} MB")
