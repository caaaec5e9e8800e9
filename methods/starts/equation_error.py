"""Initial guesses by equation error: the equation of motion regressed on smooth curves through the displacements.

The curves are sums of one to four damped sinusoids in free vibration, and smoothing splines under a force. On a curve
the equation of motion is algebraic in the parameters, so the misfit has no local minimum per half-period of phase
slip. An equation affine in the parameters is solved by non-negative least squares, others by nonlinear least squares in
the log-parameters, with the prior where there is one.

All functions take problems in natural units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import least_squares, nnls

from bench import Channel, Problem, Record, System, numpy_ops, regression_columns
from methods.starts.common_rates import common_rates, damped_columns

LEVELS = 4
"""Number of curves per record, from the smoothest to the roughest."""
POINTS = 400
"""Times on a curve at which the equation of motion is evaluated."""
CURVE_ERROR = 0.1
"""Relative error of a curve's acceleration, by which nonlinear regression is weighted against the prior."""
SEARCHES, FARTHEST = 60, 30.0
"""Largest number of evaluations of a nonlinear regression, and its largest log-parameter."""
OUTSIDE = 1e50
"""Residual where the equation of motion is not finite, so that the search avoids such parameters."""
SMALLEST = 0.02
"""A parameter estimated as zero is set to this fraction of the value that would balance the other terms."""


def regression_starts(problem: Problem) -> list[dict[str, float]]:
    """Regress the equation of motion on smooth curves through the displacements, once per smoothness.

    Returns no guesses for a system with hidden states, or where no record measures the displacement of every DOF.
    """
    system = problem.system
    if system.n_hidden:
        return []
    by_record = [(r.rig(system), _smoothed(system, r)) for r in problem.records]
    smoothed = [(rig, curves) for rig, curves in by_record if curves]
    if not smoothed:
        return []
    rigs = [rig for rig, _ in smoothed]
    solve = _regressed if system.affine_in_parameters else _fitted
    return [solve(problem, rigs, [curves[level] for _, curves in smoothed]) for level in range(LEVELS)]


Curves = tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray], list[np.ndarray]]
"""Displacement, velocity, acceleration and force at ``POINTS`` times, each a list of one array per DOF."""


def _smoothed(system: System, record: Record) -> list[Curves]:
    """Return the curves of a record for each smoothness; none where a DOF has no displacement sensor."""
    by_dof = {c.dof: c for c in record.channels if c.measures == "displacement" and c.n >= 5}
    if set(by_dof) != set(range(system.n_dof)):
        return []
    times = np.linspace(0.0, record.duration, POINTS)
    measured = [by_dof[i] for i in range(system.n_dof)]
    if any(np.any(f.values) for f in record.forces):
        levels = [[_spline(c, 10.0 ** (level - 3), times) for c in measured] for level in range(LEVELS)]
    else:
        rates = common_rates(measured, LEVELS)
        levels = [[_waves(c, rates[: level + 1], times) for c in measured] for level in range(LEVELS)]
    force = record.force(times, system.n_dof)
    return [([x for x, _, _ in level], [v for _, v, _ in level], [a for _, _, a in level], force) for level in levels]


