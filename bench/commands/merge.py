"""A submission, or another store, brought into a store."""

from __future__ import annotations

import hashlib
import os
import secrets
from datetime import UTC, datetime
from pathlib import Path

from bench.commands.declaration import file
from bench.engine.runner import compute_bounds
from bench.errors import InputError
from bench.exchange.merging import merge, merge_store, summarised, understood, verify
from bench.exchange.recomputing import widest_limits
from bench.exchange.submission import unpack
from bench.isolation.machine import usable_cores
from bench.reporting.terminal import wrapped
from bench.store.bounds import load_bounds
from bench.store.store import Store


def merge_source(source: Path, folder: Path, share: float, seed: int | None, workers: int | None) -> int:
    """Merge a submission or a store; returns 1 where a submission does not agree; raises InputError."""
    into = Store(folder)
    if os.path.isdir(source):
        print(merge_store(source, into))
        return 0
    file("submission", source, "a submission, or the folder of a store")
    drawn = secrets.randbits(48) if seed is None else seed
    return _merge_submission(source, into, share, drawn, workers or usable_cores())


def _merge_submission(path: Path, into: Store, share: float, seed: int, workers: int) -> int:
    manifest, submitted = unpack(path)
    pairs = [(stored, understood(stored, manifest, path)) for stored in submitted]
    cells = [cell for _, cell in pairs]
    into.prepare()
    limits = widest_limits(submitted, workers)
    for identity, why in compute_bounds(cells, into, limits).items():
        raise InputError("submission", path, f"cell {identity[:8]}: {why}")
    verification = verify(pairs, share, seed, limits)
    print(wrapped(str(verification)))
    if verification.different:
        again = f"python -m bench share action=merge submission={path} seed={seed}"
        print(f"nothing was added; {again} draws the same rows again")
        return 1
    facts = {
        **{name: manifest.get(name, "") for name in ("by", "made", "class", "benchmark")},
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "merged": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": seed,
        **verification.facts(),
    }
    bounds = load_bounds(cells, into.bounds)
    print(merge([
        summarised(stored, bound).marked({**facts, "replicates": list(verification.compared.get(stored.identity, ()))})
        for stored, bound in zip(submitted, bounds, strict=True)
    ], into))  # fmt: skip
    return 0
