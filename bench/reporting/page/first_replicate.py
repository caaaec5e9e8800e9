"""What a cell keeps of its first replicate, read for pictures: samples, truth, the fit, and the stated intervals.

A cell stores neither the names behind its belief nor, for a method without a reconstruction of its own, its response.
Both are made again here, and used only if they agree with the stored scores of that replicate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.contract.problem import Channel, Record
from bench.dynamics.simulate import fitted_start, simulate
from bench.errors import InputError
from bench.reporting.frame import Result
from bench.store.store import Store
from bench.systems import System

AGREES = 0.02
"""Largest relative difference from a stored score."""
TWO_SIDED = (2.5, 97.5)


@dataclass(frozen=True)
class FirstReplicate:
    """Of the first replicate: ``times``, ``values`` (n,) of the samples of one DOF, ``truth`` and ``fit`` on ``dense``.

    ``band`` is the stated standard deviation of the fit; ``fit`` and ``band`` are None where they are not known.
    """

    dof: int
    dofs: int
    times: np.ndarray
    values: np.ndarray
    dense: np.ndarray
    truth: np.ndarray
    fit: np.ndarray | None
    band: np.ndarray | None


def first_replicate(store: Store, result: Result) -> FirstReplicate | None:
    """What is kept, of the first DOF with a sensor; None where the cell has no arrays or they are not readable."""
    arrays = result.arrays()
    if not {"sample_times", "sample_values", "sample_dof", "dense_times", "true_displacement"} <= set(arrays):
        return None
    dof = int(arrays["sample_dof"][0])
    own = arrays["sample_dof"] == dof
    truth = np.atleast_2d(arrays["true_displacement"])
    fit = arrays.get("displacement")
    if fit is None:
        fit = simulated(result, arrays)
    fit = None if fit is None or np.shape(fit) != truth.shape or not np.isfinite(fit).all() else fit[dof]
    band = arrays.get("displacement_sd")
    return FirstReplicate(
        dof, len(truth), arrays["sample_times"][own], arrays["sample_values"][own], arrays["dense_times"], truth[dof],
        fit, None if band is None or fit is None else np.atleast_2d(band)[dof],
    )  # fmt: skip


def log_parameters(result: Result, arrays: Mapping[str, np.ndarray], system: System) -> np.ndarray | None:
    """The mean of the belief as log-parameters in the system's order, if the stored ratios say that it is."""
    mean, truth = arrays.get("mean"), result.parameters
    if mean is None or mean.shape != (len(system.names),) or not result.n or not set(system.names) <= set(truth):
        return None
    with np.errstate(all="ignore"):
        for name, value in zip(system.names, np.exp(mean), strict=True):
            if not abs(value / truth[name] / result.first(f"{name}_ratio") - 1.0) < 1e-3:
                return None
    return mean


def simulated(result: Result, arrays: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """The response from the identified parameters (n_dof, n_dense) in free vibration, if its stored error agrees."""
    system = result.known_model
    if system is None or result.forced or result.added_mass or result.truth_drawn:
        return None
    mean = log_parameters(result, arrays, system)
    if mean is None or not result.ok[0]:
        return None
    p = dict(zip(system.names, map(float, np.exp(mean)), strict=True))
    dofs, times, values = (arrays[f"sample_{name}"] for name in ("dof", "times", "values"))
    measured = [int(i) for i in np.unique(dofs)]
    channels = tuple(Channel(times[dofs == i], values[dofs == i], dof=i) for i in measured)
    try:
        began = fitted_start(system, p, Record(channels, (), result.start_told))
        response = simulate(system, p, began, arrays["dense_times"]).displacement
    except (InputError, np.linalg.LinAlgError):
        return None
    error = np.sqrt(np.mean((response - np.atleast_2d(arrays["true_displacement"]))[measured] ** 2))
    return response if abs(error / result.first("rmse_simulated") - 1.0) < AGREES else None


def stated_interval(store: Store, result: Result, quantity: str) -> tuple[float, float] | None:
    """The first replicate's stated interval of a quantity over its true value: two standard deviations of its logarithm
    to either side, or the middle 95 % of the draws."""
    system = result.known_model
    if system is None or result.truth_drawn:
        return None
    what = next((q for q in system.quantities if q.name == quantity), None)
    if what is None:
        return None
    arrays = result.arrays()
    true = float(what.value(result.parameters))
    draws = arrays.get("draws")
    if draws is not None and draws.shape[1:] == (len(system.names),):
        values = what.value({name: draws[:, i] for i, name in enumerate(system.names)})
        low, high = np.percentile(values, TWO_SIDED) / true
        return float(low), float(high)
    mean = log_parameters(result, arrays, system)
    covariance = arrays.get("covariance")
    if mean is None or covariance is None:
        return None
    vector = np.array(what.vector(system.names))
    centre = math.log(what.coefficient) + float(vector @ mean) - math.log(true)
    with np.errstate(over="ignore", invalid="ignore"):  # of a fit that ran away
        sd = math.sqrt(max(float(vector @ covariance @ vector), 0.0))
    if not math.isfinite(sd) or abs(centre) + 2 * sd > 50:
        return None
    return math.exp(centre - 2 * sd), math.exp(centre + 2 * sd)
