"""Start values from the data alone, and the plain output-error fit that screens them: shared by shooting and MCMC.

The misfit of a response has one minimum per half-period that the phase can slip over the record, so a local search
from a wrong frequency stays there. The cure is a scan: at given parameters the response of a *linear* system is
affine in its initial state, in the sensors' offsets and in 1 over the scale of its parameters against a known force,
so these are projected out (variable projection: G. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973) and what is
left is a function of stiffness and damping only, evaluated on a grid of frequency and decay. Its best separate minima
are the starts. Systems that are not linear, or have several degrees of freedom, are started from damped sinusoids
fitted to each displacement: a regression of the equation of motion on them gives the parameters
(:mod:`methods.starts.equation_error`).

Everything here expects a problem in its natural units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from bench import (
    Channel,
    Cost,
    Estimate,
    Force,
    InitialState,
    Normal,
    Prior,
    Problem,
    Record,
    SimulatedResponse,
    System,
    fitted_start,
    simulate,
    state_matrix,
)
from methods.starts.equation_error import CYCLE_STEP, DECAYS, MAX_CYCLES, regression_starts
from methods.starts.rough import RADIANS_A_STEP, Start, rough_readings

SIGMA_FLOOR = 1e-4
"""The noise assumed while fitting is at least this part of a channel's root mean square; see ``noise``."""
LOG_LIMIT = 40.0
NOISE_SHARE = 0.05
"""Error of the integration over the standard error that the data allow."""
HALVINGS = 4
"""How often the steps are halved at most."""
ALIAS_MARGIN = 6.0
"""By how much in minus twice the log-posterior: odds of 20 to 1."""
PRIORLESS_SD = 3.0
"""Log standard deviation, a factor of 20, of the prior on parameters that the problem has none for."""


