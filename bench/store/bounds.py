"""Bounds are computed once and kept, each in a file named by all that it depends on, versions included.

The name decides the number: a file that is not whole is computed anew, without a word.
"""

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
from typing import NamedTuple, Protocol

from bench.errors import InputError
from bench.information.fisher import Bound, compute_bound, own_times
from bench.isolation.mainless import without_main
from bench.scenario.scenario import Scenario
from bench.store.bound_file import bound_file, bound_text
from bench.store.seal import read_regular, write_new
from bench.store.version import bound_version

UNWRITABLE = 74
"""Exit status of the process that computes bounds where it cannot store them."""


class Bounded(Protocol):
    """What has a bound, as a cell: a scenario and seed; the replicates count where each has times of its own."""

    @property
    def scenario(self) -> Scenario: ...

    @property
    def seed(self) -> int: ...

    @property
    def replicates(self) -> int: ...


class Replicates(NamedTuple):
    """Replicates of a scenario, which have a bound without a method."""

    scenario: Scenario
    seed: int = 0
    replicates: int = 1


def bound_identity(wanted: Bounded) -> str:
    """Hash of everything the bound depends on: the seed only where it draws a force or times."""
    scenario, seed = wanted.scenario, wanted.seed
    drawn = own_times(scenario, seed)
    identity = {
        "version": bound_version(scenario.system),
        **scenario.undisturbed.data_identity(),
        **scenario.told_identity(),
        "dense": scenario.dense,
        "forecast": scenario.forecast,
        "seed": seed if scenario.force or drawn else None,
    }
    if drawn and scenario.disturbance is not None:
        identity |= {"disturbance": scenario.disturbance.to_dict(), "replicates": wanted.replicates}
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


def bound_path(wanted: Bounded, folder: Path) -> Path:
    """The file of a folder that keeps a bound."""
    return folder / f"{bound_identity(wanted)}.bound"


def keep_bound(wanted: Bounded, folder: Path) -> None:
    """Compute a bound here and write its file; raises InputError where ``folder`` cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        raise _unwritable(folder) from None
    path = bound_path(wanted, folder)
    text = json.dumps(asdict(compute_bound(wanted.scenario, wanted.seed, wanted.replicates)))
    temporary = path.with_suffix(f".{uuid.uuid4().hex}.tmp")  # two machines can have the same process ids
    try:
        write_new(temporary, bound_file(text))
        os.replace(temporary, path)
    except OSError:
        raise _unwritable(path.parent) from None


def _unwritable(folder: Path) -> InputError:
    return InputError("store", folder, "the bounds cannot be written; make room, or name another folder")


def _keep_all(wanted: Sequence[Bounded], folder: Path) -> None:
    """Main function of the process that computes bounds with jax."""
    try:
        for one in wanted:
            keep_bound(one, folder)
    except InputError:
        sys.exit(UNWRITABLE)


def load_bounds(wanted: Sequence[Bounded], folder: Path) -> list[Bound]:
    """The bounds from the cache under ``folder``.

    What is missing or damaged is computed first: of linear systems here, of others in one process of its own, so that
    jax never shares a process with a fit. Raises InputError where ``folder`` cannot be written.
    """
    paths = [bound_path(one, folder) for one in wanted]
    found = {path: kept_bound(path) for path in dict.fromkeys(paths)}
    missing = {path: one for path, one in zip(paths, wanted, strict=True) if found[path] is None}.values()
    for one in missing:
        if one.scenario.make_system().linear:
            keep_bound(one, folder)
    if others := [one for one in missing if not one.scenario.make_system().linear]:
        process = multiprocessing.get_context("spawn").Process(target=_keep_all, args=(others, folder))
        with without_main():
            process.start()
        process.join()
        if process.exitcode == UNWRITABLE:
            raise _unwritable(folder)
        if process.exitcode != 0:
            raise RuntimeError(f"the computation of {len(others)} bound(s) failed (exit {process.exitcode})")
    return [found[path] or _written(path) for path in paths]


def _written(path: Path) -> Bound:
    """The bound that has just been written."""
    bound = kept_bound(path)
    if bound is None:
        raise InputError("store", path, "the bound that was written there cannot be read; run again")
    return bound


def kept_bound(path: Path) -> Bound | None:
    """The bound of a file; None where there is none, or none that is whole."""
    try:
        values = json.loads(bound_text(read_regular(path)))
        names, null_space = tuple(values.pop("names")), tuple(map(tuple, values.pop("null_space")))
        return Bound(names=names, null_space=null_space, **values)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
