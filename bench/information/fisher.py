"""The Cramér-Rao bound of a scenario: the best that data and prior allow, by quantity and for the displacement.

The bound is the inverse of (Fisher information of the data at the truth + precision of the prior), in the
log-parameters (and the initial state, where it is not told). With Gaussian noise of unknown level the cross terms
between level and parameters vanish (the expectation of the residual is zero), so estimating the level costs nothing.

Sensitivities come from jax: exactly, through matrix exponentials, for a linear system, through Runge-Kutta steps fine
enough not to matter for others. It is computed once per scenario,
in a process of its own, and cached.
"""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import os
import sys
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from bench.contract.problem import Force
from bench.dynamics.mechanics import rk4_step, state_rate
from bench.dynamics.simulate import interval_polynomials, longest_step, merged_grid
from bench.errors import InputError
from bench.isolation.mainless import without_main
from bench.scenario.scenario import Scenario
from bench.systems import Ops, Quantity, System

UNWRITABLE = 74
"""Exit status of the process that computes bounds where it cannot store them."""
REFINE = 12
"""Integration steps per step that plain simulation would take."""
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


def _jax_ops() -> Ops:
    import jax.numpy as jnp

    def solve(matrix: Sequence[Sequence[Any]], rhs: Sequence[Any]) -> list[Any]:
        solution = jnp.linalg.solve(jnp.stack([jnp.stack(row) for row in matrix]), jnp.stack(rhs))
        return [solution[i] for i in range(len(rhs))]

    return cast(
        Ops,
        SimpleNamespace(
            sin=jnp.sin, cos=jnp.cos, tanh=jnp.tanh, exp=jnp.exp, abs=jnp.abs, where=jnp.where, solve=solve
        ),
    )


