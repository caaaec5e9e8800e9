"""The verb ``share``: submit, merge, publish and export results."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from bench.commands.declaration import Others, Within, file
from bench.commands.stores import DEFAULT, ArchiveFolder, CellIdentity, StoreFolder, named_store, one_cell
from bench.errors import InputError

if TYPE_CHECKING:
    from bench.store.store import Store
    from bench.store.stored_cell import StoredCell

SCENARIO = ("system", "prior", "disturbance", "snr", "initial_state", "seed")
"""Fields that determine the data of a replicate."""
CELL = (*SCENARIO, "method", "replicates", "timeout_s", "memory_mb", "store", "workers")


def share(action: Annotated[Literal["submit", "merge", "export", "publish"], "what to do"]) -> int:
    """Share results: action=submit, merge, export or publish."""
    raise InputError("form", "", f"action={action} needs form=petab, arviz or notebook")


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


def merge(
    submission: Annotated[Path, "submission, or folder of another store"],
    store: StoreFolder = DEFAULT,
    verify: Annotated[float, Within(ge=0.1, le=1), "share of a submission's rows that is recomputed"] = 0.1,
    seed: Annotated[int | None, Within(ge=0, le=2**63 - 1), "seed of the choice of these rows [random]"] = None,
    fresh: Annotated[
        int, Within(ge=0, le=999), "number of data sets with a secret seed on which the method is tried"
    ] = 40,
    workers: Annotated[int | None, Within(ge=1, le=1024), "worker processes [one per core]"] = None,
) -> int:
    """Merge a submission, or another store, into a store.

    Rows of a submission, drawn at random over all its cells, are recomputed first, and the method is tried on varied
    scenarios with a secret seed. Its cells are added only if every recomputed score and status agrees and the errors
    over the bound are the same on the secret scenarios; tables mark them as submitted. Of two results of one cell the
    store keeps a computed one rather than a submitted one, a current one rather than a stale one, and the one with more
    successful fits; otherwise the one that it has.
    Exit status: 0, 1 where a submission does not agree, 2 for bad input.
    """
    from bench.engine.runner import compute_bounds
    from bench.exchange.merging import add_cells, add_store, summarised, understood, verified
    from bench.exchange.recomputing import widest_limits
    from bench.exchange.secret_problems import compare_fresh
    from bench.exchange.submission import unpack
    from bench.isolation.machine import usable_cores
    from bench.reporting.terminal import wrapped
    from bench.store.bounds import load_bounds
    from bench.store.store import Store

    into = Store(store)
    if os.path.isdir(submission):
        print(add_store(submission, into))
        return 0
    file("submission", submission, "name a submission, or the folder of a store")
    drawn = secrets.randbits(48) if seed is None else seed
    manifest, submitted = unpack(submission)
    cells = [understood(stored, manifest, submission) for stored in submitted]
    into.prepare()
    limits = widest_limits(submitted, workers or usable_cores())
    for identity, why in compute_bounds(cells, into, limits).items():
        raise InputError("submission", submission, f"cell {identity[:8]}: {why}")
    verification = verified(list(zip(submitted, cells, strict=True)), verify, drawn, limits)
    print(wrapped(str(verification)))
    if verification.different:
        again = f"python -m bench share action=merge submission={submission} seed={drawn}"
        print(f"nothing was added; {again} draws the same rows again")
        return 1
    bounds = load_bounds(cells, into.bounds)
    comparison = compare_fresh(list(zip(submitted, cells, bounds, strict=True)), fresh, limits)
    if comparison is not None:
        print(wrapped(str(comparison)))
        if comparison.differs:
            print("nothing was added: the errors of the method differ between secret and public data")
            return 1
    facts = {
        **{name: manifest.get(name, "") for name in ("by", "made", "class", "benchmark")},
        "sha256": hashlib.sha256(submission.read_bytes()).hexdigest(),
        "merged": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": drawn,
        **verification.facts(),
        **({"fresh_problems": comparison.problems, "fresh_p_value": comparison.p_value} if comparison else {}),
    }
    print(add_cells([
        summarised(stored, bound).marked({**facts, "replicates": list(verification.compared.get(stored.identity, ()))})
        for stored, bound in zip(submitted, bounds, strict=True)
    ], into))  # fmt: skip
    return 0


def publish(
    store: StoreFolder = DEFAULT,
    archive: Annotated[Path | None, "folder of the published archive [that of the checkout]"] = None,
) -> int:
    """Write the cells of a store to the published archive, one file per experiment."""
    from bench.exchange.publishing import described, write_published
    from bench.reporting.whole_file import check_folder
    from bench.store.archive import Archive
    from bench.store.store import NONE, default_archive

    known = default_archive()
    published = Archive(archive or Path("results/archive" if known == NONE else known))
    folder, computed = published.folder, named_store(store, NONE, filled=True)
    check_folder(folder, "archive")
    try:
        changed = write_published(computed, published, described())
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError("archive", folder, f"written only in part ({error})") from None
    for path in changed:
        print(f"{path}: {f'{path.stat().st_size / 1e6:.2f} MB' if path.exists() else 'removed'}")
    sizes = [path.stat().st_size for path in folder.rglob("*.parquet")]
    print(f"{len(changed)} of {len(sizes)} files written; the archive takes {sum(sizes) / 1e6:.2f} MB")
    return 0


def petab(
    scenario: Annotated[Sequence[str], Others(SCENARIO), "system=, snr=, initial_state=, prior=, disturbance=, seed="],
    replicate: Annotated[int, Within(ge=0, le=99_999), "number of the replicate"] = 0,
    out: Annotated[Path, "folder to write"] = Path("petab"),
) -> int:
    """Export data, equations, prior and true values of a replicate as a PEtab problem (version 1, with SBML)."""
    from bench.config.experiment import sweep
    from bench.config.overrides import read_overrides
    from bench.exchange.petab import petab_files
    from bench.reporting.whole_file import check_folder, write

    (job,) = sweep({**read_overrides(scenario), "method": ["oracle"]}, multirun=False)
    check_folder(out)
    for name, text in petab_files(job.cell().scenario, job.config.seed, replicate).items():
        write(out / name, text, out)
        print(out / name)
    return 0


def arviz(
    cell: CellIdentity,
    store: StoreFolder = DEFAULT,
    archive: ArchiveFolder = None,
    out: Annotated[Path | None, "file to write [<cell>.nc]"] = None,
) -> int:
    """Export the posterior draws of a stored cell as InferenceData (netCDF)."""
    from bench.exchange.inference_data import inference_data
    from bench.reporting.whole_file import check_file

    path = out or Path(f"{cell}.nc")
    stored = one_cell(named_store(store, archive), cell)
    check_file(path)
    draws = inference_data(stored)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draws.to_netcdf(str(path))
    except OSError as error:
        raise InputError("out", path, f"cannot be written ({error.strerror}); name another file") from None
    print(path)
    return 0


def notebook(
    cell: Annotated[Sequence[str], Others(CELL), "method=, system=, snr=, ... as for python -m bench"],
    out: Annotated[Path, "file to write"] = Path("cell.ipynb"),
) -> int:
    """Export a cell as a Jupyter notebook."""
    from bench.config.experiment import sweep
    from bench.config.overrides import read_overrides
    from bench.exchange.notebook import notebook
    from bench.reporting.whole_file import check_file, write

    overrides = read_overrides(cell)
    (job,) = sweep(overrides, multirun=False)
    check_file(out)
    write(out, notebook(job.cell(), overrides))
    print(out)
    return 0


VARIANTS = {
    "action=submit": submit, "action=merge": merge, "action=publish": publish, "action=export form=petab": petab,
    "action=export form=arviz": arviz, "action=export form=notebook": notebook,
}  # fmt: skip
