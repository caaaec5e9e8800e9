"""The registered online methods: entry points of the group ``bench.trackers``, and every other method by a window."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from bench.contract.online import OnlineCard, OnlineIdentifier
from bench.entrants.registry import default_settings, load_method, make_method, registered
from bench.entrants.window import OF_WINDOW, Window
from bench.errors import InputError
from bench.scenario.declaration import validated

GROUP = "bench.trackers"
WINDOW = "window_"
"""What stands before a method's name where it is followed in windows: ``window_`` and the name of a batch method."""


@cache
def registered_online() -> dict[str, EntryPoint]:
    """Entry points by name; nothing is imported."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda point: point.name)}


def first_online() -> str:
    """The one whose card stands first: what is taken where none is asked for."""
    return min(registered_online(), key=lambda name: load_online(name).card.order)


def online_names() -> list[str]:
    """All that may be asked for: online methods, then every batch method in windows."""
    return [*registered_online(), *(WINDOW + name for name in registered())]


def load_online(name: str) -> type[OnlineIdentifier]:
    """The class behind a name; raises InputError for an unknown one or one that does not load."""
    if name not in registered_online():
        raise InputError("method", name, f"online methods: {', '.join(online_names())}")
    try:
        loaded = registered_online()[name].load()
    except Exception as error:
        raise InputError("method", name, f"its entry point does not load ({type(error).__name__}: {error})") from None
    if not (isinstance(loaded, type) and issubclass(loaded, OnlineIdentifier) and dataclasses.is_dataclass(loaded)):
        raise InputError("method", name, "its entry point must name a dataclass that subclasses bench.OnlineIdentifier")
    return loaded


def online_card(name: str) -> OnlineCard:
    """The card of an online method, or of a batch method in windows."""
    if name.startswith(WINDOW):
        own = load_method(name.removeprefix(WINDOW)).card
        title = f"{own.title or name.removeprefix(WINDOW)}, window"
        return OnlineCard(
            f"in windows: {own.summary}", "batch method", own.settings_source, title, 2000 + own.order, own.colour
        )
    return load_online(name).card


def make_online(name: str, settings: Mapping[str, Any] | None = None) -> OnlineIdentifier:
    """An online method with validated settings; raises InputError that names the setting."""
    given = dict(settings or {})
    if name.startswith(WINDOW):
        batch = name.removeprefix(WINDOW)
        own = {key: given.pop(key) for key in OF_WINDOW if key in given}
        make_method(batch, {})  # an unknown name is said before a setting
        return validated(Window, {"batch": batch, "settings": {**default_settings(batch), **given}, **own}, _paths(own))
    cls = load_online(name)
    known = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
    for key in given:
        if key not in known:
            raise InputError(f"method.{key}", given[key], f"settings of {name}: {', '.join(known) or 'none'}")
    return validated(cls, given, _paths(given))


def _paths(settings: Mapping[str, Any]) -> dict[str, str]:
    return {"": "method", **{key: f"method.{key}" for key in settings}}
