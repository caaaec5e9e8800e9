"""Mixtures of normal or multivariate Student t distributions, as approximations of a posterior."""

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
"""Modes whose minus twice log-posterior is within this of the best belong to the proposal."""
PROPOSAL_DOF = 6.0
ABOVE_LEAST = 1.2
"""Least noise at the centre of a proposal over the lower limit, so that most of it lies above the limit."""
NARROW, NARROWEST = 1e-8, 1e-15
"""Least eigenvalue of a correlation factored without regularisation, and the resolution of double precision."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """A mixture with ``log_weights`` (m,), ``centres`` (m, d) and Cholesky factors ``roots`` (m, d, d)."""

    log_weights: np.ndarray
    centres: np.ndarray
    roots: np.ndarray
    dof: float = np.inf
    """Degrees of freedom; infinite for normal distributions."""

    @cached_property
    def _inverse_roots(self) -> np.ndarray:
        return np.linalg.inv(self.roots)

    @property
    def weights(self) -> np.ndarray:
        return np.exp(self.log_weights - np.logaddexp.reduce(self.log_weights))

    def draw(self, n: int, random: Any, spread: float = 1.0) -> np.ndarray:
        """Draw (n, d), with scales multiplied by ``spread``."""
        which = random.choice(len(self.log_weights), size=n, p=self.weights)
        z = random.standard_normal((n, self.centres.shape[1]))
        if np.isfinite(self.dof):
            z *= np.sqrt(self.dof / random.chisquare(self.dof, size=n))[:, None]
        return np.asarray(self.centres[which] + spread * np.einsum("nij,nj->ni", self.roots[which], z))

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Return the log-density (n,) at points (n, d)."""
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
        """Multiply a mixture of normals by a normal density and normalise (Papamakarios and Murray, 2016, appendix)."""
        covariances = self.roots @ self.roots.swapaxes(1, 2)
        both, away = covariances + covariance, mean - self.centres
        moved = np.linalg.solve(both, away[..., None])[..., 0]
        logs = self.log_weights - 0.5 * (np.sum(away * moved, axis=-1) + np.linalg.slogdet(both)[1])
        shrunk = covariances - covariances @ np.linalg.solve(both, covariances)
        roots = np.linalg.cholesky(0.5 * (shrunk + shrunk.swapaxes(1, 2)))
        centres = self.centres + np.einsum("kij,kj->ki", covariances, moved)
        return Mixture(logs - np.logaddexp.reduce(logs), centres, roots)


def laplace(posterior: Posterior, modes: Sequence[tuple[float, np.ndarray]]) -> Mixture:
    """Return Student t distributions at the plausible modes, slightly wider than Laplace approximations.

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
        raise NoEstimate("the data do not determine a parameter; more samples, a known force or a prior are required")
    # since Laplace weights are approximate, every mode gets a least weight
    weights = 0.9 * np.exp(masses - np.logaddexp.reduce(masses)) + 0.1 / len(masses)
    return Mixture(np.log(weights), np.stack(centres), np.stack(roots), PROPOSAL_DOF)


def _root(correlation: np.ndarray) -> np.ndarray:
    """Return a lower triangular root of a correlation (d, d), also of a numerically singular one."""
    values, axes = np.linalg.eigh(correlation)
    if values[0] > NARROW:
        return np.asarray(np.linalg.cholesky(correlation + 1e-10 * np.eye(len(values))))
    upper = np.linalg.qr((axes * np.sqrt(np.maximum(values, NARROWEST))).T, mode="r")
    return np.asarray((upper * np.sign(np.diag(upper))[:, None]).T)
