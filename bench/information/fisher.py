"""The Cramér-Rao bound of a scenario: the best that data and prior allow, by quantity and for the displacement.

The bound is the inverse of (Fisher information of the data at the truth + precision of the prior), in the
log-parameters (and the initial state, where it is not told). With Gaussian noise of unknown level the cross terms
between level and parameters vanish (the expectation of the residual is zero), so estimating the level costs nothing.

Sensitivities are exact for a linear system (:mod:`bench.information.linear_sensitivities`); jax differentiates fine
Runge-Kutta steps for others (:mod:`bench.information.stepped_sensitivities`), in a process of its own. A bound is
computed once and kept.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import sys
import uuid
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bench.errors import InputError
from bench.information.linear_sensitivities import linear_sensitivities
from bench.information.stepped_sensitivities import stepped_sensitivities
from bench.isolation.mainless import without_main
from bench.scenario.scenario import Scenario
from bench.systems import Quantity

UNWRITABLE = 74
"""Exit status of the process that computes bounds where it cannot store them."""
RANK_TOLERANCE = 1e-9
"""Eigenvalues of the Fisher information below this part of the largest count as zero."""
FORMAT = 1


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
    def covariance(self) -> np.ndarray:
        """The bound on the covariance; on the informed directions only, where some are not."""
        return _pseudo_inverse(self.data + np.diag(self.precision))

    @cached_property
    def null_space(self) -> np.ndarray:
        """Directions of the log-parameters that the data cannot tell, orthonormal rows over ``names``."""
        return _null_space(self.data, len(self.names))

    @cached_property
    def _untold(self) -> np.ndarray:
        return _null_space(self.data + np.diag(self.precision), len(self.names))

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
        w = self._exponents(quantity)
        return float(w @ self.covariance @ w)

    def prior_share(self, quantity: Quantity) -> float:
        """The part of that variance that comes from the prior's error; 0 where nothing tells the quantity."""
        w, variance = self._exponents(quantity), self.variance(quantity)
        from_prior = self.covariance @ np.diag(self.precision) @ self.covariance
        return float(w @ from_prior @ w / variance) if 0 < variance < np.inf else 0.0

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
        own = told.covariance[: g.shape[2], : g.shape[2]]  # the first record's, which is scored
        return float(np.sqrt(np.mean(np.einsum("dti,ij,dtj->dt", g, own, g))))

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


def _pseudo_inverse(information: np.ndarray) -> np.ndarray:
    """Inverse on the directions that are informed; a quantity outside them is reported as inf by the caller."""
    scaled, scale = _scaled(information)
    return np.asarray(np.linalg.pinv(scaled, rcond=RANK_TOLERANCE, hermitian=True) / np.outer(scale, scale))


def _null_space(information: np.ndarray, n_parameters: int) -> np.ndarray:
    """Uninformed directions of the log-parameters, initial states profiled out; orthonormal rows, maybe none."""
    own, nuisance = information[:n_parameters, :n_parameters], information[n_parameters:, n_parameters:]
    if nuisance.size:
        cross = information[:n_parameters, n_parameters:]
        own = own - cross @ _pseudo_inverse(nuisance) @ cross.T
    scaled, scale = _scaled(own)
    values, vectors = np.linalg.eigh(scaled)
    null = (vectors[:, values < RANK_TOLERANCE * max(values[-1], 1e-300)] / scale[:, None]).T
    return np.linalg.qr(null.T)[0].T if null.size else null


def bound_identity(scenario: Scenario, seed: int) -> str:
    """Hash of everything the bound depends on (the seed only where it draws a force)."""
    identity = {
        "format": FORMAT,
        **scenario.undisturbed.data_identity(),
        **scenario.told_identity(),
        "dense": scenario.dense,
        "forecast": scenario.forecast,
        "seed": seed if scenario.force else None,
    }
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


Job = tuple[Scenario, int, Path]
"""A scenario and seed, and the file that keeps their bound."""


def _compute_to_file(job: Job) -> None:
    scenario, seed, path = job
    text = json.dumps(asdict(compute_bound(scenario, seed)))
    temporary = path.with_suffix(f".{uuid.uuid4().hex}.tmp")  # two machines can have the same process ids
    try:
        temporary.write_text(text)
        os.replace(temporary, path)
    except OSError:
        raise _unwritable(path.parent) from None


def _unwritable(folder: Path) -> InputError:
    return InputError("store", folder, "the bounds cannot be written; make room, or name another folder")


def _compute_all(jobs: Sequence[Job]) -> None:
    """Main function of the process that computes bounds with jax."""
    try:
        for job in jobs:
            _compute_to_file(job)
    except InputError:
        sys.exit(UNWRITABLE)


def load_bounds(wanted: Sequence[tuple[Scenario, int]], folder: Path) -> list[Bound]:
    """The bounds of (scenario, seed) pairs from the cache under ``folder``.

    What is missing is computed first: of linear systems here, of others in one process of its own, so that jax never
    shares a process with a fit. Raises InputError where ``folder`` cannot be written.
    """
    paths = [folder / f"{bound_identity(scenario, seed)}.bound" for scenario, seed in wanted]
    missing = {path: job for path, job in zip(paths, wanted, strict=True) if not path.exists()}
    if missing:
        folder.mkdir(parents=True, exist_ok=True)
    jobs = [(scenario, seed, path) for path, (scenario, seed) in missing.items()]
    for job in jobs:
        if job[0].make_system().linear:
            _compute_to_file(job)
    if others := [job for job in jobs if not job[0].make_system().linear]:
        process = multiprocessing.get_context("spawn").Process(target=_compute_all, args=(others,))
        with without_main():
            process.start()
        process.join()
        if process.exitcode == UNWRITABLE:
            raise _unwritable(folder)
        if process.exitcode != 0:
            raise RuntimeError(f"the computation of {len(others)} bound(s) failed (exit {process.exitcode})")
    return [_from_file(path) for path in paths]


def _from_file(path: Path) -> Bound:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        names, null_space = tuple(values.pop("names")), tuple(map(tuple, values.pop("null_space")))
        return Bound(names=names, null_space=null_space, **values)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError("store", path, "not a whole bound; remove it, it is computed anew") from None