@dataclass(frozen=True, eq=False)
class OutputError:
    """Measured minus simulated, as a function of one vector ``theta``, vectorised over many of them.

    ``theta`` holds the log-parameters (without the gauge mass, fixed at 1, where nothing tells the scale), then
    displacement and velocity at time 0 of each record whose start is unknown, then the unknown offsets.
    """

    problem: Problem

    @property
    def system(self) -> System:
        return self.problem.system

    @property
    def prior(self) -> Prior | None:
        return self.problem.prior

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        fixed = {self.system.gauge} if self.prior is None and not self.problem.scale_told else set()
        return tuple(name for name in self.system.names if name not in fixed)

    @cached_property
    def unknown_starts(self) -> tuple[int, ...]:
        return tuple(i for i, record in enumerate(self.problem.records) if record.initial_state is None)

    @cached_property
    def channels(self) -> tuple[tuple[int, Channel], ...]:
        """Record number and channel, in the order of the data."""
        return tuple((i, c) for i, record in enumerate(self.problem.records) for c in record.channels)

    @cached_property
    def offset_channels(self) -> tuple[int, ...]:
        return tuple(i for i, (_, channel) in enumerate(self.channels) if channel.offset)

    @property
    def size(self) -> int:
        return len(self.free) + 2 * self.system.n_dof * len(self.unknown_starts) + len(self.offset_channels)

    @cached_property
    def data(self) -> np.ndarray:
        return np.concatenate([channel.values for _, channel in self.channels])

    @cached_property
    def channel_of(self) -> np.ndarray:
        """The channel number of each sample, shape (N,)."""
        return np.repeat(np.arange(len(self.channels)), [channel.n for _, channel in self.channels])

    @cached_property
    def counts(self) -> np.ndarray:
        return np.array([channel.n for _, channel in self.channels])

    @cached_property
    def rms(self) -> np.ndarray:
        """Root mean square of each channel; 1 where it is all zeros."""
        sizes = [float(np.sqrt(np.mean(c.values**2))) if c.n else 0.0 for _, c in self.channels]
        return np.array([size if size > 0 else 1.0 for size in sizes])

    def parameters(self, theta: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters, each of the leading shape of ``theta``."""
        values = dict(zip(self.free, np.moveaxis(np.exp(theta[..., : len(self.free)]), -1, 0), strict=True))
        return {name: values.get(name, np.ones(theta.shape[:-1])) for name in self.system.names}

    def starts(self, theta: np.ndarray) -> list[Start]:
        """Initial state by record: the told one, or displacement and velocity of shape (n_dof, ...)."""
        n, at = self.system.n_dof, len(self.free)
        found: list[Start] = []
        for record in self.problem.records:
            if record.initial_state is not None:
                found.append(record.initial_state)
                continue
            part = np.moveaxis(theta[..., at : at + 2 * n], -1, 0)
            found.append((part[:n], part[n:]))
            at += 2 * n
        return found

    def offsets(self, theta: np.ndarray) -> np.ndarray:
        """One offset a channel (zero where there is none), shape (..., n_channels)."""
        all_offsets = np.zeros((*theta.shape[:-1], len(self.channels)))
        if self.offset_channels:
            all_offsets[..., list(self.offset_channels)] = theta[..., -len(self.offset_channels) :]
        return all_offsets

    def predict(self, theta: np.ndarray) -> np.ndarray:
        """Simulated measurements, shape (..., N); not finite where the response diverges."""
        p = self.parameters(theta)
        parts = [
            self.readings(p, start, record)
            for start, record in zip(self.starts(theta), self.problem.records, strict=True)
        ]
        return np.concatenate(parts, -1) + self.offsets(theta)[..., self.channel_of]

    def readings(self, p: dict[str, np.ndarray], start: Start, record: Record) -> np.ndarray:
        """What the sensors of a record would show, channel after channel, shape (..., n), without offsets."""
        return readings(self.system, p, start, record)

    def penalty(self, theta: np.ndarray) -> np.ndarray:
        """Standardised distances from the prior, shape (..., n_parameters); of no length without a prior."""
        if self.prior is None:
            return np.zeros((*theta.shape[:-1], 0))
        return self.prior.residuals(theta[..., : len(self.free)])

    def noise(self, residuals: np.ndarray, used: float, floor: float = SIGMA_FLOOR) -> np.ndarray:
        """Noise by channel, ``RSS / (N - used)`` with the degrees of freedom shared in proportion to the samples.

        Bounded below by ``floor`` of the channel's size: data that fit better than that (80 dB) would leave the prior
        no weight that double precision can resolve.
        """
        share = max(1.0 - used / self.data.size, 1.0 / self.data.size)
        rss = np.bincount(self.channel_of, residuals**2, len(self.channels))
        return np.maximum(np.sqrt(rss / (np.maximum(self.counts, 1) * share)), floor * self.rms)

    def profile(self, theta: np.ndarray) -> float:
        """Minus twice the log-posterior with the noise of each channel at its best value, up to a constant."""
        with np.errstate(all="ignore"):
            return self.profile_of(theta, self.data - self.predict(theta))

    def profile_of(self, theta: np.ndarray, residuals: np.ndarray) -> float:
        """The same, of residuals (N,) that are known already; infinite where they are not finite."""
        if not np.all(np.isfinite(residuals)):
            return np.inf
        sigma = self.noise(residuals, 0.0)
        return float(2 * self.counts @ np.log(sigma) + np.sum(self.penalty(theta) ** 2))

    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Prediction (..., N) and its derivatives (..., N, size), by central differences, at ``theta`` (..., size)."""
        d, k = theta.shape[-1], len(self.free)
        # one step for all log-parameters: raised together they change nothing where no force tells the scale, and the
        # errors of the differences, which cancel to the same degree then, would otherwise pass for information
        step = 1e-5 * np.where(np.arange(d) < k, 1.0, np.maximum(1.0, np.abs(theta)))
        moves = step[..., None] * np.eye(d)
        sets = np.concatenate([theta[..., None, :], theta[..., None, :] + moves, theta[..., None, :] - moves], axis=-2)
        with np.errstate(all="ignore"):
            predicted = self.predict(sets.reshape(-1, d)).reshape(*sets.shape[:-1], -1)
            slopes = (predicted[..., 1 : d + 1, :] - predicted[..., d + 1 :, :]) / (2 * step[..., None])
        return predicted[..., 0, :], np.swapaxes(slopes, -1, -2)

    def settle(self, thetas: np.ndarray, rounds: int = 2, iterations: int = 10) -> np.ndarray:
        """Fit and noise in turn, from each of ``thetas`` (starts, size), all starts simulated together."""
        for _ in range(rounds):
            with np.errstate(all="ignore"):
                residuals = self.data - self.predict(thetas)
            good = np.flatnonzero(np.all(np.isfinite(residuals), axis=-1))
            searches = [Search(self, thetas[i], self.noise(residuals[i], 0.0)) for i in good]
            for _ in range(iterations):
                going = [search for search in searches if not search.done]
                if not going:
                    break
                predicted, jacobian = self.jacobian(np.stack([search.trial for search in going]))
                for search, own, slopes in zip(going, predicted, jacobian, strict=True):
                    search.step(own, slopes)
            if searches:
                thetas = thetas.copy()
                thetas[good] = np.stack([search.kept for search in searches])
        return thetas

    def covariance(self, slopes: np.ndarray, sigma: np.ndarray, log_sd: float | None = None) -> np.ndarray | None:
        """Inverse of the Gauss-Newton Hessian over theta; None where the data and the prior leave a direction open.

        ``slopes`` (N, size) are the derivatives of the predictions, ``sigma`` the noise by channel; ``log_sd`` is the
        width of a prior on the log-parameters where the problem has none.
        """
        sigma, k = np.maximum(sigma, 1e-8 * self.rms), len(self.free)
        sds = self.prior.log_sds if self.prior is not None else np.full(k, log_sd or np.inf)
        rows = np.concatenate([slopes / sigma[self.channel_of][:, None], np.eye(k, slopes.shape[1]) / sds[:, None]])
        sizes = np.linalg.norm(rows, axis=0)
        if np.any(sizes == 0) or not np.all(np.isfinite(rows)) or len(rows) < rows.shape[1]:
            return None
        _, values, axes = np.linalg.svd(rows / sizes, full_matrices=False)
        if values[-1] < 1e-9 * values[0]:
            return None
        root = axes.T / values / sizes[:, None]
        return np.asarray(root @ root.T)

    def vector(self, p: dict[str, float]) -> np.ndarray:
        """``theta`` at parameters, with the initial states and offsets that fit the data best there."""
        theta = np.zeros(self.size)
        theta[: len(self.free)] = np.log([p[name] for name in self.free])
        at = len(self.free)
        for i in self.unknown_starts:
            start = fitted_start(self.system, p, self.problem.records[i])
            both = np.concatenate([start.displacement, start.velocity])
            theta[at : at + both.size] = np.where(np.isfinite(both), both, 0.0)
            at += both.size
        if self.offset_channels:
            with np.errstate(all="ignore"):
                residuals = self.data - self.predict(theta)
            means = [np.mean(residuals[self.channel_of == i]) for i in self.offset_channels]
            theta[at:] = np.where(np.isfinite(means), means, 0.0)
        return theta


class Search:
    """Levenberg-Marquardt on ``((y - h) / sigma)² + prior`` from one start: what to try, and the best vector so far."""

    def __init__(self, model: OutputError, theta: np.ndarray, sigma: np.ndarray, tolerance: float = 1e-6) -> None:
        self.model, self.weights, self.tolerance = model, 1.0 / sigma[model.channel_of], tolerance
        k = len(model.free)
        self.slope = np.zeros((0, theta.size))
        if model.prior is not None:
            self.slope = np.eye(k, theta.size) / model.prior.log_sds[:, None]
        self.trial = self.kept = theta
        self.damping, self.best, self.done = 1e-3, np.inf, False
        self.hessian, self.gradient = np.eye(theta.size), np.zeros(theta.size)

    def step(self, predicted: np.ndarray, jacobian: np.ndarray) -> None:
        """Judge the trial by its prediction (N,) and derivatives (N, size), and choose the next one."""
        model, k = self.model, len(self.model.free)
        r = np.concatenate([self.weights * (model.data - predicted), -model.penalty(self.trial)])
        cost = float(r @ r)
        if np.isfinite(cost) and np.all(np.isfinite(jacobian)) and cost < self.best:
            settled = self.best - cost < self.tolerance * max(cost, 1.0)
            j = np.concatenate([self.weights[:, None] * jacobian, self.slope])
            self.hessian, self.gradient, self.best, self.kept = j.T @ j, j.T @ r, cost, self.trial
            self.damping *= 0.3
            if settled:
                self.done = True
                return
        else:
            self.damping *= 8.0
        scaled = self.hessian + self.damping * np.diag(np.diag(self.hessian) + 1e-12)
        move = np.linalg.lstsq(scaled, self.gradient, rcond=None)[0]
        move[:k] = np.clip(move[:k], -1.5, 1.5)
        if np.max(np.abs(move) / np.maximum(1.0, np.abs(self.kept))) < 1e-10:
            self.done = True
            return
        trial = self.kept + move
        trial[:k] = np.clip(trial[:k], -LOG_LIMIT, LOG_LIMIT)
        self.trial = trial


@dataclass(frozen=True, eq=False)
class Stepped(OutputError):
    """The same, for a nonlinear system without hidden states, integrated by steps of at most so many radians."""

    radians: float = RADIANS_A_STEP

    def readings(self, p: dict[str, np.ndarray], start: Start, record: Record) -> np.ndarray:
        """As above; not finite where the response diverges."""
        return rough_readings(self.system, p, start, record, self.radians)


def readings(system: System, p: dict[str, np.ndarray], start: Start, record: Record) -> np.ndarray:
    """As :func:`bench.measurements`, with one simulation for all sensors that are read at the same times."""
    rig, motions, parts = record.rig(system), dict[bytes, Any](), []
    for channel in record.channels:
        key = channel.times.tobytes()
        if key not in motions:
            motions[key] = simulate(rig, p, start, channel.times, record.forces)
        parts.append(motions[key].measured(rig, p, channel, record))
    return np.concatenate(parts, axis=-1)


def estimate_at(
    model: OutputError, theta: np.ndarray, covariance: np.ndarray | None, used: float, cost: Cost, message: str = ""
) -> Estimate:
    """The answer that ``theta`` is, in the model's units: all parameters, or the groups where the gauge mass is fixed.

    ``covariance`` (size, size) is that of theta, Student's t with ``N - used`` degrees of freedom, or None.
    """
    system, k = model.system, len(model.free)
    dof = max(model.data.size - used, 1.0)
    p = {name: float(value) for name, value in model.parameters(theta).items()}
    starts = tuple(s if isinstance(s, InitialState) else InitialState(s[0], s[1]) for s in model.starts(theta))
    spread = None if covariance is None else covariance[:k, :k]
    parameters = groups = None
    if k == len(system.names):
        parameters = Normal(system.names, theta[:k], spread, log=True, dof=dof)
    else:
        # the gauge is 1 here, so a group is exp(weights . logs): first order (delta method) for its covariance
        powers = np.array([group.vector(model.free) for group in system.groups])
        values = np.array([group.value(p) for group in system.groups])
        if spread is not None:
            spread = values[:, None] * (powers @ spread @ powers.T) * values
        groups = Normal(tuple(group.name for group in system.groups), values, spread, log=False, dof=dof)
    return Estimate(
        system,
        parameters=parameters,
        groups=groups,
        reconstructions=tuple(
            SimulatedResponse(record.rig(system), p, start, record.forces)
            for start, record in zip(starts, model.problem.records, strict=True)
        ),
        initial_states=starts,
        offsets=tuple(map(float, model.offsets(theta))),
        message=message,
        cost=cost,
    )


def screening(model: OutputError) -> OutputError:
    """The model for comparing starts: of a nonlinear system without hidden states, less finely integrated."""
    return model if model.system.linear or model.system.n_hidden else Stepped(model.problem)


def as_fine_as_noise(model: OutputError, theta: np.ndarray) -> OutputError:
    """The model for a final answer near ``theta``, integrated to ``NOISE_SHARE`` of the standard error of the data.

    Steps are halved until that moves no sample by more: no law of the error holds where a force is not smooth.
    """
    quick = screening(model)
    if not isinstance(quick, Stepped):
        return model
    predicted = quick.predict(theta)
    sigma = model.noise(model.data - predicted, 0.0)
    allowed = NOISE_SHARE * sigma[model.channel_of] / np.sqrt(model.data.size)
    for _ in range(HALVINGS):
        finer = Stepped(model.problem, 0.5 * quick.radians)
        before, predicted = predicted, finer.predict(theta)
        if np.all(np.abs(predicted - before) <= allowed):
            break
        quick = finer
    return quick


def silent(problem: Problem) -> bool:
    """Whether no sensor shows any motion: every value zero, or constant where a constant offset is unknown."""
    return all(
        not np.any(c.values - (c.values[:1] if c.offset else 0.0))
        for record in problem.records
        for c in record.channels
    )


def screened(model: OutputError, n: int = 3, rounds: int = 2, iterations: int = 8) -> list[tuple[float, np.ndarray]]:
    """The best ``n`` separate starts after a few output-error steps each: (profile, theta), best first.

    The sampling is taken to resolve the motion: where the slowest oscillation of a linear system came to lie above
    half the sampling rate, it is dropped as the alias of a slower one, unless data and prior clearly prefer it.
    """
    found: list[tuple[float, np.ndarray]] = []
    quick = screening(model)
    thetas = np.stack([quick.vector(p) for p in candidates(model, n + 1)])
    for theta in quick.settle(thetas, rounds, iterations):
        value = quick.profile(theta)
        near = [other for _, other in found if np.max(np.abs(other - theta)[: len(model.free)]) < 1e-2]
        if np.isfinite(value) and not near:
            found.append((value, theta))
    found.sort(key=lambda pair: pair[0])
    resolved = [pair for pair in found if not _aliased(model, pair[1])]
    clear = not resolved or found[0][0] + ALIAS_MARGIN < resolved[0][0]
    return (found if clear else resolved)[:n]


def _aliased(model: OutputError, theta: np.ndarray) -> bool:
    if not model.system.linear:
        return False
    rates = np.linalg.eigvals(state_matrix(model.system, model.parameters(theta))[0])
    oscillations = np.abs(rates.imag)[np.abs(rates.imag) > 0]
    gaps = [float(np.median(np.diff(c.times))) for _, c in model.channels if c.n > 1]
    return bool(oscillations.size and gaps and oscillations.min() * min(gaps) > np.pi)


def candidates(model: OutputError, n: int) -> list[dict[str, float]]:
    """Parameter sets to start from, in natural units: from the scan, the regression, and the prior's nominal values."""
    problem = model.problem
    with np.errstate(all="ignore"):
        linear = problem.system.linear
        loaded = any(record.added_mass is not None for record in problem.records)
        found = (loaded_scan(problem, n) if loaded else scan(problem, n)) if linear else []
        if problem.system.n_dof > 1 or not linear:
            found = regression_starts(problem) + found
    if problem.prior is not None and (problem.system.n_dof > 1 or not linear or loaded):
        found.append(dict(problem.prior.nominal))
    good = [p for p in found if all(np.isfinite(v) and v > 0 for v in p.values())]
    return good or [dict(problem.prior.nominal) if problem.prior else dict.fromkeys(problem.system.names, 1.0)]


# ---------------------------------------------------------------------------------------------- linear systems


def scan(problem: Problem, n: int) -> list[dict[str, float]]:
    """The ``n`` best separate minima of the projected misfit over a grid of frequency and decay.

    The grid goes to half the sampling rate, and on to the rate itself as far as the prior expects the motion there.

    All stiffnesses are raised together, and all dampings, from the prior's nominal proportions or from equal ones;
    for one degree of freedom that is the whole space.
    """
    return [p for _, p in _minima(problem, n, problem.prior is not None)]


def _minima(problem: Problem, n: int, fixed_scale: bool) -> list[tuple[float, dict[str, float]]]:
    """Those minima and their misfits; ``fixed_scale`` says that the gauge is that of the problem's units."""
    names, base = problem.system.names, _proportions(problem)
    misfit: np.ndarray | float = 0.0
    strength: np.ndarray | float = 0.0
    grid = np.zeros((0, 2))
    resolved = max(_most_cycles(record) for record in problem.records)
    cycles = max(resolved, min(_expected_cycles(problem), 2 * resolved))
    for record in problem.records:
        grid, responses = _grid_responses(problem.system, base, _signature(record), cycles, _told(record))
        rss, scale = _projected(record, responses, fixed_scale)
        misfit, strength = misfit + rss, strength + scale / len(problem.records)
    table, scales = np.reshape(misfit, (-1, len(DECAYS))), np.reshape(strength, (-1, len(DECAYS)))
    found = []
    for i, j in _separate_minima(table)[:n]:
        frequency, decay = grid[i * len(DECAYS) + j]
        levels = _by_kind(problem.system, base, np.array(frequency), np.array(decay))
        found.append((table[i, j], {name: float(levels[name] * max(scales[i, j], 1e-12)) for name in names}))
    return found


def _proportions(problem: Problem) -> tuple[float, ...]:
    """The parameters over the first of their kind: as the prior has them, or all equal."""
    prior, system = problem.prior, problem.system
    if prior is None or system.n_dof == 1:
        return tuple(1.0 for _ in system.names)
    sizes = {"mass": prior.nominal[system.gauge]}
    for p in system.parameters:
        sizes.setdefault(p.kind, prior.nominal[p.name])
    return tuple(prior.nominal[p.name] / sizes[p.kind] for p in system.parameters)


def loaded_scan(problem: Problem, n: int) -> list[dict[str, float]]:
    """The starts of :func:`scan` where known masses were added in some records.

    The records of each load are scanned as if their rig were plain; :func:`unloaded` tells the mass from the lightest
    and the heaviest. Pairs of minima are taken in the order of their common misfit.
    """
    by_load = records_by_load(problem)
    loads = sorted(by_load)
    light = _minima(by_load[loads[0]], n, fixed_scale=False)
    heavy = _minima(by_load[loads[-1]], n, fixed_scale=False) if len(loads) > 1 else []
    pairs = []
    for misfit, p in light:
        for other, q in heavy:
            found = unloaded(problem, {loads[0]: p, loads[-1]: q})
            if found is not None:
                pairs.append((misfit + other, found))
    return [p for _, p in sorted(pairs, key=lambda pair: pair[0])[:n]] or [p for _, p in light]


def unloaded(problem: Problem, by_load: Mapping[float, Mapping[str, float]]) -> dict[str, float] | None:
    """Parameters of the rig from those that fit its records with each of two loads as if it were plain.

    Each tells ``r = k / (m + load)``, so that ``m = (r2 load2 - r1 load1) / (r1 - r2)``; None where that is not
    positive. Damping and stiffness over mass are the first one's. The masses of several degrees of freedom are taken
    to share the load, as a first guess.
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
    """The problem by the mass that was added in all, each part as if it had been on the plain rig."""
    parts: dict[float, list[Record]] = {}
    for record in problem.records:
        load = 0.0 if record.added_mass is None else float(np.sum(record.added_mass))
        parts.setdefault(load, []).append(replace(record, added_mass=None))
    return {load: replace(problem, records=tuple(records)) for load, records in parts.items()}


def _separate_minima(table: np.ndarray) -> list[tuple[int, int]]:
    """Row and column of the local minima along the rows' axis, best first."""
    table = np.where(np.isfinite(table), table, np.inf)
    best = table.min(axis=1)
    padded = np.concatenate([[np.inf], best, [np.inf]])
    rows = np.flatnonzero((best <= padded[:-2]) & (best <= padded[2:]) & np.isfinite(best))
    return [(int(i), int(table[i].argmin())) for i in sorted(rows, key=lambda i: best[i])]


def _most_cycles(record: Record) -> float:
    """Highest frequency of the scan in cycles per unit of time: half the sampling rate of the densest channel."""
    gaps = [float(np.median(np.diff(c.times))) for c in record.channels if c.n > 1]
    return float(min(0.5 / min(gaps, default=0.1), MAX_CYCLES))


def _expected_cycles(problem: Problem) -> float:
    """The same for what the prior expects: its frequency two standard deviations up; 0 without a prior.

    Rounded up to whole cycles, so that records with priors much alike share their grid.
    """
    if problem.prior is None:
        return 0.0
    system, prior = problem.system, problem.prior
    stiffness = next((p.name for p in system.parameters if p.kind == "stiffness"), system.gauge)
    log_rate = 0.5 * np.log(prior.nominal[stiffness] / prior.nominal[system.gauge])
    sd = 0.5 * np.hypot(prior.log_sd[stiffness], prior.log_sd[system.gauge])
    return float(min(np.ceil(np.exp(min(log_rate + 2 * sd, LOG_LIMIT)) / (2 * np.pi)), MAX_CYCLES))


def _by_kind(system: System, base: Sequence[float], frequency: np.ndarray, decay: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters with stiffness ``w² + d²`` and damping ``2 d`` over mass, times the base proportions."""
    w = 2 * np.pi * frequency
    sizes = {"mass": np.ones_like(w), "stiffness": w**2 + decay**2, "damping": 2 * decay, "other": np.ones_like(w)}
    return {p.name: b * sizes[p.kind] for p, b in zip(system.parameters, base, strict=True)}


Signature = tuple[tuple[tuple[bytes, str, int], ...], tuple[tuple[bytes, bytes, str, int], ...]]


def _signature(record: Record) -> Signature:
    """What decides the unit responses of a record; forces are taken relative to their common size."""
    size = _force_size(record)
    channels = tuple((np.round(c.times, 12).tobytes(), c.measures, c.dof) for c in record.channels)
    forces = tuple(
        (np.round(f.times, 12).tobytes(), np.round(f.values / size, 9).tobytes(), f.hold, f.dof) for f in record.forces
    )
    return channels, forces


def _force_size(record: Record) -> float:
    return max((float(np.max(np.abs(f.values))) for f in record.forces), default=0.0) or 1.0


def _whole(start: InitialState) -> np.ndarray:
    return np.concatenate([start.displacement, start.velocity])


def _told(record: Record) -> tuple[float, ...] | None:
    """A told start of several degrees of freedom: their 2 n_dof unit responses would fill the memory.

    Those of one are the same in every replicate, and kept.
    """
    start = record.initial_state
    return tuple(map(float, _whole(start))) if start is not None and start.displacement.size > 1 else None


@lru_cache(maxsize=8)
def _grid_responses(
    system: System, base: tuple[float, ...], signature: Signature, cycles: float, told: tuple[float, ...] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Grid points (G, 2) as (cycles, decay), and responses (G, N, S + 1): those to each start, then the force's.

    Starts: the ``told`` one, else 2 n_dof unit ones.
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
    starts = np.eye(2 * n) if told is None else np.array([told])
    responses = np.zeros((len(grid), sum(c.n for c in channels), len(starts) + 1))
    free, forced = Record(channels), Record(channels, forces)
    for i, start in enumerate(starts):
        state = np.broadcast_to(start[:, None], (2 * n, len(grid)))
        responses[..., i] = readings(system, p, (state[:n], state[n:]), free)
    if forces:
        rest = np.zeros((n, len(grid)))
        responses[..., -1] = readings(system, p, (rest, rest), forced)
    return grid, responses


def _projected(record: Record, responses: np.ndarray, fixed_scale: bool) -> tuple[np.ndarray, np.ndarray]:
    """Misfit left at each grid point once start, offsets and scale are fitted; and that scale of the parameters."""
    sizes = [float(np.sqrt(np.mean(c.values**2))) or 1.0 if c.n else 1.0 for c in record.channels]
    weights = np.concatenate([np.full(c.n, 1.0 / s) for c, s in zip(record.channels, sizes, strict=True)])
    y = np.concatenate([c.values for c in record.channels])
    columns, known = [], np.zeros(responses.shape[:2])
    if record.initial_state is not None:
        start = _whole(record.initial_state)
        known = known + (responses[..., 0] if _told(record) else responses[..., :-1] @ start)
    else:
        columns += [responses[..., i] for i in range(responses.shape[-1] - 1)]
    pushed = bool(record.forces) and bool(np.any(responses[..., -1]))
    if pushed and fixed_scale:
        known = known + responses[..., -1] * _force_size(record)
    elif pushed:
        columns.append(responses[..., -1] * _force_size(record))
    for c in record.channels:
        if c.offset:
            mine = np.concatenate([np.full(other.n, float(other is c)) for other in record.channels])
            columns.append(np.broadcast_to(mine, responses.shape[:2]))
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
        at = 0 if record.initial_state is not None else responses.shape[-1] - 1
        gain = solution[:, at] / norms[:, at]
        scale = np.where(gain > 0, 1.0 / np.maximum(gain, 1e-12), np.nan)
    rss = np.sum(residual**2, axis=1) - np.sum(solution * right, axis=1)
    return np.where(np.isfinite(scale), rss, np.inf), np.where(np.isfinite(scale), scale, 1.0)
