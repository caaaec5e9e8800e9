"""``python -m bench.submit``: pack the stored cells of a method into one file, to be merged elsewhere.

With each cell go its rows, the arrays and tracebacks beside it, the versions of all that computed it, its seed, and
digests of its data. Cells of older code are refused, since nobody could compute them again. ``python -m bench.merge``
takes the file.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from bench.commands.fields import path_of, read_fields
from bench.commands.guard import command
from bench.commands.stores import store_of
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import DISTRIBUTION, registered
from bench.errors import InputError
from bench.reporting.whole_file import check_file
from bench.store.cell import stored_as_cell
from bench.store.opening import DEFAULT_STORE, NONE
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.store.submitted import unmarked_cell

USAGE = f"""usage: python -m bench.submit method=<name> [field=value ...]

fields (defaults in brackets):
  method         a registered method; its variants go with it
  experiment     [all] only the cells of this experiment, such as open
  store          [{DEFAULT_STORE}] where the cells are
  by             [nobody] who submits them
  out            [<method>.submission] the file\n\n"""
DEFAULTS = {"method": "", "experiment": "", "store": DEFAULT_STORE, "by": "", "out": ""}


def main(argv: Sequence[str] | None = None) -> int:
    """Print what was packed; exit status 2 for bad input."""
    return command("bench.submit", USAGE + str(__doc__), argv, _main)


def _main(arguments: Sequence[str]) -> int:
    from bench.exchange.submission import ENDING, LINE, is_line, pack

    fields = read_fields(arguments, DEFAULTS)
    method = fields["method"]
    if method in REFERENCES or method not in registered():
        raise InputError("method", method, f"one of {', '.join(registered())}")
    if not is_line(fields["by"]):
        raise InputError("by", fields["by"], LINE)
    store = store_of({"store": fields["store"], "archive": NONE})
    path = path_of(fields["out"] or f"{method}{ENDING}")
    check_file(path)
    cells = chosen(store, method, fields["experiment"])
    manifest = pack(path, store, cells, _facts(fields))
    rows = sum(len(stored.rows) for stored in cells)
    print(f"{path}: {len(cells)} cells of {method}, {rows} rows, {len(manifest['files'])} files")
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
        found.append(unmarked_cell(stored))
    if not found:
        of = f" of {experiment}" if experiment else ""
        raise InputError("method", method, f"{store.folder} holds no cell of it{of}; run python -m bench first")
    if stale:
        remedy = "are of another version; run the same sweep again"
        raise InputError("store", store.folder, f"{len(stale)} of {len(found)} cells ({stale[0]}, ...) {remedy}")
    return found


def _facts(fields: dict[str, str]) -> dict[str, Any]:
    from bench.config.choices import choices
    from bench.config.files import read_yaml

    drawn = {name: read_yaml("experiment", name).get("draw") for name in choices("experiment")}
    return {
        "method": fields["method"],
        "class": registered()[fields["method"]].value,
        "benchmark": version(DISTRIBUTION),
        "releases": {name: str(draw["release"]) for name, draw in drawn.items() if draw},
        "by": fields["by"],
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
    }


if __name__ == "__main__":
    sys.exit(main())