def _waves(channel: Channel, rates: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return displacement, velocity and acceleration (3, n_times) of the least-squares sum of damped sinusoids."""
    columns = damped_columns(channel.times, rates, channel.offset)
    fitted = np.linalg.lstsq(columns, channel.values, rcond=1e-9)[0]
    amplitudes, basis = fitted[: rates.size] + 1j * fitted[rates.size : 2 * rates.size], np.exp(rates[:, None] * times)
    return np.stack([((amplitudes * rates**order) @ basis).real for order in range(3)])


def _spline(channel: Channel, weight: float, times: np.ndarray) -> np.ndarray:
    """Return displacement, velocity and acceleration (3, n_times) of a smoothing spline.

    It is fitted in units of the sampling step, so that its weight does not depend on the sampling rate.
    """
    step = float(np.median(np.diff(channel.times)))
    values = channel.values - channel.offset * np.mean(channel.values)
    curve = make_smoothing_spline(channel.times / step, values, lam=weight)
    return np.stack([curve(times / step, nu=order) / step**order for order in range(3)])


def _fixed(problem: Problem) -> dict[str, float]:
    """Return the gauge mass, fixed at 1, where neither a force nor a prior sets the scale; else nothing."""
    return {} if problem.scale_known and problem.prior is None else {problem.system.gauge: 1.0}


def _regressed(problem: Problem, rigs: Sequence[System], blocks: Sequence[Curves]) -> dict[str, float]:
    """Solve each rig's residual on its curves by non-negative least squares."""
    system = problem.system
    parts = [regression_columns(rig, *block) for rig, block in zip(rigs, blocks, strict=True)]
    columns, rest = np.concatenate([a for a, _ in parts]), np.concatenate([b for _, b in parts])
    names = list(system.names)
    fixed = _fixed(problem)
    right = -rest - sum((columns[:, names.index(name)] * value for name, value in fixed.items()), np.zeros(len(rest)))
    free = [name for name in names if name not in fixed]
    sizes = {name: float(np.sqrt(np.mean(columns[:, names.index(name)] ** 2))) or 1.0 for name in names}
    scaled = np.stack([columns[:, names.index(name)] / sizes[name] for name in free], axis=1)
    estimate = nnls(scaled, right)[0]
    least = SMALLEST * float(np.sqrt(np.mean(right**2)))
    return fixed | {name: float(max(value, least) / sizes[name]) for name, value in zip(free, estimate, strict=True)}


def _fitted(problem: Problem, rigs: Sequence[System], blocks: Sequence[Curves]) -> dict[str, float]:
    """Solve each rig's residual on its curves by nonlinear least squares in the log-parameters.

    The relative error of the curves' accelerations is taken to be ``CURVE_ERROR``, with as many independent values as
    samples. The search starts at the oscillator of the curves' frequency and at the prior's nominal values.
    """
    system, prior = problem.system, problem.prior
    fixed = _fixed(problem)
    free = [name for name in system.names if name not in fixed]
    starts = [_oscillator(system, blocks)] + ([dict(prior.nominal)] if prior is not None else [])
    size = _size(starts[0], rigs, blocks)
    weight = np.sqrt(problem.n / (POINTS * len(blocks) * system.n_dof)) / (CURVE_ERROR * size)

    def misfit(logs: np.ndarray) -> np.ndarray:
        p = {**fixed, **dict(zip(free, np.exp(np.clip(logs, -FARTHEST, FARTHEST)), strict=True))}
        rows = weight * _equations(p, rigs, blocks)
        every = np.log([p[name] for name in system.names])
        rows = np.concatenate([rows, [] if prior is None else prior.residuals(every)])
        return np.nan_to_num(rows, nan=OUTSIDE, posinf=OUTSIDE, neginf=-OUTSIDE)

    ends = [least_squares(misfit, np.log([start[name] for name in free]), max_nfev=SEARCHES) for start in starts]
    best = min(ends, key=lambda end: float(end.cost))
    return {**fixed, **dict(zip(free, map(float, np.exp(np.clip(best.x, -FARTHEST, FARTHEST))), strict=True))}


def _oscillator(system: System, blocks: Sequence[Curves]) -> dict[str, float]:
    """Return parameters for the curves' frequency w: mass 1, stiffness w², damping w / 10, else w^n for time^-n."""
    speeds, sizes = (np.concatenate([np.ravel(part) for block in blocks for part in block[i]]) for i in (1, 0))
    w = float(np.linalg.norm(speeds) / (np.linalg.norm(sizes) or 1.0)) or 1.0
    shares = {"mass": 1.0, "damping": 0.1}
    return {p.name: shares.get(p.kind, 1.0) * w**-p.dimension.time for p in system.parameters}


def _equations(p: Mapping[str, float], rigs: Sequence[System], blocks: Sequence[Curves]) -> np.ndarray:
    """Concatenate the residuals of all rigs on their curves."""
    rows = [rig.residual(p, x, v, a, f, [], numpy_ops) for rig, (x, v, a, f) in zip(rigs, blocks, strict=True)]
    return np.concatenate([np.broadcast_to(np.asarray(r, float), (POINTS,)) for residuals in rows for r in residuals])


def _size(p: Mapping[str, float], rigs: Sequence[System], blocks: Sequence[Curves]) -> float:
    """Return the root mean square of the inertia forces or of the external force, whichever is larger."""
    still = [(x, v, [np.zeros_like(array) for array in a], f) for x, v, a, f in blocks]
    inertia = _equations(p, rigs, blocks) - _equations(p, rigs, still)
    force = np.concatenate([np.ravel(array) for *_, f in blocks for array in f])
    sizes = [float(np.sqrt(np.mean(part**2))) for part in (inertia, force)]
    return max((size for size in sizes if np.isfinite(size)), default=1.0) or 1.0
