"""The verb ``share``: results handed on to others, taken from others, and in the formats of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from bench.commands.declaration import Within
from bench.commands.export import arviz, notebook, petab
from bench.commands.stores import OWN, StoreFolder
from bench.errors import InputError

MOST_SEED = 2**63 - 1


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
    verify: Annotated[float, Within(ge=0.1, le=1), "share of a submission's rows that is "
                      "recomputed"] = 0.1,
    seed: Annotated[int | None, Within(ge=0, le=MOST_SEED), "seed of the choice of these rows [drawn]"] = None,
    workers: Annotated[int | None, Within(ge=1, le=1024), "worker processes [one per core]"] = None,
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
