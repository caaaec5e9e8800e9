"""Equation-error least squares on numerically differentiated displacement: the paper's baseline.

The parameters (without a known scale, the identifiable groups such as k/m and c/m) are the least-squares solution of
the equation of motion with numerically differentiated velocity and acceleration, one equation per sample and degree of
freedom.

``derivative="finite"`` uses central differences over three samples: the baseline of the paper. It is biased even
without noise: for a pole ``s`` and step ``h`` the second difference of ``e^{st}`` is ``2 (cosh(sh) - 1)/h²`` times it,
not ``s²``, and the central difference ``sinh(sh)/h`` times it, not ``s``. So k/m is low by about ``ω²h²/12``: some 11 %
at 5.3 samples per cycle. Noise makes the columns random (errors in variables).

``derivative="spline"`` differentiates a smoothing spline (degree 5 or 7). Smoothing damps displacement, velocity and
acceleration of the regression equally, which causes little bias. The smoothing weight is chosen by the simulated
response (:mod:`methods.regression.smoothing`).

``derivative="weak"`` differentiates test functions instead of samples and weights the equations by their noise
covariance (:mod:`methods.regression.weak`); it supports linear systems only.

A known initial state is used to choose the smoothing and for the noise level of the bootstrap, not in the regression.
The prior is not used; the benchmark combines groups with it. The uncertainty is the spread of a parametric bootstrap,
which excludes bias: the intervals of the finite-difference variant do not cover the true value where its bias matters.
A message warns where the record shows this, and an estimate of k/m dominated by noise, as at many samples per cycle, is
rejected (:mod:`methods.regression.hausman`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from bench import Card, Estimate, Scope
from methods.regression.equation import Regression, solve
from methods.regression.hausman import bias_warnings
from methods.regression.identifier import RegressionIdentifier, answer, bootstrap_covariances
from methods.regression.smoothing import TRIED, TRIED_AGAIN, smoothing_again, solved_on_splines, spline_fits
from methods.regression.weak import weak_fit


@dataclass(frozen=True)
class LS(RegressionIdentifier):
    """Equation-error least squares; ``derivative`` as above, ``bootstrap``: synthetic records for the covariance."""

    derivative: Literal["finite", "spline", "weak"] = "finite"
    bootstrap: int = 100

    version: ClassVar[int] = 2
    """2: smoothing splines are accurate at irregular times."""
    card: ClassVar[Card] = Card(
        summary="equation-error least squares on finite differences, smoothing splines or in weak form (derivative=)",
        start="used when known",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only; Hausman's test warns of bias",
        settings_source="finite: the paper's baseline; spline: smoothing by the likelihood of the simulated response",
        tuning="finite: none; spline: on 3 development systems (damping 3-26 %, 2.7-5.4 cycles) at 40-5 dB compared "
        "penalty orders 2-4, 0-3 samples omitted, weight by restricted likelihood or by simulation",
        title="LS, finite differences",
        order=120,
        paper="ls",
        variants={
            "ls_spline": {
                "title": "LS, smoothing spline",
                "order": 130,
                "paper": "",
            },
            "ls_weak": {
                "summary": "weak form of the equation of motion, generalised least squares with its noise (WENDy)",
                "settings_source": "test functions (1 - s²)^6, reweighting: Messenger and Bortz (2021), Bortz (2023)",
                "tuning": "on 5 development systems (damping 3-52 %, 2-4 cycles) at 20-5 dB compared supports 20-70 % "
                "of the record singly and together, powers 4-8, weights by the noise of the residual or part of it",
                "title": "LS, weak form",
                "order": 135,
                "paper": "",
            },
        },
    )
    scope: ClassVar[Scope] = Scope(
        several_records=True, several_channels=True, offsets=True, max_dof=None, added_mass=True
    )

    @property
    def records_held(self) -> int:
        return max(TRIED, self.bootstrap * TRIED_AGAIN if self.derivative == "spline" else self.bootstrap)

    def fit(self, regression: Regression, rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Solve the equations of all problems, and of their synthetic records, at once."""
        splines = spline_fits(regression)

        def fitter(data: Regression) -> np.ndarray:
            if self.derivative == "spline":
                return solved_on_splines(data, *smoothing_again(data, splines))
            return weak_fit(data, splines) if self.derivative == "weak" else solve(*data.finite())

        unknowns = splines.unknowns if self.derivative == "spline" else fitter(regression)
        covariances = bootstrap_covariances(regression, splines.centres, splines.noise, fitter, rngs, self.bootstrap)
        of_problems = zip(unknowns, covariances, bias_warnings(regression, unknowns, covariances, splines), strict=True)
        return [answer(regression, theta, cov, *warning) for theta, cov, warning in of_problems]
