"""``python -m bench.status``: what is stored, failed, stale and missing, and why; reads only, computes nothing.

Alone it describes a store; with the fields of a sweep (``experiment=table3``, ``method=ls,pinn snr=20,10``) it says how
far that sweep is, and with ``watch=true`` follows it until it is done.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np
import pandas as pd

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
from bench.store import index as view
from bench.store.cell import Cell
from bench.store.opening import DEFAULT_STORE
from bench.store.store import Store
from bench.store.version import cell_version
from bench.sweep.plan import Reasons, State, plan, read_retry

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
WATCH_S, SHORTEST_S, LONGEST_S = 2.0, 0.1, 3600.0


def states(store: Store) -> pd.DataFrame:
    """One line a stored cell: ``label``, ``replicates``, ``wall_s``, ``state`` and ``why``, indexed by identity."""
    columns = ("problem", "method", "kind", "disturbance", "label", "statuses", "version", "replicates", "wall_s")
    found = view.cells(store, columns)
    reasons = Reasons(store)
    kinds = found[["problem", "method", "kind", "disturbance", "statuses", "version"]].fillna("").astype(object)
    state, why = np.empty(len(found), object), np.empty(len(found), object)
    for kind, places in kinds.groupby(list(kinds.columns)).indices.items():
        state[places], why[places] = _state(str(found.index[places[0]]), kind, reasons)
    return found.assign(state=state, why=why)


def _state(identity: str, kind: tuple[str, ...], reasons: Reasons) -> tuple[str, str]:
    problem, method, system, disturbance, statuses, version = kind
    if problem:
        return State.DAMAGED.value, problem
    if method not in method_names():
        return "foreign", f"no method {method} is installed here"
    now = cell_version(method, system, disturbance or "none")
    state, why = reasons.standing(identity, method, now, version, statuses)
    return state.value, why


def store_page(store: Store) -> str:
    """The store by method and state, and the reasons of what is not done."""
    found = states(store)
    if found.empty:
        return f"{store.folder}: no cells yet; python -m bench method=ls computes a first one"
    labels = found["label"].fillna("?")
    counts = found.groupby([labels, "state"]).size().unstack(fill_value=0)
    order = [name for name in (*(s.value for s in State), "foreign") if name in counts]
    spent = found.groupby(labels)["wall_s"].sum()
    fits = found.groupby(labels)["replicates"].sum()
    rows = [
        [
            str(label),
            *(str(int(counts.loc[label, name]) or "") for name in order),
            str(int(fits[label])),
            f"{spent[label]:.0f}",
        ]
        for label in counts.index
    ]
    total = found["state"].value_counts()
    headers = ["method", *order, "fits", "fit s"]
    said = f"{len(found)} cells: " + ", ".join(f"{total[s]} {s}" for s in order)
    lines = [table(rows, headers), "", wrapped(said), *_places(found, store)]
    return "\n".join([*lines, *_reasons(found)])


def _places(found: pd.DataFrame, store: Store) -> list[str]:
    """Which folders the cells lie in."""
    if store.archive is None:
        return [f"store: {store.folder}"]
    own = sum(map(store.own, found.index))
    return [
        f"store: {store.folder} ({own} cells)",
        f"published archive: {store.archive.folder} ({len(found) - own} cells)",
    ]


def _reasons(found: pd.DataFrame) -> list[str]:
    lines = []
    for state in ("stale", "failed", "foreign", "damaged"):
        own = found[found["state"] == state]
        for why, n in own["why"].value_counts().head(MOST_REASONS).items():
            labels = ", ".join(sorted(set(own.loc[own["why"] == why, "label"].dropna()))[:6])
            said = f"{state}: {n} x {_short(str(why))}" + (f" ({labels})" if labels else "")
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
