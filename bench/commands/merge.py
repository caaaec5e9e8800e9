"""A submission, or another store, brought into a store."""

from __future__ import annotations

import hashlib
import math
import os
import secrets
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from bench.commands.declaration import File
from bench.config.fields import MOST_MEMORY_MB, MOST_TIMEOUT_S
from bench.contract.estimate import Status
from bench.engine.pool import Limits
from bench.engine.progress import progress_bar
from bench.entrants.registry import registered
from bench.errors import InputError
from bench.exchange.comparison import SAME, difference, miss_probability
from bench.information.fisher import Bound
from bench.isolation.cores import usable_cores
from bench.reporting.terminal import wrapped
from bench.scoring.path import of_clock
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.store.bounds import load_bounds
from bench.store.cell import Cell, stored_as_cell
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.store.submitted import marked
from bench.sweep.launch import preloaded
from bench.sweep.plan import Planned, State
from bench.sweep.runner import compute_bounds, run_replicates

LEAST_ROWS = 5
AGAIN = "python -m bench share action=merge"
OF_MACHINE = (Status.TIMEOUT, Status.KILLED, Status.OOM)
"""What becomes of a fit on a slower or smaller machine: rows that are not compared."""
MOST_NAMED = 5


@dataclass(frozen=True)
class Verification:
    """Which rows were computed again, by cell; the largest relative difference; the cells that came out otherwise."""

    compared: Mapping[str, tuple[int, ...]]
    of: int
    largest: float
    different: tuple[str, ...]

    @property
    def n(self) -> int:
        return sum(map(len, self.compared.values()))


def merge_source(source: Path, folder: Path, share: float, seed: int | None, workers: int | None) -> int:
    """Merge a submission or a store; returns 1 where a submission does not agree; raises InputError."""
    into = Store(folder)
    if os.path.isdir(source):
        return _merge_store(Store(source), into)
    File("a submission, or the folder of a store")("submission", str(source))
    drawn = secrets.randbits(48) if seed is None else seed
    return _merge_submission(source, into, share, drawn, workers or usable_cores())


def _merge_store(source: Store, into: Store) -> int:
    from bench.exchange.merged import merge

    if source.folder.resolve() == into.folder.resolve():
        raise InputError("store", into.folder, "a store is not merged with itself; name another")
    cells = list(source)
    if not cells:
        raise InputError("submission", source.folder, "no cell is stored there")
    into.prepare()
    _say(merge(cells, source, into), into)
    return 0


def _say(done: Any, into: Store) -> None:
    counts = f"{done.added} cells added, {done.replaced} in the place of others, {done.kept} kept as they were"
    print(f"{into.folder}: {counts}")


def _merge_submission(path: Path, into: Store, share: float, seed: int, workers: int) -> int:
    from bench.exchange.merged import merge
    from bench.exchange.submission import unpack

    with tempfile.TemporaryDirectory() as folder:
        manifest, theirs = unpack(path, Path(folder))
        pairs = [(stored, _understood(stored, manifest, path)) for stored in _whole(theirs, path)]
        if not pairs:
            raise InputError("submission", path, "it holds no cell")
        into.prepare()
        limits = widest_limits([stored for stored, _ in pairs], workers)
        for identity, why in compute_bounds([cell for _, cell in pairs], into, limits).items():
            raise InputError("submission", path, f"cell {identity[:8]}: {why}")
        found = verify(pairs, theirs, share, seed, limits)
        print(wrapped(_verdict(found)))
        if found.different:
            print(f"nothing was added; {AGAIN} submission={path} seed={seed} draws the same rows again")
            return 1
        facts = {
            "by": manifest.get("by", ""), "made": manifest.get("made", ""), "class": manifest.get("class", ""),
            "benchmark": manifest.get("benchmark", ""), "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            "merged": datetime.now(UTC).isoformat(timespec="seconds"), "rows_compared": found.n, "of_rows": found.of,
            "seed": seed, "largest_difference": float(f"{found.largest:.2g}"),
            "missed_5_percent": miss_probability(found.of, found.n),
        }  # fmt: skip
        bounds = load_bounds([cell for _, cell in pairs], into.bounds)
        cells = []
        for (stored, _), bound in zip(pairs, bounds, strict=True):
            own = summarised(stored, bound)
            cells.append(marked(own, {**facts, "replicates": list(found.compared.get(stored.identity, ()))}))
        _say(merge(cells, theirs, into), into)
    return 0


def _whole(theirs: Store, path: Path) -> Iterator[StoredCell]:
    """The cells of a submission; raises InputError for one that is damaged, or whose files are."""
    for identity in theirs.identities():
        stored = None if theirs.damage(identity) else theirs.load(identity)
        if stored is None:
            raise InputError("submission", path, f"cell {identity[:8]} is damaged; have it sent again")
        yield stored


