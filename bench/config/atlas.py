"""Configuration of the atlases: ``conf/atlas/<kind>.yaml``, one file per kind of test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.atlas.design import Slice, blocks, make_point, sobol
from bench.atlas.forced_test import Forced
from bench.atlas.point import FreeDecay, Point
from bench.atlas.run import PointBlock
from bench.config.files import read_yaml
from bench.entrants.registry import make_method
from bench.errors import check_name

FREE_DECAY, FORCED = "free_decay", "forced"
TESTS: Mapping[str, type[Point]] = {FREE_DECAY: FreeDecay, FORCED: Forced}
"""Kinds of test by the name of their file."""
SAMPLED = "points"
"""Name of the part with the randomly sampled points; the other parts are slices."""


def atlas_content(test: str = FREE_DECAY) -> Mapping[str, Any]:
    """Return the configuration of a kind of test; raises InputError for an unknown kind."""
    check_name("test", test, TESTS)
    return read_yaml("atlas", test)


def atlas_slices(test: str = FREE_DECAY) -> list[Slice]:
    """Return the slices of an atlas."""
    kind, slices = TESTS[test], []
    for name, stated in atlas_content(test)["slices"].items():
        across, up, (columns, rows) = stated["across"], stated["up"], stated["size"]
        values = {axis.name: stated.get(axis.name, 1.0 if axis.name in (across, up) else None) for axis in kind.AXES}
        slices.append(Slice(name, make_point(kind, values, stated[kind.CHOICE.name]), across, up, (columns, rows)))
    return slices


def part_names(test: str = FREE_DECAY) -> list[str]:
    """Return the names of the parts: the sampled points, then each slice."""
    return [SAMPLED, *atlas_content(test)["slices"]]


def atlas_methods(test: str = FREE_DECAY) -> list[str]:
    """Return the labels of all methods of the atlas; those computed at every point come first."""
    content = atlas_content(test)
    return [*content["methods"], *content["points_by_method"]]


def efficient_methods() -> list[str]:
    """Return the methods that reach the bound, on which a plan can rely."""
    return list(atlas_content()["on_the_bound"])


def atlas_blocks(
    part: str, methods: Sequence[str] = (), most_points: int | None = None, test: str = FREE_DECAY
) -> list[PointBlock]:
    """Return the blocks of points to compute for one part of an atlas, with the methods of a block in sequence.

    Args:
        part: Name of the part, see :func:`part_names`.
        methods: Labels of the methods; empty for all of the atlas.
        most_points: Number of points after which to stop; None for all.
        test: Kind of test.

    Raises:
        InputError: The atlas has no such kind of test, part or method.
    """
    content, known = atlas_content(test), atlas_methods(test)
    check_name("part", part, part_names(test))
    for name in methods:
        check_name("method", name, known)
    if sampled := part == SAMPLED:
        points = list(sobol(TESTS[test], content["points"], content["seed"]))
    else:
        points = next(s for s in atlas_slices(test) if s.name == part).points()
    points = points[:most_points]
    result = []
    for number, block in enumerate(blocks(points, content["block"])):
        for label in known if sampled else content["slice_methods"]:
            limit = content["points_by_method"].get(label, len(points)) if sampled else len(points)
            if (methods and label not in methods) or number * content["block"] >= limit:
                continue
            settings = dict(content["variants"].get(label, {}))
            method = settings.pop("method", label)
            make_method(method, settings)  # raises InputError for a wrong setting before any work starts
            n = content["replicates_by_method"].get(label, content["replicates"])
            n = n if sampled else content["slice_replicates"]
            result.append(PointBlock(block, method, settings, n, content["seed"], label))
    return result
