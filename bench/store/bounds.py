"""Bounds are computed once and kept, each in a file named by all that it depends on, its code included."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import sys
import uuid
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from bench.errors import InputError
from bench.information.fisher import Bound, compute_bound
from bench.isolation.mainless import without_main
from bench.scenario.scenario import Scenario
from bench.store.version import bound_version

UNWRITABLE = 74
"""Exit status of the process that computes bounds where it cannot store them."""


def bound_identity(scenario: Scenario, seed: int) -> str:
    """Hash of everything the bound depends on (the seed only where it draws a force)."""
    system = type(scenario.make_system())
    identity = {
        "code": bound_version((system.__module__, system.__name__)),
        **scenario.undisturbed.data_identity(),
        **scenario.told_identity(),
        "dense": scenario.dense,
        "forecast": scenario.forecast,
        "seed": seed if scenario.force else None,
    }
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


Job = tuple[Scenario, int, Path]
"""A scenario and seed, and the file that keeps their bound."""


def _compute_to_file(job: Job) -> None:
    scenario, seed, path = job
    text = json.dumps(asdict(compute_bound(scenario, seed)))
    temporary = path.with_suffix(f".{uuid.uuid4().hex}.tmp")  # two machines can have the same process ids
    try:
        temporary.write_text(text)
        os.replace(temporary, path)
    except OSError:
        raise _unwritable(path.parent) from None


def _unwritable(folder: Path) -> InputError:
    return InputError("store", folder, "the bounds cannot be written; make room, or name another folder")


def _compute_all(jobs: Sequence[Job]) -> None:
    """Main function of the process that computes bounds with jax."""
    try:
        for job in jobs:
            _compute_to_file(job)
    except InputError:
        sys.exit(UNWRITABLE)


def load_bounds(wanted: Sequence[tuple[Scenario, int]], folder: Path) -> list[Bound]:
    """The bounds of (scenario, seed) pairs from the cache under ``folder``.

    What is missing is computed first: of linear systems here, of others in one process of its own, so that jax never
    shares a process with a fit. Raises InputError where ``folder`` cannot be written.
    """
    paths = [folder / f"{bound_identity(scenario, seed)}.bound" for scenario, seed in wanted]
    missing = {path: job for path, job in zip(paths, wanted, strict=True) if not path.exists()}
    if missing:
        folder.mkdir(parents=True, exist_ok=True)
    jobs = [(scenario, seed, path) for path, (scenario, seed) in missing.items()]
    for job in jobs:
        if job[0].make_system().linear:
            _compute_to_file(job)
    if others := [job for job in jobs if not job[0].make_system().linear]:
        process = multiprocessing.get_context("spawn").Process(target=_compute_all, args=(others,))
        with without_main():
            process.start()
        process.join()
        if process.exitcode == UNWRITABLE:
            raise _unwritable(folder)
        if process.exitcode != 0:
            raise RuntimeError(f"the computation of {len(others)} bound(s) failed (exit {process.exitcode})")
    return [_from_file(path) for path in paths]


def _from_file(path: Path) -> Bound:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        names, null_space = tuple(values.pop("names")), tuple(map(tuple, values.pop("null_space")))
        return Bound(names=names, null_space=null_space, **values)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError("store", path, "not a whole bound; remove it, it is computed anew") from None
