"""Bayesian online change-point detection: filters that each assume one last change, weighted by what they predicted.

A hypothesis is a filter of constant parameters that began, at some sample, from the belief of then with one parameter
opened (R. P. Adams, D. J. C. MacKay, arXiv:0710.3742, with the Kalman filter's predictive density in place of a
conjugate one; P. Fearnhead, Z. Liu, J. Royal Statistical Society B 69:589, 2007, for bounding their number). Every few
samples, and as soon as a value surprises, one is born for each parameter; the least likely of those that have had their
time make room. The answer is the mixture, so between changes it is nearly that of a filter of constants, and behind one
that of a filter that knew.

Alarm: the logarithm (base 10) of the odds that something has changed within the samples that the bank remembers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import InputError, Layout, OnlineCard, OnlineIdentifier
from methods.online.bank import FLOOR, Rule, Told
from methods.online.filtering import FilterTracker

CHANGE = 0.3
"""Standard deviation of a jump of a log-parameter: a factor of 1.35."""


SURPRISE = 3.0
"""Standard deviations of a value, at which hypotheses are born out of turn: the change is a few samples old."""
LOOSER = 10.0
"""Times the motion's covariance in a new hypothesis: what was filtered since the change was filtered wrongly."""
ASKED = 10
"""Samples behind a jump, of which none is left out: the hypotheses shall tell what has jumped."""
OLD = 1_000_000
"""Age (samples) of a hypothesis that was there from the beginning."""


class ChangePointTracker(FilterTracker):
    """``born`` samples between births, ``hazard`` a change a sample; member 0 at first is the one without a change."""

    holds = (*FilterTracker.holds, "ages", "since")

    def __init__(self, layout: Layout, warm_up: int, members: int, born: int, hazard: float, rule: Rule) -> None:
        super().__init__(layout, warm_up, rule, np.zeros((members, len(layout.free))), 1.0)
        self.born, self.hazard = born, hazard
        self.ages, self.since = np.full(members, OLD), 0

    def first_weights(self) -> np.ndarray:
        """All on the first."""
        found = np.full(len(self.walk), 1e-300)
        found[0] = 1.0
        return found

    def judged(self, told: Told) -> float:
        """Let hypotheses be born when it is time; the odds of a recent change."""
        self.since += 1
        self.ages = self.ages + 1
        weights = np.asarray(self.weights)
        share = np.exp(weights - np.max(weights))
        share = share / share.sum()
        remembered = self.born * len(self.walk) // len(self.layout.free)
        recent = float(np.sum(share[self.ages <= remembered]))
        if self.due(told):
            self._bear(told, share)
            self.since = 0
        return float(np.log10(max(recent, 1e-300) / max(1.0 - recent, 1e-12)))

    def due(self, told: Told) -> bool:
        """Whether hypotheses are to be born: every so often, and as soon as a value surprises."""
        if self.far or told.outlier.any():
            return False  # a new one would explain all
        return self.since >= self.born or (self.since > 1 and bool(np.any(told.surprise > SURPRISE)))

    def jumped(self) -> None:
        """Ask whether a sensor's zero or a parameter has jumped.

        The first hypothesis has the zero open, one a parameter that and the motion: it was filtered with what was
        wrong. A few samples tell them apart.
        """
        self.far = 0
        best = self._answering()
        mean, covariance, model = np.array(self.means)[best], self.covariances()[best], self.model
        added = np.zeros((1 + len(self.layout.free), model.size))
        added[0, model.offsets] = self.zero_variance()
        added[1:, : model.n_motion] = self.square
        for parameter in range(len(self.layout.free)):
            added[1 + parameter, model.logs.start + parameter] = CHANGE**2
        means = np.tile(mean, (len(self.walk), 1))
        spreads = np.stack([self.rooted(covariance + np.diag(own)) for own in added])
        rest = np.repeat(spreads[:1], len(means) - len(added), axis=0)  # who was here before expects what no longer is
        self.means, self.spreads = means, np.concatenate([spreads, rest])
        self._asked(len(added))
        self.asking = ASKED

    def loosened(self, covariance: np.ndarray, parameter: int) -> np.ndarray:
        """The spread of a new hypothesis: one parameter has changed, and the motion may have gone wrong since."""
        motion, i = slice(0, self.model.n_motion), self.model.logs.start + parameter
        covariance = covariance.copy()
        covariance[motion, motion] *= LOOSER
        covariance[i, i] += CHANGE**2
        return self.rooted(covariance)

    def _answering(self) -> int:
        """The member that the answer is most like."""
        return int(np.argmax(self.weights))

    def _asked(self, number: int) -> None:
        """Weigh the first ``number`` members, the new hypotheses, alike, and nothing else."""
        self.ages[:number], self.ages[number:] = 0, OLD
        self.weights = np.where(np.arange(len(self.walk)) < number, -np.log(number), FLOOR)
        self.since = 0

    def _bear(self, told: Told, share: np.ndarray) -> None:
        """One hypothesis a parameter, in the places of the least likely."""
        means, spreads, kinds = np.array(self.means), np.array(self.spreads), len(self.layout.free)
        spared = (self.ages < self.born * len(share) // (2 * kinds)) | (share == np.max(share))
        places = np.argsort(np.where(spared, np.inf, share))[:kinds]
        chance = self.hazard * self.since
        share = share * (1.0 - chance)
        for parameter, place in enumerate(places):
            means[place], spreads[place] = told.mean, self.loosened(told.covariance, parameter)
            share[place], self.ages[place] = chance / kinds, 0
        self.means, self.spreads = means, spreads
        self.weights = np.log(np.maximum(share / share.sum(), 1e-300))


@dataclass(frozen=True)
class ChangePoint(OnlineIdentifier):
    """``members`` hypotheses, born every ``born`` samples; ``hazard``: probability of a change, a sample."""

    warm_up: int = 150
    members: int = 36
    born: int = 8
    hazard: float = 1e-4
    card: ClassVar[OnlineCard] = OnlineCard(
        "Bayesian online change-point detection with extended Kalman filters of constant parameters",
        "R. P. Adams, D. J. C. MacKay, arXiv:0710.3742; P. Fearnhead, Z. Liu, JRSS B 69:589, 2007",
        "a change in 10 000 samples, of a factor of 1.35 in one parameter",
        "change points",
        40,
        "#AA4499",
    )

    def __post_init__(self) -> None:
        if self.warm_up < 20:
            raise InputError("method.warm_up", self.warm_up, "at least 20 samples")
        if not 0 < self.hazard < 1:
            raise InputError("method.hazard", self.hazard, "a probability between 0 and 1")
        if self.members < 4 or self.born < 1:
            raise InputError("method.members", self.members, "at least 4 hypotheses, born every 1 or more samples")

    def start(self, layout: Layout) -> ChangePointTracker:
        """A bank before its first sample."""
        members = max(self.members, 4 * len(layout.free))
        return ChangePointTracker(layout, self.warm_up, members, self.born, self.hazard, "extended")
