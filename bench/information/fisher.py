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
from bench.scenario.scenario import DISTURBANCE, Scenario
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
    records = range(len(scenario.rigs()))
    gradients = [sensitivities(scenario, seed, scenario.times, record)[1] for record in records]
    return _information(scenario, seed, gradients, measured)


def _information(
    scenario: Scenario, seed: int, gradients: Sequence[np.ndarray], measured: Sequence[int] | None = None
) -> Information:
    """From the sensitivities at the samples of each record, shape (n_dof, n_samples, n_parameters + 2 n_dof).

    Records add up; a start that is not told is each record's own.
    """
    system = scenario.make_system()
    own = 0 if scenario.initial_state == "known" else 2 * system.n_dof
    n, records = len(system.names), len(gradients)
    dofs = list(scenario.measured_dofs if measured is None else measured)
    data, precision = np.zeros((n + own * records, n + own * records)), np.zeros(n + own * records)
    for record, gradient in enumerate(gradients):
        scaled = (gradient[..., : n + own] / scenario.sigmas(seed, record)[:, None, None])[dofs]
        at = np.r_[:n, n + own * record : n + own * (record + 1)]
        data[np.ix_(at, at)] += np.einsum("dti,dtj->ij", scaled, scaled)
    if scenario.prior is not None:
        kinds = [scenario.prior.sd_by_kind[p.kind] for p in system.parameters]
        precision[:n] = 1.0 / np.array(kinds) ** 2
    return Information(system.names, data, precision)


def compute_bound(scenario: Scenario, seed: int = 0, replicates: int = 1) -> Bound:
    """The bound of a scenario without its disturbance; ``seed`` matters only where it draws a force or times.

    Where a disturbance gives every replicate times of its own and states them, the bound is that of these times: over
    the first ``replicates`` the root mean square, as errors are compared. Where every replicate has a truth of its own
    there is no one bound: errors are then compared with infinity.
    """
    drawn = [_told_times(scenario, seed, i) for i in range(replicates if own_times(scenario, seed) else 1)]
    scenario = scenario.undisturbed
    scored = np.concatenate([scenario.dense_times, scenario.forecast_times])
    grids, gradients = [], []
    for record in range(len(scenario.rigs())):
        grids.append(np.unique(np.concatenate([scored, *(times[record] for times in drawn)])))
        gradients.append(sensitivities(scenario, seed, grids[record], record)[1])
    of_record = list(zip(gradients, grids, strict=True))
    found = [
        _information(scenario, seed, [_at(*pair, t) for pair, t in zip(of_record, times, strict=True)])
        for times in drawn
    ]

    def mean_square(at: np.ndarray) -> float:
        g = _at(*of_record[0], at)[list(scenario.measured_dofs)]
        # the first record's unknowns, which is scored
        roots = [(g[..., : len(told.precision)] @ told.factor[: g.shape[2]]) for told in found]
        return float(np.mean([np.mean(np.sum(root**2, axis=-1)) for root in roots]))

    none, system = np.inf if scenario.truth_drawn else 1.0, scenario.make_system()
    variances = {q.name: np.array([told.variance(q) for told in found]) for q in system.quantities}
    return Bound(
        names=system.names,
        relative_sd={name: none * float(np.sqrt(np.mean(variance))) for name, variance in variances.items()},
        identifiable={q.name: all(told.identifiable(q) for told in found) for q in system.quantities},
        prior_share={q.name: _share(found, q, variances[q.name]) for q in system.quantities},
        rmse=none * float(np.sqrt(mean_square(scenario.dense_times))),
        rmse_forecast=none * float(np.sqrt(mean_square(scenario.forecast_times))),
        null_space=tuple(tuple(map(float, row)) for row in found[0].null_space),
    )


def own_times(scenario: Scenario, seed: int) -> bool:
    """Whether a disturbance gives every replicate sample times of its own, and states them."""
    return scenario.disturbance is not None and _told_times(scenario, seed, 0)[0] is not scenario.times


def _told_times(scenario: Scenario, seed: int, index: int) -> list[np.ndarray]:
    """The sample times of each record of a replicate, as they are stated to a method."""
    if scenario.disturbance is None:
        return [scenario.times] * len(scenario.rigs())
    keys = [(record,) if record else () for record in range(len(scenario.rigs()))]  # as the data's streams have them
    streams = [scenario.stream(DISTURBANCE, seed, index, *key) for key in keys]
    return [scenario.disturbance.sampling(scenario.times, rng)[0] for rng in streams]


def _at(gradient: np.ndarray, times: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Of sensitivities at sorted times those at wanted ones, which are among them."""
    return gradient[:, np.searchsorted(times, wanted)]


def _share(found: Sequence[Information], quantity: Quantity, variances: np.ndarray) -> float:
    """The prior's part of a mean variance."""
    if not np.all(np.isfinite(variances)) or not np.any(variances):
        return 0.0
    shares = np.array([told.prior_share(quantity) for told in found])
    return float(np.sum(shares * variances) / np.sum(variances))


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
