"""Cramér-Rao bound of a scenario, for quantities and for the displacement.

The bound is the inverse of the sum of the Fisher information of the data at the true values and the precision of the
prior, over the log-parameters and, if it is unknown, the initial state. With Gaussian noise of unknown level the cross
terms between level and parameters vanish, so an unknown level does not change the bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import qr, solve_triangular

from bench.information.sensitivities import linear_sensitivities, stepped_sensitivities
from bench.scenario.scenario import DISTURBANCE, Scenario
from bench.systems import Quantity

RANK_TOLERANCE = 1e-9
"""Eigenvalues of the Fisher information count as zero below this fraction of the largest."""
ORTHOGONAL = 1e-5
"""Largest product of a unit direction and the exponents of a quantity that counts as zero."""


@dataclass(frozen=True)
class Bound:
    """Smallest root mean square errors of unbiased estimators.

    Attributes:
        names: Names of the parameters.
        relative_sd: Standard deviation of the logarithm of each quantity, which is its relative error to first order;
            inf if neither data nor prior determine it.
        identifiable: True for each quantity that the data alone determine.
        prior_share: Fraction of the variance of each quantity that is due to the prior.
        rmse: Root mean square displacement error (m) of DOFs with a sensor, over the record.
        rmse_forecast: The same over the forecast after the record.
        null_space: Directions of the log-parameters, rows over ``names``, that the data do not determine.
    """

    names: tuple[str, ...]
    relative_sd: dict[str, float]
    identifiable: dict[str, bool]
    prior_share: dict[str, float]
    rmse: float
    rmse_forecast: float
    null_space: tuple[tuple[float, ...], ...]


def sensitivities(scenario: Scenario, seed: int, times: np.ndarray, record: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Compute the displacement (n_dof, n_times) and its derivatives (n_dof, n_times, n_parameters + 2 n_dof).

    Derivatives by the log-parameters, then by initial displacement and velocity of each DOF, at the truth.
    """
    system = scenario.rigs()[record]
    differentiate = linear_sensitivities if system.linear else stepped_sensitivities
    return differentiate(system, scenario.parameters, scenario.start, times, scenario.forces(seed))


@dataclass(frozen=True, eq=False)
class Information:
    """Fisher information of the ``data`` and diagonal ``precision`` of the prior, to first order.

    Over the log-parameters ``names``, then the initial displacements and velocities where they are unknown.
    """

    names: tuple[str, ...]
    data: np.ndarray
    precision: np.ndarray

    @cached_property
    def _inverse(self) -> Inverse:
        return invert(self.data, self.precision)

    @property
    def factor(self) -> np.ndarray:
        """Factor of the bound on the covariance, ``covariance = factor @ factor.T``."""
        return self._inverse.factor

    @property
    def covariance(self) -> np.ndarray:
        """Bound on the covariance, restricted to the identifiable directions."""
        return self.factor @ self.factor.T

    @cached_property
    def null_space(self) -> np.ndarray:
        """Directions of the log-parameters that the data do not determine, orthonormal rows over ``names``."""
        k = len(self.names)
        information, nuisance = self.data[:k, :k], self.data[k:, k:]
        if nuisance.size:
            root = self.data[:k, k:] @ invert(nuisance, np.zeros(len(nuisance))).factor
            information = information - root @ root.T
        scaled, scale = _scaled(information)
        values, vectors = np.linalg.eigh(scaled)
        return _orthonormal((vectors[:, values < RANK_TOLERANCE * max(values[-1], 1e-300)] / scale[:, None]).T)

    def _exponents(self, quantity: Quantity) -> np.ndarray:
        return np.pad(quantity.vector(self.names), (0, len(self.precision) - len(self.names)))

    def identifiable(self, quantity: Quantity) -> bool:
        """Return True if the data alone determine a quantity."""
        return _orthogonal(self.null_space, quantity.vector(self.names))

    def variance(self, quantity: Quantity) -> float:
        """Return the bound on the variance of the logarithm of a quantity; inf if nothing determines it."""
        if not _orthogonal(_orthonormal(self._inverse.open[:, : len(self.names)]), quantity.vector(self.names)):
            return float("inf")
        return float(np.sum((self._exponents(quantity) @ self.factor) ** 2))

    def prior_share(self, quantity: Quantity) -> float:
        """Return the fraction of the variance of a quantity that is due to the prior; 0 if it is infinite."""
        factor, variance = self.factor, self.variance(quantity)
        from_prior = np.sqrt(self.precision) * (factor @ (self._exponents(quantity) @ factor))
        return float(np.sum(from_prior**2) / variance) if 0 < variance < np.inf else 0.0

    def condition(self, with_prior: bool) -> tuple[float, int]:
        """Return the condition number of the information scaled to a unit diagonal, and how many directions it omits.

        Those are uninformed: their eigenvalue is zero to within rounding.
        """
        values = np.linalg.eigvalsh(_scaled(self.data + with_prior * np.diag(self.precision))[0])
        informed = values[values >= RANK_TOLERANCE * values[-1]]
        return float(informed[-1] / informed[0]), len(values) - len(informed)


