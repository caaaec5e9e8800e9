"""Kalman filters on line: state and log-parameters together, parameters as random walks of unknown rate.

The rate is not set by hand. Filters of several rates run side by side, from none to a fast one, and the likelihood of
what each predicted decides what counts: the rate is a Markov chain that seldom changes, and the beliefs are mixed
accordingly before each prediction (interacting multiple models: H. A. P. Blom, Y. Bar-Shalom, IEEE Trans. Automatic
Control 33:780, 1988), so a filter that has been wrong for long takes over from those that were right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import InputError, Layout, OnlineCard, OnlineIdentifier
from methods.online.bank import Rule, Told
from methods.online.filtering import FilterTracker

RATES = (0.0, 3e-4, 2e-3, 1e-2)
"""Standard deviations of the random walk of a log-parameter, a sample."""


class Rates(FilterTracker):
    """Filters of several rates, mixed by a Markov chain."""

    mixes = True

    def judged(self, told: Told) -> float:
        return float("nan")

    def first_weights(self) -> np.ndarray:
        """Those that the chain has in the long run."""
        values, vectors = np.linalg.eig(self.chain.T)
        found = np.abs(np.real(vectors[:, int(np.argmax(np.real(values)))]))
        return np.asarray(found / found.sum())


def settling(members: int, changes: float, settles: float) -> np.ndarray:
    """A transition matrix whose first mode is left with probability ``changes``, and returned to with ``settles``."""
    found = np.eye(members) * (1.0 - settles)
    found[:, 0] = settles
    found[0] = changes / (members - 1)
    found[0, 0] = 1.0 - changes
    return found


@dataclass(frozen=True)
class OnlineEKF(OnlineIdentifier):
    """``warm_up`` samples before the filters begin; ``changes``: probability a sample that the rate changes."""

    warm_up: int = 150
    changes: float = 1e-5
    settles: float = 1e-2
    rule: ClassVar[Rule] = "extended"
    card: ClassVar[OnlineCard] = OnlineCard(
        "extended Kalman filters with random walks of several rates, weighted by likelihood",
        "C. B. Yun, M. Shinozuka, J. Structural Mechanics 8:187, 1980; Blom and Bar-Shalom 1988",
        "rates: a factor of five apart; a change in a thousand samples",
        "EKF",
        10,
        "#117733",
    )

    def __post_init__(self) -> None:
        if self.warm_up < 20:
            raise InputError("method.warm_up", self.warm_up, "at least 20 samples")
        if not 0 < self.changes < 1:
            raise InputError("method.changes", self.changes, "a probability between 0 and 1")

    def start(self, layout: Layout) -> FilterTracker:
        """A bank before its first sample."""
        walk = np.repeat(np.square(RATES)[:, None], len(layout.free), axis=1)
        return Rates(layout, self.warm_up, self.rule, walk, settling(len(RATES), self.changes, self.settles))


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
        "#661100",
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
        "#44AA99",
    )
