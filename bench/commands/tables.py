"""``python -m bench.tables``: the tables of all experiments as Markdown, CSV and LaTeX, from stored rows alone.

A table is what its experiment in ``conf`` describes; a cell that the store lacks is a row that says so.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from bench.commands.guard import command, read_folders
from bench.errors import InputError
from bench.reporting.tables.leaderboard import leaderboard
from bench.reporting.tables.tables import described_cells, table_experiments, table_files
from bench.store.store import Store
from bench.sweep.plan import State, plan

USAGE = "usage: python -m bench.tables [store=results/rows] [out=results]"


def write_tables(store: Store, out: Path, experiments: Sequence[str]) -> list[Path]:
    """Write the tables that have any stored cell; returns the paths written."""
    written = []
    for experiment in experiments:
        contents = table_files(experiment, store)
        if not contents:
            print(f"{experiment}: no cells stored; run python -m bench -m experiment={experiment}", file=sys.stderr)
            continue
        _say_stale(experiment, store)
        for name, content in contents.items():
            path = out / name
            path.write_text(content, encoding="utf-8")
            written.append(path)
    return written


def _say_stale(experiment: str, store: Store) -> None:
    """A line on the error stream where a table rests on cells that other code or packages computed."""
    planned = plan(described_cells(experiment)[1], store)
    stale = [one for one in planned if one.state is State.STALE]
    if stale:
        said = f"{len(stale)} of {len(planned)} cells are stale ({stale[0].why[:100]})"
        print(f"{experiment}: {said}; python -m bench -m experiment={experiment} computes them again", file=sys.stderr)


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.tables [store=results/rows] [out=results]``; exit status 2 for bad input."""
    return command("bench.tables", f"{USAGE}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    folders = read_folders(arguments, {"store": "results/rows", "out": "results"})
    store, out = Store(folders["store"]), folders["out"]
    if not store.folder.is_dir():
        raise InputError("store", store.folder, "there is no such folder; run some cells first")
    Store(out).prepare()
    for path in write_tables(store, out, table_experiments()):
        print(path)
    for name, content in leaderboard(store).items():
        (out / name).write_text(content, encoding="utf-8")
        print(out / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
