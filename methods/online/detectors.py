"""Detectors of a change: a filter of constant parameters that is replaced by another where the data support a change.

Beside the filter that answers run others, each opened at an earlier sample in one log-parameter, and in the motion. The
ratio of what such a filter has predicted since then to what the first has exceeds ``exp(h)`` at any time with
probability ``exp(-h)`` at most while nothing changes (J. Ville, Étude critique de la notion de collectif, 1939). Behind
an alarm the filter of the largest ratio answers: it has been estimated from the samples behind the change.

**Generalised likelihood ratio** (A. S. Willsky, H. L. Jones, IEEE Trans. Automatic Control 21:108, 1976): filters are
opened every few samples; the alarm is the logarithm of the largest ratio.

**CUSUM** (E. S. Page, Biometrika 41:100, 1954): the filter's moves of each log-parameter, over the standard deviation
that they should have, are white noise of unit variance while nothing changes, and have a mean afterwards. Two sums a
parameter, one each way, each less an allowance, are compared with a threshold. The change is taken to be where a
parameter's ratio was last below 1 (M. Basseville, I. Nikiforov, Detection of Abrupt Changes, 1993, section 2.2): there
its filter is opened. Beyond the threshold the answer is the mixture of all, weighted by their ratios, until one is
nearly certain or none is supported: a sum alone changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from bench import Layout, OnlineCard
from methods.online.bank import FLOOR, Outcome
from methods.online.change_point import HypothesisTracker
from methods.online.filtering import FilterIdentifier, FilterTracker

LARGEST_MOVE = 5.0
"""Standard deviations of a sample's move that count at most."""
LARGEST_GAIN = 8.0
"""Largest contribution of one sample to the alarm, a log-likelihood ratio: a spike alone raises none."""
DECIDED = 0.99
"""Share of the weight with which a hypothesis is the only one."""
OLDEST = 999_999
"""Age of a place that no hypothesis holds."""


