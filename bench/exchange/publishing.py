"""Write the published archive from a store and the present archive.

A cell of the store replaces that of the archive; a cell that no experiment describes is not published. A file of the
archive has the cells of one experiment; a cell of several experiments is in the file of the first (tables by number,
then the others by name). All files are replaced together at the end; if that is interrupted, restore the folder
(``git restore results/archive``) and run it again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from bench.config.choices import choices
from bench.config.experiment import Experiment
from bench.config.random_scenarios import drawn_scenarios
from bench.files import read_regular
from bench.store.archive import Archive
from bench.store.publication import write_archive
from bench.store.seal import Unsealed, unsealed_text
from bench.store.store import BOUND_FORMAT, Store
from bench.store.stored_cell import StoredCell


@dataclass(frozen=True)
class Described:
    """Cells that the experiments describe.

    Attributes:
        places: File of each cell, by identity.
        bounds: Identities of all bounds.
        drawn: Experiments with random scenarios, whose arrays are not published.
    """

    places: Mapping[str, str] = field(default_factory=dict)
    bounds: Collection[str] = ()
    drawn: Collection[str] = ()


def described() -> Described:
    """Read the experiments: tables by number, then the others by name."""
    numbers = {name: Experiment(name).table.get("number") for name in choices("experiment")}
    places, bounds = dict[str, str](), set[str]()
    for name in sorted(numbers, key=lambda own: (numbers[own] is None, numbers[own] or 0, own)):
        for cell in Experiment(name).cells():
            places.setdefault(cell.identity, name)
            bounds.add(cell.bound_identity)
    return Described(places, bounds, [name for name in numbers if drawn_scenarios(name)])


def write_published(store: Store, archive: Archive, experiments_described: Described) -> list[Path]:
    """Write an archive with the cells of a store added; returns the files that have changed.

    Raises InputError for a damaged cell, OSError without room.
    """
    both = Store(store.folder, archive)
    experiments: dict[str, list[StoredCell]] = {}
    for identity in both.identities():
        name, cell = experiments_described.places.get(identity), both.load(identity)
        assert cell is not None
        if name is None:
            continue
        experiments.setdefault(name, []).append(
            replace(cell, arrays={}) if name in experiments_described.drawn else cell
        )
    return write_archive(archive.folder, experiments, _bounds(both, archive, experiments_described.bounds))


def _bounds(both: Store, archive: Archive, used: Collection[str]) -> dict[str, str]:
    """Return the texts of bounds by identity, without damaged files, which are recomputed when needed."""
    texts = archive.bounds()
    for path in both.bounds.glob("*.bound"):
        with contextlib.suppress(OSError, Unsealed):
            texts[path.stem] = unsealed_text(BOUND_FORMAT, read_regular(path))
    return {name: text for name, text in texts.items() if not used or name in used}
