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

from bench import InputError, Layout, OnlineCard, OnlineIdentifier
from methods.online.bank import Told
from methods.online.change_point import CHANGE, ChangePointTracker
from methods.online.filtering import FilterTracker


class _Cusum(FilterTracker):
    holds = (*FilterTracker.holds, "up", "down")

    def __init__(self, layout: Layout, settings: OnlineCUSUM) -> None:
        super().__init__(layout, settings.warm_up, "extended", np.zeros((1, len(layout.free))), 1.0)
        self.settings = settings
        self.up = self.down = np.zeros(len(layout.free))

    def judged(self, told: Told) -> float:
        drift, moves = self.settings.allowance, np.clip(told.moves[0], -5.0, 5.0)
        self.up, self.down = np.maximum(self.up + moves - drift, 0.0), np.maximum(self.down - moves - drift, 0.0)
        alarm = float(max(self.up.max(), self.down.max()))
        if alarm > self.settings.threshold:
            added = np.zeros(self.model.size)
            added[self.model.logs] = CHANGE**2
            added[: self.model.n_motion] = self.square  # filtered with what was wrong, it would draw the parameters off
            self.opened(added)
            self.up = self.down = np.zeros(len(self.layout.free))
        return alarm


@dataclass(frozen=True)
class OnlineCUSUM(OnlineIdentifier):
    """``allowance`` a sample and ``threshold``, in standard deviations of a sample's move."""

    warm_up: int = 150
    allowance: float = 0.25
    threshold: float = 16.0
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filter of constants, opened when a two-sided CUSUM of its parameter moves rings",
        "E. S. Page, Biometrika 41:100, 1954",
        "half of a mean of half a standard deviation; about one false alarm in 10 000 samples (Siegmund's formula)",
        "CUSUM",
        60,
        "#DDCC77",
    )

    def __post_init__(self) -> None:
        for name in ("allowance", "threshold"):
            if not getattr(self, name) > 0:
                raise InputError(f"method.{name}", getattr(self, name), "a positive number of standard deviations")

    def start(self, layout: Layout) -> FilterTracker:
        """A filter before its first sample."""
        return _Cusum(layout, self)


class _Ratio(ChangePointTracker):
    holds = (*ChangePointTracker.holds, "ratios", "bounded")

    def __init__(self, layout: Layout, settings: OnlineGLR) -> None:
        members = max(settings.members, 4 * len(layout.free))
        super().__init__(layout, settings.warm_up, members, settings.born, 0.5, "extended")
        self.threshold, self.ratios, self.bounded = settings.threshold, np.zeros(members), np.zeros(members)

    def judged(self, told: Told) -> float:
        """The answer is that of member 0, the one without a change; the others only count."""
        gained = told.gained - told.gained[0]
        self.ratios, self.bounded = self.ratios + gained, self.bounded + np.clip(gained, -MOST_TOLD, MOST_TOLD)
        self.since += 1
        self.ages = self.ages + 1
        alive = self.ages < OLDEST
        alarm = float(np.max(np.where(alive, np.minimum(self.ratios, self.bounded), -np.inf), initial=0.0))
        means, spreads = np.array(self.means), np.array(self.spreads)
        if alarm > self.threshold:
            won = int(np.argmax(np.where(alive, self.ratios, -np.inf)))
            means[:], spreads[:] = means[won], spreads[won]  # the losers expect what is not so: none may gate a value
            self.ages[1:], self.ratios[:], self.bounded[:] = OLDEST, 0.0, 0.0
        elif self.due(told):
            self.since = 0
            kinds = len(self.layout.free)
            worst = np.where(alive & (self.ages < self.born * len(means) // (2 * kinds)), np.inf, self.ratios)
            worst[~alive], worst[0] = -np.inf, np.inf
            for parameter, place in enumerate(np.argsort(worst)[:kinds]):
                means[place], spreads[place] = means[0], self.loosened(spreads[0], parameter)
                self.ages[place], self.ratios[place], self.bounded[place] = 0, 0.0, 0.0
        else:
            self.weights = self.first_log_weights()
            return alarm
        self.means, self.spreads, self.weights = means, spreads, self.first_log_weights()
        return alarm

    def _answering(self) -> int:
        return 0

    def _asked(self, number: int) -> None:
        """Let the new hypotheses compete with the first of them, which answers meanwhile."""
        self.ages[:number], self.ages[number:] = 0, OLDEST
        self.ratios[:], self.bounded[:], self.since = 0.0, 0.0, 0
        self.weights = self.first_log_weights()

    def first_log_weights(self) -> np.ndarray:
        """All on member 0."""
        return np.log(self.first_weights())


MOST_TOLD = 8.0
"""To the alarm, of a logarithm of a ratio, by one sample: a spike alone does not ring."""
OLDEST = 999_999
"""Age of a place that no hypothesis holds."""


@dataclass(frozen=True)
class OnlineGLR(OnlineIdentifier):
    """``threshold``: natural logarithm of the likelihood ratio that rings."""

    warm_up: int = 150
    members: int = 36
    born: int = 8
    threshold: float = 9.0
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filter of constants, replaced when a generalised likelihood ratio of a change rings",
        "A. S. Willsky, H. L. Jones, IEEE Trans. Automatic Control 21:108, 1976",
        "threshold: a ratio of 8 000; at most one false alarm in 20 000 samples (Ville's inequality)",
        "likelihood ratio",
        70,
        "#CC6677",
    )

    def __post_init__(self) -> None:
        if not self.threshold > 0:
            raise InputError("method.threshold", self.threshold, "a positive logarithm of a likelihood ratio")

    def start(self, layout: Layout) -> FilterTracker:
        """A bank before its first sample."""
        return _Ratio(layout, self)