def _orthogonal(directions: np.ndarray, exponents: Sequence[float]) -> bool:
    return not directions.size or float(np.max(np.abs(directions @ np.asarray(exponents)))) < ORTHOGONAL


def information(scenario: Scenario, seed: int = 0, measured: Sequence[int] | None = None) -> Information:
    """Compute the information in displacements of the ``measured`` DOFs (by default the scenario's), undisturbed."""
    scenario = scenario.undisturbed
    records = range(len(scenario.rigs()))
    gradients = [sensitivities(scenario, seed, scenario.times, record)[1] for record in records]
    return _information(scenario, seed, gradients, measured)


def _information(
    scenario: Scenario, seed: int, gradients: Sequence[np.ndarray], measured: Sequence[int] | None = None
) -> Information:
    """Add up the records, of sensitivities at the samples of each, shape (n_dof, n_samples, n_parameters + 2 n_dof).

    Each record has its own unknown initial state.
    """
    system = scenario.make_system()
    states = 0 if scenario.initial_state == "known" else 2 * system.n_dof
    n, size = len(system.names), len(system.names) + states * len(gradients)
    dofs = list(scenario.measured_dofs if measured is None else measured)
    data, precision = np.zeros((size, size)), np.zeros(size)
    for record, gradient in enumerate(gradients):
        scaled = (gradient[..., : n + states] / scenario.sigmas(seed, record)[:, None, None])[dofs]
        unknowns = np.r_[:n, n + states * record : n + states * (record + 1)]
        data[np.ix_(unknowns, unknowns)] += np.einsum("dti,dtj->ij", scaled, scaled)
    if scenario.prior is not None:
        precision[:n] = [scenario.prior.sd_by_kind[p.kind] ** -2.0 for p in system.parameters]
    return Information(system.names, data, precision)


def compute_bound(scenario: Scenario, seed: int = 0, replicates: int = 1) -> Bound:
    """Compute the bound of a scenario without its disturbance; ``seed`` matters where it draws a force or times.

    Where a disturbance gives every replicate times of its own and states them, the bound is that of these times: over
    the first ``replicates`` the root mean square, as errors are compared. Where every replicate has a truth of its own
    there is no common bound: errors are then compared with infinity.
    """
    drawn = [_stated_times(scenario, seed, i) for i in range(replicates if own_times(scenario, seed) else 1)]
    scenario = scenario.undisturbed
    scored = np.concatenate([scenario.dense_times, scenario.forecast_times])
    grids, gradients = [], []
    for record in range(len(scenario.rigs())):
        grids.append(np.unique(np.concatenate([scored, *(times[record] for times in drawn)])))
        gradients.append(sensitivities(scenario, seed, grids[record], record)[1])

    def sampled(record: int, times: np.ndarray) -> np.ndarray:
        return gradients[record][:, np.searchsorted(grids[record], times)]

    of_replicates = [
        _information(scenario, seed, [sampled(record, of_record) for record, of_record in enumerate(times)])
        for times in drawn
    ]

    def rmse(times: np.ndarray) -> float:
        gradient = sampled(0, times)[list(scenario.measured_dofs)]
        # the unknowns of the first record, which is scored
        roots = [gradient[..., : len(i.precision)] @ i.factor[: gradient.shape[2]] for i in of_replicates]
        return unbounded * float(np.sqrt(np.mean([np.mean(np.sum(root**2, axis=-1)) for root in roots])))

    unbounded, quantities = np.inf if scenario.truth_drawn else 1.0, scenario.make_system().quantities
    variances = {q.name: np.array([i.variance(q) for i in of_replicates]) for q in quantities}
    return Bound(
        names=scenario.make_system().names,
        relative_sd={name: unbounded * float(np.sqrt(np.mean(variance))) for name, variance in variances.items()},
        identifiable={q.name: all(i.identifiable(q) for i in of_replicates) for q in quantities},
        prior_share={q.name: _mean_share(of_replicates, q, variances[q.name]) for q in quantities},
        rmse=rmse(scenario.dense_times),
        rmse_forecast=rmse(scenario.forecast_times),
        null_space=tuple(tuple(map(float, row)) for row in of_replicates[0].null_space),
    )


