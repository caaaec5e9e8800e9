"""Classes that installed packages register by entry points: methods, trackers, systems and parts of methods."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from bench.errors import InputError, did_you_mean


@cache
def entry_points_of(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, without importing anything."""
    return {point.name: point for point in sorted(entry_points(group=group), key=lambda point: point.name)}


def load_entry_point(
    field: str,
    name: str,
    points: Mapping[str, EntryPoint],
    base: type,
    known: Collection[str] = (),
    needs: Collection[str] = (),
) -> Any:
    """Import the class registered under a name.

    Args:
        field: Field of the configuration that selects the name.
        name: Name of the entry point.
        points: Entry points of the group, by name.
        base: Required base class.
        known: All valid names, if there are more than the entry points.
        needs: Attributes that the class must define.

    Returns:
        The class.

    Raises:
        InputError: If the name is unknown or ambiguous, the import fails, or the object is not such a class.
    """
    if name not in points:
        names = list(known or points)
        kind = field.rpartition(".")[2]
        raise InputError(field, name, f"{did_you_mean(name, names)}known {kind}s: {', '.join(names)}")
    point = points[name]
    values = {point.value, *(other.value for other in entry_points(group=point.group, name=name))}
    if len(values) > 1:
        raise InputError(
            field, name, f"several packages register it ({', '.join(sorted(values))}); uninstall all but one"
        )
    try:
        loaded = point.load()
    except Exception as error:
        remedy = f"could not import its entry point ({point.value}: {type(error).__name__}: {error})"
        raise InputError(field, name, remedy) from None
    if not (isinstance(loaded, type) and issubclass(loaded, base)):
        raise InputError(field, name, f"its entry point ({point.value}) must name a subclass of {base.__name__}")
    missing = sorted(getattr(loaded, "__abstractmethods__", ()))
    missing += [attribute for attribute in needs if not getattr(loaded, attribute, None)]
    if missing:
        raise InputError(field, name, f"its entry point ({point.value}) lacks {', '.join(missing)}")
    return loaded
