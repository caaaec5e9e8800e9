"""``python -m bench.recheck``: which stale cells does a change of the code leave as they are?

A cell is stale when a definition that computes it has changed. Where the change was meant to alter nothing, this runs
some replicates of each stale cell again and compares them with the stored ones, every score and what they say: a tenth
of the replicates and at least five, drawn over the whole cell. Where all are the same, but for a tenth of what rounding
to the three digits of a table takes, the cell counts as computed by the present code, and its provenance says by what
it was computed, which replicates were compared, how far they differ at most, and how likely that misses a change of 5 %
of them. (Training a network carries the last bits of another processor to the sixth digit of its answer.) Where any
differs the cell is named and stays stale, for a sweep to compute; so does one with a failed replicate, whose repair may
have been the change. Each cell is dealt with as soon as its replicates are there: a run that is interrupted goes on
where it was.

Cells that were vouched for on fewer replicates are checked again. Where no more than the summary or the bound beside it
has changed, those are made anew from the stored rows, and nothing is fitted.
"""

from __future__ import annotations

import contextlib
import math
import re
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.commands.fields import listed, read_fields
from bench.commands.guard import command
from bench.commands.reproduce import compare_rows
from bench.commands.stores import FIELDS, store_of
from bench.config.choices import check_choice
from bench.config.experiment import Experiment
from bench.config.schema import MOST_MEMORY_MB, MOST_TIMEOUT_S
from bench.contract.estimate import Status
from bench.errors import InputError
from bench.information.fisher import Bound
from bench.isolation.cores import usable_cores
from bench.reporting.terminal import wrapped
from bench.run.pool import Limits
from bench.run.progress import progress_bar
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.store.bounds import load_bounds
from bench.store.cell import Cell, stored_as_cell
from bench.store.locks import Claims
from bench.store.opening import DEFAULT_STORE
from bench.store.provenance import provenance
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.store.version import rows_digest
from bench.sweep.launch import preloaded
from bench.sweep.plan import FAILURES, Planned, State
from bench.sweep.runner import compute_bounds, run_replicates

USAGE = f"""usage: python -m bench.recheck [experiment=<name>] [method=<name>,<name>] [store={DEFAULT_STORE}]

experiment, method: only the stale cells of these\n\n"""
ONE_IN, LEAST = 10, 5
"""Of the replicates of a cell, one in so many is compared, and so many at least."""
SAME = 5e-5
"""Largest relative difference of a score: rounding to three digits takes 5e-4 at least."""
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")
"""In a message: its last digits are a processor's."""
HIT_ONE_IN = 20
"""The change that may be missed hits one replicate in so many: 5 %."""


@dataclass(frozen=True)
class Check:
    """A stored cell to be checked, as this version describes it, and the replicates that are compared.

    ``stamp`` says when its file was written: what another run has stored since then is not written over.
    """

    stored: StoredCell
    cell: Cell
    replicates: tuple[int, ...]
    stamp: int = 0

    @property
    def miss(self) -> float:
        return miss_probability(self.cell.replicates, len(self.replicates))


