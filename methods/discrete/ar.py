"""Autoregression of order two: the difference equation of a sampled free decay, by least squares.

``x_j = a₁ x_(j-1) + a₂ x_(j-2)`` is solved for a₁ and a₂ over all samples (the least-squares form of Prony's method:
S. M. Kay, Modern Spectral Estimation, 1988, section 11.4), and its roots are turned into k/m and c/m
(:mod:`methods.discrete.difference`).

This is the plain form that textbooks give and people run, and it has their bias. The columns are measured too: their
noise (errors in variables; T. Söderström, Automatica 43:939, 2007) draws the coefficients towards zero, the more the
more samples a cycle there are, since then two neighbours differ by little else than noise. The estimate is biased
at any length of record, towards too much damping above all. ``iqml`` removes that bias. The uncertainty is a parametric
bootstrap's spread, which does not show it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card
from methods.discrete.difference import NO_OSCILLATOR, equations, groups_of
from methods.modal.free_decay import PoleIdentifier
from methods.regression.equation import solve


@dataclass(frozen=True)
class AR(PoleIdentifier):
    """Autoregression of order two by least squares; ``bootstrap`` records are drawn for the covariance, 0 for none."""

    bootstrap: int = 100

    unreadable: ClassVar[str] = NO_OSCILLATOR
    card: ClassVar[Card] = Card(
        summary="autoregression of order two: least squares on the difference equation of the sampled free decay",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only, not the bias of noisy columns",
        settings_source="order 2: two exponentials of one mass",
        tuning="none",
        title="AR, least squares",
        order=200,
        colour="#8C6D31",
        marker="<",
    )

    def poles_read(self, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
        return groups_of(solve(*equations(sets, offset)), step)
