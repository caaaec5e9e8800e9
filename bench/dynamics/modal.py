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


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes in order of natural frequency: ``frequencies`` (n,) in Hz, ``damping_ratios`` (n,), ``shapes`` (n_dof, n).

    Two real eigenvalues (an overdamped mode) make one entry: the frequency is that of their geometric mean, the
    damping ratio is above 1, and the shape is that of the slower one.
    """

    frequencies: np.ndarray
    damping_ratios: np.ndarray
    shapes: np.ndarray


def modes(system: System, parameters: Mapping[str, Any]) -> Modes:
    """The modes of a linear system; masses, dampers and springs may all be over one mass. NaNs if it is not finite.

    Raises ValueError where the system is not linear.
    """
    return modes_of_all(system, {name: np.array([float(value)]) for name, value in parameters.items()})[0]


def modes_of_all(system: System, parameters: Mapping[str, np.ndarray]) -> list[Modes]:
    """The same for parameters of shape (n,): ``n`` modes."""
    n, count = system.n_dof, len(next(iter(parameters.values())))
    with np.errstate(all="ignore"):  # of a fit that ran away
        try:
            matrices, _ = state_matrix(system, parameters)
            rates, vectors = np.linalg.eig(matrices)
        except np.linalg.LinAlgError:  # said of all where it is so of one
            if count == 1:
                return [Modes(np.full(n, np.nan), np.full(n, np.nan), np.full((n, n), np.nan))]
            each = ({name: own[i : i + 1] for name, own in parameters.items()} for i in range(count))
            return [found for one in each for found in modes_of_all(system, one)]
        return [_paired(own, shapes[:n]) for own, shapes in zip(rates, vectors, strict=True)]


def _paired(rates: np.ndarray, shapes: np.ndarray) -> Modes:
    """Modes from the eigenvalues (2 n,) of a state matrix and the displacements (n, 2 n) of its eigenvectors."""
    order = np.argsort(np.abs(rates))
    rates, shapes = rates[order], shapes[:, order]
    real = np.flatnonzero(rates.imag == 0)
    pairs = [(i, i) for i in np.flatnonzero(rates.imag > 0)] + list(zip(real[::2], real[1::2], strict=False))
    sizes = np.array([np.sqrt(np.abs(rates[i] * rates[j])) for i, j in pairs])
    decays = np.array([-(rates[i] + rates[j]).real / 2 for i, j in pairs])
    order = np.argsort(sizes)
    chosen = np.stack([shapes[:, i] for i, _ in pairs], axis=1)
    return Modes(sizes[order] / (2 * np.pi), decays[order] / sizes[order], chosen[:, order])


def mac(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Modal assurance criterion of shapes (n_dof, n) and (n_dof, m), (n, m): 1 where they are the same but for scale.

    ``|a' b|² / ((a' a) (b' b))`` (R. J. Allemang, Sound and Vibration 37(8):14, 2003).
    """
    crossed = np.abs(a.conj().T @ b) ** 2
    return np.asarray(crossed / np.outer(np.sum(np.abs(a) ** 2, axis=0), np.sum(np.abs(b) ** 2, axis=0)))


@dataclass(frozen=True)
class Agreement:
    """Identified modes against true ones, each matched to one by shape.

    ``frequency_pct`` and ``damping_pct``: root mean square over the modes of the relative error (%); ``least_mac``: the
    worst agreement in shape.
    """

    frequency_pct: float
    damping_pct: float
    least_mac: float


def agreement(identified: Modes, true: Modes) -> Agreement:
    """How well the modes agree; infinite errors and a MAC of 0 where the identified ones are not finite."""
    if not all(np.all(np.isfinite(part)) for part in vars(identified).values()):
        return Agreement(float("inf"), float("inf"), 0.0)
    likeness = mac(true.shapes, identified.shapes)
    # where shapes do not tell (one DOF, or sensors alike), frequencies do
    distance = np.abs(np.log(np.maximum(identified.frequencies, 1e-300) / true.frequencies[:, None]))
    mine, theirs = linear_sum_assignment(-likeness + 0.1 * np.minimum(distance, 1.0))

    def rms(found: np.ndarray, wanted: np.ndarray) -> float:
        return float(100.0 * np.sqrt(np.mean((found[theirs] / wanted[mine] - 1.0) ** 2)))

    return Agreement(
        rms(identified.frequencies, true.frequencies),
        rms(identified.damping_ratios, true.damping_ratios),
        float(likeness[mine, theirs].min()),
    )
