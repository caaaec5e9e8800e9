"""``python -m bench.status``: what is stored, failed, stale and missing, and why; reads only, computes nothing.

Alone it describes a store; with the fields of a sweep (``experiment=table3``, ``method=ls,pinn snr=20,10``) it says how
far that sweep is, and with ``watch=true`` follows it until it is done.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from bench.commands.fields import number, read_fields
from bench.commands.guard import command
from bench.commands.stores import FIELDS, store_of
from bench.commands.watch import Progress, follow
from bench.contract.estimate import Status
from bench.entrants.registry import method_names
from bench.errors import InputError
from bench.isolation.cores import usable_cores
from bench.reporting.plan_table import listing
from bench.reporting.terminal import table, wrapped
from bench.store.cell import Cell
from bench.store.opening import DEFAULT_STORE
from bench.store.store import Store
from bench.store.stored import Head
from bench.store.version import cell_version
from bench.sweep.plan import State, plan, read_retry, standing
from bench.systems import registered_systems

USAGE = f"""usage: python -m bench.status [store=<folder>]                         a store
       python -m bench.status experiment=table3 [watch=true]          a sweep
       python -m bench.status method=ls,pinn snr=40,20 [watch=10]     a sweep

fields (defaults in brackets):
  store          [{DEFAULT_STORE}] where cells are kept
  archive        [that of the checkout] published cells; a folder, or none
  watch          [false] true: follow the sweep while a run computes it, with a
                 look every 2 s; a number: with a look every so many seconds.
                 In place on a terminal, else a line a look. It ends when every
                 cell is stored, or with Ctrl-C (status 130; the run goes on)
  experiment, method, ...    the sweep, as for python -m bench -m
"""
OWN_FIELDS = {**FIELDS, "watch": "false"}
MOST_REASONS = 3
FOREIGN = "foreign"
"""The state of a cell whose method or system is not installed."""
WATCH_S, SHORTEST_S, LONGEST_S = 2.0, 0.1, 3600.0


@dataclass(frozen=True)
class Standing:
    """A stored cell, where it stands and why."""

    head: Head
    state: str
    why: str


def standings(store: Store) -> list[Standing]:
    """Say of every stored cell whether it is current, stale, failed, foreign or damaged."""
    return [Standing(head, *_standing(head)) for head in store.heads()]


def _standing(head: Head) -> tuple[str, str]:
    if head.problem:
        return State.DAMAGED.value, head.problem
    method, system = str(head.cell.get("method")), str(head.cell.get("data", {}).get("system"))
    if method not in method_names():
        return FOREIGN, f"no method {method} is installed here"
    if system not in registered_systems():
        return FOREIGN, f"no system {system} is installed here"
    state, why = standing(head, method, cell_version(method, system))
    return state.value, why


def store_page(store: Store) -> str:
    """Describe the store by method and state, with the reasons of what is not current."""
    found = standings(store)
    if not found:
        return f"{store.folder}: no cells yet; python -m bench method=ls computes a first one"
    total = Counter(one.state for one in found)
    order = [name for name in (*(s.value for s in State), FOREIGN) if total[name]]
    rows = []
    for label in sorted({one.head.label for one in found}):
        own = [one for one in found if one.head.label == label]
        counts = Counter(one.state for one in own)
        fits, spent = sum(one.head.replicates for one in own), sum(one.head.wall_s for one in own)
        rows.append([label, *(str(counts[name] or "") for name in order), str(fits), f"{spent:.0f}"])
    said = f"{len(found)} cells: " + ", ".join(f"{total[name]} {name}" for name in order)
    lines = [table(rows, ["method", *order, "fits", "fit s"]), "", wrapped(said), *_places(found, store)]
    return "\n".join([*lines, *_reasons(found)])


def _places(found: Sequence[Standing], store: Store) -> list[str]:
    """Say which folders the cells lie in."""
    if store.archive is None:
        return [f"store: {store.folder}"]
    own = sum(one.head.stamp > 0 for one in found)
    return [
        f"store: {store.folder} ({own} cells)",
        f"published archive: {store.archive.folder} ({len(found) - own} cells)",
    ]


def _reasons(found: Sequence[Standing]) -> list[str]:
    lines = []
    for state in (State.STALE.value, State.FAILED.value, FOREIGN, State.DAMAGED.value):
        reasons = Counter(one.why for one in found if one.state == state)
        for why, n in reasons.most_common(MOST_REASONS):
            labels = sorted({one.head.label for one in found if one.state == state and one.why == why} - {"?"})[:6]
            said = f"{state}: {n} x {_short(why)}" + (f" ({', '.join(labels)})" if labels else "")
            lines.append(wrapped(said, "    ", "  "))
    return lines


def _short(text: str) -> str:
    return text if len(text) <= 160 else f"{text[:157]}..."


def main(argv: Sequence[str] | None = None) -> int:
    """Print the page; exit status 2 for bad input."""
    return command("bench.status", USAGE, argv, _main, "no longer watched; a run that is under way goes on")


def _main(arguments: Sequence[str]) -> int:
    fields = [argument for argument in arguments if argument.partition("=")[0] not in OWN_FIELDS]
    given = read_fields([argument for argument in arguments if argument not in fields], OWN_FIELDS)
    seconds = read_watch(given["watch"])
    if seconds and not fields:
        raise InputError("watch", given["watch"], "say what to follow: experiment=<name>, or the fields of the sweep")
    sweep = _sweep(fields) if fields else None  # first, so that a misspelt field is said whatever the store is
    store = store_of(given)
    if sweep is None:
        print(store_page(store))
    elif seconds:
        follow(Progress(sweep[0], store, sweep[1]), seconds)
    else:
        print(listing(plan(sweep[0], store, sweep[1]), store, usable_cores()))
    return 0


def read_watch(text: str) -> float:
    """Seconds between two looks; 0 for none. Raises InputError."""
    if text in ("false", "true"):
        return WATCH_S if text == "true" else 0.0
    wanted = f"true, false, or the seconds between two looks, at least {SHORTEST_S:g}"
    return number("watch", text, math.nextafter(SHORTEST_S, 0.0), LONGEST_S, wanted)


def _sweep(fields: Sequence[str]) -> tuple[list[Cell], frozenset[Status]]:
    """The cells of a sweep, and the failures that it tries again."""
    from bench.config.experiment import expand

    jobs = expand(fields, multirun=True)
    return [job.cell() for job in jobs], read_retry(jobs[0].config.retry)


if __name__ == "__main__":
    sys.exit(main())
