"""Initialisation of a filter by maximum likelihood of the first samples.

Given log-parameters, the motion of a linear system under a held force is linear and Gaussian, so the Kalman filter's
innovations give the exact likelihood of parameters, noise and unknown force (F. C. Schweppe, IEEE Trans. Information
Theory 11:61, 1965); for a nonlinear system the extended filter gives an approximation. It is maximised over

- the log-parameters of the layout,
- the logarithm of each sensor's noise,
- the logarithm of each unknown force's standard deviation, and the logit of its autocorrelation over an interval.

The initial guesses come from a scan over every resolved frequency and several damping ratios and masses, the best few
of which are optimised. The initial state and the sensors' zeros are unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from bench import DiscreteModel, Layout, dimension_scale
from methods.kalman.core import predict, update

RATIOS = (0.01, 0.05, 0.25)
"""Damping ratios of the scan."""
MASSES = (0.1, 0.4, 1.0, 2.5, 10.0)
"""Masses of the scan, over the mass at which the known force alone causes the measured displacement."""
PUSHES = (0.05, 0.3)
"""Unknown forces of the scan, over the force that causes that displacement within one radian."""
FOLLOWED = 4
"""Number of guesses that are optimised."""
ITERATIONS = 80
DRAWN = 600
"""Random guesses of the scan for several degrees of freedom."""
UNSETTLED = 2
"""First samples without a prediction, per unknown of the initial state."""
OPEN_LOG = 3.0
"""Prior standard deviation of a log-parameter: a factor of 20."""
OPEN = 10.0
"""Prior standard deviation of the initial state, over the size of the measured motion."""
SPIKE = 8.0
"""A sample further from its neighbours' mean than this many robust standard deviations is omitted."""


@dataclass(frozen=True, eq=False)
class Head:
    """The first samples: values (n, n_sensors), NaN where missing, and known forces (n, n_forced)."""

    layout: Layout
    values: np.ndarray
    forces: np.ndarray

    @property
    def size(self) -> float:
        """Return the root mean square over all sensors of the values about their means."""
        return float(np.sqrt(np.mean(np.nanvar(self.values, axis=0)))) or 1.0

    def swing(self, omega: float) -> float:
        """Return the root mean square displacement of a motion at ``omega`` (rad/s), by the first sensor's kind."""
        power = {"displacement": 0, "velocity": 1, "acceleration": 2}[self.layout.sensors[0].measures]
        return self.size / omega**power

    def frequency(self) -> float:
        """Return the angular frequency (rad/s) at which the first sensor's periodogram is largest."""
        y = np.nan_to_num(self.values[:, 0] - np.nanmean(self.values[:, 0]))
        power = np.abs(np.fft.rfft(y * np.hanning(y.size))) ** 2
        top = 1 + int(np.argmax(power[1:]))
        return float(2 * np.pi * np.fft.rfftfreq(y.size, self.layout.interval)[top])

    def first(self, omega: float) -> np.ndarray:
        """Return the prior standard deviations of the motion and of the sensors' zeros, (n_motion + n_sensors,).

        A displacement sensor's zero is taken as exact under a known force, which may cause the mean of its values.
        """
        system, x = self.layout.system, OPEN * self.swing(omega)
        sizes = np.sqrt(np.nanmean(self.values**2, axis=0)).tolist()
        exact = [self.layout.scale_known and sensor.measures == "displacement" for sensor in self.layout.sensors]
        zeros = [0.0 if is_exact else size for is_exact, size in zip(exact, sizes, strict=True)]
        return np.array([x] * system.n_dof + [x * omega] * system.n_dof + [x] * system.n_hidden + zeros)


@dataclass(frozen=True, eq=False)
class Levels:
    """Noise of each sensor, and standard deviation (N) and autocorrelation of each unknown force."""

    sigma: np.ndarray
    push: np.ndarray
    memory: np.ndarray


@dataclass(frozen=True, eq=False)
class Beginning:
    """Mean and covariance of the joint state at the last of the first samples, and the noise levels.

    ``expected``, (n, n_sensors): one-step predictions of the samples; NaN for the first ones.
    """

    mean: np.ndarray
    covariance: np.ndarray
    levels: Levels
    expected: np.ndarray


