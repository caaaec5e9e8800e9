"""Where the samplers begin, and what an ensemble proposes: Student t distributions on the modes of the posterior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import gammaln, logsumexp

from bench import NoEstimate
from methods.sampling.posterior import NOISE_LEAST, NOISE_SD, Posterior
from methods.starts.open_parameters import PRIORLESS_SD

MODE_MARGIN = 25.0
"""A mode joins the proposal while minus twice its log-posterior is within this of the best."""

ABOVE_LEAST = 1.2
"""A proposal is centred on noise at least so many times the least one, or much of it would lie outside."""
NARROW, NARROWEST = 1e-8, 1e-15
"""The least eigenvalue of a correlation that is factored as it stands; and what double precision resolves."""


@dataclass(frozen=True)
class Proposal:
    """A mixture of multivariate Student t: weights (m,), centres (m, d), roots (m, d, d) of the scale matrices."""

    weights: np.ndarray
    centres: np.ndarray
    roots: np.ndarray
    dof: float = 6.0

    @staticmethod
    def around(posterior: Posterior, modes: Sequence[tuple[float, np.ndarray]]) -> Proposal:
        """Laplace approximations at the modes that could be true, a little widened.

        Args:
            posterior: Its model gives response, slopes and noise at each mode.
            modes: Minus twice the log-posterior and theta of each, best first.

        Raises:
            NoEstimate: None of the approximations is proper.
        """
        model, errors, found = posterior.model, posterior.errors, []
        n_channels = len(model.channels)
        for theta in [theta for value, theta in modes if value < modes[0][0] + MODE_MARGIN]:
            predicted, slopes = model.jacobian(theta)
            left = max(model.data.size - theta.size, 1)
            scales = errors.scales(model, model.data - predicted, float(theta.size))
            sigma = np.maximum(scales, ABOVE_LEAST * NOISE_LEAST * model.rms)
            covariance = model.covariance(slopes, sigma / np.sqrt(errors.location), PRIORLESS_SD)
            if covariance is None:
                continue
            whole = np.zeros((posterior.size, posterior.size))
            whole[: theta.size, : theta.size] = covariance
            share = np.maximum(model.counts * left / model.data.size, 0.5)
            whole[theta.size :, theta.size :] = np.diag(1.0 / (errors.scale * share + NOISE_SD**-2)).reshape(
                n_channels, -1
            )
            scale = np.sqrt(np.diag(whole))
            root = scale[:, None] * _root(whole / np.outer(scale, scale))
            centre = np.concatenate([theta, np.log(sigma)])
            mass = float(posterior(centre[None])[0] + np.sum(np.log(np.diag(root))))
            if np.isfinite(mass):
                found.append((mass, centre, 1.1 * root))
        if not found:
            raise NoEstimate("the data leave a parameter open; give more samples, a known force or a prior")
        masses = np.array([mass for mass, _, _ in found])
        # the Laplace approximation of a mode's weight is rough: none is left without visits
        weights = 0.9 * np.exp(masses - logsumexp(masses)) + 0.1 / len(found)
        return Proposal(weights, np.stack([c for _, c, _ in found]), np.stack([r for _, _, r in found]))

    def draw(self, n: int, random: Any, spread: float = 1.0) -> np.ndarray:
        """``n`` draws, shape (n, d), ``spread`` times as wide."""
        which = random.choice(len(self.weights), size=n, p=self.weights / self.weights.sum())
        z = random.standard_normal((n, self.centres.shape[1]))
        z *= np.sqrt(self.dof / random.chisquare(self.dof, size=n))[:, None]
        return np.asarray(self.centres[which] + spread * np.einsum("nij,nj->ni", self.roots[which], z))

    @cached_property
    def inverse_roots(self) -> np.ndarray:
        return np.linalg.inv(self.roots)

    def log_density(self, phi: np.ndarray) -> np.ndarray:
        """Log-density, shape (n,), of phi (n, d)."""
        d = phi.shape[1]
        z = np.einsum("mij,nmj->nmi", self.inverse_roots, phi[:, None] - self.centres)
        log_det = np.sum(np.log(np.diagonal(self.roots, axis1=1, axis2=2)), axis=1)
        tails = -0.5 * (self.dof + d) * np.log1p(np.sum(z**2, axis=2) / self.dof)
        constant = gammaln(0.5 * (self.dof + d)) - gammaln(0.5 * self.dof) - 0.5 * d * np.log(self.dof * np.pi)
        parts = tails - log_det + np.log(self.weights)
        largest = parts.max(axis=1)
        return np.asarray(largest + np.log(np.sum(np.exp(parts - largest[:, None]), axis=1)) + constant)


def _root(correlation: np.ndarray) -> np.ndarray:
    """A lower triangular root of a correlation (d, d), also where it is so narrow that rounding made it singular."""
    values, axes = np.linalg.eigh(correlation)
    if values[0] > NARROW:
        return np.asarray(np.linalg.cholesky(correlation + 1e-10 * np.eye(len(values))))
    upper = np.linalg.qr((axes * np.sqrt(np.maximum(values, NARROWEST))).T, mode="r")
    return np.asarray((upper * np.sign(np.diag(upper))[:, None]).T)
