"""A submission: the stored cells of a method in one file."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bench.commands.stores import named_store
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import DISTRIBUTION, registered
from bench.errors import InputError
from bench.reporting.whole_file import check_file
from bench.store.cell import stored_as_cell
from bench.store.store import NONE, Store
from bench.store.stored import StoredCell


def submit_cells(method: str, experiment: str, folder: Path, by: str, out: Path | None) -> int:
    """Write a submission and print what it holds; raises InputError."""
    from bench.exchange.submission import ENDING, LINE, is_line, pack

    if method in REFERENCES or method not in registered():
        raise InputError("method", method, f"one of {', '.join(registered())}")
    if not is_line(by):
        raise InputError("by", by, LINE)
    store = named_store(folder, NONE)
    path = out or Path(f"{method}{ENDING}")
    check_file(path)
    cells = chosen(store, method, experiment)
    pack(path, cells, _facts(method, by))
    rows = sum(len(stored.rows) for stored in cells)
    print(f"{path}: {len(cells)} cells of {method}, {rows} rows")
    return 0


def chosen(store: Store, method: str, experiment: str) -> list[StoredCell]:
    """The cells of a method and its variants, of one experiment's scenarios if that is named.

    Raises InputError where there is none, or one that the present code would compute otherwise.
    """
    wanted = None
    if experiment:
        from bench.config.experiment import Experiment

        wanted = [(scenario.to_dict(), seed) for scenario, seed in Experiment(experiment).scenarios()]
    found, stale = [], []
    for stored in store:
        if stored.cell.get("method") != method:
            continue
        cell = stored_as_cell(stored)
        if wanted is not None and (cell.scenario.to_dict(), cell.seed) not in wanted:
            continue
        if not cell.version.is_that_of(stored.version):
            stale.append(stored.identity[:8])
        found.append(stored.without_mark())
    if not found:
        of = f" of {experiment}" if experiment else ""
        raise InputError("method", method, f"{store.folder} holds no cell of it{of}; run python -m bench first")
    if stale:
        remedy = "are of another version; run the same sweep again"
        raise InputError("store", store.folder, f"{len(stale)} of {len(found)} cells ({stale[0]}, ...) {remedy}")
    return found


def _facts(method: str, by: str) -> dict[str, Any]:
    from bench.config.choices import choices
    from bench.config.files import read_yaml

    drawn = {name: read_yaml("experiment", name).get("draw") for name in choices("experiment")}
    return {
        "method": method,
        "class": registered()[method].value,
        "benchmark": version(DISTRIBUTION),
        "releases": {name: str(draw["release"]) for name, draw in drawn.items() if draw},
        "by": by,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
    }
