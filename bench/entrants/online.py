"""The registered online methods: entry points of the group ``bench.trackers``, and every batch method in windows."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib.metadata import EntryPoint
from typing import Any, ClassVar

import numpy as np

from bench.contract.estimate import Estimate
from bench.contract.method import Identifier
from bench.contract.online import Layout, OnlineCard, OnlineIdentifier, Tracker
from bench.contract.problem import Problem
from bench.contract.window import WindowTracker, window_problem
from bench.entrants.registry import default_settings, load_dataclass, load_method, make, make_method, registered
from bench.entry_points import entry_points_of
from bench.errors import InputError

GROUP = "bench.trackers"
WINDOW = "window_"
"""Prefix of the name of a batch method that is fitted in windows."""
WINDOW_SETTINGS = ("length", "every", "arrival")
"""Settings of the window; all others are the method's own."""
AFTER_TRACKERS = 2000
"""Added to the order of a batch method: in windows it stands behind all trackers."""
FEWEST = 10


@dataclasses.dataclass(frozen=True)
class Window(OnlineIdentifier):
    """The batch method ``batch``, with its ``settings``, on the last ``length`` samples, every ``every`` new ones.

    The initial state of a window is unknown. ``arrival``: whether the estimate before a window is its prior
    (moving-horizon estimation); else each fit stands alone.
    """

    batch: str = ""
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    length: int = 150
    every: int = 10
    arrival: bool = False

    card: ClassVar[OnlineCard] = OnlineCard("a batch method in windows", "", "", "window")

    def __post_init__(self) -> None:
        if self.length < FEWEST:
            raise InputError("method.length", self.length, f"at least {FEWEST} samples")
        if self.every < 1:
            raise InputError("method.every", self.every, "at least 1 sample")

    def start(self, layout: Layout) -> Tracker:
        """Return a tracker before its first sample."""
        method = make_method(self.batch, self.settings)
        return _MethodTracker(layout, method, self.length, self.every, self.arrival)

    def objection(self, layout: Layout) -> str | None:
        """Object to unknown forces, and to what the batch method objects to."""
        if layout.ambient:
            return "a batch method needs every force to be known, and here one is not"
        times = np.arange(float(FEWEST)) * layout.interval
        rows = np.sin(times / layout.interval)[:, None]
        example = window_problem(layout, times, np.tile(rows, len(layout.sensors)), np.tile(rows, len(layout.forced)))
        assert example is not None
        return make_method(self.batch, self.settings).objection(example)


class _MethodTracker(WindowTracker):
    """Windows answered by a batch method."""

    def __init__(self, layout: Layout, method: Identifier, length: int, every: int, arrival: bool) -> None:
        super().__init__(layout, length, every, arrival)
        self.method = method

    def answer(self, problem: Problem) -> Estimate:
        """Return the answer of the method, with the same random stream in every window."""
        return self.method.identify(problem, np.random.default_rng(0))


def registered_online() -> dict[str, EntryPoint]:
    """Return the entry points of trackers by name; nothing is imported."""
    return entry_points_of(GROUP)


def _load(name: str) -> type[OnlineIdentifier]:
    cls: type[OnlineIdentifier] = load_dataclass(registered_online(), name, OnlineIdentifier, online_names())
    return cls


def online_names() -> list[str]:
    """Return the names of online methods, then those of every batch method in windows."""
    return [*registered_online(), *(WINDOW + name for name in registered())]


def first_online() -> str:
    """Return the default tracker, whose card stands first."""
    return min(registered_online(), key=lambda name: online_card(name).order)


def online_card(name: str) -> OnlineCard:
    """Return the card of an online method, or of a batch method in windows."""
    if not name.startswith(WINDOW):
        return _load(name).card
    batch = name.removeprefix(WINDOW)
    card = load_method(batch).card
    title = f"{card.title or batch}, window"
    order = AFTER_TRACKERS + card.order
    return OnlineCard(f"in windows: {card.summary}", "batch method", card.settings_source, title, order)


def make_online(name: str, settings: Mapping[str, Any] | None = None) -> OnlineIdentifier:
    """Return an online method with validated settings; raises InputError that names the setting."""
    stated = dict(settings or {})
    if not name.startswith(WINDOW):
        cls = _load(name)
        return make(cls, name, stated, [field.name for field in dataclasses.fields(cls)])  # type: ignore[arg-type]
    batch = name.removeprefix(WINDOW)
    window = {key: stated.pop(key) for key in WINDOW_SETTINGS if key in stated}
    make_method(batch, {})  # an unknown name is refused before a setting
    values = {"batch": batch, "settings": {**default_settings(batch), **stated}, **window}
    return make(Window, name, values, values)
