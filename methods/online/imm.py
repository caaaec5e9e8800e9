"""Interacting multiple models: all parameters are constant, or one of them changes, slowly or fast.

The modes form a Markov chain, by which their distributions are mixed before each prediction (H. A. P. Blom, Y.
Bar-Shalom, IEEE Trans. Automatic Control 33:780, 1988). A mode lasts several samples, since one cannot show a change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import OnlineCard
from methods.online.ekf import OnlineEKF
from methods.online.filtering import Probability

RATES = (2e-3, 2e-2)
"""Standard deviations per sample of the random walk of the log-parameter that changes."""


@dataclass(frozen=True)
class OnlineIMM(OnlineEKF):
    """``changes``: prior probability per sample that a parameter begins to change; ``settles``: that it stops."""

    changes: Probability = 1e-4
    settles: Probability = 0.05
    card: ClassVar[OnlineCard] = OnlineCard(
        "interacting multiple models of extended Kalman filters: nothing changes, or one parameter, slowly or fast",
        "H. A. P. Blom, Y. Bar-Shalom, IEEE Trans. Automatic Control 33:780, 1988",
        "a change in 10 000 samples that lasts 20; rates a factor of ten apart",
        "IMM",
        50,
    )

    def walks(self, parameters: int) -> np.ndarray:
        """Return the process noise of each mode: none, or of one parameter at one of the rates."""
        return np.concatenate([np.zeros((1, parameters)), *(np.eye(parameters) * rate**2 for rate in RATES)])
