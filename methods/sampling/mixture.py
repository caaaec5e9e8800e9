"""Mixtures of normals or multivariate Student t: what a posterior looks like before it is sampled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import gammaln

from bench import NoEstimate
from methods.sampling.posterior import NOISE_LEAST, NOISE_SD, Posterior
from methods.starts.wide_prior import PRIORLESS_SD

MODE_MARGIN = 25.0
"""A mode joins the proposal while minus twice its log-posterior is within this of the best."""
PROPOSAL_DOF = 6.0
ABOVE_LEAST = 1.2
"""A proposal is centred on noise at least so many times the least one, or much of it would lie outside."""
NARROW, NARROWEST = 1e-8, 1e-15
"""The least eigenvalue of a correlation that is factored as it stands; and what double precision resolves."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """``log_weights`` (m,), ``centres`` (m, d), ``roots`` (m, d, d), lower triangular, of the scale matrices."""

    log_weights: np.ndarray
    centres: np.ndarray
    roots: np.ndarray
    dof: float = np.inf
    """Infinite: normals."""

    @cached_property
    def _inverse_roots(self) -> np.ndarray:
        return np.linalg.inv(self.roots)

    @property
    def weights(self) -> np.ndarray:
        return np.exp(self.log_weights - np.logaddexp.reduce(self.log_weights))

    def draw(self, n: int, random: Any, spread: float = 1.0) -> np.ndarray:
        """``n`` draws, shape (n, d), ``spread`` times as wide."""
        which = random.choice(len(self.log_weights), size=n, p=self.weights)
        z = random.standard_normal((n, self.centres.shape[1]))
        if np.isfinite(self.dof):
            z *= np.sqrt(self.dof / random.chisquare(self.dof, size=n))[:, None]
        return np.asarray(self.centres[which] + spread * np.einsum("nij,nj->ni", self.roots[which], z))

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log-density, shape (n,), of points (n, d)."""
        d, v = x.shape[1], self.dof
        squares = np.sum(np.einsum("mij,nmj->nmi", self._inverse_roots, x[:, None] - self.centres) ** 2, axis=2)
        if np.isfinite(v):
            logs = -0.5 * (v + d) * np.log1p(squares / v)
            logs += gammaln(0.5 * (v + d)) - gammaln(0.5 * v) - 0.5 * d * np.log(v * np.pi)
        else:
            logs = -0.5 * squares - 0.5 * d * np.log(2 * np.pi)
        log_det = np.sum(np.log(np.diagonal(self.roots, axis1=1, axis2=2)), axis=1)
        return np.asarray(np.logaddexp.reduce(logs - log_det + self.log_weights, axis=1))

    def times(self, mean: np.ndarray, covariance: np.ndarray) -> Mixture:
        """A mixture of normals times a normal density, normalised (Papamakarios and Murray, 2016, appendix)."""
        covariances = self.roots @ self.roots.swapaxes(1, 2)
        both, away = covariances + covariance, mean - self.centres
        moved = np.linalg.solve(both, away[..., None])[..., 0]
        logs = self.log_weights - 0.5 * (np.sum(away * moved, axis=-1) + np.linalg.slogdet(both)[1])
        shrunk = covariances - covariances @ np.linalg.solve(both, covariances)
        roots = np.linalg.cholesky(0.5 * (shrunk + shrunk.swapaxes(1, 2)))
        centres = self.centres + np.einsum("kij,kj->ki", covariances, moved)
        return Mixture(logs - np.logaddexp.reduce(logs), centres, roots)


def laplace(posterior: Posterior, modes: Sequence[tuple[float, np.ndarray]]) -> Mixture:
    """Return Student t distributions on the modes that could be true, a little wider than Laplace approximations.

    Args:
        posterior: Its model gives response, slopes and noise at each mode.
        modes: Minus twice the log-posterior and theta of each, best first.

    Raises:
        NoEstimate: None of the approximations is proper.
    """
    model, errors = posterior.model, posterior.errors
    masses, centres, roots = list[float](), list[np.ndarray](), list[np.ndarray]()
    for theta in [theta for value, theta in modes if value < modes[0][0] + MODE_MARGIN]:
        predicted, slopes = model.jacobian(theta)
        scales = errors.scales(model, model.data - predicted, float(theta.size))
        sigma = np.maximum(scales, ABOVE_LEAST * NOISE_LEAST * model.rms)
        covariance = model.covariance(slopes, sigma / np.sqrt(errors.location), PRIORLESS_SD)
        if covariance is None:
            continue
        left = np.maximum(model.counts * max(model.data.size - theta.size, 1) / model.data.size, 0.5)
        whole = np.diag(np.concatenate([np.zeros(theta.size), 1.0 / (errors.scale * left + NOISE_SD**-2)]))
        whole[: theta.size, : theta.size] = covariance
        scale = np.sqrt(np.diag(whole))
        root = scale[:, None] * _root(whole / np.outer(scale, scale))
        centre = np.concatenate([theta, np.log(sigma)])
        mass = float(posterior(centre[None])[0] + np.sum(np.log(np.diag(root))))
        if np.isfinite(mass):
            masses.append(mass)
            centres.append(centre)
            roots.append(1.1 * root)
    if not masses:
        raise NoEstimate("the data leave a parameter open; give more samples, a known force or a prior")
    # the Laplace approximation of a mode's weight is rough: none is left without visits
    weights = 0.9 * np.exp(masses - np.logaddexp.reduce(masses)) + 0.1 / len(masses)
    return Mixture(np.log(weights), np.stack(centres), np.stack(roots), PROPOSAL_DOF)


def _root(correlation: np.ndarray) -> np.ndarray:
    """A lower triangular root of a correlation (d, d), also where it is so narrow that rounding made it singular."""
    values, axes = np.linalg.eigh(correlation)
    if values[0] > NARROW:
        return np.asarray(np.linalg.cholesky(correlation + 1e-10 * np.eye(len(values))))
    upper = np.linalg.qr((axes * np.sqrt(np.maximum(values, NARROWEST))).T, mode="r")
    return np.asarray((upper * np.sign(np.diag(upper))[:, None]).T)
