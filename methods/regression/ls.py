"""Equation-error least squares on numerically differentiated displacement: the paper's baseline.

The measured displacement is differentiated, velocity and acceleration are put into the equation of motion, and the
parameters (where nothing tells the scale: the identifiable groups, e.g. k/m and c/m) are the least-squares solution of
the resulting linear equations, one a sample and degree of freedom.

``derivative="finite"`` differentiates by central differences over three samples: the baseline of the paper. It has a
bias without any noise: at a rate ``s`` (a root of the system) and step ``h`` the second difference of ``e^{st}`` is
``2 (cosh(sh) - 1)/h²`` times it, not ``s²``, and the central difference ``sinh(sh)/h`` times it, not ``s``. So
k/m is about ``ω²h²/12`` low: some 11 % at five samples a cycle. Noise makes the columns random (errors in variables).

``derivative="spline"`` differentiates a smoothing spline (degree 5 or 7). Smoothing damps displacement, velocity and
acceleration of the regression alike, so it biases little. How much to smooth is decided by the data and the equations:
each smoothing gives an estimate, and the one is kept whose simulated response is closest to the record
(:func:`methods.regression.bootstrap.spline_fits`). A likelihood of the spline alone fails on few samples a cycle.

``derivative="weak"`` differentiates test functions instead of samples, and weighs the noise as it enters
(:mod:`methods.regression.weak`): linear systems only.

Told: the equations, the samples, the known force. A told start is used in choosing the smoothing and in the noise
level of the bootstrap, not in the regression: the finite-difference estimate itself does not depend on it. The prior is
not used: the harness combines groups with it. There is no own reconstruction: the harness simulates the response. The
uncertainty is a parametric bootstrap's spread; it does not hold the bias, so the intervals of the finite-difference
variant miss the truth where its bias matters. The message says so where the record itself tells it, and a k/m that is
of the noise alone, as many samples a cycle give, is refused (:mod:`methods.regression.hausman`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal

import numpy as np

from bench import Card, Estimate, Problem, Serves
from methods.regression.bootstrap import TRIED, TRIED_ANEW, bootstrap_covariances, spline_fits, spline_refit
from methods.regression.company import Finish, answers_together
from methods.regression.equation import Regression, Values, answer, layout_objection, solve
from methods.regression.hausman import doubt, most_likely
from methods.regression.weak import weak_fit
from methods.starts.ambiguity import BandIdentifier


@dataclass(frozen=True)
class LS(BandIdentifier):
    """Equation-error least squares; ``derivative`` as above, ``bootstrap`` data sets are drawn for the covariance."""

    derivative: Literal["finite", "spline", "weak"] = "finite"
    bootstrap: int = 100

    card: ClassVar[Card] = Card(
        summary="equation-error least squares on finite differences, smoothing splines or in weak form (derivative=)",
        start="used when known",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only; a bias beyond it (Hausman's test) is said",
        settings_source="finite: the paper's baseline; spline: smoothing by the likelihood of the simulated response",
        tuning="finite: none; spline: on 3 development systems (damping 3-26 %, 2.7-5.4 cycles) at 40-5 dB tried "
        "penalty orders 2-4, 0-3 samples left out, weight by restricted likelihood or by simulation",
        title="LS, finite differences",
        order=120,
        colour="#000000",
        marker="x",
        paper="ls",
        variants={
            "ls_spline": {
                "title": "LS, smoothing spline",
                "order": 130,
                "colour": "#555555",
                "marker": "+",
                "paper": "",
            },
            "ls_weak": {
                "summary": "weak form of the equation of motion, generalised least squares with its noise (WENDy)",
                "settings_source": "test functions (1 - s²)^6, reweighting: Messenger and Bortz (2021), Bortz (2023)",
                "tuning": "on 5 development systems (damping 3-52 %, 2-4 cycles) at 20-5 dB tried supports of 20-70 % "
                "of the record alone and together, powers 4-8, weights by the noise of the whole residual or a part",
                "title": "LS, weak form",
                "order": 135,
                "colour": "#777777",
                "marker": "2",
                "paper": "",
            },
        },
    )
    serves: ClassVar[Serves] = Serves(
        several_records=True, several_channels=True, offsets=True, max_dof=None, added_mass=True
    )

    works_in = "natural units"

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or layout_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate groups, or parameters where the scale is told."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together."""
        refits = self.bootstrap * TRIED_ANEW if self.derivative == "spline" else self.bootstrap
        return answers_together(problems, rngs, self._solve, max(refits, TRIED))

    def _solve(self, regressions: Sequence[Regression], rngs: Sequence[np.random.Generator]) -> Sequence[Finish]:
        joined, fits = Regression.joined(regressions), spline_fits(regressions)

        def fitter(values: Values) -> np.ndarray:
            if self.derivative == "spline":
                return spline_refit(joined, fits, values)
            if self.derivative == "weak":
                return weak_fit(joined, fits, values)
            return solve(*joined.finite(values))

        spline = self.derivative == "spline"
        unknowns = [fit.unknowns for fit in fits] if spline else fitter(joined.values)
        covariances = bootstrap_covariances(fits, fitter, rngs, self.bootstrap)
        likely = most_likely(joined, fits)
        return [partial(_answer, *own) for own in zip(regressions, unknowns, covariances, likely, strict=True)]


def _answer(
    regression: Regression, unknowns: np.ndarray, covariance: np.ndarray | None, likely: np.ndarray
) -> Estimate:
    return answer(regression, unknowns, covariance, doubt(regression, unknowns, covariance, likely))
