"""Maximum-likelihood search for poles: modes are added one by one, and their number is selected by a criterion.

Linear parameters are eliminated by variable projection (G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973;
Jacobian of L. Kaufman, BIT 15:49, 1975). The criterion is the Bayesian information criterion (G. Schwarz, Ann. Stat.
6:461, 1978). Subclasses define the data and the model of their noise.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeVar

import numpy as np

from bench.contract.modal import MOST_MODES, ModalProblem, Mode
from bench.likelihood.least_squares import Linearisation, minimise

ITERATIONS, SCREENING, TRIAL = 60, 4, 8
"""Largest numbers of iterations: of a full search, from every starting point, and from the ``KEPT`` best ones."""
KEPT = 2
"""Number of starting points that are kept after screening."""
DECAYS = 8
"""Number of decay rates in the search for a further mode, in geometric progression."""
ROUNDING = 1e-7
"""Least ratio of noise to signal of a channel, due to rounding."""
MANY = "the largest number of modes was reached, so the record may be no sum of modes"


@dataclass(frozen=True, eq=False)
class PoleFit(ABC):
    """Fit of modes to data, with least-squares factors; the poles are common to all blocks and outputs.

    Attributes:
        poles: Complex poles (1/s), shape (m,).
        level: Variance of the whitened errors, shape (outputs,).
        values: Data, shape (blocks, outputs, n).
        resolution: Least distance (rad/s) between the two modes into which one is split.
    """

    poles: np.ndarray
    level: np.ndarray
    values: np.ndarray
    resolution: float

    @property
    @abstractmethod
    def basis(self) -> np.ndarray:
        """Basis functions (blocks, k, n): for real parts of the modes' factors, for imaginary parts, and others."""

    @property
    @abstractmethod
    def slopes(self) -> np.ndarray:
        """Derivatives (blocks, outputs, size, n) by the real, then the imaginary parts of :attr:`nonlinear`."""

    @abstractmethod
    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Whiten rows (blocks, outputs or 1, k, n); return real columns (blocks, outputs or 1, n', k)."""

    @abstractmethod
    def moved(self, nonlinear: np.ndarray) -> Self:
        """Return the fit with other nonlinear parameters, clipped to their limits."""

    @abstractmethod
    def with_noise(self) -> Self:
        """Return the fit with the noise model estimated from its residuals."""

    @abstractmethod
    def starts(self) -> Sequence[Self]:
        """Return starting points with one more mode."""

    @abstractmethod
    def part(self, mode: int) -> np.ndarray:
        """Return the contribution of a mode to the data."""

    @property
    @abstractmethod
    def criterion(self) -> float:
        """Bayesian information criterion with the noise model estimated from the residuals."""

    @property
    @abstractmethod
    def has_room(self) -> bool:
        """Whether there are enough data for one more mode."""

    @property
    def nonlinear(self) -> np.ndarray:
        """Complex nonlinear parameters, the poles first."""
        return self.poles

    @property
    def functions_count(self) -> int:
        """Number of complex factors per block and output, those of the modes first."""
        return self.poles.size

    @property
    def plausible(self) -> bool:
        """Whether the poles can be those of modes."""
        return True

    @property
    def rank(self) -> tuple[bool, float]:
        """Sort key of fits, smallest for the best."""
        return not self.plausible, self.criterion

    def factor_errors(self) -> np.ndarray:
        """Return variances (blocks, m) of the common relative error of a block's factors."""
        return np.zeros((len(self.values), self.poles.size))

    def gradient_covariance(self, slopes: np.ndarray) -> np.ndarray:
        """Return the covariance of the gradient for whitened derivatives (blocks, outputs, n', size)."""
        flat = slopes.reshape(-1, slopes.shape[-1])
        return np.asarray(flat.T @ flat)

    @cached_property
    def projection(self) -> tuple[np.ndarray, np.ndarray]:
        """QR decomposition of the whitened basis."""
        q, r = np.linalg.qr(self.whitened(self.basis[:, None]))
        return q, r

    @cached_property
    def factors(self) -> np.ndarray:
        """Least-squares factors of the basis, shape (blocks, outputs, k)."""
        q, r = self.projection
        data = np.swapaxes(q, -1, -2) @ self.whitened(self.values[:, :, None])
        return np.asarray((np.linalg.pinv(r) @ data)[..., 0])

    @property
    def residues(self) -> np.ndarray:
        """Complex factors, shape (blocks, outputs, functions)."""
        size = self.functions_count
        return np.asarray(self.factors[..., :size] + 1j * self.factors[..., size : 2 * size])

    @cached_property
    def residuals(self) -> np.ndarray:
        """Residuals, shape (blocks, outputs, n)."""
        return np.asarray(self.values - self.factors @ self.basis)

    @property
    def projected(self) -> tuple[np.ndarray, np.ndarray]:
        """Components of the whitened derivatives along the basis, and their orthogonal rest over the noise level."""
        q, slopes = self.projection[0], self.whitened(self.slopes)
        along = np.swapaxes(q, -1, -2) @ slopes
        return along, (slopes - q @ along) / np.sqrt(self.level)[:, None, None]

    def refined(self, iterations: int = ITERATIONS) -> Self:
        """Return the fit after a search for all poles from the present ones, with a fixed noise model."""
        size = self.nonlinear.size

        def evaluate(_: np.ndarray, unknowns: np.ndarray) -> Linearisation:
            fit = self.moved(unknowns[0, :size] + 1j * unknowns[0, size:])
            left = fit.whitened(fit.residuals[:, :, None]) / np.sqrt(self.level)[:, None, None]
            x = np.concatenate([fit.nonlinear.real, fit.nonlinear.imag])[None]
            return Linearisation.of(x, left.reshape(1, -1), -fit.projected[1].reshape(1, -1, 2 * size))

        if not size:
            return self
        start = evaluate(np.zeros(1), np.concatenate([self.nonlinear.real, self.nonlinear.imag])[None])
        x = minimise(evaluate, start, iterations).point.unknowns[0]
        return self.moved(x[:size] + 1j * x[size:])

    def settled(self) -> Self:
        """Return the fit after alternating searches for the poles and the noise model."""
        fit = self.refined()
        for _ in range(2):
            fit = fit.with_noise().refined()
        return fit

    def longer(self) -> Self:
        """Return the best fit with one more mode.

        Two poles may come close to each other during a search, so of the other starting points the one with the
        smallest criterion is kept as well.
        """
        screened = sorted((start.refined(SCREENING) for start in self.starts()), key=lambda fit: fit.rank)
        behind = sorted(screened[KEPT:], key=lambda fit: fit.rank[1])
        return min((fit.refined(TRIAL) for fit in [*screened[:KEPT], *behind[:1]]), key=lambda fit: fit.rank).settled()

    def splits(self) -> list[Self]:
        """Return starting points with each mode split in two, as residuals of two close modes have no separate line."""
        fits = []
        for i, pole in enumerate(self.poles):
            apart = 1j * max(-pole.real, self.resolution)
            poles = np.append(self.poles, pole + apart)
            poles[i] = pole - apart
            fits.append(replace(self, poles=poles))
        return fits

    def modes(self) -> tuple[Mode, ...]:
        """Return the modes sorted by frequency, with standard errors from the Fisher information.

        A shape is the mean of the factors of all blocks with weights of least variance.
        """
        m, size = self.poles.size, self.nonlinear.size
        along, across = self.projected
        flat = across.reshape(-1, 2 * size)
        covariance = np.linalg.pinv(flat.T @ flat, hermitian=True)
        covariance = covariance @ self.gradient_covariance(across) @ covariance
        inverse = np.linalg.pinv(self.projection[1])
        places = np.array([np.arange(m), self.functions_count + np.arange(m)])
        variance = np.mean(np.sum(inverse**2, axis=-1)[..., places], axis=-2) * self.level[:, None]
        by_pole = (inverse @ along)[..., places, :]
        residues = self.residues[..., :m]
        first = np.sum(residues / variance, axis=0) / np.sum(1.0 / variance, axis=0)
        variances = variance + np.abs(first) ** 2 * self.factor_errors()[:, None]
        weights = 1.0 / variances / np.sum(1.0 / variances, axis=0)
        shapes = np.sum(weights * residues, axis=0)
        mean_by_pole = np.sum(weights[:, :, None, :, None] * by_pole, axis=0)
        by_poles = np.einsum("ocmi,ij,ocmj->om", mean_by_pole, covariance, mean_by_pole) / 2.0
        shape_sd = np.sqrt(np.sum(weights**2 * variances, axis=0) + by_poles)
        whole = np.linalg.norm(self.values) or 1.0
        modes = []
        for i, pole in enumerate(self.poles):
            pair = np.ix_([i, size + i], [i, size + i])
            share = float(np.linalg.norm(self.part(i)) / whole)
            modes.append(Mode.of_pole(pole, covariance[pair], shapes[:, i], shape_sd[:, i], share))
        return tuple(sorted(modes, key=lambda mode: mode.frequency))


Fit = TypeVar("Fit", bound=PoleFit)


def add_modes(
    fit: Fit, problem: ModalProblem, judge: Callable[[Fit], bool] = lambda fit: True
) -> tuple[Fit, tuple[Mode, ...], str]:
    """Add modes one by one, while the criterion decreases or until the required number is reached.

    Args:
        fit: Initial fit.
        problem: Band, and number of modes if it is given.
        judge: Decides whether to continue after an accepted fit.

    Returns:
        The last fit, its modes in the band, and the reason for their number.
    """
    counted, (low, high) = problem.count is not None, problem.band or (0.0, np.inf)
    while True:
        rates = np.abs(fit.poles) / (2 * np.pi)
        if np.count_nonzero((low <= rates) & (rates <= high)) == problem.count:
            reason = "as requested"
            break
        if fit.poles.size == MOST_MODES or not fit.has_room:
            reason = MANY if fit.has_room else "there are too few data for another"
            break
        longer = fit.longer()
        gain = fit.criterion - longer.criterion
        if not counted and not longer.plausible:
            reason = "another would only split a mode with nonlinear decay"
            break
        if not counted and gain <= 0:
            reason = f"another would raise the Bayesian information criterion by {-gain:.2g}"
            break
        fit = longer
        if not judge(fit):
            reason = "the search was ended"
            break
    modes = fit.modes() if fit.poles.size else ()
    return fit, tuple(mode for mode in modes if low <= mode.frequency <= high), reason
