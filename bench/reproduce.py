"""``python -m bench.reproduce <cell>``: run a stored cell again, and say how what comes out compares with it.

``identical``: every score of every replicate is the stored one; ``within tolerance``: they differ by less than would
show in a table; ``drifted``: they do not, and the worst scores are named, with what has changed in the code, the
packages and the machine since. ``<cell>`` is an identity, or the start of one; the stored cell is left as it is.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.cell import Cell
from bench.cli import read_fields
from bench.disturbance import make_disturbance
from bench.errors import InputError
from bench.launch import complete
from bench.scenario import ForceSpec, PriorSpec, Scenario
from bench.slots import Limits
from bench.store import DIGITS, Store, StoredCell
from bench.store_archive.opening import DEFAULT_STORE, open_store
from bench.terminal import command
from bench.version import Version

USAGE = f"usage: python -m bench.reproduce <cell> [store={DEFAULT_STORE}] [archive=<folder>|none]\n\n"
TOLERANCE = 1e-3
"""Relative difference of a score that no table shows; the stored digits are finer."""
MOST_NAMED = 5


@dataclass(frozen=True)
class Verdict:
    """``differences``: worst relative difference by score; ``changed``: what else is not as it was, in words."""

    name: str
    differences: Mapping[str, float]
    changed: tuple[str, ...]


def stored_as_cell(stored: StoredCell) -> Cell:
    """The cell whose description is stored; raises InputError where this version describes it differently."""
    what = stored.cell
    data, told = what["data"], what["told"]
    prior = told["prior"]
    if prior is not None:
        widths = {kind: sd for kind, sd in prior.items() if kind != "wrong"}
        prior = PriorSpec("stored", widths, prior["wrong"], "truth" if data.get("truth") == "drawn" else "nominal")
    scenario = Scenario(
        system=data["system"],
        parameters=data["parameters"],
        initial=(tuple(data["initial"][0]), tuple(data["initial"][1])),
        snr_db=data["snr_db"],
        duration=data["duration"],
        samples=data["samples"],
        told=told["initial_state"],
        prior=prior,
        force=ForceSpec(**data["force"]) if data["force"] else None,
        options=data["options"],
        dense=what["dense"],
        forecast=what["forecast"],
        label=what["system"],
        disturbance=_disturbance(data.get("disturbance")),
        measured=tuple(data["measured"]) if "measured" in data else None,
        added_mass=tuple(data["added_mass"]) if "added_mass" in data else None,
    )
    # the description sorts them; a prior that is centred on them names them in the system's order
    names = scenario.make_system().names
    scenario = replace(scenario, parameters={name: data["parameters"][name] for name in names})
    cell = Cell(scenario, what["method"], what["settings"], what["replicates"], what["seed"], what["label"])
    if cell.identity != stored.identity:
        raise InputError("cell", stored.identity, "this version describes its configuration differently; run it anew")
    return cell


def _disturbance(stored: Mapping[str, Any] | None) -> Any:
    if not stored:
        return None
    settings = dict(stored)
    return make_disturbance(settings.pop("kind"), settings)


def compare(old: StoredCell, new: StoredCell) -> Verdict:
    """How a cell that was run again compares with the stored one: statuses, scores, data, and what computed them."""
    differences: dict[str, float] = {}
    changed = []
    for before, after in zip(old.rows, new.rows, strict=True):
        if before.status is not after.status:
            changed.append(f"replicate {before.replicate} was {before.status}, now {after.status}")
        for name in {*before.scores, *after.scores}:
            gap = _relative(before.scores.get(name, math.nan), after.scores.get(name, math.nan))
            differences[name] = max(differences.get(name, 0.0), gap)
    other_data = sum(before.data != after.data for before, after in zip(old.rows, new.rows, strict=True))
    worst = max(differences.values(), default=0.0)
    name = "identical"
    if worst > 0.5 * 10.0 ** (1 - DIGITS):
        name = "within tolerance"
    if worst > TOLERANCE or changed:
        name = "drifted"
    if other_data:
        changed.append(f"the data of {other_data} replicate(s) differ in their last digits or more")
    return Verdict(name, {k: v for k, v in differences.items() if v > 0}, (*changed, *_circumstances(old, new)))


def _relative(before: float, after: float) -> float:
    if before == after or (math.isnan(before) and math.isnan(after)):
        return 0.0
    if not (math.isfinite(before) and math.isfinite(after)):
        return math.inf
    return abs(before - after) / max(abs(before), abs(after))


def _circumstances(old: StoredCell, new: StoredCell) -> list[str]:
    lines = Version(new.version["modules"], new.version["packages"]).changes(old.version)
    for field in ("python", "system", "processor"):
        before, after = old.provenance.get(field), new.provenance.get(field)
        if before != after:
            lines.append(f"{field} {before}, now {after}")
    return lines


def find(store: Store, text: str) -> StoredCell:
    """The stored cell whose identity starts so; raises InputError for none or several."""
    found = [identity for identity in store.identities() if identity.startswith(text)] if store.there() else []
    if len(found) != 1:
        reason = "no such cell" if not found else f"{len(found)} cells start so"
        raise InputError("cell", text, f"{reason} in {store.folder}; their files are named by them")
    stored = store.load(found[0])
    assert stored is not None
    return stored


def run_again(stored: StoredCell) -> StoredCell:
    """Run a stored cell again in a store of its own."""
    cell = stored_as_cell(stored)
    limits = stored.provenance.get("limits", {})
    with tempfile.TemporaryDirectory() as folder:
        fresh = Store(Path(folder) / "rows")
        fresh.prepare()
        complete([cell], fresh, Limits(os.cpu_count() or 1, limits.get("timeout_s", 600.0)))
        again = fresh.load(cell.identity)
    assert again is not None
    return again


def page(stored: StoredCell, verdict: Verdict) -> str:
    """The verdict in a few lines."""
    what, come = stored.cell, stored.provenance
    commit = str(come.get("commit"))[:10] + (" with changes" if come.get("dirty") else "")
    lines = [
        f"{what['label']} on {what['system']}, {what['snr_db']:g} dB, initial state {what['initial_state']}, "
        f"{len(stored.rows)} replicates, computed {come.get('started')} at commit {commit}",
        f"run again: {verdict.name}",
    ]
    worst = sorted(verdict.differences.items(), key=lambda item: -item[1])[:MOST_NAMED]
    lines += [f"  {name}: relative difference up to {gap:.1g}" for name, gap in worst]
    return "\n".join([*lines, *(f"  {text}" for text in verdict.changed)])


def main(argv: Sequence[str] | None = None) -> int:
    """Print the verdict; exit status 0, 1 where the cell has drifted, 2 for bad input."""
    return command("bench.reproduce", USAGE + str(__doc__), argv, _main)


def _main(arguments: Sequence[str]) -> int:
    if not arguments:
        print(USAGE + str(__doc__))
        return 2
    names = [a for a in arguments if "=" not in a]
    given = read_fields([a for a in arguments if "=" in a], {"store": DEFAULT_STORE, "archive": ""})
    if len(names) != 1 or not all(c in "0123456789abcdef" for c in names[0]):
        raise InputError("cell", " ".join(names), "give one identity, or the start of one")
    store = open_store(given["store"], given["archive"])
    stored = find(store, names[0])
    verdict = compare(stored, run_again(stored))
    print(page(stored, verdict))
    print(store.whereabouts(stored.identity))
    return 1 if verdict.name == "drifted" else 0


if __name__ == "__main__":
    sys.exit(main())