def _understood(stored: StoredCell, manifest: Mapping[str, Any], path: Path) -> Cell:
    """The cell that a stored one answers.

    Raises InputError where the submission is of another method, or this installation could not compute it again.
    """
    method = manifest.get("method")
    if stored.cell.get("method") != method:
        remedy = f"cell {stored.identity[:8]} is of {stored.cell.get('method')}, the submission of {method}"
        raise InputError("submission", path, f"{remedy}; have it sent again")
    try:
        cell = stored_as_cell(stored)
    except InputError as error:
        raise InputError("submission", path, f"cell {stored.identity[:8]} means nothing here: {error}") from None
    here = registered()[cell.method].value if cell.method in registered() else "a reference row"
    if manifest.get("class", here) != here:
        remedy = f"computed by {manifest['class']}, and {cell.method} is {here} here; install what computed it"
        raise InputError("submission", path, remedy)
    if not cell.version.is_that_of(stored.version):
        remedy = f"{cell.version.changed_since(stored.version)}; install the method and the benchmark that computed it"
        raise InputError("submission", path, remedy)
    if [row.replicate for row in stored.rows] != list(range(cell.replicates)):
        raise InputError("submission", path, f"cell {stored.identity[:8]} lacks some of its {cell.replicates} rows")
    return cell


def draw(pairs: Sequence[tuple[StoredCell, Cell]], share: float, seed: int) -> dict[str, tuple[int, ...]]:
    """The rows that are computed again, by cell: so large a share of all, and five at least, each equally likely."""
    rows = [(stored.identity, row.replicate) for stored, _ in pairs for row in stored.rows
            if row.status not in OF_MACHINE]  # fmt: skip
    n = min(len(rows), max(LEAST_ROWS, math.ceil(share * len(rows))))
    found: dict[str, list[int]] = {}
    for i in sorted(np.random.default_rng(seed).choice(len(rows), n, replace=False).tolist()):
        found.setdefault(rows[i][0], []).append(rows[i][1])
    return {identity: tuple(replicates) for identity, replicates in found.items()}


def verify(
    pairs: Sequence[tuple[StoredCell, Cell]], theirs: Store, share: float, seed: int, limits: Limits
) -> Verification:
    """Compute some of the rows again, and compare every score that does not hang on the machine's speed."""
    chosen = draw(pairs, share, seed)
    rows = {stored.identity: list(map(_timeless_row, stored.rows)) for stored, _ in pairs}
    differences: dict[str, float] = {}

    def on_rows(cell: Cell, again: Sequence[Row]) -> None:
        own = rows[cell.identity]
        before = [own[replicate] for replicate in chosen[cell.identity]]
        differences[cell.identity] = difference(before, list(map(_timeless_row, again)), own)

    planned = [
        (Planned(cell, State.STALE, "", True, theirs.stamp(cell.identity)), chosen[cell.identity])
        for _, cell in pairs
        if cell.identity in chosen
    ]
    with progress_bar() as on_look:
        run_replicates(planned, theirs, limits, on_rows, on_look)
    return Verification(
        compared=chosen,
        of=sum(len(stored.rows) for stored, _ in pairs),
        largest=max(differences.values(), default=0.0),
        different=tuple(_named(stored) for stored, _ in pairs if differences.get(stored.identity, 0.0) >= SAME),
    )


def summarised(stored: StoredCell, bound: Bound) -> StoredCell:
    """Return the cell with its summary and bound computed from its rows."""
    summary = {name: dict(vars(line)) for name, line in summarise(stored.rows, bound).items()}
    return replace(stored, summary=summary, prior_share=bound.prior_share, identifiable=bound.identifiable)


def widest_limits(cells: Sequence[StoredCell], workers: int) -> Limits:
    """Return so many workers, and the widest limits that any of the cells states and a run accepts."""
    given = [stored.provenance.get("limits", {}) for stored in cells]
    widest = {
        name: max([getattr(Limits(), name), *(own for one in given if (own := float(one.get(name, 0))) <= most)])
        for name, most in (("timeout_s", MOST_TIMEOUT_S), ("memory_mb", MOST_MEMORY_MB))
    }
    return Limits(workers, **widest, preload=preloaded())


def _timeless_row(row: Row) -> Row:
    return replace(row, scores={name: value for name, value in row.scores.items() if not of_clock(name)})


def _named(stored: StoredCell) -> str:
    what = stored.cell
    return f"{stored.identity[:8]} {what['label']} on {what['system']}, {what['snr_db']:g} dB"


def _verdict(found: Verification) -> str:
    if found.different:
        said = "; ".join(found.different[:MOST_NAMED])
        return f"{found.n} of {found.of} rows computed again: {len(found.different)} cells come out otherwise ({said})"
    missed = miss_probability(found.of, found.n)
    return (
        f"{found.n} of {found.of} rows computed again, and all come out the same (to {found.largest:.1g}); "
        f"a change of 5 % of the rows is missed with probability {missed:.2g}"
    )
