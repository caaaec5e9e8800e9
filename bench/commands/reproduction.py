"""``python -m bench.reproduction``: a verdict on each of the paper's 59 numbers, and what it rests on.

Each number is judged under the reading of the protocol and under others (:mod:`bench.reporting.reproduction`). Cells
that the store lacks are run first, where it holds some; the page is ``results/reproduction.md``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

from bench.commands.fields import path_of, read_fields
from bench.commands.guard import command
from bench.commands.stores import FIELDS, filled_store
from bench.isolation.cores import usable_cores
from bench.reporting.frame import Result
from bench.reporting.reproduction import Place, all_cells, ratio_verdicts, verdicts
from bench.reporting.reproduction_page import files
from bench.reporting.whole_file import check_folder, write
from bench.run.pool import Limits
from bench.store.cell import Cell
from bench.store.opening import DEFAULT_STORE
from bench.store.store import Store
from bench.sweep.launch import complete


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.reproduction [store=...] [archive=...] [out=results]``; exit status 2 for bad input."""
    usage = f"usage: python -m bench.reproduction [store={DEFAULT_STORE}] [archive=<folder>|none] [out=results]"
    kept = "interrupted; finished cells are kept"
    return command("bench.reproduction", f"{usage}\n\n{__doc__}", argv, _main, kept)


def _main(arguments: Sequence[str]) -> int:
    fields = read_fields(arguments, {**FIELDS, "out": "results"})
    store, out = filled_store(fields), path_of(fields["out"])
    check_folder(out)
    store.prepare()
    cells = all_cells()
    results = _results(cells, store)
    for name, text in files(verdicts(results), ratio_verdicts(results), next(iter(cells.values()))).items():
        write(out / name, text, out)
        print(out / name)
    return 0


def _results(cells: Mapping[str, Mapping[Place, Cell]], store: Store) -> dict[str, dict[Place, Result]]:
    """The results of all cells; what is missing is run first, with a progress bar."""
    wanted = {cell.identity: cell for own in cells.values() for cell in own.values()}
    complete(list(wanted.values()), store, Limits(usable_cores()))
    results = {identity: Result.of_cell(cell, store.load(identity)) for identity, cell in wanted.items()}
    return {name: {place: results[cell.identity] for place, cell in own.items()} for name, own in cells.items()}


if __name__ == "__main__":
    sys.exit(main())
