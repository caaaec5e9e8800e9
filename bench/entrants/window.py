"""Any registered batch method as an online one, fitted again to the last samples at a fixed interval of samples."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bench.contract.estimate import Estimate
from bench.contract.method import Identifier
from bench.contract.online import Layout, OnlineCard, OnlineIdentifier, Tracker
from bench.contract.problem import Problem
from bench.contract.window import WindowTracker, window_problem
from bench.entrants.registry import make_method
from bench.errors import InputError

OF_WINDOW = ("length", "every", "arrival")
"""Settings of the window; all others are the method's own."""
FEWEST = 10


@dataclass(frozen=True)
class Window(OnlineIdentifier):
    """The batch method ``batch``, with its ``settings``, on the last ``length`` samples, every ``every`` new ones.

    The initial state of a window is unknown. ``arrival``: whether the estimate before a window is its prior
    (moving-horizon estimation); else each fit stands alone.
    """

    batch: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
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
