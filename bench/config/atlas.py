"""The atlases as they are configured, a kind of test each: ``conf/atlas/<kind>.yaml``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import yaml

from bench.atlas.design import Slice, blocks, made, sobol
from bench.atlas.forced import Forced
from bench.atlas.point import FreeDecay, Point
from bench.atlas.run import Block
from bench.entrants.registry import make_method
from bench.errors import InputError, did_you_mean

FREE_DECAY, FORCED = "free_decay", "forced"
TESTS: Mapping[str, type[Point]] = {FREE_DECAY: FreeDecay, FORCED: Forced}
"""The kinds of test, by the name of their file."""
SAMPLED = "points"
"""What the part is called that is not a slice."""


@cache
def atlas_content(test: str = FREE_DECAY) -> Mapping[str, Any]:
    """The content of the file of a kind of test; raises InputError for a kind that there is not."""
    if test not in TESTS:
        raise InputError("test", test, f"{did_you_mean(test, list(TESTS))}one of {', '.join(TESTS)}")
    content = yaml.safe_load(files("conf").joinpath("atlas", f"{test}.yaml").read_text(encoding="utf-8"))
    assert isinstance(content, dict)
    return content


def atlas_slices(test: str = FREE_DECAY) -> list[Slice]:
    """The slices, by name."""
    return [_slice(TESTS[test], name, stated) for name, stated in atlas_content(test)["slices"].items()]


def part_names(test: str = FREE_DECAY) -> list[str]:
    """The sampled points, and each slice."""
    return [SAMPLED, *atlas_content(test)["slices"]]


def atlas_points(test: str = FREE_DECAY) -> list[Point]:
    """The points of the sequence."""
    content = atlas_content(test)
    return sobol(TESTS[test], content["points"], content["seed"])


def atlas_methods(test: str = FREE_DECAY) -> list[str]:
    """Every method of the atlas, those of all points first."""
    content = atlas_content(test)
    return [*content["methods"], *content["points_by_method"]]


def on_the_bound() -> list[str]:
    """Methods that a plan may count on."""
    return list(atlas_content()["on_the_bound"])


def atlas_blocks(
    part: str, methods: Sequence[str] = (), most_points: int | None = None, test: str = FREE_DECAY
) -> list[Block]:
    """What is to be computed for a part, block by block; all methods of a block one behind the other.

    Raises InputError for a kind of test, a part or a method that the atlas does not have.
    """
    content = atlas_content(test)
    if part not in (parts := part_names(test)):
        raise InputError("part", part, f"{did_you_mean(part, parts)}some of {', '.join(parts)}")
    known = atlas_methods(test)
    own = known if part == SAMPLED else list(content["slice_methods"])
    for name in methods:
        if name not in known:
            raise InputError("method", name, f"{did_you_mean(name, known)}some of {', '.join(known)}")
    points = atlas_points(test) if part == SAMPLED else next(s for s in atlas_slices(test) if s.name == part).points()
    points = points[:most_points]
    found = []
    for number, block in enumerate(blocks(points, content["block"])):
        for name in own:
            limit = content["points_by_method"].get(name, len(points)) if part == SAMPLED else len(points)
            if (not methods or name in methods) and number * content["block"] < limit:
                found.append(_block(content, part, name, block))
    return found


def _block(content: Mapping[str, Any], part: str, label: str, block: Sequence[Point]) -> Block:
    settings = dict(content["variants"].get(label, {}))
    method = settings.pop("method", label)
    make_method(method, settings)  # a name or a setting that is wrong is said before any work starts
    n = content["replicates_by_method"].get(label, content["replicates"])
    return Block(block, method, settings, n if part == SAMPLED else content["slice_replicates"], content["seed"], label)


def _slice(kind: type[Point], name: str, stated: Mapping[str, Any]) -> Slice:
    columns, rows = stated["size"]
    free = {stated["across"]: 1.0, stated["up"]: 1.0}
    at = {axis.name: stated.get(axis.name, free.get(axis.name)) for axis in kind.AXES}
    fixed = made(kind, at, stated[kind.CHOICE.name])
    return Slice(name, fixed, stated["across"], stated["up"], (columns, rows))