def n_compared(n: int) -> int:
    """How many of ``n`` replicates are compared."""
    return min(n, max(LEAST, -(-n // ONE_IN)))


def draw(identity: str, n: int) -> tuple[int, ...]:
    """The replicates of a cell that are compared: any of them with the same probability, but always the same ones."""
    rng = np.random.default_rng(int(identity, 16))
    return tuple(sorted(rng.choice(n, n_compared(n), replace=False).tolist()))


def miss_probability(n: int, compared: int) -> float:
    """The probability that ``compared`` of ``n`` replicates, drawn without replacement, hold none of the changed ones.

    5 % of the replicates, rounded up, are changed: the hypergeometric distribution at zero (W. Feller, An Introduction
    to Probability Theory and Its Applications, vol. 1, 3rd ed., 1968, section II.6).
    """
    changed = -(-n // HIT_ONE_IN)
    return math.comb(n - changed, compared) / math.comb(n, compared)


def checks(store: Store, wanted: Callable[[StoredCell], bool] = lambda stored: True) -> list[Check]:
    """The cells to be checked: stale, or vouched for on too few replicates; none of whose replicates failed."""
    found = []
    for stored, stamp in _stamped(store):
        failed = any(row.status in FAILURES or row.status is Status.MISSING_DEPENDENCY for row in stored.rows)
        if failed or not wanted(stored):
            continue
        try:
            cell = stored_as_cell(stored)
        except InputError:
            continue  # its configuration means something else now
        if cell.version.digest != stored.version.get("digest") or _vouched_on_few(stored):
            found.append(Check(stored, cell, draw(cell.identity, cell.replicates), stamp))
    return found


def _stamped(store: Store) -> Iterator[tuple[StoredCell, int]]:
    """Every stored cell, and when its file was written at the latest (ns)."""
    for identity in store.identities():
        stamp = store.stamp(identity)
        if (stored := store.load(identity)) is not None:
            yield stored, stamp


def _notes(stored: StoredCell) -> list[dict[str, Any]]:
    return list(stored.provenance.get("rechecked", []))


def _vouched_on_few(stored: StoredCell) -> bool:
    """By the last recheck, which has compared the rows as they were computed: those before it do not matter."""
    notes = _notes(stored)
    if not notes:
        return False
    compared = notes[-1]["replicates"]
    n = compared if isinstance(compared, int) else len(compared)  # older notes say how many, not which
    return n < n_compared(len(stored.rows))


def difference(check: Check, rows: Sequence[Row]) -> float:
    """The largest relative difference of replicates that were computed anew.

    Infinite where one has another status or says something else; the numbers in what it says may differ.
    """
    chosen = set(check.replicates)
    before = [row for row in check.stored.rows if row.replicate in chosen]
    if [_said(row) for row in before] != [_said(row) for row in rows]:
        return math.inf
    return max(compare_rows(before, rows, check.stored.rows).differences.values(), default=0.0)


def _said(row: Row) -> tuple[Status, str]:
    return row.status, NUMBER.sub("#", row.message)


def vouched(check: Check, bound: Bound, commit: str | None, largest: float) -> StoredCell:
    """The cell as one of the present code, with a note of why, and with the present summary and bound."""
    stored, notes = check.stored, _notes(check.stored)
    computed_by = notes[0]["computed_by"] if notes else stored.version.get("digest")
    note = {
        "replicates": list(check.replicates), "largest_difference": float(f"{largest:.2g}"),
        "missed_5_percent": check.miss, "computed_by": computed_by, "commit": commit,
    }  # fmt: skip
    return replace(summarised(stored, check.cell, bound), provenance={**stored.provenance, "rechecked": [*notes, note]})


def summarised(stored: StoredCell, cell: Cell, bound: Bound) -> StoredCell:
    """The cell with a summary and bound of the present code, its rows as they are."""
    summary = {name: dict(vars(own)) for name, own in summarise(stored.rows, bound).items()}
    return replace(
        stored,
        summary=summary,
        version=cell.version.as_json(),
        prior_share=bound.prior_share,
        identifiable=bound.identifiable,
    )


def withdrawn(check: Check) -> StoredCell:
    """The cell as what it was before anything vouched for it: computed by code of which the digest alone is known."""
    stored, notes = check.stored, _notes(check.stored)
    if not notes:
        return stored
    kept = {key: value for key, value in stored.provenance.items() if key != "rechecked"}
    version = {"digest": notes[0]["computed_by"], "modules": {}, "packages": {}}
    return replace(stored, version=version, provenance=kept)


def main(argv: Sequence[str] | None = None) -> int:
    """Print how many cells were confirmed, and which were not; exit status 2 for bad input."""
    kept = "interrupted; what was confirmed is kept, the same command goes on"
    return command("bench.recheck", USAGE + str(__doc__), argv, _main, kept)


def _main(arguments: Sequence[str]) -> int:
    fields = read_fields(arguments, {"experiment": "", "method": "", **FIELDS})
    wanted, store = _filter(fields), store_of(fields)
    renewed = summarise_anew([(stored, stamp) for stored, stamp in _stamped(store) if wanted(stored)], store)
    found = checks(store, wanted)
    if renewed:
        print(f"{renewed} cells: rows as they were, summaries and bounds made anew")
    elif not found:
        print("no cell is stale")
    if found:
        limits = widest_limits([check.stored for check in found], usable_cores())
        lost = compute_bounds([check.cell for check in found], store, limits)
        bounded = [check for check in found if check.cell.identity not in lost]
        confirmed = run(bounded, store, limits)
        without = [f"{_named(c)}: {lost[c.cell.identity]}; it stays stale" for c in found if c.cell.identity in lost]
        print("\n".join(map(wrapped, [*without, *closing(bounded, confirmed)])))
    return 0


def summarise_anew(found: Sequence[tuple[StoredCell, int]], store: Store) -> int:
    """Store the cells whose rows are those of the present code with a summary and bound of it; returns how many.

    Each is given with when its file was written. One that another run is at, or has stored since, is left to that; one
    whose bound cannot be computed within the limits that it was computed with stays stale.
    """
    wanted = []
    for stored, stamp in found:
        with contextlib.suppress(InputError):  # its configuration means something else now
            cell, digest = stored_as_cell(stored), str(stored.version.get("digest"))
            if cell.version.digest != digest and cell.version.of_rows == rows_digest(digest):
                wanted.append((stored, stamp, cell))
    if not wanted:
        return 0
    store.prepare()
    limits = widest_limits([stored for stored, _, _ in wanted], usable_cores())
    lost = compute_bounds([cell for _, _, cell in wanted], store, limits)
    wanted = [one for one in wanted if one[2].identity not in lost]
    bounds = load_bounds([cell for _, _, cell in wanted], store.bounds)
    claims, done = Claims(store.claims), 0
    try:
        for (stored, stamp, cell), bound in zip(wanted, bounds, strict=True):
            if claims.take(cell.identity):
                if store.stamp(cell.identity) == stamp:
                    store.restate(summarised(stored, cell, bound))
                    done += 1
                claims.release(cell.identity)
    finally:
        claims.release_all()
    return done


def _filter(fields: Mapping[str, str]) -> Callable[[StoredCell], bool]:
    """Whether a stored cell is of the experiment and the methods that were asked for, if any."""
    methods = set(listed("method", fields["method"])) if fields["method"] else None
    for name in methods or ():
        check_choice("method", name.split(" ")[0])  # behind a blank, a label has the settings of a variant
    identities: Collection[str] | None = None
    if fields["experiment"]:
        identities = {cell.identity for cell in Experiment(fields["experiment"]).cells()}
    return lambda stored: (
        (identities is None or stored.identity in identities) and (methods is None or stored.cell["label"] in methods)
    )


def widest_limits(cells: Sequence[StoredCell], workers: int) -> Limits:
    """So many workers, and the widest limits that any of the cells was computed with; what no run takes counts not."""
    given = [stored.provenance.get("limits", {}) for stored in cells]
    widest = {
        name: max([getattr(Limits(), name), *(own for one in given if (own := float(one.get(name, 0))) <= most)])
        for name, most in (("timeout_s", MOST_TIMEOUT_S), ("memory_mb", MOST_MEMORY_MB))
    }
    return Limits(workers, **widest, preload=preloaded())


def run(found: Sequence[Check], store: Store, limits: Limits) -> dict[str, bool]:
    """Compute the replicates of all checks, whose bounds are kept, and restate each cell as soon as its own are there.

    Returns:
        Whether a cell came out the same, by identity; one that another run has stored meanwhile is left out.
    """
    by_identity = {check.cell.identity: check for check in found}
    confirmed: dict[str, bool] = {}

    def on_rows(cell: Cell, rows: Sequence[Row]) -> None:
        check = by_identity[cell.identity]
        if store.stamp(cell.identity) != check.stamp:
            return  # by another run, whose rows are newer; from here to the end the cell is claimed
        largest = difference(check, rows)
        confirmed[cell.identity] = largest < SAME
        if confirmed[cell.identity]:
            come = provenance(cell.version, limits.workers, limits.timeout_s, limits.memory_mb, time.time())
            bound = load_bounds([cell], store.bounds)[0]
            store.restate(vouched(check, bound, come["commit"], largest))
        elif _notes(check.stored):
            store.restate(withdrawn(check))

    planned = [(Planned(check.cell, State.STALE, "", True, check.stamp), check.replicates) for check in found]
    with progress_bar() as on_look:
        run_replicates(planned, store, limits, on_rows, on_look)
    return confirmed


def _named(check: Check) -> str:
    what = check.stored.cell
    return f"{check.cell.identity[:8]}  {what['label']} on {what['system']}, {what['snr_db']:g} dB"


def closing(found: Sequence[Check], confirmed: Mapping[str, bool]) -> list[str]:
    """What differs, by name; what came out the same, by method, with what it can have missed."""
    lines, groups = [], defaultdict(list)
    for check in found:
        what, result = check.stored.cell, confirmed.get(check.cell.identity)
        if result is False:
            lines.append(f"{_named(check)}: comes out otherwise, and stays stale")
        elif result:
            groups[str(what["label"])].append(check)
    for label, own in sorted(groups.items()):
        compared, total = sum(len(check.replicates) for check in own), sum(check.cell.replicates for check in own)
        missed = [check.miss for check in own]
        lines.append(
            f"{label}: {len(own)} cells, {compared} of {total} replicates; a change of 5 % of the replicates of a cell "
            f"is missed with probability {max(missed):.2g} at most, of all cells with {math.prod(missed):.2g}"
        )
    kept = sum(confirmed.values())
    stored_meanwhile = len(found) - len(confirmed)
    more = f"; {stored_meanwhile} were stored by another run meanwhile" if stored_meanwhile else ""
    return [*lines, f"{len(found)} cells checked: {kept} come out the same, and are kept{more}"]


if __name__ == "__main__":
    sys.exit(main())