def own_times(scenario: Scenario, seed: int) -> bool:
    """Return True if every replicate has different, known sample times because of a disturbance."""
    return scenario.disturbance is not None and _stated_times(scenario, seed, 0)[0] is not scenario.times


def _stated_times(scenario: Scenario, seed: int, index: int) -> list[np.ndarray]:
    """Return the sample times of each record of a replicate, as they are stated to a method."""
    if scenario.disturbance is None:
        return [scenario.times] * len(scenario.rigs())
    keys = [(record,) if record else () for record in range(len(scenario.rigs()))]  # as the data's streams have them
    streams = [scenario.stream(DISTURBANCE, seed, index, *key) for key in keys]
    return [scenario.disturbance.sampling(scenario.times, rng)[0] for rng in streams]


def _mean_share(of_replicates: Sequence[Information], quantity: Quantity, variances: np.ndarray) -> float:
    """Return the prior's part of a mean variance."""
    if not np.all(np.isfinite(variances)) or not np.any(variances):
        return 0.0
    shares = np.array([i.prior_share(quantity) for i in of_replicates])
    return float(np.sum(shares * variances) / np.sum(variances))


def _scaled(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the information with a unit diagonal, and the scale it was divided by on both sides."""
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))  # rounding can make an entry negative
    scale = np.where(scale > 0, scale, 1.0)
    return information / np.outer(scale, scale), scale


@dataclass(frozen=True, eq=False)
class Inverse:
    """``factor @ factor.T`` is the inverse on the informed directions; the rows of ``open`` are the others."""

    factor: np.ndarray
    open: np.ndarray


def invert(data: np.ndarray, precision: np.ndarray) -> Inverse:
    """Invert ``data + diag(precision)``, however much larger the one is than the other in some directions.

    The sum is never formed: a prior that is weaker than the rounding of the data's largest entries still counts where
    the data have no information, and likewise. Roots of both stand above each other, and are triangularised by
    reflections with the largest rows first and pivoted columns, which is stable row by row (N. J. Higham, Accuracy and
    Stability of Numerical Algorithms, 2nd ed. 2002, section 19.4).
    """
    scaled, scale = _scaled(data)
    values, vectors = np.linalg.eigh(scaled)
    informed = values >= RANK_TOLERANCE * max(float(values[-1]), 1e-300)
    prior, without = np.diag(np.sqrt(precision) / scale), vectors[:, ~informed]
    if without.size:
        _, sizes, sides = np.linalg.svd(prior @ without)
        without = without @ sides[sizes <= RANK_TOLERANCE * float(np.max(prior))].T
    kept = np.linalg.qr(np.concatenate([without, np.eye(len(data))], axis=1))[0][:, without.shape[1] :]
    rows = np.concatenate([np.sqrt(values[informed])[:, None] * vectors[:, informed].T, prior]) @ kept
    return Inverse(kept @ inverse_root(rows) / scale[:, None], without.T / scale)


def inverse_root(rows: np.ndarray) -> np.ndarray:
    """Return ``F`` with ``F F'`` the inverse of ``rows' rows``, for independent columns and rows of any sizes."""
    rows = rows[np.argsort(-np.max(np.abs(rows), axis=1))]
    triangle, order = qr(rows, mode="r", pivoting=True)
    n = rows.shape[1]
    return np.eye(n)[:, order] @ solve_triangular(triangle[:n], np.eye(n))


def _orthonormal(rows: np.ndarray) -> np.ndarray:
    return np.linalg.qr(rows.T)[0].T if rows.size else rows
