"""Cramér-Rao bound of the modes of a record: the smallest standard deviation of an unbiased estimate.

Amplitudes, phases and a constant are nuisance parameters of each sensor, onto whose complement the derivatives by
frequency and damping ratio are projected (S. M. Kay, Fundamentals of Statistical Signal Processing, 1993, section 3.7).
The force of a blow is treated as known: its noise increases the bound by less than 1 % if the force is set to zero
outside of the blow, and by much more otherwise.
"""

from __future__ import annotations

import numpy as np

from bench.modal.scenario import ModalTruth, poles

STEP = 1e-5
"""Relative step of the finite differences by a pole, whose error is about its square."""


def modal_bound(truth: ModalTruth) -> np.ndarray:
    """Return the bound on the standard deviation of ln frequency and ln damping ratio of each mode, (2, modes)."""
    damping_ratios, modal_poles = truth.damping_ratios, poles(truth.frequencies, truth.damping_ratios)
    sizes = np.abs(modal_poles)
    by_damping = -sizes * damping_ratios * (1.0 + 1j * damping_ratios / np.sqrt(1.0 - damping_ratios**2))
    waves = np.array([truth.waves(pole).ravel() for pole in modal_poles])
    slopes = np.array([_slope(truth, pole) for pole in modal_poles])
    constant = np.ones((1, waves.shape[1]))
    nuisance = np.linalg.qr(np.concatenate([waves.real, waves.imag, constant]).T)[0]
    information = np.zeros((2 * len(modal_poles), 2 * len(modal_poles)))
    for shape, sigma in zip(truth.shapes.T, truth.sigma, strict=True):
        by_quantity = [(shape * by)[:, None] * slopes for by in (modal_poles, by_damping)]
        derivatives = np.concatenate(by_quantity).real.T
        derivatives -= nuisance @ (nuisance.T @ derivatives)
        information += derivatives.T @ derivatives / sigma**2
    scale = 1.0 / np.sqrt(np.diag(information))
    variances = np.diag(np.linalg.inv(information * np.outer(scale, scale))) * scale**2
    return np.asarray(np.sqrt(variances).reshape(2, -1))


def _slope(truth: ModalTruth, pole: complex) -> np.ndarray:
    step = STEP * abs(pole)
    return np.asarray((truth.waves(pole + step) - truth.waves(pole - step)).ravel() / (2.0 * step))
