"""The verb ``share``: results handed on to others, taken from others, and in the formats of other tools."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from bench.commands.declaration import Number, Others, Whole
from bench.commands.stores import OWN, ArchiveFolder, StoreFolder, cell_identity, named_store
from bench.errors import InputError

MOST_SEED = 2**63 - 1
SCENARIO = ("system", "prior", "disturbance", "snr", "initial_state", "seed")
"""Fields, or groups of them, that determine the data of a replicate."""
CELL = (*SCENARIO, "method", "replicates", "timeout_s", "memory_mb", "store", "workers")


def share(action: Annotated[Literal["submit", "merge", "export", "publish"], "what to do"]) -> int:
    """Share results: action=submit, merge, export or publish."""
    raise InputError("form", "", f"petab, arviz or notebook, of action={action}")


def submit(
    method: Annotated[str, "registered method; its variants go with it"],
    experiment: Annotated[str, "only the cells of this experiment, such as open [all]"] = "",
    store: StoreFolder = OWN,
    by: Annotated[str, "who submits the cells"] = "",
    out: Annotated[Path | None, "file to write [<method>.submission]"] = None,
) -> int:
    """Pack the stored cells of a method into one file, to be merged elsewhere.

    It holds their rows, arrays and tracebacks, the versions of all that computed them, their seeds, and digests of
    their data. Stale cells are refused, since nobody could recompute them.
    """
    from bench.commands.submit import submit_cells

    return submit_cells(method, experiment, store, by, out)


def merge(
    submission: Annotated[Path, "submission, or folder of another store"],
    store: StoreFolder = OWN,
    verify: Annotated[float, Number(0.1 - 1e-12, 1.0, "a number from 0.1"), "share of a submission's rows that is "
                      "recomputed"] = 0.1,
    seed: Annotated[int | None, Whole(0, MOST_SEED), "seed of the choice of these rows [drawn]"] = None,
    workers: Annotated[int | None, Whole(1, 1024), "worker processes [one per core]"] = None,
) -> int:  # fmt: skip
    """Merge a submission, or another store, into a store.

    Of a submission some rows, drawn at random over all its cells, are recomputed first. Only where every score and
    status agrees is anything added; tables show the cells as submitted. Of two answers to one question the better is
    kept: one's own rather than a submitted one, a current one rather than a stale one, the one with more successful
    fits; else the one that was there.
    Exit status: 0, 1 where a submission does not agree, 2 for bad input.
    """
    from bench.commands.merge import merge_source

    return merge_source(submission, store, verify, seed, workers)


def petab(
    scenario: Annotated[Sequence[str], Others(SCENARIO), "system=, snr=, initial_state=, prior=, disturbance=, seed="],
    replicate: Annotated[int, Whole(0, 99_999), "number of the replicate"] = 0,
    out: Annotated[Path, "folder to write"] = Path("petab"),
) -> int:
    """Export a replicate's data, equations and prior as a PEtab problem (version 1, with SBML), and its true values."""
    from bench.commands.export import export_petab

    return export_petab(scenario, replicate, out)


def arviz(
    cell: Annotated[str, cell_identity, "identity of a stored cell, or its start"],
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
    out: Annotated[Path | None, "file to write [<cell>.nc]"] = None,
) -> int:
    """Export the posterior draws of a stored cell as InferenceData (netCDF)."""
    from bench.commands.export import export_arviz

    return export_arviz(cell, named_store(store, archive), out or Path(f"{cell}.nc"))


def notebook(
    cell: Annotated[Sequence[str], Others(CELL), "method=, system=, snr=, ... as for python -m bench"],
    out: Annotated[Path, "file to write"] = Path("cell.ipynb"),
) -> int:
    """Export a cell as a Jupyter notebook."""
    from bench.commands.export import export_notebook

    return export_notebook(cell, out)


def publish(
    store: StoreFolder = OWN,
    archive: Annotated[Path | None, "folder of the published archive [that of the checkout]"] = None,
) -> int:
    """Write the cells of a store into the published archive, a file per experiment."""
    from bench.commands.publish import publish_cells

    return publish_cells(store, archive)


VARIANTS = {
    "action=submit": submit, "action=merge": merge, "action=publish": publish, "action=export form=petab": petab,
    "action=export form=arviz": arviz, "action=export form=notebook": notebook,
}  # fmt: skip
