"""The atlas as it is configured: ``conf/atlas/free_decay.yaml``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import yaml

from bench.atlas.design import Slice, blocks, sobol
from bench.atlas.point import Point
from bench.atlas.run import Task
from bench.config.suggest import did_you_mean
from bench.entrants.registry import make_method
from bench.errors import InputError

SAMPLED = "points"
"""What the part is called that is not a slice."""


def atlas_content() -> dict[str, Any]:
    """The content of the file."""
    content = yaml.safe_load(files("conf").joinpath("atlas", "free_decay.yaml").read_text(encoding="utf-8"))
    assert isinstance(content, dict)
    return content


def atlas_slices() -> list[Slice]:
    """The slices, by name."""
    return [_slice(name, stated) for name, stated in atlas_content()["slices"].items()]


def part_names() -> list[str]:
    """The sampled points, and each slice."""
    return [SAMPLED, *atlas_content()["slices"]]


def atlas_points() -> list[Point]:
    """The points of the sequence."""
    content = atlas_content()
    return sobol(content["points"], content["seed"])


def atlas_methods() -> list[str]:
    """Every method of the atlas, those of all points first."""
    content = atlas_content()
    return [*content["methods"], *content["points_by_method"]]


def on_the_bound() -> list[str]:
    """Methods that a plan may count on."""
    return list(atlas_content()["on_the_bound"])


def atlas_tasks(part: str, methods: Sequence[str] = (), most_points: int | None = None) -> list[Task]:
    """What is to be computed for a part, block by block; all methods of a block one behind the other.

    Raises InputError for a part or a method that the atlas does not have.
    """
    content = atlas_content()
    if part not in part_names():
        raise InputError("part", part, f"{did_you_mean(part, part_names())}some of {', '.join(part_names())}")
    own = atlas_methods() if part == SAMPLED else list(content["slice_methods"])
    for name in methods:
        if name not in atlas_methods():
            near = did_you_mean(name, atlas_methods())
            raise InputError("method", name, f"{near}some of {', '.join(atlas_methods())}")
    points = atlas_points() if part == SAMPLED else next(s for s in atlas_slices() if s.name == part).points()
    points = points[:most_points]
    found = []
    for number, block in enumerate(blocks(points, content["block"])):
        for name in own:
            limit = content["points_by_method"].get(name, len(points)) if part == SAMPLED else len(points)
            if (not methods or name in methods) and number * content["block"] < limit:
                found.append(_task(content, part, name, block))
    return found


def _task(content: Mapping[str, Any], part: str, label: str, block: Sequence[Point]) -> Task:
    settings = dict(content["variants"].get(label, {}))
    method = settings.pop("method", label)
    make_method(method, settings)  # a name or a setting that is wrong is said before any work starts
    n = content["replicates_by_method"].get(label, content["replicates"])
    return Task(block, method, settings, n if part == SAMPLED else content["slice_replicates"], content["seed"], label)


def _slice(name: str, stated: Mapping[str, Any]) -> Slice:
    columns, rows = stated["size"]
    free = {stated["across"]: 1.0, stated["up"]: 1.0}
    at = {key: stated.get(key, free.get(key)) for key in ("samples", "cycles", "damping_ratio", "snr_db", "phase")}
    fixed = Point(**at, start_known=bool(stated["start_known"]))
    return Slice(name, fixed, stated["across"], stated["up"], (columns, rows))
