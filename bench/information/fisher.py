"""The Cramér-Rao bound of a scenario: the best that data and prior allow, by quantity and for the displacement.

The bound is the inverse of (Fisher information of the data at the truth + precision of the prior), in the
log-parameters (and the initial state, where it is not told). With Gaussian noise of unknown level the cross terms
between level and parameters vanish (the expectation of the residual is zero), so estimating the level costs nothing.

Sensitivities are exact for a linear system (:mod:`bench.information.linear_sensitivities`); jax differentiates fine
Runge-Kutta steps for others (:mod:`bench.information.stepped_sensitivities`), in a process of its own
(:mod:`bench.store.bounds` keeps them).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import qr, solve_triangular

from bench.information.linear_sensitivities import linear_sensitivities
from bench.information.stepped_sensitivities import stepped_sensitivities
from bench.scenario.scenario import Scenario
from bench.systems import Quantity

RANK_TOLERANCE = 1e-9
"""Eigenvalues of the Fisher information below this part of the largest count as zero."""


@dataclass(frozen=True)
class Bound:
    """What no unbiased estimate can beat, as root mean squares.

    ``relative_sd`` by quantity: the standard deviation of its logarithm, hence of its relative error to first order
    (inf where neither data nor prior tell it). ``identifiable`` by quantity: whether the data alone tell it.
    ``prior_share`` by quantity: the part of its variance that comes from the prior's error rather than the noise's.
    ``rmse`` and ``rmse_forecast``: root mean square displacement error (m) of the DOFs with a sensor, over the record
    and over what follows it.
    ``null_space``: directions of the log-parameters, rows over ``names``, that the data cannot tell.
    """

    names: tuple[str, ...]
    relative_sd: dict[str, float]
    identifiable: dict[str, bool]
    prior_share: dict[str, float]
    rmse: float
    rmse_forecast: float
    null_space: tuple[tuple[float, ...], ...]


def sensitivities(scenario: Scenario, seed: int, times: np.ndarray, record: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Displacement, shape (n_dof, n_times), and its derivatives (n_dof, n_times, n_parameters + 2 n_dof).

    Derivatives by the log-parameters, then by initial displacement and velocity of each DOF, at the truth.
    """
    system = scenario.rigs()[record]
    differentiate = linear_sensitivities if system.linear else stepped_sensitivities
    return differentiate(system, scenario.parameters, scenario.start, times, scenario.forces(seed))


@dataclass(frozen=True, eq=False)
class Information:
    """What data and prior tell to first order: Fisher information ``data`` and diagonal ``precision`` of the prior.

    Over the log-parameters ``names``, then the initial displacements and velocities where they are not told.
    """

    names: tuple[str, ...]
    data: np.ndarray
    precision: np.ndarray

    @cached_property
    def _inverse(self) -> Inverse:
        return invert(self.data, self.precision)

    @property
    def factor(self) -> np.ndarray:
        """A root of the bound on the covariance, which is ``factor @ factor.T``; see ``covariance``."""
        return self._inverse.factor

    @property
    def covariance(self) -> np.ndarray:
        """The bound on the covariance; on the informed directions only, where some are not."""
        return self.factor @ self.factor.T

    @cached_property
    def null_space(self) -> np.ndarray:
        """Directions of the log-parameters that the data cannot tell, orthonormal rows over ``names``."""
        return _null_space(self.data, len(self.names))

    @cached_property
    def _untold(self) -> np.ndarray:
        return _orthonormal(self._inverse.untold[:, : len(self.names)])

    def _exponents(self, quantity: Quantity) -> np.ndarray:
        w = np.zeros(len(self.precision))
        w[: len(self.names)] = quantity.vector(self.names)
        return w

    def identifiable(self, quantity: Quantity) -> bool:
        """Whether the data alone tell a quantity."""
        return _orthogonal(self.null_space, quantity.vector(self.names))

    def variance(self, quantity: Quantity) -> float:
        """The bound on the variance of the quantity's logarithm; inf where neither data nor prior tell it."""
        if not _orthogonal(self._untold, quantity.vector(self.names)):
            return float("inf")
        return float(np.sum((self._exponents(quantity) @ self.factor) ** 2))

    def prior_share(self, quantity: Quantity) -> float:
        """The part of that variance that comes from the prior's error; 0 where nothing tells the quantity."""
        factor, variance = self.factor, self.variance(quantity)
        from_prior = np.sqrt(self.precision) * (factor @ (self._exponents(quantity) @ factor))
        return float(np.sum(from_prior**2) / variance) if 0 < variance < np.inf else 0.0

    def condition(self, with_prior: bool) -> tuple[float, int]:
        """Condition number of the information scaled to a unit diagonal, and how many directions it leaves out.

        Those left out are uninformed: their eigenvalue is zero to within rounding.
        """
        values = np.linalg.eigvalsh(_scaled(self.data + with_prior * np.diag(self.precision))[0])
        informed = values[values >= RANK_TOLERANCE * values[-1]]
        return float(informed[-1] / informed[0]), len(values) - len(informed)


def _orthogonal(directions: np.ndarray, exponents: Sequence[float]) -> bool:
    return not directions.size or float(np.max(np.abs(directions @ np.asarray(exponents)))) < 1e-5


def information(scenario: Scenario, seed: int = 0, measured: Sequence[int] | None = None) -> Information:
    """The information in displacements of the ``measured`` DOFs (by default those of the scenario), undisturbed."""
    scenario = scenario.undisturbed
    _, gradient = sensitivities(scenario, seed, scenario.times)
    return _information(scenario, seed, gradient, measured)


