"""Storage of bounds: each is computed once and stored in a file named by a hash of everything that it depends on.

A damaged or incomplete file is replaced by a new computation without a message.
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
    """Anything with a scenario, a seed and a number of replicates, such as a cell."""

    @property
    def scenario(self) -> Scenario: ...

    @property
    def seed(self) -> int: ...

    @property
    def replicates(self) -> int: ...


class Replicates(NamedTuple):
    """Replicates of a scenario, for a bound without a method."""

    scenario: Scenario
    seed: int = 0
    replicates: int = 1


def bound_identity(subject: Bounded) -> str:
    """Hash everything that the bound depends on.

    The seed is included only if it determines a random force or random times, and the number of replicates only if each
    has different times.
    """
    scenario, seed = subject.scenario, subject.seed
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
        identity |= {"disturbance": scenario.disturbance.to_dict(), "replicates": subject.replicates}
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


def bound_path(subject: Bounded, folder: Path) -> Path:
    """Return the path of a bound in a folder."""
    return folder / f"{bound_identity(subject)}.bound"


def store_bound(subject: Bounded, folder: Path) -> Bound:
    """Compute a bound and store it; raises InputError if ``folder`` cannot be written."""
    bound = compute_bound(subject.scenario, subject.seed, subject.replicates)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(bound_path(subject, folder), sealed(BOUND_FORMAT, json.dumps(asdict(bound))))
    except OSError:
        remedy = "the bounds cannot be written; free disk space, or use another folder"
        raise InputError("store", folder, remedy) from None
    return bound


def load_bounds(subjects: Sequence[Bounded], folder: Path) -> list[Bound]:
    """Return bounds from a folder; missing or damaged ones are computed and stored (:func:`store_bound`)."""
    return [read_bound(bound_path(item, folder)) or store_bound(item, folder) for item in subjects]


def read_bound(path: Path) -> Bound | None:
    """Return the bound in a file; None if the file is missing or damaged."""
    try:
        values = json.loads(unsealed_text(BOUND_FORMAT, read_regular(path)))
        names, null_space = tuple(values.pop("names")), tuple(map(tuple, values.pop("null_space")))
        return Bound(names=names, null_space=null_space, **values)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
