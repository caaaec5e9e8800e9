"""The likelihood of output error: measured minus simulated, as a function of one vector of unknowns, and its maximum.

With Gaussian noise minus twice the log-posterior is ``sum ((y - h) / sigma)² + sum ((log p - log nominal) / sd)²`` up
to the noise level's own term (L. Ljung, System Identification, 2nd ed. 1999, chapters 7 and 10). It is for a problem in
its natural units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.contract.belief import Normal
from bench.contract.estimate import Cost, Estimate
from bench.contract.prior import Prior
from bench.contract.problem import Channel, InitialState, Problem, Record
from bench.dynamics.simulate import SimulatedResponse, fitted_start, measurements
from bench.systems import System

SIGMA_FLOOR = 1e-4
"""The noise assumed while fitting is at least this part of a channel's root mean square; see ``noise``."""
LOG_LIMIT = 40.0
"""Largest size of a log-parameter in a search."""

Start = InitialState | tuple[np.ndarray, np.ndarray]
"""A start as it is told, or displacement and velocity of shape (n_dof, ...) of many sets at once."""


@dataclass(frozen=True, eq=False)
class OutputError:
    """Measured minus simulated, as a function of one vector ``theta``, vectorised over many of them.

    ``theta`` holds the log-parameters (without the gauge mass, held at ``gauge``, where nothing tells the scale), then
    displacement and velocity at time 0 of each record whose start is unknown, then the unknown offsets.
    """

    problem: Problem
    gauge: float = 1.0

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
        return {name: values.get(name, np.full(theta.shape[:-1], self.gauge)) for name in self.system.names}

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
        return measurements(self.system, p, start, record)

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


class Standardised:
    """Residuals over the noise, and distances from the prior, with their derivatives, for a least-squares solver.

    One simulation of many sets serves both, unless residuals are to be ``exact``: a nonlinear motion is integrated more
    accurately alone (:func:`bench.dynamics.simulate.simulate`). ``evaluations`` counts simulated responses.
    """

    def __init__(self, model: OutputError, sigma: np.ndarray, exact: bool = False) -> None:
        self.model, self.weights, self.evaluations = model, 1.0 / sigma[model.channel_of], 0
        self.exact = exact
        self._at, self._slopes = np.full(model.size, np.nan), np.zeros((0, model.size))

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """Shape (N + parameters,)."""
        predicted, slopes = self.model.jacobian(theta)
        self.evaluations += 2 * self.model.size + 1
        # a neighbour that diverged says nothing of the slope
        self._at, self._slopes = theta.copy(), np.where(np.isfinite(slopes), slopes, 0.0)
        if self.exact:
            predicted = self.model.predict(theta)
        return np.concatenate([(predicted - self.model.data) * self.weights, self.model.penalty(theta)])

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Derivatives of :meth:`residuals`, shape (N + parameters, size)."""
        if not np.array_equal(theta, self._at):
            self.residuals(theta)
        rows, prior = self._slopes * self.weights[:, None], self.model.prior
        if prior is None:
            return rows
        return np.concatenate([rows, np.eye(len(self.model.free), theta.size) / prior.log_sds[:, None]])


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
