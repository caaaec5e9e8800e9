"""A Bayesian PINN: Hamiltonian Monte Carlo over all weights and parameters.

L. Yang, X. Meng and G. Karniadakis, J. Comput. Phys. 425:109913, 2021: a standard normal prior of the weights, and the
likelihood of data and equation of motion. The sampler is blackjax's NUTS (M. D. Hoffman and A. Gelman, J. Mach. Learn.
Res. 15:1593, 2014), in the coordinates of :mod:`methods.pinn_family.beliefs.output_layer`, from the trained point.

The hidden weights are stiff even so, and what the step size allows them would hold up the parameters: a first warm-up
finds their step, and they are then as heavy as makes it that of the others.

Two chains. Whether they agree is judged on parameters, offsets, the displacement at :data:`PLACES` times, and the log
density, by the split R-hat and the effective draws of A. Vehtari et al., Bayesian Analysis 16:667, 2021; not on
weights, of which many permutations give the same function of time. The answer says where they do not.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from bench import NoEstimate, Status
from methods.pinn_family.beliefs.output_layer import Coordinates
from methods.pinn_family.beliefs.trained import Posterior, Said, TrainedFit, from_draws

CHAINS = 2
WARMUP = (60, 40)
"""Steps of the two warm-ups of a chain."""
DRAWS = 150
"""Draws of a chain."""
DOUBLINGS = 4
"""The most doublings of a path: up to 15 gradients a draw."""
STEP = 0.3
"""The step that output layer and parameters should have."""
R_HAT, EFFECTIVE = 1.05, 50.0
"""The largest R-hat and the least effective draws that are believed."""
PLACES = 10


def stated(posterior: Posterior, fit: TrainedFit, rng: np.random.Generator, members: int) -> TrainedFit:
    """Draws of all weights and parameters."""
    coordinates = Coordinates(posterior)
    chains = [_chain(coordinates, rng) for _ in range(CHAINS)]
    paths = np.stack([own[0] for own in chains])
    gradients = sum(own[2] for own in chains)
    draws = [coordinates.point(u) for u in paths.reshape(-1, paths.shape[-1])]
    judged = np.array([_judged(posterior, z) for z in draws]).reshape(*paths.shape[:2], -1)
    density = np.stack([own[1] for own in chains])[..., None]
    found = {
        "parameters": judged[..., : len(posterior.residuals.free)],
        "displacement": judged[..., len(posterior.residuals.free) :],
        "density": density,
    }
    health = {name: _health(own) for name, own in found.items()}
    bad = [
        f"{name} R-hat {r_hat:.2f}, {effective:.0f} effective draws"
        for name, (r_hat, effective) in health.items()
        if not (r_hat <= R_HAT and effective >= EFFECTIVE)
    ]
    remark = f"; the chains have not converged ({'; '.join(bad)})" if bad else "; the chains have converged"
    worst = np.array(list(health.values()))
    traces = {"r_hat": worst[:, 0], "effective_sample_size": worst[:, 1], "log_density": density[..., 0]}
    answer = from_draws(posterior, fit, draws, Said(remark, traces, gradients))
    answer.draws = np.array([posterior.parameters(z) for z in draws])
    return answer


def _judged(posterior: Posterior, z: Any) -> np.ndarray:
    """Free log-parameters, offsets, and displacements at some times."""
    logs = posterior.parameters(z)[posterior.residuals.free]
    few = [own[:, np.linspace(0, own.shape[1] - 1, PLACES).astype(int)].ravel() for own in posterior.paths(z)]
    return np.concatenate([logs, *few, posterior.offsets(z)])


def _health(paths: np.ndarray) -> tuple[float, float]:
    """The worst R-hat and effective draws of (chains, draws, size)."""
    from blackjax.diagnostics import ess_bulk, rhat

    moving = np.ptp(paths, axis=(0, 1)) > 0  # a start that the ansatz has exactly does not
    if not np.any(moving):
        return float("inf"), 0.0
    r_hat, effective = np.asarray(rhat(paths[..., moving])), np.asarray(ess_bulk(paths[..., moving]))
    worst = float(np.max(r_hat)), float(np.min(effective))
    return worst if np.all(np.isfinite(worst)) else (float("inf"), 0.0)


def _chain(coordinates: Coordinates, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, int]:
    """Positions u (draws, n), log densities (draws,), and how many gradients they took."""
    try:
        import blackjax  # noqa: F401
    except ImportError as error:
        sentence = "uncertainty=nuts needs blackjax: pip install 'vibration-bench[nuts]'"
        raise NoEstimate(sentence, Status.MISSING_DEPENDENCY) from error
    import jax

    jax.config.update("jax_enable_x64", True)
    first = np.asarray(coordinates.first.cpu())
    asked = 0

    def target(u: Any) -> tuple[np.float64, np.ndarray]:
        nonlocal asked
        asked += 1
        value, slope = coordinates.value_and_slope(np.array(u))
        return np.float64(value), slope

    warm, sample = compiled(first.size)
    hidden = np.arange(first.size) < coordinates.n_hidden
    metric = np.ones(first.size)
    begun = 0.1 if not coordinates.n_hidden else 0.01
    HELD.append(target)
    try:
        u, step = first, begun
        for steps in WARMUP:
            keys = jax.random.split(jax.random.key(int(rng.integers(2**31))), steps)
            place, tuned = warm(keys, u, step, metric)
            u, step = np.asarray(place), float(tuned)
            if steps == WARMUP[0] and coordinates.n_hidden:
                metric = np.where(hidden, min(1.0, (step / STEP) ** 2), 1.0)
                step = STEP
        keys = jax.random.split(jax.random.key(int(rng.integers(2**31))), DRAWS)
        path, density = (np.asarray(own) for own in sample(keys, u, step, metric))
    finally:
        HELD.pop()
    return path, density, asked


HELD: list[Callable[[Any], tuple[np.float64, np.ndarray]]] = []
"""The log density and gradient that the compiled code asks: the last; so that it is compiled once for all problems."""


@cache
def compiled(n: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Warming up and sampling in n dimensions, as functions of keys, position, step and inverse masses (n,)."""
    import blackjax
    import jax
    import jax.numpy as jnp
    from blackjax.adaptation.step_size import dual_averaging_adaptation

    shapes = jax.ShapeDtypeStruct((), jnp.float64), jax.ShapeDtypeStruct((n,), jnp.float64)

    def asked(u: Any) -> Any:
        return jax.pure_callback(lambda at: HELD[-1](at), shapes, u)

    @jax.custom_vjp
    def log_density(u: Any) -> Any:
        return asked(u)[0]

    log_density.defvjp(asked, lambda slope, by: (by * slope,))
    kernel = blackjax.mcmc.nuts.build_kernel()
    begin, update, finish = dual_averaging_adaptation(0.8)

    def moved(key: Any, state: Any, step: Any, metric: Any) -> Any:
        return kernel(key, state, log_density, step, metric, max_num_doublings=DOUBLINGS)

    def warm(keys: Any, u: Any, step: Any, metric: Any) -> Any:
        def once(carry: Any, key: Any) -> Any:
            state, tuned = carry
            state, info = moved(key, state, jnp.exp(tuned.log_step_size), metric)
            return (state, update(tuned, info.acceptance_rate)), None

        first = blackjax.nuts.init(u, log_density), begin(step)
        (state, tuned), _ = jax.lax.scan(once, first, keys)
        return state.position, finish(tuned)

    def sample(keys: Any, u: Any, step: Any, metric: Any) -> Any:
        def once(state: Any, key: Any) -> Any:
            state, _ = moved(key, state, step, metric)
            return state, (state.position, state.logdensity)

        return jax.lax.scan(once, blackjax.nuts.init(u, log_density), keys)[1]

    return jax.jit(warm), jax.jit(sample)
