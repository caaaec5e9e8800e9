"""The likelihood of the first samples: what a filter needs to begin, found from the data alone.

Given log-parameters, the motion of a linear system under a held force is linear and Gaussian, so the Kalman filter's
innovations give the exact likelihood of parameters, noise and unknown force (F. C. Schweppe, IEEE Trans. Information
Theory 11:61, 1965); for a nonlinear system the extended filter's are its approximation. It is maximised over

- the log-parameters of the layout,
- the logarithm of each sensor's noise,
- of each unknown force the logarithm of its standard deviation and what it keeps of itself over an interval,

from a scan: every frequency that the record resolves, several damping ratios and masses, of which the most likely few
are followed. The motion at first is unknown. Nothing here knows a true value, and no level is set by hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from bench import HeldModel, Layout, dimension_scale
from methods.kalman.core import Affine, Update, predict, update

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
OPEN_LOG = 3.0
"""Standard deviation of a log-parameter before any sample: a factor of 20."""
OPEN = 10.0
"""Standard deviation of the motion at first, over what is seen of it."""


@dataclass(frozen=True, eq=False)
class Head:
    """The first samples: values (n, n_sensors), NaN where one is missing, and told forces (n, n_forced)."""

    layout: Layout
    values: np.ndarray
    forces: np.ndarray

    @property
    def size(self) -> float:
        """Root mean square of the values over all sensors."""
        return float(np.sqrt(np.nanmean(self.values**2))) or 1.0

    def frequency(self) -> float:
        """Where the periodogram of the first sensor is largest (rad/s)."""
        y = np.nan_to_num(self.values[:, 0] - np.nanmean(self.values[:, 0]))
        power = np.abs(np.fft.rfft(y * np.hanning(y.size))) ** 2
        top = 1 + int(np.argmax(power[1:]))
        return float(2 * np.pi * np.fft.rfftfreq(y.size, self.layout.interval)[top])

    def first_motion(self, omega: float) -> np.ndarray:
        """Standard deviations of the motion before any sample, shape (n_motion,)."""
        system, size = self.layout.system, OPEN * self.size
        kind = self.layout.sensors[0].measures
        x = size * {"displacement": 1.0, "velocity": 1.0 / omega, "acceleration": 1.0 / omega**2}[kind]
        return np.array([x] * system.n_dof + [x * omega] * system.n_dof + [x] * system.n_hidden)


@dataclass(frozen=True, eq=False)
class Levels:
    """Noise of each sensor, and of each unknown force its standard deviation (N) and what it keeps of itself."""

    sigma: np.ndarray
    push: np.ndarray
    memory: np.ndarray


@dataclass(frozen=True, eq=False)
class Beginning:
    """What the first samples tell: mean and covariance of the joint state at the last of them, and the levels."""

    mean: np.ndarray
    covariance: np.ndarray
    levels: Levels
    log_likelihood: float


def beginning(head: Head) -> Beginning:
    """Find the most likely parameters and levels of the first samples, and the belief after the last of them.

    Not finite where no start of the scan leads anywhere. Methods that follow the same stream share the answer.
    """
    return _beginning(head.layout, head.values.shape, head.values.tobytes(), head.forces.tobytes())


@lru_cache(maxsize=8)
def _beginning(layout: Layout, shape: tuple[int, int], values: bytes, forces: bytes) -> Beginning:
    given = np.frombuffer(forces).reshape(shape[0], len(layout.forced))
    return _searched(Head(layout, np.frombuffer(values).reshape(shape), given))


def _searched(head: Head) -> Beginning:
    from scipy.optimize import minimize  # slow to import

    like = compiled(head.layout)
    first = head.first_motion(head.frequency())
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
            objective, starts[i], jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": ITERATIONS}
        )
        if end.fun < best:
            best, found = float(end.fun), end.x
    mean, covariance = like.belief(found, head.values, head.forces, first)
    return Beginning(np.array(mean), np.array(covariance), like.parts(found)[1], -best)


def _limits(head: Head, start: np.ndarray) -> list[tuple[float, float]]:
    """Of each entry: a factor of 1e4 either way; noise between a part in 1e5 and three times what is seen."""
    limits = [(s - 9.0, s + 9.0) for s in start]
    n, c, a = (len(part) for part in (head.layout.free, head.layout.sensors, head.layout.ambient))
    limits[n : n + c] = [(np.log(1e-5 * head.size), np.log(3.0 * head.size))] * c
    limits[n + c + a :] = [(-8.0, 6.0)] * a
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
    masses = MASSES if layout.scale_told else (1.0,)
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
        size = head.size
        mass = mass * drive / (size * omega**2) if layout.scale_told else 1.0
        jitter = rng.normal(0.0, 0.5 if layout.system.n_dof > 1 else 0.0, len(layout.free))
        logs = np.log(_sizes(layout, mass, size, omega, ratio)) + jitter
        force = push * mass * size * omega**2
        levels = [np.log(0.3 * size)] * len(layout.sensors) + [np.log(max(force, 1e-300))] * len(layout.ambient)
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


class Likelihood:
    """The negative log-likelihood of a layout, compiled: of one vector with its slope, and of many."""

    def __init__(self, layout: Layout) -> None:
        """Compile nothing yet; the first call does."""
        import jax

        jax.config.update("jax_enable_x64", True)
        self.layout, self.model = layout, HeldModel(layout)
        self.slope = jax.jit(jax.value_and_grad(self._negative))
        self.many = jax.jit(jax.vmap(self._negative, in_axes=(0, None, None, None)))
        self.belief = jax.jit(self._belief)

    def parts(self, eta: Any) -> tuple[Any, Levels]:
        """Log-parameters and levels of a vector."""
        import jax.numpy as jnp

        xp: Any = np if isinstance(eta, np.ndarray) else jnp
        n, c, a = len(self.layout.free), len(self.layout.sensors), len(self.layout.ambient)
        sigma, push = xp.exp(eta[n : n + c]), xp.exp(eta[n + c : n + c + a])
        return eta[:n], Levels(sigma, push, 1.0 / (1.0 + xp.exp(-eta[n + c + a :])))

    def _negative(self, eta: Any, values: Any, forces: Any, first: Any) -> Any:
        return self._path(eta, values, forces, first)[0]

    def _path(self, eta: Any, values: Any, forces: Any, first: Any) -> tuple[Any, Any]:
        """The negative log-likelihood, and the filtered motion and force, (n, n_motion + n_ambient)."""
        import jax
        import jax.numpy as jnp

        model, layout = self.model, self.layout
        logs, levels = self.parts(eta)
        k = model.n_motion + model.n_ambient
        rest = jnp.concatenate([jnp.zeros(model.n_sensors), logs])

        def advance(state: Any, force: Any) -> Any:
            return model.advance(jnp.concatenate([state, rest]), force, layout.interval, levels.memory)[:k]

        def observe(state: Any, force: Any) -> Any:
            return model.observe(jnp.concatenate([state, rest]), force)

        zero, still = jnp.zeros(k), jnp.zeros(len(layout.forced))
        first_cov = jnp.diag(jnp.concatenate([first**2, levels.push**2]))
        fresh = jnp.concatenate([jnp.zeros(model.n_motion), levels.push**2 * (1.0 - levels.memory**2)])
        fixed = (jax.jacfwd(observe)(zero, still), jax.jacfwd(advance)(zero, still)) if layout.system.linear else None

        def step(carry: tuple[Any, Any, Any], inputs: tuple[Any, Any]) -> tuple[Any, Any]:
            mean, cov, total = carry
            y, force = inputs
            updated = _updated(lambda s: observe(s, force), mean, cov, mean, levels, y, fixed and fixed[0])
            mean = updated.mean
            affine = _tangent(lambda s: advance(s, force), mean, fixed and fixed[1], fresh)
            return (*predict(affine, mean, updated.covariance), total - updated.likelihood), mean

        carry, means = jax.lax.scan(step, (zero, first_cov, 0.0), (values, forces))
        return carry[2], means

    def _belief(self, eta: Any, values: Any, forces: Any, first: Any) -> tuple[Any, Any]:
        """Mean and covariance of the joint state at the last sample, with no prior of the log-parameters.

        The joint filter about the path that the filter given ``eta`` has taken: one Gauss-Newton step from there.
        """
        import jax
        import jax.numpy as jnp

        model, layout = self.model, self.layout
        logs, levels = self.parts(eta)
        path = self._path(eta, values, forces, first)[1]
        rest = jnp.broadcast_to(jnp.concatenate([jnp.zeros(model.n_sensors), logs]), (len(path), layout_size(model)))
        about = jnp.concatenate([path, rest], axis=1)
        fresh = jnp.zeros(model.size).at[model.ambient].set(levels.push**2 * (1.0 - levels.memory**2))
        cov = jnp.zeros(model.size).at[: model.n_motion].set(first**2)
        cov = cov.at[model.ambient].set(levels.push**2).at[model.logs].set(OPEN_LOG**2)
        mean = jnp.zeros(model.size).at[model.logs].set(logs)

        def step(carry: tuple[Any, Any], inputs: tuple[Any, Any, Any]) -> tuple[Any, Any]:
            y, force, point = inputs
            mean, cov, *_ = _updated(lambda s: model.observe(s, force), *carry, point, levels, y)
            affine = _tangent(lambda s: model.advance(s, force, layout.interval, levels.memory), point, None, fresh)
            return predict(affine, mean, cov), (mean, cov)

        means, covs = jax.lax.scan(step, (mean, jnp.diag(cov)), (values, forces, about))[1]
        return means[-1], covs[-1]


def _tangent(function: Any, point: Any, slopes: Any, fresh: Any) -> Affine:
    """A map about a joint state, with the variances of its process noise; its slopes where they are not known."""
    import jax
    import jax.numpy as jnp

    slopes = jax.jacfwd(function)(point) if slopes is None else slopes
    return Affine(slopes, function(point) - slopes @ point, jnp.diag(fresh))


def _updated(observe: Any, mean: Any, cov: Any, point: Any, levels: Levels, y: Any, slopes: Any = None) -> Update:
    """A belief after a sample, NaN where a sensor gave nothing; the measurement about a joint state."""
    import jax.numpy as jnp

    there, affine = jnp.isfinite(y), _tangent(observe, point, slopes, 0.0 * levels.sigma)
    return update(mean, cov, affine.slopes, affine.constants, levels.sigma**2, jnp.where(there, y, 0.0), there)


def layout_size(model: HeldModel) -> int:
    """Entries of the joint state behind motion and unknown force."""
    return model.n_sensors + model.n_free


@lru_cache(maxsize=32)
def compiled(layout: Layout) -> Likelihood:
    """The likelihood of a layout, compiled once a process."""
    return Likelihood(layout)