def beginning(head: Head) -> Beginning:
    """Maximise the likelihood of the first samples; return the distribution after the last of them.

    It is not finite where every search fails. The result is cached, for several trackers of the same stream.
    """
    return _beginning(head.layout, head.values.shape, head.values.tobytes(), head.forces.tobytes())


def without_spikes(values: np.ndarray) -> np.ndarray:
    """Replace spikes, single values far from the mean of their neighbours, by NaN."""
    values = values.copy()
    for column in values.T:
        middle = 0.5 * (column[:-2] + column[2:])
        off = column[1:-1] - middle
        scale = 1.4826 * np.nanmedian(np.abs(off - np.nanmedian(off)))
        far = np.abs(off) > SPIKE * scale
        column[1:-1][far] = np.nan
    return values


@lru_cache(maxsize=128)
def _beginning(layout: Layout, shape: tuple[int, int], values: bytes, forces: bytes) -> Beginning:
    given = np.frombuffer(forces).reshape(shape[0], len(layout.forced))
    return _searched(Head(layout, np.frombuffer(values).reshape(shape), given))


def _searched(head: Head) -> Beginning:
    from scipy.optimize import minimize  # slow to import

    like = compiled(head.layout)
    first = head.first(head.frequency())
    starts = _scan(head)
    values = np.asarray(like.many(starts, head.values, head.forces, first))
    values = np.where(np.isfinite(values), values, np.inf)
    best, best_eta = np.inf, starts[0]
    for i in _apart(starts, values, len(head.layout.free)):

        def objective(eta: np.ndarray) -> tuple[float, np.ndarray]:
            value, slope = like.slope(eta, head.values, head.forces, first)
            value, slope = float(value), np.asarray(slope)
            good = np.isfinite(value) and np.all(np.isfinite(slope))
            return (value, slope) if good else (1e12, np.zeros_like(eta))

        limits = _limits(head, starts[i])
        end = minimize(
            objective,
            starts[i],
            jac=True,
            method="L-BFGS-B",
            bounds=limits,
            options={"maxiter": ITERATIONS, "ftol": 1e-7},
        )
        if end.fun < best:
            best, best_eta = float(end.fun), end.x
    mean, covariance, expected = map(np.array, like.distribution(best_eta, head.values, head.forces, first))
    return Beginning(mean, covariance, Likelihood(head.layout).parts(best_eta)[1], expected)


def _limits(head: Head, start: np.ndarray) -> list[tuple[float, float]]:
    """Return the bounds of each entry: a factor of ``exp(9)`` either way; noise from 1e-5 to 3 times the values' size.

    An unknown force with an autocorrelation above 95 % would be a drift of the zero.
    """
    limits = [(s - 9.0, s + 9.0) for s in start]
    n, c, a = (len(part) for part in (head.layout.free, head.layout.sensors, head.layout.ambient))
    limits[n : n + c] = [(np.log(1e-5 * head.size), np.log(3.0 * head.size))] * c
    limits[n + c + a :] = [(-8.0, 3.0)] * a
    return limits


def _apart(starts: np.ndarray, values: np.ndarray, n_free: int) -> list[int]:
    """Return the indices of the best guesses that differ from each other by 5 % in some parameter."""
    kept: list[int] = []
    for i in map(int, np.argsort(values)):
        if not np.isfinite(values[i]) or len(kept) == FOLLOWED:
            break
        if all(np.max(np.abs(starts[i, :n_free] - starts[j, :n_free])) > 0.05 for j in kept):
            kept.append(i)
    return kept or [0]


