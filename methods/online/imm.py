"""Interacting multiple models: at any time nothing changes, or one parameter does, slowly or fast.

The modes form a Markov chain, and the belief of each is mixed from all before a prediction (H. A. P. Blom, Y.
Bar-Shalom, IEEE Trans. Automatic Control 33:780, 1988). A mode lasts some samples, since no single one shows a change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import InputError, Layout, OnlineCard, OnlineIdentifier
from methods.online.ekf import Rates, settling

RATES = (2e-3, 2e-2)
"""Standard deviations of the random walk of the log-parameter that changes, a sample."""


@dataclass(frozen=True)
class OnlineIMM(OnlineIdentifier):
    """``changes``: probability a sample that something begins to change; ``settles``: that it ends."""

    warm_up: int = 150
    changes: float = 1e-4
    settles: float = 0.05
    card: ClassVar[OnlineCard] = OnlineCard(
        "interacting multiple models of extended Kalman filters: nothing changes, or one parameter, slowly or fast",
        "H. A. P. Blom, Y. Bar-Shalom, IEEE Trans. Automatic Control 33:780, 1988",
        "a change in 10 000 samples that lasts 20; rates a factor of ten apart",
        "IMM",
        50,
        "#332288",
    )

    def __post_init__(self) -> None:
        for name in ("changes", "settles"):
            if not 0 < getattr(self, name) < 1:
                raise InputError(f"method.{name}", getattr(self, name), "a probability between 0 and 1")
        if self.warm_up < 20:
            raise InputError("method.warm_up", self.warm_up, "at least 20 samples")

    def start(self, layout: Layout) -> Rates:
        """A bank before its first sample."""
        each = np.concatenate([np.eye(len(layout.free)) * rate**2 for rate in RATES])
        walk = np.concatenate([np.zeros((1, len(layout.free))), each])
        return Rates(layout, self.warm_up, "extended", walk, settling(len(walk), self.changes, self.settles))
