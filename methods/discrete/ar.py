"""Autoregression of order two: the difference equation of a sampled free decay, by least squares.

At even steps h a free decay is a sum of two exponentials ``z₁^j, z₂^j``, ``z = e^(sh)``, so its samples satisfy
``x_j = a₁ x_(j-1) + a₂ x_(j-2)`` with ``z² - a₁ z - a₂ = 0``. A sensor's offset d adds the constant
``(1 - a₁ - a₂) d``. Least squares over all samples gives a₁ and a₂ (the least-squares form of the method of G. R. B. de
Prony: S. M. Kay, Modern Spectral Estimation, 1988, section 11.4). The roots give ``k/m = s₁ s₂`` and
``c/m = -(s₁ + s₂)``, ``s = log(z)/h``, for a complex pair and for two positive roots (damping ratio below and above 1).

This is the usual textbook form, and it is biased: the regressors are noisy (errors in variables; T. Söderström,
Automatica 43:939, 2007), which reduces the coefficients, more so at many samples per cycle, where neighbouring samples
differ by little but noise. The bias, mainly towards larger damping, does not decrease with the length of the record.
``iqml`` removes it. The uncertainty is the spread of a parametric bootstrap, which excludes the bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card
from methods.modal.free_decay import PoleIdentifier
from methods.regression.equation import solve

NO_OSCILLATOR = (
    "the roots of its difference equation are not those of a sampled oscillator (one is negative, or one decays and "
    "one grows): more samples per cycle, a longer record or less noise are required"
)


@dataclass(frozen=True)
class AR(PoleIdentifier):
    """Autoregression of order two by least squares; ``bootstrap``: synthetic records for the covariance, 0 for none."""

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
    )

    def from_poles(self, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
        return groups_of(solve(*equations(sets, offset)), step)


def equations(sets: np.ndarray, offset: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns (sets, n - 2, 2 or 3) of a₁, a₂ and an offset's constant, and the target (sets, n - 2)."""
    columns = [sets[:, 1:-1], sets[:, :-2]] + ([np.ones_like(sets[:, 2:])] if offset else [])
    return np.stack(columns, axis=-1), sets[:, 2:]


def groups_of(a: np.ndarray, step: float) -> np.ndarray:
    """Return k/m and c/m, (..., 2), for coefficients a₁ and a₂ (..., 2 or more) at a time step.

    NaN where the roots are not those of an oscillator: not finite, negative, or on both sides of 1.
    """
    with np.errstate(all="ignore"):
        half, product = 0.5 * a[..., 0], -a[..., 1]
        decay = -np.log(product) / step
        inside = product - half**2
        angle = np.arctan2(np.sqrt(np.maximum(inside, 0.0)), half) / step
        # the larger root, and the smaller one from their product, to avoid cancellation
        large = half + np.sqrt(np.maximum(-inside, 0.0))
        rates = np.log(large) / step, np.log(product / large) / step
        pair = (0.5 * decay) ** 2 + angle**2
        real = np.where((large > 0) & (rates[0] * rates[1] > 0), rates[0] * rates[1], np.nan)
        stiffness = np.where(inside > 0, pair, real)
        groups = np.stack([stiffness, decay], axis=-1)
    return np.where(np.all(np.isfinite(groups), axis=-1, keepdims=True), groups, np.nan)


def coefficients_of(groups: np.ndarray | tuple[float, float], step: float) -> np.ndarray:
    """Return a₁ and a₂, (2,), for k/m and c/m (2,) at a time step: the inverse of :func:`groups_of`."""
    envelope, cosine, _ = _waves(groups, step)
    return np.array([2.0 * envelope * cosine, -(envelope**2)])


def coefficient_slopes(groups: np.ndarray | tuple[float, float], step: float) -> np.ndarray:
    """Differentiate :func:`coefficients_of` by k/m and c/m, (2, 2), one row per coefficient."""
    envelope, cosine, sine = _waves(groups, step)
    by_stiffness = -envelope * step**2 * sine
    by_damping = -step * envelope * cosine - 0.5 * groups[1] * by_stiffness
    return np.array([[by_stiffness, by_damping], [0.0, step * envelope**2]])


def _waves(groups: np.ndarray | tuple[float, float], step: float) -> tuple[float, float, float]:
    """Return ``e^(-dh)``, ``cosh(rh)`` and ``sinh(rh)/(rh)`` for ``d = c/2m``, ``r² = d² - k/m``; r may be zero."""
    decay = 0.5 * float(groups[1])
    angle = np.sqrt(complex(decay**2 - float(groups[0]))) * step
    ratio = np.sinh(angle) / angle if abs(angle) > 1e-4 else 1.0 + angle**2 / 6.0
    return float(np.exp(-decay * step)), float(np.cosh(angle).real), float(np.real(ratio))