def _scan(head: Head) -> np.ndarray:
    """Return initial guesses (n, n_eta): parameters for every resolved frequency, and noise levels."""
    layout = head.layout
    n, interval = len(head.values), layout.interval
    omegas = np.pi * np.arange(1, n) / (n * interval)
    masses = MASSES if layout.scale_known else (1.0,)
    pushes = PUSHES if layout.ambient else (0.0,)
    guesses = []
    rng = np.random.default_rng(0)
    grid = [(w, z, m, u) for w in omegas for z in RATIOS for m in masses for u in pushes]
    if layout.system.n_dof > 1 or len(layout.free) > 3:
        top = head.frequency()
        grid = [(top * np.exp(rng.normal(0, 0.3)), rng.choice(RATIOS), rng.choice(masses), rng.choice(pushes))
                for _ in range(DRAWN)]  # fmt: skip
    drive = float(np.sqrt(np.mean(head.forces**2))) if layout.forced else 1.0
    for omega, ratio, mass, push in grid:
        size = head.swing(omega)
        mass = mass * drive / (size * omega**2) if layout.scale_known else 1.0
        jitter = rng.normal(0.0, 0.5 if layout.system.n_dof > 1 else 0.0, len(layout.free))
        logs = np.log(_sizes(layout, mass, size, omega, ratio)) + jitter
        force = push * mass * size * omega**2
        levels = [np.log(0.3 * head.size)] * len(layout.sensors) + [np.log(max(force, 1e-300))] * len(layout.ambient)
        guesses.append(np.concatenate([logs, levels, [-1.0] * len(layout.ambient)]))
    return np.array(guesses)


def _sizes(layout: Layout, mass: float, length: float, omega: float, ratio: float) -> np.ndarray:
    """Return the size of each free parameter, for a mass oscillating at ``omega`` with a damping ratio."""
    by_name = {p.name: p for p in layout.system.parameters}
    sizes = []
    for name in layout.free:
        p = by_name[name]
        size = dimension_scale(p.dimension, mass, length, 1.0 / omega)
        sizes.append(size * (2.0 * ratio if p.kind == "damping" else 1.0))
    return np.array(sizes)


@dataclass(frozen=True)
class Likelihood:
    """The negative log-likelihood of a layout."""

    layout: Layout

    @cached_property
    def model(self) -> DiscreteModel:
        return DiscreteModel(self.layout)

    def parts(self, eta: Any) -> tuple[Any, Levels]:
        """Split a vector into log-parameters and noise levels."""
        import jax.numpy as jnp

        xp: Any = np if isinstance(eta, np.ndarray) else jnp
        n, c, a = len(self.layout.free), len(self.layout.sensors), len(self.layout.ambient)
        sigma, push = xp.exp(eta[n : n + c]), xp.exp(eta[n + c : n + c + a])
        return eta[:n], Levels(sigma, push, 1.0 / (1.0 + xp.exp(-eta[n + c + a :])))

    def negative(self, eta: Any, values: Any, forces: Any, first: Any) -> Any:
        """Return the negative log-likelihood; ``first``: prior standard deviations (:meth:`Head.first`)."""
        return self._path(eta, values, forces, first)[0]

    def _path(self, eta: Any, values: Any, forces: Any, first: Any) -> tuple[Any, Any]:
        """Return the negative log-likelihood, and the filtered states without log-parameters, (n, d - n_free)."""
        import jax
        import jax.numpy as jnp

        model, layout = self.model, self.layout
        logs, levels = self.parts(eta)
        k = model.logs.start

        def advance(state: Any, force: Any) -> Any:
            return model.advance(jnp.concatenate([state, logs]), force, layout.interval, levels.memory)[:k]

        def observe(state: Any, force: Any) -> Any:
            return model.observe(jnp.concatenate([state, logs]), force)

        distribution = jnp.zeros(k), jnp.diag(self._first(first, levels)[:k])
        fresh = jnp.zeros(k).at[model.ambient].set(levels.push**2 * (1.0 - levels.memory**2))
        fixed = None, None
        if layout.system.linear:  # one matrix for all samples
            still = jnp.zeros(len(layout.forced))
            fixed = jax.jacfwd(observe)(distribution[0], still), jax.jacfwd(advance)(distribution[0], still)
        total, (means, _) = _filtered(observe, advance, distribution, fresh, levels, (values, forces, None), fixed)
        return -total, means

    def distribution(self, eta: Any, values: Any, forces: Any, first: Any) -> tuple[Any, Any, Any]:
        """Return mean and covariance of the joint state at the last sample, and one-step predictions (n, n_sensors).

        The joint filter is linearised about the path of the filter at ``eta``, which makes one Gauss-Newton step from
        there. The predictions are those of the filter at ``eta``; NaN for the first samples, whose errors come from
        the unknown initial state.
        """
        import jax
        import jax.numpy as jnp

        model, layout = self.model, self.layout
        logs, levels = self.parts(eta)
        path = self._path(eta, values, forces, first)[1]
        about = jnp.concatenate([path, jnp.broadcast_to(logs, (len(path), len(logs)))], axis=1)
        fresh = jnp.zeros(model.size).at[model.ambient].set(levels.push**2 * (1.0 - levels.memory**2))
        distribution = jnp.zeros(model.size).at[model.logs].set(logs), jnp.diag(self._first(first, levels))

        def advance(state: Any, force: Any) -> Any:
            return model.advance(state, force, layout.interval, levels.memory)

        _, (means, covs) = _filtered(model.observe, advance, distribution, fresh, levels, (values, forces, about))
        expected = jax.vmap(lambda state, before, now: model.observe(advance(state, before), now))(
            about[:-1], forces[:-1], forces[1:]
        )
        unsettled = UNSETTLED * model.logs.start
        expected = jnp.concatenate([jnp.full((1, model.n_sensors), jnp.nan), expected]).at[:unsettled].set(jnp.nan)
        return means[-1], covs[-1], expected

    def _first(self, first: Any, levels: Levels) -> Any:
        """Return the prior variances of the joint state, (d,)."""
        import jax.numpy as jnp

        n = self.model.n_motion
        return jnp.concatenate(
            [first[:n] ** 2, levels.push**2, first[n:] ** 2, jnp.full(self.model.n_free, OPEN_LOG**2)]
        )


