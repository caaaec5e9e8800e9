"""``share action=merge``: add a submission, or another store, to a store."""

from __future__ import annotations

import hashlib
import os
import secrets
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import Within, file
from bench.commands.stores import DEFAULT, StoreFolder
from bench.errors import InputError


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
