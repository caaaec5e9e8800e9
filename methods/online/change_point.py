"""Bayesian online change-point detection: filters that each assume the time of the last change, weighted by likelihood.

A hypothesis is a filter of constant parameters that starts at some sample from the estimated distribution, with the
variance of one parameter increased (R. P. Adams, D. J. C. MacKay, arXiv:0710.3742, with the Kalman filter's predictive
density in place of a conjugate one; P. Fearnhead, Z. Liu, J. Royal Statistical Society B 69:589, 2007, for bounding
their number). Every few samples, and after a large innovation, a hypothesis starts for each parameter and replaces the
least likely one beyond a minimum age. The estimate is the mixture: between changes nearly that of a filter of constant
parameters, after a change that of a filter that started at the change.

The alarm is the logarithm (base 10) of the odds of a change within the samples that the hypotheses cover.
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
"""Standard deviation of the jump of a log-parameter: a factor of 1.35."""
SURPRISE = 3.0
"""Normalised innovation above which new hypotheses start at once, since the change is a few samples old."""
LOOSER = 10.0
"""Factor of the motion's covariance in a new hypothesis: samples since the change were misinterpreted."""
ASKED = 10
"""Samples after a jump without outlier rejection, in which the hypotheses decide what has jumped."""
OLD = 1_000_000
"""Age (samples) of a hypothesis present from the beginning."""


class HypothesisTracker(FilterTracker):
    """Filters that each assume a time of the last change; ``born``: samples between new ones, one per parameter."""

    state_names = (*FilterTracker.state_names, "ages", "since")

    def __init__(self, layout: Layout, warm_up: int, members: int, born: int) -> None:
        self.kinds, self.born = len(layout.free), born
        super().__init__(layout, warm_up, np.zeros((members, self.kinds)), 1.0)
        self.afresh()

    def afresh(self) -> None:
        """Remove all hypotheses but the first, which assumes no change."""
        self.ages, self.since = np.full(len(self.walk), OLD), 0

    def first_weights(self) -> np.ndarray:
        """Return weights with all weight on the first hypothesis."""
        return np.where(np.arange(len(self.walk)) == 0, 1.0, 1e-300)

    @property
    def remembered(self) -> int:
        """Return the samples that the hypotheses cover; in the first half of them, none is replaced."""
        return self.born * len(self.walk) // self.kinds

    def due(self, outcome: Outcome) -> bool:
        """Return True where new hypotheses are due: every ``born`` samples, and after a large innovation."""
        if self.far or outcome["outlier"]:
            return False  # a new hypothesis would explain any outlier
        return self.since >= self.born or (self.since > 1 and bool(np.any(outcome["surprise"] > SURPRISE)))

    def begin(self, mean: np.ndarray, spread: np.ndarray, places: np.ndarray, kinds: np.ndarray) -> None:
        """Start hypotheses from a distribution, each with larger variances of one parameter and of the motion.

        Args:
            mean: Mean of the joint state, (d,).
            spread: Covariance of the joint state, (d, d).
            places: Indices of the members to replace.
            kinds: Index of the log-parameter that each hypothesis assumes to have changed.
        """
        means, spreads, motion = np.array(self.means), np.array(self.spreads), slice(0, self.model.n_motion)
        means[places], spreads[places] = mean, spread
        for place, log in zip(places, self.model.logs.start + kinds, strict=True):
            spreads[place, motion, motion] *= LOOSER
            spreads[place, log, log] += CHANGE**2
        self.ages[places], self.since = 0, 0
        self.means, self.spreads = means, spreads

    def jumped(self) -> None:
        """Start hypotheses of a jump of the sensors' zeros, and of each parameter together with the motion."""
        self.far = 0
        best = self.answering()
        added = [self.variances(offsets=self.zero_variance())]
        added += [self.variances(motion=self.square, logs=CHANGE**2 * row) for row in np.eye(self.kinds)]
        added += added[:1] * (len(self.walk) - len(added))  # earlier hypotheses no longer apply
        self.spreads = np.asarray(self.spreads)[best] + np.array([np.diag(variances) for variances in added])
        self.means = np.tile(np.asarray(self.means)[best], (len(self.walk), 1))
        self.since, self.asking = 0, ASKED
        self.compete(1 + self.kinds)

    def answering(self) -> int:
        """Return the index of the member with the largest weight."""
        return int(np.argmax(self.weights))

    def compete(self, number: int) -> None:
        """Give the first ``number`` members equal weights and the others none."""
        new = np.arange(len(self.walk)) < number
        self.ages, self.weights = np.where(new, 0, OLD), np.where(new, -np.log(number), FLOOR)


class ChangePointTracker(HypothesisTracker):
    """Tracker of change points; ``hazard``: probability of a change per sample."""

    def __init__(self, layout: Layout, method: ChangePoint) -> None:
        super().__init__(layout, method.warm_up, max(method.members, 4 * len(layout.free)), method.born)
        self.hazard = method.hazard

    def judged(self, outcome: Outcome) -> float:
        """Start hypotheses when due; return the log-odds of a recent change."""
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
    """``members`` hypotheses, new ones every ``born`` samples; ``hazard``: probability of a change per sample."""

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
        """Return a bank before its first sample."""
        return ChangePointTracker(layout, self)