def _filtered(
    observe: Any, advance: Any, distribution: Any, fresh: Any, levels: Levels, rows: Any, fixed: Any = (None, None)
) -> tuple[Any, Any]:
    """Run an extended Kalman filter over rows of values (NaN: missing), forces and the states to linearise about.

    Args:
        observe: Measurement function of state and forces.
        advance: State transition over an interval, of state and forces.
        distribution: Mean and covariance before the first row.
        fresh: Variances of the process noise per interval.
        levels: Noise of the sensors.
        rows: Values (n, n_sensors), forces (n, n_forced), states (n, d) to linearise about, or None for the mean.
        fixed: Jacobians of both functions where they are the same for all rows.

    Returns:
        The log-likelihood, and means (n, d) and covariances (n, d, d) after each row.
    """
    import jax
    import jax.numpy as jnp

    def straight(function: Any, point: Any, force: Any, slopes: Any) -> tuple[Any, Any]:
        slopes = jax.jacfwd(function)(point, force) if slopes is None else slopes
        return slopes, function(point, force) - slopes @ point

    def step(carry: Any, row: Any) -> Any:
        (mean, cov), total = carry
        y, force, point = row
        measured = jnp.isfinite(y)
        line = straight(observe, mean if point is None else point, force, fixed[0])
        mean, cov, *_, gained = update(mean, cov, *line, levels.sigma**2, jnp.where(measured, y, 0.0), measured)
        line = straight(advance, mean if point is None else point, force, fixed[1])
        return (predict(*line, jnp.diag(fresh), mean, cov), total + gained), (mean, cov)

    (_, total), path = jax.lax.scan(step, (distribution, 0.0), rows)
    return total, path


class CompiledLikelihood(NamedTuple):
    """Compiled functions: negative log-likelihood with gradient, the same of many vectors, and the distribution."""

    slope: Any
    many: Any
    distribution: Any


@lru_cache(maxsize=32)
def compiled(layout: Layout) -> CompiledLikelihood:
    """Return the likelihood functions of a layout, compiled at the first call of each."""
    import jax

    jax.config.update("jax_enable_x64", True)
    likelihood = Likelihood(layout)
    many = jax.vmap(likelihood.negative, in_axes=(0, None, None, None))
    return CompiledLikelihood(*map(jax.jit, (jax.value_and_grad(likelihood.negative), many, likelihood.distribution)))
