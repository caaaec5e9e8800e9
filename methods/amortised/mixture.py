"""A mixture of normals over two logarithms: times a normal prior, and drawn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Mixture:
    """``log_weights`` (K,), ``means`` (K, d), ``covariances`` (K, d, d)."""

    log_weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray

    def times(self, mean: np.ndarray, covariance: np.ndarray) -> Mixture:
        """The mixture times a normal density, normalised: again a mixture (Papamakarios, Murray 2016, appendix)."""
        both = self.covariances + covariance
        away = mean - self.means
        moved = np.linalg.solve(both, away[..., None])[..., 0]
        _, log_det = np.linalg.slogdet(both)
        logs = self.log_weights - 0.5 * (np.sum(away * moved, axis=-1) + log_det)
        means = self.means + np.einsum("kij,kj->ki", self.covariances, moved)
        shrunk = self.covariances - self.covariances @ np.linalg.solve(both, self.covariances)
        return Mixture(logs - np.logaddexp.reduce(logs), means, 0.5 * (shrunk + shrunk.swapaxes(1, 2)))

    def mapped(self, matrix: np.ndarray, shift: np.ndarray) -> Mixture:
        """The mixture of ``matrix x + shift``."""
        return Mixture(self.log_weights, self.means @ matrix.T + shift, matrix @ self.covariances @ matrix.T)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """At points (n, d): (n,)."""
        inverse = np.linalg.inv(np.linalg.cholesky(self.covariances))
        z = np.einsum("kij,nkj->nki", inverse, x[:, None] - self.means)
        log_det = np.sum(np.log(np.diagonal(inverse, axis1=1, axis2=2)), axis=1)
        logs = self.log_weights + log_det - 0.5 * np.sum(z**2, axis=-1) - 0.5 * x.shape[1] * np.log(2 * np.pi)
        return np.asarray(np.logaddexp.reduce(logs, axis=1))

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """``n`` draws, (n, d)."""
        weights = np.exp(self.log_weights)
        which = rng.choice(len(weights), n, p=weights / weights.sum())
        roots = np.linalg.cholesky(self.covariances)
        z = rng.standard_normal((n, self.means.shape[1]))
        return np.asarray(self.means[which] + np.einsum("nij,nj->ni", roots[which], z))
