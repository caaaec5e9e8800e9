"""Search for poles by maximum likelihood: modes are added one by one, and their number is judged by a criterion.

All but the poles is linear and is eliminated by variable projection (G. H. Golub, V. Pereyra, SIAM J. Numer. Anal.
10:413, 1973; Jacobian of L. Kaufman, BIT 15:49, 1975). The criterion is the Bayesian one (G. Schwarz, Ann. Stat. 6:461,
1978). What is fitted, and how its noise is estimated, is a subclass's.
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
"""Trial steps of a search at most; from every start; and of those that are left after it."""
KEPT = 2
"""Starts that are left."""
DECAYS = 8
"""Decay rates of the search for a further mode, in equal ratios."""
ROUNDING = 1e-7
"""Least noise, over the size of a channel: less is rounding of the numbers."""
MANY = "as many as are sought: what is there may be no sum of modes"


@dataclass(frozen=True, eq=False)
class PoleFit(ABC):
    """Modes of ``poles`` (m,), complex, in 1/s, beside ``values`` (blocks, outputs, n), with factors of least squares.

    All blocks and outputs have the poles in common, and factors of their own. ``level`` (outputs,): variance of the
    whitened errors. ``resolution``: least distance (rad/s) between the two modes that one is split into.
    """

    poles: np.ndarray
    level: np.ndarray
    values: np.ndarray
    resolution: float

    @property
    @abstractmethod
    def basis(self) -> np.ndarray:
        """Functions (blocks, k, n): of unit real parts of the modes' factors, of imaginary parts, and others."""

    @property
    @abstractmethod
    def slopes(self) -> np.ndarray:
        """Derivatives (blocks, outputs, size, n) by real parts of :attr:`nonlinear`, then by imaginary parts."""

    @abstractmethod
    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (blocks, outputs or 1, k, n) with errors that are white, real: (blocks, outputs or 1, n', k)."""

    @abstractmethod
    def moved(self, nonlinear: np.ndarray) -> Self:
        """Return the fit with other values of what is not linear, within their limits."""

    @abstractmethod
    def with_noise(self) -> Self:
        """Return the fit with noise as its residuals have it."""

    @abstractmethod
    def starts(self) -> Sequence[Self]:
        """Return fits with one more mode, from which to search for the best."""

    @abstractmethod
    def part(self, mode: int) -> np.ndarray:
        """Return what a mode adds to the data."""

    @property
    @abstractmethod
    def criterion(self) -> float:
        """The Bayesian information criterion with the best noise of these residuals."""

    @property
    @abstractmethod
    def has_room(self) -> bool:
        """Return whether there are enough data for one more mode."""

    @property
    def nonlinear(self) -> np.ndarray:
        """Complex unknowns that are not linear, the poles first."""
        return self.poles

    @property
    def functions_count(self) -> int:
        """Number of complex factors in a block and output, those of the modes first."""
        return self.poles.size

    @property
    def plausible(self) -> bool:
        """Return whether the poles can be those of modes."""
        return True

    @property
    def rank(self) -> tuple[bool, float]:
        """Return the quantity that is least for the best of some fits."""
        return not self.plausible, self.criterion

    def factor_errors(self) -> np.ndarray:
        """Return variances (blocks, m) of the relative error of all of a block's factors together."""
        return np.zeros((len(self.values), self.poles.size))

    def gradient_covariance(self, slopes: np.ndarray) -> np.ndarray:
        """Return the covariance of the products of whitened errors with derivatives (blocks, outputs, n', size)."""
        flat = slopes.reshape(-1, slopes.shape[-1])
        return np.asarray(flat.T @ flat)

    @cached_property
    def projection(self) -> tuple[np.ndarray, np.ndarray]:
        """Orthonormal columns and triangle of the whitened basis."""
        q, r = np.linalg.qr(self.whitened(self.basis[:, None]))
        return q, r

    @cached_property
    def factors(self) -> np.ndarray:
        """Factors of the basis, (blocks, outputs, k)."""
        q, r = self.projection
        data = np.swapaxes(q, -1, -2) @ self.whitened(self.values[:, :, None])
        return np.asarray((np.linalg.pinv(r) @ data)[..., 0])

    @property
    def residues(self) -> np.ndarray:
        """Complex factors (blocks, outputs, functions)."""
        size = self.functions_count
        return np.asarray(self.factors[..., :size] + 1j * self.factors[..., size : 2 * size])

    @cached_property
    def residuals(self) -> np.ndarray:
        """Shape (blocks, outputs, n)."""
        return np.asarray(self.values - self.factors @ self.basis)

    @property
    def projected(self) -> tuple[np.ndarray, np.ndarray]:
        """Whitened derivatives along the basis, and what it leaves of them over the noise's standard deviation."""
        q, slopes = self.projection[0], self.whitened(self.slopes)
        along = np.swapaxes(q, -1, -2) @ slopes
        return along, (slopes - q @ along) / np.sqrt(self.level)[:, None, None]

    def refined(self, iterations: int = ITERATIONS) -> Self:
        """Return the fit of all poles, searched for from these, with the noise as it is."""
        size = self.nonlinear.size

        def evaluate(_: np.ndarray, unknowns: np.ndarray) -> Linearisation:
            fit = self.moved(unknowns[0, :size] + 1j * unknowns[0, size:])
            left = fit.whitened(fit.residuals[:, :, None]) / np.sqrt(self.level)[:, None, None]
            x = np.concatenate([fit.nonlinear.real, fit.nonlinear.imag])[None]
            return Linearisation.of(x, left.reshape(1, -1), -fit.projected[1].reshape(1, -1, 2 * size))

        if not size:
            return self
        start = evaluate(np.zeros(1), np.concatenate([self.nonlinear.real, self.nonlinear.imag])[None])
        x = minimise(evaluate, start, iterations).at.unknowns[0]
        return self.moved(x[:size] + 1j * x[size:])

    def settled(self) -> Self:
        """Return the fit with noise and poles to each other's liking."""
        fit = self.refined()
        for _ in range(2):
            fit = fit.with_noise().refined()
        return fit

    def longer(self) -> Self:
        """Return the best fit with one more mode.

        Two poles may pass close by each other on their way: of the starts that rank behind, the one of least criterion
        is tried, too.
        """
        screened = sorted((start.refined(SCREENING) for start in self.starts()), key=lambda fit: fit.rank)
        behind = sorted(screened[KEPT:], key=lambda fit: fit.rank[1])
        return min((fit.refined(TRIAL) for fit in [*screened[:KEPT], *behind[:1]]), key=lambda fit: fit.rank).settled()

    def splits(self) -> list[Self]:
        """Return fits with each mode split in two, as a line between two close ones leaves no line beside it."""
        fits = []
        for i, pole in enumerate(self.poles):
            apart = 1j * max(-pole.real, self.resolution)
            poles = np.append(self.poles, pole + apart)
            poles[i] = pole - apart
            fits.append(replace(self, poles=poles))
        return fits

    def modes(self) -> tuple[Mode, ...]:
        """Return the modes in order of frequency, with standard errors from the Fisher information.

        A factor is a mean over the blocks with the weights of least variance.
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
    """Add modes one by one, while the criterion falls or until there are as many as are asked for.

    Args:
        fit: from which to begin.
        problem: states the band, and the number of modes where it is known.
        judge: decides whether to go on from a fit that is better.

    Returns:
        the last fit, its modes in the band, and why there is none with more
    """
    asked, (low, high) = problem.count is not None, problem.band or (0.0, np.inf)
    while True:
        rates = np.abs(fit.poles) / (2 * np.pi)
        if np.count_nonzero((low <= rates) & (rates <= high)) == problem.count:
            why = "as asked"
            break
        if fit.poles.size == MOST_MODES or not fit.has_room:
            why = MANY if fit.has_room else "the data are too few for one more"
            break
        longer = fit.longer()
        gain = fit.criterion - longer.criterion
        if not asked and not longer.plausible:
            why = "a further one would only split one that does not decay as a mode"
            break
        if not asked and gain <= 0:
            why = f"a further one would raise the Bayesian information criterion by {-gain:.2g}"
            break
        fit = longer
        if not judge(fit):
            why = "the search was ended"
            break
    modes = fit.modes() if fit.poles.size else ()
    return fit, tuple(mode for mode in modes if low <= mode.frequency <= high), why
