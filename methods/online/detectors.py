"""Change detectors: a filter of constant parameters is replaced by another when the data support a change.

In parallel with the main filter run hypotheses: filters whose variances of one log-parameter and of the motion were
increased at an earlier sample. While nothing changes, the likelihood ratio of a hypothesis to the main filter exceeds
``exp(h)`` at any time with probability at most ``exp(-h)`` (J. Ville, Étude critique de la notion de collectif, 1939).
After an alarm the hypothesis with the largest ratio becomes the main filter; it used the samples after the change.

**Generalised likelihood ratio** (A. S. Willsky, H. L. Jones, IEEE Trans. Automatic Control 21:108, 1976): hypotheses
start every few samples; the alarm is the logarithm of the largest ratio.

**CUSUM** (E. S. Page, Biometrika 41:100, 1954): the filter's normalised updates of each log-parameter are white noise
of unit variance while nothing changes, and have a non-zero mean afterwards. Two cumulative sums per parameter, one per
sign, each less an allowance, are compared with a threshold. The time of the change is estimated as the last sample at
which a parameter's ratio was below 1 (M. Basseville, I. Nikiforov, Detection of Abrupt Changes, 1993, section 2.2);
there its hypothesis starts. Above the threshold the estimate is the mixture weighted by the ratios, until one
hypothesis is nearly certain or none is supported. A sum alone does not change the estimate.
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
"""Limit of the normalised updates in the sums."""
LARGEST_GAIN = 8.0
"""Largest contribution of one sample to the log-likelihood ratio of the alarm, so that a spike raises none."""
DECIDED = 0.99
"""Weight above which a hypothesis replaces all others."""
OLDEST = 999_999
"""Age of a member without a hypothesis."""


class _Ratio(HypothesisTracker):
    """Likelihood-ratio detector; member 0 is the main filter and gives the estimate."""

    state_names = (*HypothesisTracker.state_names, "ratios", "bounded")

    threshold = float("inf")
    """Log-likelihood ratio above which the hypothesis of the largest ratio becomes the main filter."""

    def afresh(self) -> None:
        """Remove all hypotheses and ratios."""
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
            self.start_hypotheses(np.argsort(worth)[: self.kinds], np.arange(self.kinds))
        self.weights = np.log(self.first_weights())
        return alarm

    def evidence(self, outcome: Outcome) -> np.ndarray:
        """Update and return the log-likelihood ratio of each hypothesis, -inf where there is none."""
        gained = outcome["gained"] - outcome["gained"][0]
        self.ratios, self.bounded = self.ratios + gained, self.bounded + np.clip(gained, -LARGEST_GAIN, LARGEST_GAIN)
        self.since, self.ages = self.since + 1, self.ages + 1
        return np.where(self.ages < OLDEST, np.minimum(self.ratios, self.bounded), -np.inf)

    def replace(self, winner: int) -> None:
        """Replace all members by one, since the others would reject valid values as outliers."""
        self.means, self.spreads = (
            np.repeat(np.asarray(part)[[winner]], len(self.walk), 0) for part in (self.means, self.spreads)
        )
        self.compete(1)

    def start_hypotheses(self, places: np.ndarray, kinds: np.ndarray) -> None:
        """Start hypotheses at ``places`` from the main filter."""
        self.begin(np.asarray(self.means)[0], np.asarray(self.spreads)[0], places, kinds)
        self.ratios[places], self.bounded[places] = 0.0, 0.0

    def answering(self) -> int:
        return 0

    def compete(self, number: int) -> None:
        """Restart the ratios for the first ``number`` members; the first gives the estimate."""
        self.afresh()
        self.ages = np.where(np.arange(len(self.walk)) < number, 0, OLDEST)
        self.weights = np.log(self.first_weights())


@dataclass(frozen=True)
class OnlineGLR(FilterIdentifier):
    """``threshold``: natural logarithm of the likelihood ratio at which an alarm is raised."""

    members: Annotated[int, Interval(ge=4)] = 36
    born: Annotated[int, Interval(ge=1)] = 8
    threshold: Annotated[float, Interval(gt=0.0)] = 13.0
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filter of constants, replaced when a generalised likelihood ratio raises an alarm",
        "A. S. Willsky, H. L. Jones, IEEE Trans. Automatic Control 21:108, 1976",
        "at most one false alarm in a million samples (Ville's inequality); chosen of two on 104 other streams",
        "likelihood ratio",
        70,
    )

    def start(self, layout: Layout) -> FilterTracker:
        """Return a bank before its first sample."""
        tracker = _Ratio(layout, self.warm_up, max(self.members, 4 * len(layout.free)), self.born)
        tracker.threshold = self.threshold
        return tracker


class _Cusum(_Ratio):
    """CUSUM detector; member ``i + 1`` assumes a change of parameter i and restarts while its ratio is below 1."""

    state_names = (*_Ratio.state_names, "sums", "ringing")

    def __init__(self, layout: Layout, method: OnlineCUSUM) -> None:
        super().__init__(layout, method.warm_up, 1 + len(layout.free), method.born)
        self.method = method

    def afresh(self) -> None:
        """Reset both sums of every parameter to zero."""
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
            self.start_hypotheses(1 + kinds, kinds)
        return alarm if share[0] < 0.5 else min(alarm, self.method.threshold)

    def jumped(self) -> None:
        """Increase the variances of the sensors' zeros, at a second jump those of parameters and motion too."""
        FilterTracker.jumped(self)
        self.compete(1)


@dataclass(frozen=True)
class OnlineCUSUM(FilterIdentifier):
    """``allowance`` per sample and ``threshold`` of the sums, in standard deviations of a sample's update.

    ``support``: natural logarithm of the likelihood ratio above which a change is more likely than none; ``born``:
    samples between hypotheses.
    """

    allowance: Annotated[float, Interval(gt=0.0)] = 0.25
    threshold: Annotated[float, Interval(gt=0.0)] = 16.0
    support: Annotated[float, Interval(gt=0.0)] = 13.0
    born: Annotated[int, Interval(ge=1)] = 8
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filter of constants; a two-sided CUSUM of its updates admits competing filters of a change",
        "E. S. Page, Biometrika 41:100, 1954",
        "allowance: half of a mean of half a standard deviation; support: as for the likelihood ratio",
        "CUSUM",
        60,
    )

    def start(self, layout: Layout) -> FilterTracker:
        """Return a filter before its first sample."""
        return _Cusum(layout, self)
