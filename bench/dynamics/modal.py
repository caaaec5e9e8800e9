"""Natural frequencies, damping ratios and mode shapes of a linear system, and how well two sets of modes agree.

A state ``[x, v]`` moves as ``exp(λ t)`` along an eigenvector of the state matrix. A vibrating mode is a conjugate pair
with natural frequency ``|λ| / 2π`` and damping ratio ``-Re λ / |λ|``; its shape is the displacement part of the
eigenvector (D. J. Ewins, Modal Testing, 2nd edition, 2000, section 2.5).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from bench.dynamics.mechanics import state_matrix
from bench.systems import System

RESOLVED = 1e7
"""Largest ratio of two natural frequencies; beyond it, rounding of the largest eigenvalue spoils the smallest."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes in order of natural frequency: ``frequencies`` (n,) in Hz, ``damping_ratios`` (n,), ``shapes`` (n_dof, n).

    Two real eigenvalues (an overdamped mode) make one entry: the frequency is that of their geometric mean, the
    damping ratio is above 1, and the shape is that of the slower one. Of several replicates each has a leading axis.
    """

    frequencies: np.ndarray
    damping_ratios: np.ndarray
    shapes: np.ndarray


def modes(system: System, parameters: Mapping[str, Any]) -> Modes:
    """Compute the modes of a linear system; masses, dampers and springs may all be over one mass.

    Values may be NaN. Raises ValueError if the system is not linear.
    """
    batch = modes_of_all(system, {name: np.array([float(value)]) for name, value in parameters.items()})
    return Modes(batch.frequencies[0], batch.damping_ratios[0], batch.shapes[0])


def modes_of_all(system: System, parameters: Mapping[str, np.ndarray]) -> Modes:
    """Compute the modes for parameters of shape (count,), with a leading axis of that length.

    One of each conjugate pair makes a mode, and two real eigenvalues that follow each other in size.
    """
    with np.errstate(all="ignore"):  # of an outlier fit
        matrices, _ = state_matrix(system, parameters)
        finite = np.all(np.isfinite(matrices), axis=(1, 2), keepdims=True)
        rates, vectors = np.linalg.eig(np.where(finite, matrices, 0.0))
        rates, shapes = np.where(finite[..., 0], rates, np.nan), np.where(finite, vectors[:, : system.n_dof], np.nan)
        kinds = np.select([rates.imag > 0, rates.imag == 0], [0, 1], 2)
        order = np.lexsort((np.abs(rates), kinds))
        place, vibrating = np.arange(system.n_dof), np.sum(kinds == 0, axis=1, keepdims=True)
        first = np.where(place < vibrating, place, 2 * place - vibrating)
        second = np.where(place < vibrating, first, first + 1)
        slower, faster = (np.take_along_axis(order, places, axis=1) for places in (first, second))
        slow, fast = (np.take_along_axis(rates, places, axis=1) for places in (slower, faster))
        sizes, decays = np.sqrt(np.abs(slow * fast)), -(slow + fast).real / 2
        order = np.argsort(sizes, axis=1)
        sizes, decays, chosen = (np.take_along_axis(values, order, axis=1) for values in (sizes, decays, slower))
        return Modes(sizes / (2 * np.pi), decays / sizes, np.take_along_axis(shapes, chosen[:, None], axis=2))


def mac(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the modal assurance criterion (n, m) of shapes (n_dof, n) and (n_dof, m); 1 for proportional shapes.

    ``|a' b|² / ((a' a) (b' b))`` (R. J. Allemang, Sound and Vibration 37(8):14, 2003). Leading axes are kept.
    """
    crossed = np.abs(np.swapaxes(a.conj(), -1, -2) @ b) ** 2
    squares_a, squares_b = (np.sum(np.abs(shapes) ** 2, axis=-2) for shapes in (a, b))
    return np.asarray(crossed / (squares_a[..., :, None] * squares_b[..., None, :]))


@dataclass(frozen=True)
class Agreement:
    """Errors of identified modes, matched to the true ones by shape; numbers, or arrays by replicate.

    ``frequency_pct`` and ``damping_pct`` are the root mean square over the modes of the relative error (%),
    ``least_mac`` is the smallest modal assurance criterion.
    """

    frequency_pct: np.ndarray
    damping_pct: np.ndarray
    least_mac: np.ndarray


def agreement(identified: Modes, true: Modes) -> Agreement:
    """Compare identified modes, of one or several replicates, with the true modes.

    Errors are infinite and the MAC is 0 if the identified modes are not finite, or their frequencies differ so much
    that the lower ones are rounding errors, as after an outlier fit.
    """
    finite = np.isfinite(identified.shapes).all(axis=(-2, -1))
    for numbers in (identified.frequencies, identified.damping_ratios):
        finite = finite & np.isfinite(numbers).all(axis=-1)
    with np.errstate(all="ignore"):
        finite &= identified.frequencies.max(axis=-1) < RESOLVED * identified.frequencies.min(axis=-1)
        likeness = mac(true.shapes, identified.shapes)
        # frequencies decide the matching if shapes do not (one DOF, or equal shapes)
        near = np.abs(np.log(np.maximum(identified.frequencies, 1e-300)[..., None, :] / true.frequencies[:, None]))
    costs = np.where(finite[..., None, None], -likeness + 0.1 * np.minimum(near, 1.0), 0.0)
    assignments = [linear_sum_assignment(cost)[1] for cost in costs.reshape(-1, *costs.shape[-2:])]
    matching = np.array(assignments, int).reshape(costs.shape[:-1])

    def rms(estimates: np.ndarray, values: np.ndarray) -> np.ndarray:
        errors = np.take_along_axis(estimates, matching, axis=-1) / values - 1.0
        return np.where(finite, 100.0 * np.sqrt(np.mean(errors**2, axis=-1)), np.inf)

    matched = np.take_along_axis(likeness, matching[..., None], axis=-1)
    return Agreement(
        rms(identified.frequencies, true.frequencies),
        rms(identified.damping_ratios, true.damping_ratios),
        np.where(finite, matched.min(axis=(-2, -1)), 0.0),
    )