class _Ratio(HypothesisTracker):
    """The answer is that of member 0, the one without a change; the others only count."""

    holds = (*HypothesisTracker.holds, "ratios", "bounded")

    threshold = float("inf")
    """Logarithm of a ratio from which on the filter of the largest answers."""

    def afresh(self) -> None:
        """No hypothesis but the first, and no ratio."""
        super().afresh()
        self.ratios, self.bounded = np.zeros(len(self.walk)), np.zeros(len(self.walk))

    def judged(self, outcome: Outcome) -> float:
        evidence = self.evidence(outcome)
        alarm = float(np.max(evidence, initial=0.0))
        if alarm > self.threshold:
            self.replace(int(np.argmax(np.where(self.ages < OLDEST, self.ratios, -np.inf))))
        elif self.due(outcome):
            alive = self.ages < OLDEST
            worth = np.where(alive & (self.ages < self.remembered // 2), np.inf, self.ratios)
            worth[~alive], worth[0] = -np.inf, np.inf
            self.bear(np.argsort(worth)[: self.kinds], np.arange(self.kinds))
        self.weights = np.log(self.first_weights())
        return alarm

    def evidence(self, outcome: Outcome) -> np.ndarray:
        """Return the logarithm of the ratio of each hypothesis after a sample, -inf where there is none."""
        gained = outcome["gained"] - outcome["gained"][0]
        self.ratios, self.bounded = self.ratios + gained, self.bounded + np.clip(gained, -LARGEST_GAIN, LARGEST_GAIN)
        self.since, self.ages = self.since + 1, self.ages + 1
        return np.where(self.ages < OLDEST, np.minimum(self.ratios, self.bounded), -np.inf)

    def replace(self, winner: int) -> None:
        """Let a hypothesis be the only one: the losers expect what is not so, and none may gate a value."""
        self.means, self.spreads = (
            np.repeat(np.asarray(part)[[winner]], len(self.walk), 0) for part in (self.means, self.spreads)
        )
        self.compete(1)

    def bear(self, places: np.ndarray, kinds: np.ndarray) -> None:
        """Begin hypotheses in some places, from the first."""
        self.begin(np.asarray(self.means)[0], np.asarray(self.spreads)[0], places, kinds)
        self.ratios[places], self.bounded[places] = 0.0, 0.0

    def answering(self) -> int:
        return 0

    def compete(self, number: int) -> None:
        """Let the first ``number`` members count from now on, of which the first answers meanwhile."""
        self.afresh()
        self.ages = np.where(np.arange(len(self.walk)) < number, 0, OLDEST)
        self.weights = np.log(self.first_weights())


@dataclass(frozen=True)
class OnlineGLR(FilterIdentifier):
    """``threshold``: natural logarithm of the likelihood ratio that rings."""

    members: Annotated[int, Interval(ge=4)] = 36
    born: Annotated[int, Interval(ge=1)] = 8
    threshold: Annotated[float, Interval(gt=0.0)] = 13.0
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filter of constants, replaced when a generalised likelihood ratio of a change rings",
        "A. S. Willsky, H. L. Jones, IEEE Trans. Automatic Control 21:108, 1976",
        "at most one false alarm in a million samples (Ville's inequality); chosen of two on 104 other streams",
        "likelihood ratio",
        70,
    )

    def start(self, layout: Layout) -> FilterTracker:
        """A bank before its first sample."""
        tracker = _Ratio(layout, self.warm_up, max(self.members, 4 * len(layout.free)), self.born)
        tracker.threshold = self.threshold
        return tracker


class _Cusum(_Ratio):
    """Member ``i + 1`` is opened in parameter i, and anew while its ratio is below 1, by Page's rule for a ratio."""

    holds = (*_Ratio.holds, "sums", "ringing")

    def __init__(self, layout: Layout, method: OnlineCUSUM) -> None:
        super().__init__(layout, method.warm_up, 1 + len(layout.free), method.born)
        self.method = method

    def afresh(self) -> None:
        """Both sums of every parameter at zero."""
        super().afresh()
        self.sums, self.ringing = np.zeros((2, self.kinds)), False

    def judged(self, outcome: Outcome) -> float:
        moves = np.clip(outcome["moves"], -LARGEST_MOVE, LARGEST_MOVE)
        self.sums = np.maximum(self.sums + np.stack([moves, -moves]) - self.method.allowance, 0.0)
        evidence, alarm = self.evidence(outcome), float(self.sums.max())
        supported = evidence > 0
        self.ringing = bool(alarm > self.method.threshold or (self.ringing and supported.any()))
        odds = np.maximum(evidence - self.method.support, FLOOR)
        odds[0] = 0.0
        self.weights = odds if self.ringing else np.log(self.first_weights())
        share = np.exp(odds - np.logaddexp.reduce(odds))
        if self.ringing and np.max(share[1:]) > DECIDED:
            self.replace(int(np.argmax(share)))
        elif not self.ringing and self.due(outcome):
            kinds = np.flatnonzero(~supported[1:])
            self.bear(1 + kinds, kinds)
        return alarm if share[0] < 0.5 else min(alarm, self.method.threshold)

    def jumped(self) -> None:
        """Open the sensors' zeros; parameters and motion too where that was not enough."""
        FilterTracker.jumped(self)
        self.compete(1)


@dataclass(frozen=True)
class OnlineCUSUM(FilterIdentifier):
    """``allowance`` a sample and ``threshold`` of the sums, in standard deviations of a sample's move.

    ``support``: natural logarithm of the likelihood ratio from which on a change is more likely than none; ``born``:
    samples between hypotheses.
    """

    allowance: Annotated[float, Interval(gt=0.0)] = 0.25
    threshold: Annotated[float, Interval(gt=0.0)] = 16.0
    support: Annotated[float, Interval(gt=0.0)] = 13.0
    born: Annotated[int, Interval(ge=1)] = 8
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filter of constants; a two-sided CUSUM of its moves lets filters of a change compete with it",
        "E. S. Page, Biometrika 41:100, 1954",
        "allowance: half of a mean of half a standard deviation; support as of the likelihood ratio",
        "CUSUM",
        60,
    )

    def start(self, layout: Layout) -> FilterTracker:
        """A filter before its first sample."""
        return _Cusum(layout, self)
