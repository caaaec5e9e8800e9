"""Bayesian online change-point detection: filters that each assume one last change, weighted by what they predicted.

A hypothesis is a filter of constant parameters that began, at some sample, from the distribution of then with one
parameter opened (R. P. Adams, D. J. C. MacKay, arXiv:0710.3742, with the Kalman filter's predictive density in place of
a conjugate one; P. Fearnhead, Z. Liu, J. Royal Statistical Society B 69:589, 2007, for bounding their number). Every
few samples, and as soon as a value surprises, one begins for each parameter; the least likely of those that have had
their time make room. The answer is the mixture, so between changes it is nearly that of a filter of constants, and
behind one that of a filter that knew.

Alarm: the logarithm (base 10) of the odds that something has changed within the samples that the bank remembers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from bench import Layout, OnlineCard
from methods.online.bank import FLOOR, Outcome
from methods.online.filtering import FilterIdentifier, FilterTracker, Probability

CHANGE = 0.3
"""Standard deviation of a jump of a log-parameter: a factor of 1.35."""
SURPRISE = 3.0
"""Standard deviations of a value, at which hypotheses begin out of turn: the change is a few samples old."""
LOOSER = 10.0
"""Times the motion's covariance in a new hypothesis: what was filtered since the change was filtered wrongly."""
ASKED = 10
"""Samples behind a jump, of which none is left out: the hypotheses decide what has jumped."""
OLD = 1_000_000
"""Age (samples) of a hypothesis that was there from the beginning."""


class HypothesisTracker(FilterTracker):
    """A bank of filters that each assume one last change; ``born`` samples between new ones, one a parameter."""

    holds = (*FilterTracker.holds, "ages", "since")

    def __init__(self, layout: Layout, warm_up: int, members: int, born: int) -> None:
        self.kinds, self.born = len(layout.free), born
        super().__init__(layout, warm_up, np.zeros((members, self.kinds)), 1.0)
        self.afresh()

    def afresh(self) -> None:
        """Leave no hypothesis but the first, which knows of no change."""
        self.ages, self.since = np.full(len(self.walk), OLD), 0

    def first_weights(self) -> np.ndarray:
        """Return all weight on the first."""
        return np.where(np.arange(len(self.walk)) == 0, 1.0, 1e-300)

    @property
    def remembered(self) -> int:
        """Samples in which as many hypotheses begin as there are members; for half of them each is spared."""
        return self.born * len(self.walk) // self.kinds

    def due(self, outcome: Outcome) -> bool:
        """Decide whether hypotheses are to begin: every so often, and as soon as a value surprises."""
        if self.far or outcome["outlier"]:
            return False  # a new one would explain all
        return self.since >= self.born or (self.since > 1 and bool(np.any(outcome["surprise"] > SURPRISE)))

    def begin(self, mean: np.ndarray, spread: np.ndarray, places: np.ndarray, kinds: np.ndarray) -> None:
        """Begin hypotheses in some places: from a distribution, a parameter of each kind opened, and the motion looser.

        What was filtered since the parameter changed was filtered wrongly.
        """
        means, spreads, motion = np.array(self.means), np.array(self.spreads), slice(0, self.model.n_motion)
        means[places], spreads[places] = mean, spread
        for place, log in zip(places, self.model.logs.start + kinds, strict=True):
            spreads[place, motion, motion] *= LOOSER
            spreads[place, log, log] += CHANGE**2
        self.ages[places], self.since = 0, 0
        self.means, self.spreads = means, spreads

    def jumped(self) -> None:
        """Ask whether a sensor's zero or a parameter has jumped.

        The first hypothesis has the zero open, one a parameter that and the motion: it was filtered with what was
        wrong. A few samples tell them apart.
        """
        self.far = 0
        best = self.answering()
        added = [self.variances(offsets=self.zero_variance())]
        added += [self.variances(motion=self.square, logs=CHANGE**2 * row) for row in np.eye(self.kinds)]
        added += added[:1] * (len(self.walk) - len(added))  # who was here before expects what no longer is
        self.spreads = np.asarray(self.spreads)[best] + np.array([np.diag(variances) for variances in added])
        self.means = np.tile(np.asarray(self.means)[best], (len(self.walk), 1))
        self.since, self.asking = 0, ASKED
        self.compete(1 + self.kinds)

    def answering(self) -> int:
        """Return the member that the answer is most like."""
        return int(np.argmax(self.weights))

    def compete(self, number: int) -> None:
        """Weigh the first ``number`` members, the new hypotheses, alike, and nothing else."""
        new = np.arange(len(self.walk)) < number
        self.ages, self.weights = np.where(new, 0, OLD), np.where(new, -np.log(number), FLOOR)


class ChangePointTracker(HypothesisTracker):
    """``hazard``: probability of a change, a sample."""

    def __init__(self, layout: Layout, method: ChangePoint) -> None:
        super().__init__(layout, method.warm_up, max(method.members, 4 * len(layout.free)), method.born)
        self.hazard = method.hazard

    def judged(self, outcome: Outcome) -> float:
        """Begin hypotheses when it is time; the odds of a recent change."""
        self.since, self.ages = self.since + 1, self.ages + 1
        share = np.exp(np.asarray(self.weights) - np.max(self.weights))
        share = share / share.sum()
        recent = float(np.sum(share[self.ages <= self.remembered]))
        if self.due(outcome):
            chance = self.hazard * self.since
            spared = (self.ages < self.remembered // 2) | (share == np.max(share))
            places = np.argsort(np.where(spared, np.inf, share))[: self.kinds]
            self.begin(outcome["mean"], outcome["covariance"], places, np.arange(self.kinds))
            share *= 1.0 - chance
            share[places] = chance / self.kinds
            self.weights = np.log(np.maximum(share / share.sum(), 1e-300))
        return float(np.log10(max(recent, 1e-300) / max(1.0 - recent, 1e-12)))


@dataclass(frozen=True)
class ChangePoint(FilterIdentifier):
    """``members`` hypotheses, born every ``born`` samples; ``hazard``: probability of a change, a sample."""

    members: Annotated[int, Interval(ge=4)] = 36
    born: Annotated[int, Interval(ge=1)] = 8
    hazard: Probability = 1e-6
    card: ClassVar[OnlineCard] = OnlineCard(
        "Bayesian online change-point detection with extended Kalman filters of constant parameters",
        "R. P. Adams, D. J. C. MacKay, arXiv:0710.3742; P. Fearnhead, Z. Liu, JRSS B 69:589, 2007",
        "a change in a million samples, of a factor of 1.35 in one parameter; chosen of three on 104 other streams",
        "change points",
        40,
    )

    def start(self, layout: Layout) -> ChangePointTracker:
        """A bank before its first sample."""
        return ChangePointTracker(layout, self)
