"""Forces that a fitted model lacks: dry friction, quadratic damping, a cubic spring.

Each is added to first order about none of it: a regression of the residuals on the derivatives of the fit and on those
by the added forces (a score test: C. R. Rao, Proc. Camb. Phil. Soc. 44:50, 1948). Those that lower the Bayesian
information criterion most, with the noise as coloured as it then is, are taken to be there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import ClassVar

import numpy as np

from bench.contract.problem import InitialState
from bench.dynamics.simulate import measurements
from bench.likelihood.autoregression import even_times
from bench.records.colour import information_criterion
from bench.records.linearised import Linearised
from bench.records.strongest import strongest_frequency
from bench.systems import Parameter, Quantity, System

NAMES = {"mu": "dry friction", "c2": "quadratic damping", "k3": "a cubic spring"}
SHAPED = {"l", "k3s"}
"""Parameters of a spring that is no straight line already."""
SMALL = 1e-3
"""Size of an added force, over the spring's, in the differences that give its derivative."""
TURNS = 0.05
"""Speed at which the sign of dry friction turns, over the largest speed."""
STRONG = 6.0
"""Least gain in the criterion that counts (R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90:773, 1995)."""
MOST_SAMPLES, MOST_CYCLES = 2000, 100.0
"""Samples and first cycles of a record that are looked at: the shape of cycles and of a decay shows in them, and the
motion with an added force is simulated step by step."""


@dataclass(frozen=True)
class WithForces(System):
    """A system of one DOF and, beside it, ``mu tanh(x'/v_s) + c2 |x'| x' + k3 x³``.

    The sizes stand among the values of the parameters, may have any sign and be many; they are no parameters.
    """

    system: System
    smoothing_velocity: float
    name: ClassVar[str] = "with_forces"
    smooth: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.system.parameters

    @property
    def n_hidden(self) -> int:
        return self.system.n_hidden

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return self.system.groups

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        (left,) = self.system.residual(p, x, v, a, f, z, ops)
        friction = p["mu+"] * ops.tanh(v[0] / self.smoothing_velocity) + p["c2+"] * ops.abs(v[0]) * v[0]
        return [left + friction + p["k3+"] * x[0] * x[0] * x[0]]

    def hidden_rates(self, p, x, v, f, z, ops):  # type: ignore[no-untyped-def]
        return self.system.hidden_rates(p, x, v, f, z, ops)


def missing_forces(fit: Linearised) -> tuple[str, ...]:
    """Name the forces that the residuals of a fit of one displacement record of one DOF show to be missing."""
    model = fit.model
    record, names = model.problem.records[0], set(model.system.names)
    if len(model.problem.records) > 1 or model.system.n_dof > 1 or not {"c", "k"} <= names:
        return ()
    channel = record.channels[0]
    if len(record.channels) > 1 or channel.measures != "displacement" or not even_times(channel.times):
        return ()
    candidates = [name for name in NAMES if name not in names and not (name == "k3" and names & SHAPED)]
    cycles = channel.times * strongest_frequency(channel.times, channel.values)
    end = int(np.searchsorted(cycles, MOST_CYCLES))
    kept = slice(0, end, -(-end // MOST_SAMPLES))
    slopes, residuals = fit.slopes[kept], fit.residuals[kept]
    columns = _columns(fit, candidates, kept)
    first = information_criterion(_residuals(slopes, residuals), fit.theta.size)
    gains: dict[tuple[str, ...], float] = {(): STRONG}
    for count in range(1, len(columns) + 1):
        for names_added in combinations(columns, count):
            rows = np.column_stack([slopes, *(columns[name] for name in names_added)])
            gains[names_added] = first - information_criterion(_residuals(rows, residuals), rows.shape[1])
    return tuple(NAMES[name] for name in max(gains, key=gains.__getitem__))


def _columns(fit: Linearised, names: list[str], kept: slice) -> dict[str, np.ndarray]:
    """Return derivatives of the prediction at the kept samples by each added force, by central differences."""
    model, record = fit.model, fit.model.problem.records[0]
    p = {name: float(value) for name, value in model.parameters(fit.theta).items()}
    motion = model.data - fit.residuals
    size, rate = float(np.ptp(motion)) / 2.0, float(np.sqrt(p["k"] / p["m"]))
    force = SMALL * p["k"] * size
    sizes = {"mu": force, "c2": force / (rate * size) ** 2, "k3": force / size**3}
    sets = {name: np.full(2 * len(names), value) for name, value in p.items()}
    sets |= {f"{name}+": np.zeros(2 * len(names)) for name in NAMES}
    for i, name in enumerate(names):
        sets[f"{name}+"][2 * i : 2 * i + 2] = sizes[name], -sizes[name]
    start = model.starts(fit.theta)[0]
    state = (start.displacement, start.velocity) if isinstance(start, InitialState) else start
    x, v = (np.repeat(np.asarray(part)[:, None], 2 * len(names), axis=1) for part in state)
    channel = record.channels[0]
    thin = replace(channel, times=channel.times[kept], values=channel.values[kept])
    system = WithForces(model.system, TURNS * rate * size)
    with np.errstate(all="ignore"):
        ends = measurements(system, sets, (x, v), replace(record, channels=(thin,)))
    columns = {name: (ends[2 * i] - ends[2 * i + 1]) / (2 * sizes[name]) for i, name in enumerate(names)}
    return {name: column for name, column in columns.items() if np.all(np.isfinite(column))}


def _residuals(rows: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """Return what a regression on the columns of ``rows`` (n, p) leaves."""
    norms = np.linalg.norm(rows, axis=0)
    scaled = rows / np.where(norms > 0, norms, 1.0)
    return np.asarray(residuals - scaled @ np.linalg.lstsq(scaled, residuals, rcond=1e-10)[0])
