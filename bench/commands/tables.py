"""``python -m bench.tables``: the tables of all experiments as Markdown, CSV and LaTeX, from stored rows alone.

Pages and CSV files go to ``out``, what is meant for print (``.tex``) to ``tex``. A table is what its experiment in
``conf`` describes; a cell that the store lacks is a row that says so. A submitted method (``python -m bench.merge``)
stands in the tables of which it has every scenario, and is marked.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench.commands.fields import path_of, read_fields
from bench.commands.guard import command
from bench.commands.stores import FIELDS, filled_store
from bench.errors import InputError
from bench.reporting.whole_file import check_folder, write
from bench.store.opening import DEFAULT_STORE

if TYPE_CHECKING:
    from bench.reporting.frame import Frame

USAGE = (
    f"usage: python -m bench.tables [store={DEFAULT_STORE}] [archive=<folder>|none] [out=results] [tex=build/tables]"
)


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.tables [store=...] [archive=...] [out=...] [tex=...]``; exit status 2 for bad input."""
    return command("bench.tables", f"{USAGE}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    from bench.reporting.frame import experiment_frame, submitted_results, table_experiments, with_submitted
    from bench.reporting.tables.forms import table_files
    from bench.reporting.tables.leaderboard import EXPERIMENTS, leaderboard

    fields = read_fields(arguments, {**FIELDS, "out": "results", "tex": "build/tables"})
    store, out, tex = filled_store(fields), path_of(fields["out"]), path_of(fields["tex"])
    check_folder(out)
    check_folder(tex, "tex")
    pooled, drawn, submitted, written = [], None, submitted_results(store), 0
    for name in table_experiments():
        frame = with_submitted(experiment_frame(name, store), submitted)
        files = table_files(frame, store)
        if files:
            _say_stale(frame)
        else:
            print(f"{name}: no cells stored; run python -m bench -m experiment={name}", file=sys.stderr)
        written += _write(files, out, tex)
        pooled += [frame] if name in EXPERIMENTS else []
        drawn = frame if frame.table.get("form") == "open" else drawn
    written += _write(leaderboard(pooled, drawn), out, tex)
    if not written:
        raise InputError("store", fields["store"], "none of its cells stands in a table; see bench.status")
    return 0


def _write(files: Mapping[str, str], out: Path, tex: Path) -> int:
    """Write files by name and print their paths; returns how many."""
    for name, content in files.items():
        folder = tex if name.endswith(".tex") else out
        write(folder / name, content, folder)
        print(folder / name)
    return len(files)


def _say_stale(frame: Frame) -> None:
    """A line on the error stream where a table rests on cells of another version."""
    unique = {result.identity: result for result in frame}.values()
    stale = [(one.cell.version, one.stored.version) for one in unique if one.cell and one.stored]
    stale = [(now, then) for now, then in stale if not now.is_that_of(then)]
    if stale:
        now, then = stale[0]
        said = f"{len(stale)} of {len(unique)} cells are stale ({now.changed_since(then)[:100]})"
        remedy = f"python -m bench -m experiment={frame.experiment} computes them again"
        print(f"{frame.experiment}: {said}; {remedy}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
