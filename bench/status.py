"""``python -m bench.status``: what is stored, failed, stale and missing, and why; reads only, computes nothing.

Alone it describes a store; with the fields of a sweep (``experiment=table3``, ``method=ls,pinn snr=20,10``) it says how
far that sweep is.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from tabulate import tabulate

from bench import view
from bench.errors import InputError
from bench.plan import Reasons, State
from bench.registry import method_names
from bench.store import Store

USAGE = "usage: python -m bench.status [store=results/rows] [experiment=table3 | any field of a sweep]\n\n"
MOST_REASONS = 3


def states(store: Store) -> pd.DataFrame:
    """One line a stored cell: ``label``, ``replicates``, ``wall_s``, ``state`` and ``why``, indexed by identity."""
    columns = ("problem", "method", "kind", "label", "statuses", "version", "replicates", "wall_s")
    found = view.cells(store, columns)
    reasons = Reasons(store)
    kinds = found[["problem", "method", "kind", "statuses", "version"]].fillna("").astype(object)
    state, why = np.empty(len(found), object), np.empty(len(found), object)
    for kind, places in kinds.groupby(list(kinds.columns)).indices.items():
        state[places], why[places] = _state(str(found.index[places[0]]), kind, reasons)
    return found.assign(state=state, why=why)


def _state(identity: str, kind: tuple[str, ...], reasons: Reasons) -> tuple[str, str]:
    problem, method, system, statuses, version = kind
    if problem:
        return "damaged", problem
    if method not in method_names():
        return "foreign", f"no method {method} is installed here"
    state, why = reasons.standing(identity, method, system, version, statuses)
    return state.value, why


def store_page(store: Store) -> str:
    """The store by method and state, and the reasons of what is not done."""
    found = states(store)
    if found.empty:
        return f"{store.folder}: no cells"
    labels = found["label"].fillna("?")
    counts = found.groupby([labels, "state"]).size().unstack(fill_value=0)
    order = [name for name in (*(s.value for s in State), "foreign", "damaged") if name in counts]
    spent = found.groupby(labels)["wall_s"].sum()
    fits = found.groupby(labels)["replicates"].sum()
    rows = [
        [label, *(int(counts.loc[label, name]) or "" for name in order), int(fits[label]), f"{spent[label]:.0f}"]
        for label in counts.index
    ]
    table = tabulate(rows, headers=["method", *order, "fits", "fit s"], disable_numparse=True)
    total = found["state"].value_counts()
    lines = [table, "", f"{store.folder}: {len(found)} cells: " + ", ".join(f"{total[s]} {s}" for s in order)]
    return "\n".join([*lines, *_reasons(found)])


def _reasons(found: pd.DataFrame) -> list[str]:
    lines = []
    for state in ("stale", "failed", "foreign", "damaged"):
        own = found[found["state"] == state]
        for why, n in own["why"].value_counts().head(MOST_REASONS).items():
            labels = ", ".join(sorted(set(own.loc[own["why"] == why, "label"].dropna()))[:6])
            lines.append(f"  {state}: {n} x {_short(str(why))}" + (f" ({labels})" if labels else ""))
    return lines


def _short(text: str) -> str:
    return text if len(text) <= 160 else f"{text[:157]}..."


def main(argv: Sequence[str] | None = None) -> int:
    """Print the page; exit status 2 for bad input."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if {"-h", "--help"} & set(arguments):
        print(USAGE + str(__doc__))
        return 0
    try:
        fields = [argument for argument in arguments if not argument.startswith("store=")]
        given = [argument.partition("=")[2] for argument in arguments if argument.startswith("store=")]
        store = Store(Path(given[-1] if given else "results/rows"))
        if not store.folder.is_dir():
            raise InputError("store", store.folder, "there is no such folder; run a sweep first, or name another")
        print(sweep_page(fields, store) if fields else store_page(store))
    except InputError as error:
        print(f"bench.status: {error}", file=sys.stderr)
        return 2
    return 0


def sweep_page(fields: Sequence[str], store: Store) -> str:
    """A sweep's cells: done, failed, stale, missing, and why."""
    from bench.cli import listing
    from bench.config import expand, jobs_to_cells
    from bench.plan import plan

    cells = jobs_to_cells(expand(fields, multirun=True))
    return listing(plan(cells, store), store, os.cpu_count() or 1)


if __name__ == "__main__":
    sys.exit(main())
