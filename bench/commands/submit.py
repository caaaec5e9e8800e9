"""``share action=submit``: the stored cells of a method in one file."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from bench.commands.stores import DEFAULT, StoreFolder, named_store
from bench.errors import InputError

if TYPE_CHECKING:
    from bench.store.store import Store
    from bench.store.stored_cell import StoredCell


def submit(
    method: Annotated[str, "registered method, with its variants"],
    experiment: Annotated[str, "only the cells of this experiment, such as open [all]"] = "",
    store: StoreFolder = DEFAULT,
    by: Annotated[str, "who submits the cells"] = "",
    out: Annotated[Path | None, "file to write [<method>.submission]"] = None,
) -> int:
    """Pack the stored cells of a method into one file, to be merged elsewhere.

    The file holds rows, arrays, tracebacks, seeds, versions of the code and digests of the data. Stale cells are
    rejected, since they cannot be recomputed.
    """
    from bench.entrants.registry import registered
    from bench.exchange.submission import ENDING, LINE, is_line, pack
    from bench.reporting.whole_file import check_file

    if method not in registered():
        raise InputError("method", method, f"one of {', '.join(registered())}")
    if not is_line(by):
        raise InputError("by", by, LINE)
    path = out or Path(f"{method}{ENDING}")
    check_file(path)
    cells = submitted_cells(named_store(store, "none"), method, experiment)
    pack(path, cells, _facts(method, by))
    print(f"{path}: {len(cells)} cells of {method}, {sum(len(stored.rows) for stored in cells)} rows")
    return 0


def submitted_cells(store: Store, method: str, experiment: str) -> list[StoredCell]:
    """Return the cells of a method and its variants; with an experiment those of its scenarios.

    Raises InputError where there is none, and for stale cells.
    """
    from bench.config.experiment import Experiment
    from bench.store.cell import stored_as_cell

    scenarios = Experiment(experiment).scenarios() if experiment else []
    wanted = [(scenario.to_dict(), seed) for scenario, seed in scenarios]
    pairs = [(stored, stored_as_cell(stored)) for stored in store if stored.cell.get("method") == method]
    pairs = [(s, cell) for s, cell in pairs if not experiment or (cell.scenario.to_dict(), cell.seed) in wanted]
    if not pairs:
        of = f" of {experiment}" if experiment else ""
        raise InputError("method", method, f"no cell of it{of} in {store.folder}; run python -m bench first")
    if stale := [stored.identity[:8] for stored, cell in pairs if not cell.version.matches(stored.version)]:
        remedy = "are of another version; run the same sweep again"
        raise InputError("store", store.folder, f"{len(stale)} of {len(pairs)} cells ({stale[0]}, ...) {remedy}")
    return [stored.without_mark() for stored, _ in pairs]


def _facts(method: str, by: str) -> dict[str, Any]:
    from bench.config.choices import choices
    from bench.config.files import read_yaml
    from bench.entrants.registry import DISTRIBUTION, registered

    drawn = {name: read_yaml("experiment", name).get("draw") for name in choices("experiment")}
    return {
        "method": method,
        "class": registered()[method].value,
        "benchmark": version(DISTRIBUTION),
        "releases": {name: str(draw["release"]) for name, draw in drawn.items() if draw},
        "by": by,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
    }
