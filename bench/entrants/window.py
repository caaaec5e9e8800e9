"""A batch method as an online one: it fits the last samples again, every so many of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from bench.contract.online import Layout, OnlineCard, OnlineIdentifier, Tracker

OF_WINDOW = ("length", "every")
"""Settings of the window; all others are the method's own."""


@dataclass(frozen=True)
class Window(OnlineIdentifier):
    """The batch method ``batch``, with its ``settings``, on the last ``length`` samples, after every ``every`` new ones."""

    batch: str
    settings: dict[str, Any] = field(default_factory=dict)
    length: int = 100
    every: int = 10

    card: ClassVar[OnlineCard] = OnlineCard("a batch method in windows", "", "", "window")

    def start(self, layout: Layout) -> Tracker:
        """A tracker before its first sample."""
        raise NotImplementedError
