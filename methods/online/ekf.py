"""Online joint Kalman filters of state and log-parameters, with parameters as random walks of unknown rate.

Filters of several rates run in parallel, from zero to a fast one, weighted by likelihood. The rate is a Markov chain
with rare transitions, by which the distributions are mixed before each prediction (interacting multiple models: H. A.
P. Blom, Y. Bar-Shalom, IEEE Trans. Automatic Control 33:780, 1988), so that a filter of low weight can regain it fast.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Layout, OnlineCard
from methods.online.bank import Outcome, Rule
from methods.online.filtering import FilterIdentifier, FilterTracker, Probability

RATES = (0.0, 3e-4, 2e-3, 1e-2)
"""Standard deviations per sample of the random walk of a log-parameter."""

LIKELIER = -np.log(2.0)
"""Log-weight above which a mode is more likely than all others together."""
WORTH = 1000.0
"""Samples to which the prior transition probabilities are equivalent when they are updated."""


class Rates(FilterTracker):
    """Filters of several rates, mixed by a Markov chain.

    The first mode (constant parameters) is left with probability ``changes``, with equal probability to each other
    mode, and re-entered with probability ``settles``. Both are posterior means of beta distributions, given the
    observed ``switches`` of the most likely mode and the samples it ``lasted`` in the first and in other modes.
    """

    mixes = True
    state_names = (*FilterTracker.state_names, "chain", "still", "switches", "lasted")

    def __init__(self, layout: Layout, method: OnlineEKF) -> None:
        walk = method.walks(len(layout.free))
        self.prior = np.array([method.changes, method.settles])
        self.still, self.switches, self.lasted = True, np.zeros(2), np.zeros(2)
        super().__init__(layout, method.warm_up, walk, self._chain(len(walk)), method.rule)

    def _chain(self, members: int) -> np.ndarray:
        changes, settles = (WORTH * self.prior + self.switches) / (WORTH + self.lasted)
        chain = np.eye(members) * (1.0 - settles)
        chain[:, 0], chain[0] = settles, changes / (members - 1)
        chain[0, 0] = 1.0 - changes
        return chain

    def judged(self, outcome: Outcome) -> float:
        """Count the samples in the first and in other modes, and update the transition probabilities."""
        still = bool(np.asarray(self.weights)[0] > LIKELIER)
        self.lasted[int(not still)] += 1
        if still != self.still:
            self.switches[int(still)] += 1
            self.still, self.chain = still, self._chain(len(self.walk))
            self.rebuild()
        return float("nan")

    def first_weights(self) -> np.ndarray:
        """Return the stationary distribution of the chain."""
        changing = self.prior[0] / self.prior.sum()
        others = len(self.walk) - 1
        return np.array([1.0 - changing] + [changing / others] * others)


@dataclass(frozen=True)
class OnlineEKF(FilterIdentifier):
    """``changes``: prior probability per sample that parameters begin to change; ``settles``: that they stop."""

    changes: Probability = 1e-5
    settles: Probability = 1e-2
    rule: ClassVar[Rule] = "extended"
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filters with random walks of several rates, weighted by likelihood",
        "C. B. Yun, M. Shinozuka, J. Structural Mechanics 8:187, 1980; Blom and Bar-Shalom 1988",
        "rates: factors of five and seven apart; the probability of a change is learned from the stream",
        "EKF",
        10,
    )

    def walks(self, parameters: int) -> np.ndarray:
        """Return the process noise of each member's log-parameters per sample, a variance, (M, parameters)."""
        return np.repeat(np.square(RATES)[:, None], parameters, axis=1)

    def start(self, layout: Layout) -> Rates:
        """Return a bank before its first sample."""
        return Rates(layout, self)


@dataclass(frozen=True)
class OnlineUKF(OnlineEKF):
    """The unscented filter in place of the extended one."""

    rule: ClassVar[Rule] = "unscented"
    card: ClassVar[OnlineCard] = OnlineCard(
        "unscented (cubature) Kalman filters with random walks of several rates, weighted by likelihood",
        "S. Mariani, A. Ghisi, Nonlinear Dynamics 49:131, 2007; Arasaratnam and Haykin 2009",
        "as the EKF",
        "UKF",
        20,
    )


@dataclass(frozen=True)
class OnlineSquareRoot(OnlineEKF):
    """The extended filter in square-root form."""

    rule: ClassVar[Rule] = "square_root"
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filters in square-root form, rates weighted by likelihood",
        "Kaminski, Bryson and Schmidt 1971",
        "as the EKF",
        "square-root EKF",
        30,
    )