def _steps(
    system: System, scenario: Scenario, forces: Sequence[Force], times: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step lengths (n,), forces at start, middle and end of each step (n, 3, n_dof), and where each time is reached."""
    grid = merged_grid(times, forces)
    state = [np.array(part[i]) for part in scenario.initial for i in range(system.n_dof)]
    state += [np.array(0.0)] * system.n_hidden
    longest = longest_step(system, scenario.parameters, state) / REFINE
    counts = np.maximum(1, np.ceil(np.diff(grid) / longest)).astype(int)
    which = np.repeat(np.arange(counts.size), counts)
    reached = np.concatenate([[0], np.cumsum(counts)])
    parts = (np.arange(which.size) - reached[which])[:, None] + np.array([0.0, 0.5, 1.0])
    parts /= counts[which, None]
    coefficients = interval_polynomials(forces, grid, system.n_dof)[:, which]
    pushes = sum(c[:, None] * parts[..., None] ** j for j, c in enumerate(coefficients))
    return (np.diff(grid) / counts)[which], np.asarray(pushes), reached[np.searchsorted(grid, times)]


def _by_steps(
    system: System, scenario: Scenario, ops: Ops, forces: Sequence[Force], times: np.ndarray
) -> Callable[[Mapping[str, Any], Any], Any]:
    """The displacement, shape (n_dof, n_times), as a function of parameters and start, by Runge-Kutta steps."""
    import jax
    import jax.numpy as jnp

    n = system.n_dof
    lengths, pushes, reached = _steps(system, scenario, forces, times)

    def path(p: Mapping[str, Any], start: Any) -> Any:
        def step(state: Any, inputs: tuple[Any, Any]) -> tuple[Any, Any]:
            h, push = inputs
            f = [[push[i, j] for j in range(n)] for i in range(3)]
            new = jnp.stack(rk4_step(system, p, [state[i] for i in range(state.shape[0])], h, (f[0], f[1], f[2]), ops))
            return new, new[:n]

        _, after = jax.lax.scan(step, start, (jnp.asarray(lengths), jnp.asarray(pushes)))
        return jnp.concatenate([start[None, :n], after])[reached].T

    return path


def _by_exponentials(
    system: System, ops: Ops, forces: Sequence[Force], times: np.ndarray
) -> Callable[[Mapping[str, Any], Any], Any]:
    """The same of a linear system, exact: matrix exponentials of the state, the force and its derivatives.

    See :func:`bench.dynamics.simulate.matrix_exponential_response` for the formula; here jax differentiates it.
    """
    import jax
    import jax.numpy as jnp

    n, grid = system.n_dof, merged_grid(times, forces)
    pushes = interval_polynomials(forces, grid, n)
    order, h = len(pushes), np.diff(grid)
    factors = np.array([math.factorial(j) for j in range(order)])
    given = np.moveaxis(factors[:, None, None] / h[:, None] ** np.arange(order)[:, None, None] * pushes, 0, 1)
    tick = 1e-12 * max(grid[-1], 1e-300)
    _, first, which = np.unique(np.round(h / tick), return_index=True, return_inverse=True)

    def path(p: Mapping[str, Any], start: Any) -> Any:
        def rate(state: Any, f: Any) -> Any:
            return jnp.stack(state_rate(system, p, [state[i] for i in range(2 * n)], [f[i] for i in range(n)], ops))

        a, b = jax.jacfwd(rate, (0, 1))(jnp.zeros(2 * n), jnp.zeros(n))
        top = jnp.concatenate([a, b, jnp.zeros((2 * n, (order - 1) * n))], axis=1)
        bottom = np.eye(order * n, (2 + order) * n, 3 * n)
        growth = jax.vmap(jax.scipy.linalg.expm)(jnp.concatenate([top, bottom]) * h[first, None, None])[:, : 2 * n]

        def step(state: Any, inputs: tuple[Any, Any]) -> tuple[Any, Any]:
            j, push = inputs
            new = growth[j] @ jnp.concatenate([state, push])
            return new, new[:n]

        _, after = jax.lax.scan(step, start, (jnp.asarray(which), jnp.asarray(given.reshape(h.size, -1))))
        return jnp.concatenate([start[None, :n], after])[np.searchsorted(grid, times)].T

    return path


def sensitivities(scenario: Scenario, seed: int, times: np.ndarray, record: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Displacement, shape (n_dof, n_times), and its derivatives (n_dof, n_times, n_parameters + 2 n_dof).

    Derivatives by the log-parameters, then by initial displacement and velocity of each DOF, at the truth.
    """
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    system, ops = scenario.rigs()[record], _jax_ops()
    names, forces = system.names, scenario.forces(seed)
    path = (
        _by_exponentials(system, ops, forces, times)
        if system.linear
        else _by_steps(system, scenario, ops, forces, times)
    )

    def response(theta: Any) -> Any:
        p = {name: jnp.exp(theta[i]) for i, name in enumerate(names)}
        return path(p, jnp.concatenate([theta[len(names) :], jnp.zeros(system.n_hidden)]))

    logs = np.log([scenario.parameters[name] for name in names])
    theta = jnp.asarray(np.concatenate([logs, scenario.start.displacement, scenario.start.velocity]))
    return np.asarray(response(theta)), np.asarray(jax.jacfwd(response)(theta))


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


def _compute_to_files(jobs: Sequence[tuple[Scenario, int, Path]]) -> None:
    for scenario, seed, path in jobs:
        text = json.dumps(asdict(compute_bound(scenario, seed)))
        temporary = path.with_suffix(f".{uuid.uuid4().hex}.tmp")  # two machines can have the same process ids
        try:
            temporary.write_text(text)
            os.replace(temporary, path)
        except OSError:
            sys.exit(UNWRITABLE)


def load_bounds(wanted: Sequence[tuple[Scenario, int]], folder: Path) -> list[Bound]:
    """The bounds of (scenario, seed) pairs from the cache under ``folder``.

    What is missing is computed first, in one process of its own, so that jax never shares a process with a fit.
    """
    paths = [folder / f"{bound_identity(scenario, seed)}.bound" for scenario, seed in wanted]
    missing = {path: job for path, job in zip(paths, wanted, strict=True) if not path.exists()}
    if missing:
        folder.mkdir(parents=True, exist_ok=True)
        jobs = [(scenario, seed, path) for path, (scenario, seed) in missing.items()]
        process = multiprocessing.get_context("spawn").Process(target=_compute_to_files, args=(jobs,))
        with without_main():
            process.start()
        process.join()
        if process.exitcode == UNWRITABLE:
            raise InputError("store", folder, "the bounds cannot be written; make room, or name another folder")
        if process.exitcode != 0:
            raise RuntimeError(f"the computation of {len(jobs)} bound(s) failed (exit {process.exitcode})")
    return [_from_file(path) for path in paths]


def _from_file(path: Path) -> Bound:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        names, null_space = tuple(values.pop("names")), tuple(map(tuple, values.pop("null_space")))
        return Bound(names=names, null_space=null_space, **values)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError("store", path, "not a whole bound; remove it, it is computed anew") from None