def _information(
    scenario: Scenario, seed: int, gradient: np.ndarray, measured: Sequence[int] | None = None
) -> Information:
    """From the sensitivities at the samples of the first record, shape (n_dof, n_samples, n_parameters + 2 n_dof).

    Records add up; a start that is not told is each record's own.
    """
    system = scenario.make_system()
    own = 0 if scenario.initial_state == "known" else 2 * system.n_dof
    n, records = len(system.names), len(scenario.rigs())
    dofs = list(scenario.measured_dofs if measured is None else measured)
    data, precision = np.zeros((n + own * records, n + own * records)), np.zeros(n + own * records)
    for record in range(records):
        if record:
            _, gradient = sensitivities(scenario, seed, scenario.times, record)
        scaled = (gradient[..., : n + own] / scenario.sigmas(seed, record)[:, None, None])[dofs]
        at = np.r_[:n, n + own * record : n + own * (record + 1)]
        data[np.ix_(at, at)] += np.einsum("dti,dtj->ij", scaled, scaled)
    if scenario.prior is not None:
        kinds = [scenario.prior.sd_by_kind[p.kind] for p in system.parameters]
        precision[:n] = 1.0 / np.array(kinds) ** 2
    return Information(system.names, data, precision)


def compute_bound(scenario: Scenario, seed: int = 0) -> Bound:
    """The bound of a scenario without its disturbance; ``seed`` matters only where it draws a force.

    Where every replicate has a truth of its own there is no one bound: errors are then compared with infinity.
    """
    scenario = scenario.undisturbed
    system = scenario.make_system()
    times = np.unique(np.concatenate([scenario.times, scenario.dense_times, scenario.forecast_times]))
    _, gradient = sensitivities(scenario, seed, times)
    told = _information(scenario, seed, gradient[:, np.searchsorted(times, scenario.times)])

    def rms(at: np.ndarray) -> float:
        g = gradient[list(scenario.measured_dofs)][:, np.searchsorted(times, at), : len(told.precision)]
        own = told.factor[: g.shape[2]]  # the first record's, which is scored
        return float(np.sqrt(np.mean(np.sum((g @ own) ** 2, axis=-1))))

    none = np.inf if scenario.truth_drawn else 1.0
    return Bound(
        names=system.names,
        relative_sd={q.name: none * float(np.sqrt(told.variance(q))) for q in system.quantities},
        identifiable={q.name: told.identifiable(q) for q in system.quantities},
        prior_share={q.name: told.prior_share(q) for q in system.quantities},
        rmse=none * rms(scenario.dense_times),
        rmse_forecast=none * rms(scenario.forecast_times),
        null_space=tuple(tuple(map(float, row)) for row in told.null_space),
    )


def _scaled(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The information with a unit diagonal, and the scale it was divided by on both sides."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)
    return information / np.outer(scale, scale), scale


@dataclass(frozen=True, eq=False)
class Inverse:
    """``factor @ factor.T`` is the inverse on the informed directions; ``untold``: rows, those nothing tells."""

    factor: np.ndarray
    untold: np.ndarray


def invert(data: np.ndarray, precision: np.ndarray) -> Inverse:
    """Invert ``data + diag(precision)``, however much more the one tells of some directions than the other.

    The sum is never formed: a prior that is weaker than the rounding of what the data tell elsewhere still counts where
    the data tell nothing, and likewise. Roots of both stand above each other, and are triangularised by reflections
    with the largest rows first and pivoted columns, which is stable row by row (N. J. Higham, Accuracy and Stability of
    Numerical Algorithms, 2nd ed. 2002, section 19.4).
    """
    scaled, scale = _scaled(data)
    values, vectors = np.linalg.eigh(scaled)
    told = values >= RANK_TOLERANCE * max(float(values[-1]), 1e-300)
    prior = np.diag(np.sqrt(precision) / scale)
    open_ = vectors[:, ~told]
    if open_.size:
        _, sizes, sides = np.linalg.svd(prior @ open_)
        open_ = open_ @ sides[sizes <= RANK_TOLERANCE * float(np.max(prior))].T
    kept = np.linalg.qr(np.concatenate([open_, np.eye(len(data))], axis=1))[0][:, open_.shape[1] :]
    rows = np.concatenate([np.sqrt(values[told])[:, None] * vectors[:, told].T, prior]) @ kept
    return Inverse(kept @ inverse_root(rows) / scale[:, None], open_.T / scale)


def inverse_root(rows: np.ndarray) -> np.ndarray:
    """``F`` with ``F F'`` the inverse of ``rows' rows``, for independent columns, however unlike the rows' sizes."""
    rows = rows[np.argsort(-np.max(np.abs(rows), axis=1))]
    triangle, order = qr(rows, mode="r", pivoting=True)
    n = rows.shape[1]
    return np.eye(n)[:, order] @ solve_triangular(triangle[:n], np.eye(n))


def _null_space(information: np.ndarray, n_parameters: int) -> np.ndarray:
    """Uninformed directions of the log-parameters, initial states profiled out; orthonormal rows, maybe none."""
    own, nuisance = information[:n_parameters, :n_parameters], information[n_parameters:, n_parameters:]
    if nuisance.size:
        cross = information[:n_parameters, n_parameters:]
        own = own - (across := cross @ invert(nuisance, np.zeros(len(nuisance))).factor) @ across.T
    scaled, scale = _scaled(own)
    values, vectors = np.linalg.eigh(scaled)
    return _orthonormal((vectors[:, values < RANK_TOLERANCE * max(values[-1], 1e-300)] / scale[:, None]).T)


def _orthonormal(rows: np.ndarray) -> np.ndarray:
    return np.linalg.qr(rows.T)[0].T if rows.size else rows
