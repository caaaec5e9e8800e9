"""``python -m bench.benchmark``: time Tables 3 to 5, method by method, on two workers, and print the table.

It runs the cells in a temporary store, so nothing stored is used or touched. ``replicates=`` and ``method=``
shorten it; the time for the full number of replicates is then extrapolated in proportion, and marked.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from bench.commands.guard import command
from bench.config.experiment import Experiment
from bench.config.overrides import Overrides, read_overrides
from bench.engine.pool import Limits
from bench.errors import InputError
from bench.reporting.terminal import table
from bench.store.bounds import Replicates, bound_identity
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.launch import complete
from bench.sweep.runner import compute_bounds

EXPERIMENTS = ("table3", "table4", "table5")
FIELDS = ("replicates", "method", "workers")


def _cells(overrides: Overrides) -> list[Cell]:
    """The different cells of the three tables."""
    cells = [cell for name in EXPERIMENTS for cell in Experiment(name).cells(overrides)]
    return list({cell.identity: cell for cell in cells}.values())


def _place(cell: Cell) -> tuple[str, str]:
    """The method and scenario of a cell, whatever its number of replicates."""
    return cell.label, bound_identity(Replicates(cell.scenario))


def main(argv: Sequence[str] | None = None) -> int:
    """Time the methods; exit status 2 for bad input."""
    usage = "usage: python -m bench.benchmark [replicates=<n>] [method=a,b] [workers=2]"
    return command("bench.benchmark", f"{usage}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    overrides = {"workers": [2], **read_overrides(arguments)}
    for field, values in overrides.items():
        if field not in FIELDS:
            raise InputError(field, values[0], f"the tables say what is run; fields: {', '.join(FIELDS)}")
    workers = Experiment(EXPERIMENTS[0]).jobs(overrides)[0].config.workers or 2
    full = {_place(c): c.replicates for c in _cells({k: v for k, v in overrides.items() if k == "method"})}
    cells = _cells(overrides)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        compute_bounds(cells, store, Limits(workers))
        for label in dict.fromkeys(cell.label for cell in cells):
            own = [cell for cell in cells if cell.label == label]
            fits = sum(cell.replicates for cell in own)
            started = time.perf_counter()
            complete(own, store, Limits(workers))
            seconds = time.perf_counter() - started
            results = [found for cell in own if (found := store.load(cell.identity))]
            cpu = sorted(row.cpu_s for result in results for row in result.rows)
            wanted = sum(full[_place(c)] for c in own)
            whole = seconds * wanted / fits
            mark = "" if wanted == fits else " (extrapolated)"
            rows.append(
                [label, str(len(own)), str(fits), f"{cpu[len(cpu) // 2]:.3g}", f"{seconds:.1f}", f"{whole:.0f}{mark}"]
            )
    headers = ["method", "cells", "fits", "cpu s/fit", "wall s", f"wall s, tables 3-5, {workers} workers"]
    print(table(rows, headers))
    return 0


if __name__ == "__main__":
    sys.exit(main())
