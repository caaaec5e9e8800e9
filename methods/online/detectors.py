"""Detectors of a change: a filter of constant parameters that is opened again when its detector rings.

**CUSUM** (E. S. Page, Biometrika 41:100, 1954): the filter's moves of each log-parameter, over the standard deviation
that they should have, are white noise of unit variance while nothing changes, and have a mean afterwards (M.
Basseville, I. Nikiforov, Detection of Abrupt Changes, 1993, chapters 2 and 8). Two sums a parameter, one each way, each
less an allowance, are compared with a threshold.

**Generalised likelihood ratio** (A. S. Willsky, H. L. Jones, IEEE Trans. Automatic Control 21:108, 1976): filters
opened at earlier samples, each in one parameter, against the one that was not; the alarm is the largest logarithm of a
ratio of their likelihoods since then.

Behind an alarm the CUSUM's filter is opened in all parameters and in the motion; the ratio's goes on from the filter
that won.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import InputError, Layout, OnlineCard
from methods.online.bank import Outcome
from methods.online.change_point import CHANGE, ChangePointTracker
from methods.online.filtering import FilterIdentifier, FilterTracker

LARGEST_MOVE = 5.0
"""Standard deviations of a sample's move that count at most."""
LARGEST_GAIN = 8.0
"""Largest contribution of one sample to the alarm, a log-likelihood ratio: a spike alone raises none."""
OLDEST = 999_999
"""Age of a place that no hypothesis holds."""


class _Cusum(FilterTracker):
    holds = (*FilterTracker.holds, "up", "down")

    def __init__(self, layout: Layout, method: OnlineCUSUM) -> None:
        super().__init__(layout, method.warm_up, np.zeros((1, len(layout.free))), 1.0)
        self.method = method
        self.afresh()

    def afresh(self) -> None:
        """Both sums of every parameter at zero."""
        self.up = self.down = np.zeros(len(self.layout.free))

    def judged(self, outcome: Outcome) -> float:
        drift, moves = self.method.allowance, np.clip(outcome["moves"], -LARGEST_MOVE, LARGEST_MOVE)
        self.up, self.down = np.maximum(self.up + moves - drift, 0.0), np.maximum(self.down - moves - drift, 0.0)
        alarm = float(max(self.up.max(), self.down.max()))
        if alarm > self.method.threshold:
            # the motion too: filtered with what was wrong, it would draw the parameters off
            self.opened(motion=self.square, logs=CHANGE**2)
            self.afresh()
        return alarm


@dataclass(frozen=True)
class OnlineCUSUM(FilterIdentifier):
    """``allowance`` a sample and ``threshold``, in standard deviations of a sample's move."""

    allowance: float = 0.25
    threshold: float = 16.0
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filter of constants, opened when a two-sided CUSUM of its parameter moves rings",
        "E. S. Page, Biometrika 41:100, 1954",
        "half of a mean of half a standard deviation; about one false alarm in 10 000 samples (Siegmund's formula)",
        "CUSUM",
        60,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("allowance", "threshold"):
            if not getattr(self, name) > 0:
                raise InputError(f"method.{name}", getattr(self, name), "a positive number of standard deviations")

    def start(self, layout: Layout) -> FilterTracker:
        """A filter before its first sample."""
        return _Cusum(layout, self)


class _Ratio(ChangePointTracker):
    """The answer is that of member 0, the one without a change; the others only count."""

    holds = (*ChangePointTracker.holds, "ratios", "bounded")

    def __init__(self, layout: Layout, method: OnlineGLR) -> None:
        super().__init__(layout, method.warm_up, method.members, method.born)
        self.threshold = method.threshold

    def afresh(self) -> None:
        """No hypothesis but the first, and no ratio."""
        super().afresh()
        self.ratios, self.bounded = np.zeros(len(self.walk)), np.zeros(len(self.walk))

    def judged(self, outcome: Outcome) -> float:
        gained = outcome["gained"] - outcome["gained"][0]
        self.ratios, self.bounded = self.ratios + gained, self.bounded + np.clip(gained, -LARGEST_GAIN, LARGEST_GAIN)
        self.since += 1
        self.ages = self.ages + 1
        alive = self.ages < OLDEST
        alarm = float(np.max(np.where(alive, np.minimum(self.ratios, self.bounded), -np.inf), initial=0.0))
        if alarm > self.threshold:  # the losers expect what is not so: none may gate a value
            won = int(np.argmax(np.where(alive, self.ratios, -np.inf)))
            self.means, self.spreads = (
                np.repeat(np.asarray(p)[[won]], len(alive), 0) for p in (self.means, self.spreads)
            )
            self.compete(1)
        elif self.due(outcome):
            worth = np.where(alive & (self.ages < self.remembered // 2), np.inf, self.ratios)
            worth[~alive], worth[0] = -np.inf, np.inf
            places = self.bear(np.asarray(self.means)[0], np.asarray(self.spreads)[0], worth)
            self.ratios[places], self.bounded[places] = 0.0, 0.0
        self.weights = np.log(self.first_weights())
        return alarm

    def answering(self) -> int:
        return 0

    def compete(self, number: int) -> None:
        """Let the first ``number`` members count from now on, of which the first answers meanwhile."""
        self.ages = np.where(np.arange(len(self.walk)) < number, 0, OLDEST)
        self.ratios, self.bounded = np.zeros(len(self.walk)), np.zeros(len(self.walk))
        self.weights = np.log(self.first_weights())


@dataclass(frozen=True)
class OnlineGLR(FilterIdentifier):
    """``threshold``: natural logarithm of the likelihood ratio that rings."""

    members: int = 36
    born: int = 8
    threshold: float = 9.0
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filter of constants, replaced when a generalised likelihood ratio of a change rings",
        "A. S. Willsky, H. L. Jones, IEEE Trans. Automatic Control 21:108, 1976",
        "threshold: a ratio of 8 000; at most one false alarm in 20 000 samples (Ville's inequality)",
        "likelihood ratio",
        70,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.threshold > 0:
            raise InputError("method.threshold", self.threshold, "a positive logarithm of a likelihood ratio")

    def start(self, layout: Layout) -> FilterTracker:
        """A bank before its first sample."""
        return _Ratio(layout, self)
