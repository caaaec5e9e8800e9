"""The registered online methods: entry points of the group ``bench.trackers``, and every other method by a window."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from bench.contract.online import OnlineCard, OnlineIdentifier
from bench.entrants.registry import default_settings, load_class, load_method, make, make_method, registered
from bench.entrants.window import OF_WINDOW, Window
from bench.errors import InputError

GROUP = "bench.trackers"
WINDOW = "window_"
"""Prefix of the name of a batch method that is fitted in windows."""
AFTER_TRACKERS = 2000
"""Added to the order of a batch method: in windows it stands behind all trackers."""


@cache
def registered_online() -> dict[str, EntryPoint]:
    """Return the entry points by name; nothing is imported."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda point: point.name)}


def first_online() -> str:
    """Return the default tracker, whose card stands first."""
    return min(registered_online(), key=lambda name: load_online(name).card.order)


def online_names() -> list[str]:
    """Return the names of online methods, then those of every batch method in windows."""
    return [*registered_online(), *(WINDOW + name for name in registered())]


def load_online(name: str) -> type[OnlineIdentifier]:
    """Return the class of an online method; raises InputError for an unknown name or one that does not load."""
    if name not in registered_online():
        raise InputError("method", name, f"online methods: {', '.join(online_names())}")
    cls: type[OnlineIdentifier] = load_class(registered_online()[name], OnlineIdentifier)
    return cls


def online_card(name: str) -> OnlineCard:
    """Return the card of an online method, or of a batch method in windows."""
    if not name.startswith(WINDOW):
        return load_online(name).card
    batch = name.removeprefix(WINDOW)
    card = load_method(batch).card
    title = f"{card.title or batch}, window"
    order = AFTER_TRACKERS + card.order
    return OnlineCard(f"in windows: {card.summary}", "batch method", card.settings_source, title, order, card.colour)


def make_online(name: str, settings: Mapping[str, Any] | None = None) -> OnlineIdentifier:
    """Return an online method with validated settings; raises InputError that names the setting."""
    given = dict(settings or {})
    if not name.startswith(WINDOW):
        cls = load_online(name)
        return make(cls, name, given, [field.name for field in dataclasses.fields(cls)])  # type: ignore[arg-type]
    batch = name.removeprefix(WINDOW)
    window = {key: given.pop(key) for key in OF_WINDOW if key in given}
    make_method(batch, {})  # an unknown name is refused before a setting
    fields = {"batch": batch, "settings": {**default_settings(batch), **given}, **window}
    return make(Window, name, fields, fields)
