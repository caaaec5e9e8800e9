"""The likelihood of the first samples: what a filter needs to begin, found from the data alone.

Given log-parameters, the motion of a linear system under a held force is linear and Gaussian, so the Kalman filter's
innovations give the exact likelihood of parameters, noise and unknown force (F. C. Schweppe, IEEE Trans. Information
Theory 11:61, 1965); for a nonlinear system the extended filter's are its approximation. It is maximised over

- the log-parameters of the layout,
- the logarithm of each sensor's noise,
- of each unknown force the logarithm of its standard deviation and what it keeps of itself over an interval,

from a scan: every frequency that the record resolves, several damping ratios and masses, of which the most likely few
are followed. The motion at first is unknown, and so are the
sensors' zeros. Nothing here knows a true value, and no level is set by hand.
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
"""Masses of the scan, over the one at which the known force alone would move the mass as far as it is seen to move."""
PUSHES = (0.05, 0.3)
"""Unknown forces of the scan, over the one that would move the mass that far within one radian."""
FOLLOWED = 4
"""Ends of the scan that are followed."""
ITERATIONS = 80
DRAWN = 600
"""Sets of parameters of the scan where there are several degrees of freedom."""
UNSETTLED = 2
"""First samples whose predictions say nothing of the parameters, for each unknown of the state at first."""
OPEN_LOG = 3.0
"""Standard deviation of a log-parameter before any sample: a factor of 20."""
OPEN = 10.0
"""Standard deviation of the motion at first, over what is seen of it."""
SPIKE = 8.0
"""Robust standard deviations of a sample off its neighbours, beyond which it is left out."""


@dataclass(frozen=True, eq=False)
class Head:
    """The first samples: values (n, n_sensors), NaN where one is missing, and told forces (n, n_forced)."""

    layout: Layout
    values: np.ndarray
    forces: np.ndarray

    @property
    def size(self) -> float:
        """Root mean square of the values about their means over all sensors."""
        return float(np.sqrt(np.mean(np.nanvar(self.values, axis=0)))) or 1.0

    def swing(self, omega: float) -> float:
        """Root mean square of the displacement, where it swings at ``omega``; the first sensor's kind is all's."""
        power = {"displacement": 0, "velocity": 1, "acceleration": 2}[self.layout.sensors[0].measures]
        return self.size / omega**power

    def frequency(self) -> float:
        """Where the periodogram of the first sensor is largest (rad/s)."""
        y = np.nan_to_num(self.values[:, 0] - np.nanmean(self.values[:, 0]))
        power = np.abs(np.fft.rfft(y * np.hanning(y.size))) ** 2
        top = 1 + int(np.argmax(power[1:]))
        return float(2 * np.pi * np.fft.rfftfreq(y.size, self.layout.interval)[top])

    def first(self, omega: float) -> np.ndarray:
        """Standard deviations before any sample of the motion and of the sensors' zeros, (n_motion + n_sensors,).

        The zero of a displacement under a known force is taken to be right: its mean may be that force's.
        """
        system, x, told = self.layout.system, OPEN * self.swing(omega), self.layout.scale_known
        zeros = np.sqrt(np.nanmean(self.values**2, axis=0)).tolist()
        shown = [
            0.0 if told and s.measures == "displacement" else z for s, z in zip(self.layout.sensors, zeros, strict=True)
        ]
        return np.array([x] * system.n_dof + [x * omega] * system.n_dof + [x] * system.n_hidden + shown)


@dataclass(frozen=True, eq=False)
class Levels:
    """Noise of each sensor, and of each unknown force its standard deviation (N) and what it keeps of itself."""

    sigma: np.ndarray
    push: np.ndarray
    memory: np.ndarray


@dataclass(frozen=True, eq=False)
class Beginning:
    """What the first samples tell: mean and covariance of the joint state at the last of them, and the levels.

    ``expected``, (n, n_sensors): each sample as it was expected before it was seen; NaN for the first ones.
    """

    mean: np.ndarray
    covariance: np.ndarray
    levels: Levels
    expected: np.ndarray


def beginning(head: Head) -> Beginning:
    """Find the most likely parameters and levels of the first samples, and the distribution after the last of them.

    Not finite where no start of the scan leads anywhere. Methods that follow the same stream share the answer.
    """
    return _beginning(head.layout, head.values.shape, head.values.tobytes(), head.forces.tobytes())


def without_spikes(values: np.ndarray) -> np.ndarray:
    """The first samples without single values far beyond both of their neighbours, by the spread of such distances."""
    values = values.copy()
    for column in values.T:
        middle = 0.5 * (column[:-2] + column[2:])
        off = column[1:-1] - middle
        scale = 1.4826 * np.nanmedian(np.abs(off - np.nanmedian(off)))
        far = np.abs(off) > SPIKE * scale
        column[1:-1][far] = np.nan
    return values


@lru_cache(maxsize=8)
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
    best, found = np.inf, starts[0]
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
            best, found = float(end.fun), end.x
    mean, covariance, expected = map(np.array, like.distribution(found, head.values, head.forces, first))
    return Beginning(mean, covariance, Likelihood(head.layout).parts(found)[1], expected)


def _limits(head: Head, start: np.ndarray) -> list[tuple[float, float]]:
    """Of each entry: a factor of 1e4 either way; noise between a part in 1e5 and three times what is seen.

    A force that keeps more than 95 % of itself over an interval would be a drift of the zero.
    """
    limits = [(s - 9.0, s + 9.0) for s in start]
    n, c, a = (len(part) for part in (head.layout.free, head.layout.sensors, head.layout.ambient))
    limits[n : n + c] = [(np.log(1e-5 * head.size), np.log(3.0 * head.size))] * c
    limits[n + c + a :] = [(-8.0, 3.0)] * a
    return limits


def _apart(starts: np.ndarray, values: np.ndarray, n_free: int) -> list[int]:
    """The best starts that differ from each other by 5 % in some parameter."""
    kept: list[int] = []
    for i in map(int, np.argsort(values)):
        if not np.isfinite(values[i]) or len(kept) == FOLLOWED:
            break
        if all(np.max(np.abs(starts[i, :n_free] - starts[j, :n_free])) > 0.05 for j in kept):
            kept.append(i)
    return kept or [0]


def _scan(head: Head) -> np.ndarray:
    """Starts (n, n_eta): parameters of every frequency that the record resolves, and levels."""
    layout = head.layout
    n, interval = len(head.values), layout.interval
    omegas = np.pi * np.arange(1, n) / (n * interval)
    masses = MASSES if layout.scale_known else (1.0,)
    pushes = PUSHES if layout.ambient else (0.0,)
    found = []
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
        found.append(np.concatenate([logs, levels, [-1.0] * len(layout.ambient)]))
    return np.array(found)


def _sizes(layout: Layout, mass: float, length: float, omega: float, ratio: float) -> np.ndarray:
    """The size of each free parameter by its dimension, for a mass that swings at ``omega`` with a damping ratio."""
    by_name = {p.name: p for p in layout.system.parameters}
    sizes = []
    for name in layout.free:
        p = by_name[name]
        size = dimension_scale(p.dimension, mass, length, 1.0 / omega)
        sizes.append(size * (2.0 * ratio if p.kind == "damping" else 1.0))
    return np.array(sizes)


@dataclass(frozen=True)
class Likelihood:
    """The negative log-likelihood of a layout: of one vector with its slope, and of many."""

    layout: Layout

    @cached_property
    def model(self) -> DiscreteModel:
        return DiscreteModel(self.layout)

    def parts(self, eta: Any) -> tuple[Any, Levels]:
        """Log-parameters and levels of a vector."""
        import jax.numpy as jnp

        xp: Any = np if isinstance(eta, np.ndarray) else jnp
        n, c, a = len(self.layout.free), len(self.layout.sensors), len(self.layout.ambient)
        sigma, push = xp.exp(eta[n : n + c]), xp.exp(eta[n + c : n + c + a])
        return eta[:n], Levels(sigma, push, 1.0 / (1.0 + xp.exp(-eta[n + c + a :])))

    def negative(self, eta: Any, values: Any, forces: Any, first: Any) -> Any:
        """The negative log-likelihood, of motions with standard deviations ``first`` before any sample."""
        return self._path(eta, values, forces, first)[0]

    def _path(self, eta: Any, values: Any, forces: Any, first: Any) -> tuple[Any, Any]:
        """The negative log-likelihood, and the filtered states but for the log-parameters, (n, d - n_free)."""
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
        """Mean and covariance of the joint state at the last sample, with no prior of the log-parameters.

        The joint filter about the path that the filter given ``eta`` has taken: one Gauss-Newton step from there. The
        last is what each sample was expected to be before it was seen, (n, n_sensors), by the filter given ``eta``; NaN
        for the first, whose errors are those of a motion that nobody knows yet.
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
        """Variances of the joint state before any sample, (d,)."""
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
        observe: what the sensors give of a state, under forces.
        advance: the state after an interval, under forces.
        distribution: mean and covariance before the first row.
        fresh: variances that the state gains an interval.
        levels: noise of the sensors.
        rows: values (n, n_sensors), forces (n, n_forced), states (n, d), or None: about the filter's own mean.
        fixed: slopes of both maps where they are the same for all rows.

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
        there = jnp.isfinite(y)
        line = straight(observe, mean if point is None else point, force, fixed[0])
        mean, cov, *_, gained = update(mean, cov, *line, levels.sigma**2, jnp.where(there, y, 0.0), there)
        line = straight(advance, mean if point is None else point, force, fixed[1])
        return (predict(*line, jnp.diag(fresh), mean, cov), total + gained), (mean, cov)

    (_, total), path = jax.lax.scan(step, (distribution, 0.0), rows)
    return total, path


class CompiledLikelihood(NamedTuple):
    """A likelihood compiled: of one vector with its slope, of many, and the distribution at one."""

    slope: Any
    many: Any
    distribution: Any


@lru_cache(maxsize=32)
def compiled(layout: Layout) -> CompiledLikelihood:
    """Compile the likelihood of a layout once a process, at the first call of each function."""
    import jax

    jax.config.update("jax_enable_x64", True)
    likelihood = Likelihood(layout)
    many = jax.vmap(likelihood.negative, in_axes=(0, None, None, None))
    return CompiledLikelihood(*map(jax.jit, (jax.value_and_grad(likelihood.negative), many, likelihood.distribution)))
