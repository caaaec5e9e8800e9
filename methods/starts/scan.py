"""A scan of a linear system over frequency and decay, whose lowest local minima are initial guesses.

At given parameters the response of a *linear* system is affine in its initial state, in the sensors' offsets and in
the reciprocal of a common scale of m, c and k under a known force. These are projected out (variable projection: G.
Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973); the remaining misfit depends on stiffness and damping only and is
evaluated on a grid of frequency and decay.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from bench import Channel, Force, Problem, Record, System, measurements
from methods.starts.common_rates import CYCLE_STEP, DECAYS, MAX_CYCLES
from methods.starts.search_range import expected_rate, most_cycles, resolved_cycles


def scan(problem: Problem, n: int) -> list[dict[str, float]]:
    """Return the ``n`` lowest local minima of the projected misfit over a grid of frequency and decay.

    The range of the grid follows :mod:`methods.starts.search_range`. All stiffnesses are scaled together, and all
    dampings, from the prior's nominal proportions or from equal ones; one degree of freedom is covered completely.
    Where known masses were added in some records, the records of each added mass are scanned separately as if none had
    been added, and :func:`unloaded` computes the mass from the lightest and the heaviest; pairs of minima are ordered
    by the sum of their misfits.
    """
    if not is_loaded(problem):
        return [p for _, p in _minima(problem, n, problem.prior is not None)]
    by_load = records_by_load(problem)
    loads = sorted(by_load)
    light = _minima(by_load[loads[0]], n, fixed_scale=False)
    heavy = _minima(by_load[loads[-1]], n, fixed_scale=False) if len(loads) > 1 else []
    pairs = []
    for misfit, p in light:
        for other, q in heavy:
            plain = unloaded(problem, {loads[0]: p, loads[-1]: q})
            if plain is not None:
                pairs.append((misfit + other, plain))
    return [p for _, p in sorted(pairs, key=lambda pair: pair[0])[:n]] or [p for _, p in light]


def is_loaded(problem: Problem) -> bool:
    """Return True where a known mass was added in some record."""
    return any(record.added_mass is not None for record in problem.records)


def _minima(problem: Problem, n: int, fixed_scale: bool) -> list[tuple[float, dict[str, float]]]:
    """Return the misfits and parameters of the minima; ``fixed_scale``: the gauge mass is one unit."""
    names, base = problem.system.names, _proportions(problem)
    misfit: np.ndarray | float = 0.0
    strength: np.ndarray | float = 0.0
    grid = np.zeros((0, 2))
    cycles = most_cycles(problem, MAX_CYCLES)
    for record in problem.records:
        grid, responses = _grid_responses(problem.system, base, _signature(record), cycles, _known_start(record))
        rss, scale = _projected(record, responses, fixed_scale)
        misfit, strength = misfit + rss, strength + scale / len(problem.records)
    table, scales = np.reshape(misfit, (-1, len(DECAYS))), np.reshape(strength, (-1, len(DECAYS)))
    minima = []
    for i, j in _worth_a_start(problem, grid[:: len(DECAYS), 0], _separate_minima(table), table, n):
        frequency, decay = grid[i * len(DECAYS) + j]
        levels = _by_kind(problem.system, base, np.array(frequency), np.array(decay))
        minima.append((table[i, j], {name: float(levels[name] * max(scales[i, j], 1e-12)) for name in names}))
    return minima


def _worth_a_start(
    problem: Problem, frequencies: np.ndarray, minima: Sequence[tuple[int, int]], table: np.ndarray, n: int
) -> list[tuple[int, int]]:
    """Return the ``n`` best minima below half the sampling rate, and the ``n`` most probable above it."""
    resolved = max(resolved_cycles(record) for record in problem.records)
    expected = expected_rate(problem)
    within = [place for place in minima if frequencies[place[0]] <= resolved]
    beyond = [place for place in minima if frequencies[place[0]] > resolved]
    if expected is None or not beyond:
        return list(minima[:n])
    least = 1e-12 * float(np.max(table[np.isfinite(table)]))

    def surprise(place: tuple[int, int]) -> float:
        """Return minus twice the logarithm of the posterior, the noise at its best value."""
        distance = (np.log(2 * np.pi * frequencies[place[0]]) - expected[0]) / expected[1]
        return float(problem.n * np.log(max(table[place], least)) + distance**2)

    return within[:n] + sorted(beyond, key=surprise)[:n]


def _proportions(problem: Problem) -> tuple[float, ...]:
    """Return the parameters over the first of their kind: by the prior, or all equal."""
    prior, system = problem.prior, problem.system
    if prior is None or system.n_dof == 1:
        return tuple(1.0 for _ in system.names)
    sizes = {"mass": prior.nominal[system.gauge]}
    for p in system.parameters:
        sizes.setdefault(p.kind, prior.nominal[p.name])
    return tuple(prior.nominal[p.name] / sizes[p.kind] for p in system.parameters)


def unloaded(problem: Problem, by_load: Mapping[float, Mapping[str, float]]) -> dict[str, float] | None:
    """Compute the rig's parameters from fits to records with two added masses that ignore these masses.

    Each determines ``r = k / (m + load)``, so that ``m = (r2 load2 - r1 load1) / (r1 - r2)``; None where that is not
    positive. Damping and stiffness over mass are those of the first load. The masses of several degrees of freedom are
    taken to share the load, as a first guess.
    """
    system = problem.system
    (load1, p), (load2, q) = by_load.items()
    kinds = {parameter.name: parameter.kind for parameter in system.parameters}
    stiffness = next(name for name, kind in kinds.items() if kind == "stiffness")
    r1, r2 = p[stiffness] / p[system.gauge], q[stiffness] / q[system.gauge]
    shares = sum(p[name] / p[system.gauge] for name, kind in kinds.items() if kind == "mass")
    mass = (r2 * load2 - r1 * load1) / (r1 - r2) / shares if r1 != r2 else 0.0
    if not (np.isfinite(mass) and mass > 0):
        return None
    whole = mass + load1 / shares
    return {name: float(v / p[system.gauge] * (mass if kinds[name] == "mass" else whole)) for name, v in p.items()}


def records_by_load(problem: Problem) -> dict[float, Problem]:
    """Split a problem by the total added mass, which the parts then ignore."""
    parts: dict[float, list[Record]] = {}
    for record in problem.records:
        load = 0.0 if record.added_mass is None else float(np.sum(record.added_mass))
        parts.setdefault(load, []).append(replace(record, added_mass=None))
    return {load: replace(problem, records=tuple(records)) for load, records in parts.items()}


def _separate_minima(table: np.ndarray) -> list[tuple[int, int]]:
    """Return row and column of the local minima along the first axis, best first."""
    table = np.where(np.isfinite(table), table, np.inf)
    best = table.min(axis=1)
    padded = np.concatenate([[np.inf], best, [np.inf]])
    rows = np.flatnonzero((best <= padded[:-2]) & (best <= padded[2:]) & np.isfinite(best))
    return [(int(i), int(table[i].argmin())) for i in sorted(rows, key=lambda i: best[i])]


def _by_kind(system: System, base: Sequence[float], frequency: np.ndarray, decay: np.ndarray) -> dict[str, np.ndarray]:
    """Return parameters with stiffness ``w² + d²`` and damping ``2 d`` over mass, times the base proportions."""
    w = 2 * np.pi * frequency
    sizes = {"mass": np.ones_like(w), "stiffness": w**2 + decay**2, "damping": 2 * decay, "other": np.ones_like(w)}
    return {p.name: b * sizes[p.kind] for p, b in zip(system.parameters, base, strict=True)}


Signature = tuple[tuple[tuple[bytes, str, int], ...], tuple[tuple[bytes, bytes, str, int], ...]]


def _signature(record: Record) -> Signature:
    """Return the cache key of the unit responses of a record; forces are scaled by their common size."""
    size = _force_size(record)
    channels = tuple((np.round(c.times, 12).tobytes(), c.measures, c.dof) for c in record.channels)
    forces = tuple(
        (np.round(f.times, 12).tobytes(), np.round(f.values / size, 9).tobytes(), f.hold, f.dof) for f in record.forces
    )
    return channels, forces


def _force_size(record: Record) -> float:
    return max((float(np.max(np.abs(f.values))) for f in record.forces), default=0.0) or 1.0


def _known_start(record: Record) -> tuple[float, ...] | None:
    """Return a known initial state of several degrees of freedom, whose 2 n_dof unit responses would need much memory.

    The two unit responses of one degree of freedom are the same in every replicate, and cached.
    """
    start = record.initial_state
    if start is None or start.displacement.size == 1:
        return None
    return tuple(map(float, np.concatenate([start.displacement, start.velocity])))


@lru_cache(maxsize=8)
def _grid_responses(
    system: System, base: tuple[float, ...], signature: Signature, cycles: float, known: tuple[float, ...] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return grid points (G, 2) as (cycles, decay), and responses (G, N, S + 1): to initial states, then to the force.

    The initial states are the ``known`` one, or else the 2 n_dof unit vectors.
    """
    channels = tuple(
        Channel(np.frombuffer(t), np.zeros(len(t) // 8), measures, dof)  # type: ignore[arg-type]
        for t, measures, dof in signature[0]
    )
    forces = tuple(
        Force(np.frombuffer(t), np.frombuffer(v), hold, dof)  # type: ignore[arg-type]
        for t, v, hold, dof in signature[1]
    )
    frequencies = np.arange(CYCLE_STEP, max(cycles, 2 * CYCLE_STEP) + 1e-9, CYCLE_STEP)
    grid = np.stack([a.ravel() for a in np.meshgrid(frequencies, DECAYS, indexing="ij")], axis=1)
    p = _by_kind(system, base, grid[:, 0], grid[:, 1])
    n = system.n_dof
    starts = np.eye(2 * n) if known is None else np.array([known])
    responses = np.zeros((len(grid), sum(c.n for c in channels), len(starts) + 1))
    free, forced = Record(channels), Record(channels, forces)
    for i, start in enumerate(starts):
        state = np.broadcast_to(start[:, None], (2 * n, len(grid)))
        responses[..., i] = measurements(system, p, (state[:n], state[n:]), free)
    if forces:
        rest = np.zeros((n, len(grid)))
        responses[..., -1] = measurements(system, p, (rest, rest), forced)
    return grid, responses


def _projected(record: Record, responses: np.ndarray, fixed_scale: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the misfit at each grid point with initial state, offsets and scale fitted, and that scale."""
    sizes = [float(np.sqrt(np.mean(c.values**2))) or 1.0 if c.n else 1.0 for c in record.channels]
    weights = np.concatenate([np.full(c.n, 1.0 / s) for c, s in zip(record.channels, sizes, strict=True)])
    y = np.concatenate([c.values for c in record.channels])
    columns, known = [], np.zeros(responses.shape[:2])
    if (start := record.initial_state) is None:
        columns += [responses[..., i] for i in range(responses.shape[-1] - 1)]
    elif _known_start(record):
        known = known + responses[..., 0]
    else:
        known = known + responses[..., :-1] @ np.concatenate([start.displacement, start.velocity])
    pushed = bool(record.forces) and bool(np.any(responses[..., -1]))
    if pushed and fixed_scale:
        known = known + responses[..., -1] * _force_size(record)
    elif pushed:
        columns.append(responses[..., -1] * _force_size(record))
    for c in record.channels:
        if c.offset:
            indicator = np.concatenate([np.full(other.n, float(other is c)) for other in record.channels])
            columns.append(np.broadcast_to(indicator, responses.shape[:2]))
    residual = weights * (y - known)
    scale = np.ones(len(responses))
    if not columns:
        return np.sum(residual**2, axis=1), scale
    a = weights[:, None] * np.stack(columns, -1)
    norms = np.sqrt(np.sum(a**2, axis=1)) + 1e-300
    a = a / norms[:, None, :]
    gram = np.swapaxes(a, 1, 2) @ a + 1e-10 * np.eye(a.shape[-1])
    right = np.einsum("gnq,gn->gq", a, residual)
    solution = np.linalg.solve(gram, right[..., None])[..., 0]
    if pushed and not fixed_scale:
        column = 0 if record.initial_state is not None else responses.shape[-1] - 1
        gain = solution[:, column] / norms[:, column]
        scale = np.where(gain > 0, 1.0 / np.maximum(gain, 1e-12), np.nan)
    rss = np.sum(residual**2, axis=1) - np.sum(solution * right, axis=1)
    return np.where(np.isfinite(scale), rss, np.inf), np.where(np.isfinite(scale), scale, 1.0)
