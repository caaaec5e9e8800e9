"""Bounds are computed once and kept, each in a file named by all that it depends on, versions included.

The name decides the number: a file that is not whole is computed anew, without a word.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple, Protocol

from bench.errors import InputError
from bench.files import read_regular, write_whole
from bench.information.fisher import Bound, compute_bound, own_times
from bench.scenario.scenario import Scenario
from bench.store.seal import sealed, unsealed_text
from bench.store.store import BOUND_FORMAT
from bench.store.version import bound_version


class Bounded(Protocol):
    """A scenario and a seed; the replicates count where each has times of its own."""

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
    """Hash everything that the bound depends on: the seed only where it draws a force or times."""
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
    """Return the file of a folder that keeps a bound."""
    return folder / f"{bound_identity(wanted)}.bound"


def keep_bound(wanted: Bounded, folder: Path) -> Bound:
    """Compute a bound and write its file; raises InputError where ``folder`` cannot be written."""
    bound = compute_bound(wanted.scenario, wanted.seed, wanted.replicates)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(bound_path(wanted, folder), sealed(BOUND_FORMAT, json.dumps(asdict(bound))))
    except OSError:
        raise InputError("store", folder, "the bounds cannot be written; make room, or name another folder") from None
    return bound


def load_bounds(wanted: Sequence[Bounded], folder: Path) -> list[Bound]:
    """Return the bounds kept in a folder; what is missing or damaged is computed and kept, see :func:`keep_bound`."""
    return [kept_bound(bound_path(item, folder)) or keep_bound(item, folder) for item in wanted]


def kept_bound(path: Path) -> Bound | None:
    """Return the bound of a file; None where there is none, or none that is whole."""
    try:
        values = json.loads(unsealed_text(BOUND_FORMAT, read_regular(path)))
        names, null_space = tuple(values.pop("names")), tuple(map(tuple, values.pop("null_space")))
        return Bound(names=names, null_space=null_space, **values)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
