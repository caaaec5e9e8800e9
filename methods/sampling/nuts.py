"""Bayesian sampling of the posterior by the No-U-Turn sampler of blackjax.

The sampler: M. D. Hoffman, A. Gelman, J. Machine Learning Research 15:1593, 2014.

The posterior is that of ``mcmc`` with its gradient (:mod:`methods.sampling.log_posterior`), which allows long moves for
many unknowns. Coordinates are chosen so that the Laplace approximation at the best mode is a standard normal. The
chains start at draws from the Laplace approximations of all plausible modes, adapt step size and metric (Stan's
windows) over ``warmup`` steps, and then run blocks of ``draws`` steps until the diagnostics are satisfied: the
rank-normalised split R-hat and the bulk effective sample size (A. Vehtari et al., Bayesian Analysis 16:667, 2021) of
every unknown, and the share of divergent transitions. Unlike ``mcmc``, a chain does not change between half-periods:
chains that start in different modes stay there, R-hat is large, and the fit fails.

The code is compiled once for all problems of one layout, which takes longer than a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar

import numpy as np

from bench import EVERY_PROBLEM, Card, Cost, Estimate, InputError, NoEstimate, OutputError, Problem, Scope
from methods.sampling.answer import estimate_from_draws, thinned
from methods.sampling.log_posterior import DensityLayout, log_density, prepare
from methods.sampling.mixture import Mixture, laplace
from methods.sampling.modes import modes_of, require
from methods.sampling.posterior import Posterior
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.rounding import rounded


@dataclass(frozen=True)
class NUTS(SearchingIdentifier):
    """Gradient-based sampling of the posterior with ``chains`` chains.

    The chains have converged if R-hat is at most ``r_hat`` and the bulk effective sample size at least ``effective``
    for every unknown, with at most a share ``divergent`` of divergent transitions; at most ``blocks`` blocks are run.
    At most ``kept`` draws are kept, ``curves`` of which are averaged in the reconstruction.
    """

    chains: int = 4
    warmup: int = 200
    draws: int = 300
    blocks: int = 3
    r_hat: float = 1.01
    effective: float = 100.0
    divergent: float = 0.02
    kept: int = 2000
    curves: int = 100

    parts: ClassVar[Mapping[str, int]] = {"prior": 2}
    card: ClassVar[Card] = Card(
        summary="posterior sampling by the No-U-Turn sampler (blackjax) with the noise level unknown",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="quantiles of the posterior draws, their median as the value (without a prior in free vibration: "
        "their covariance)",
        settings_source="diagnostics of Vehtari et al. (2021); lengths for some hundred effective draws",
        tuning="none",
        title="Bayesian NUTS",
        order=30,
    )
    scope: ClassVar[Scope] = EVERY_PROBLEM
    requires: ClassVar[tuple[str, ...]] = ("blackjax",)
    extra: ClassVar[str] = "nuts"
    works_in = "natural units"

    def __post_init__(self) -> None:
        for name, least in (("chains", 2), ("warmup", 20), ("draws", 4), ("blocks", 1), ("kept", 2), ("curves", 1)):
            if getattr(self, name) < least:
                raise InputError(f"method.{name}", getattr(self, name), f"at least {least}")

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Sample the posterior: draws of all parameters, or a normal over the groups where no mass is known."""
        # rounded to ten digits, since leapfrog steps amplify rounding errors of the data
        model = OutputError(rounded(problem))
        modes = require(modes_of([model])[0])
        posterior = Posterior([model], [modes[0][1]])
        phi, traces, steps = self._chains(posterior, laplace(posterior, modes), rng)
        r_hat, effective, divergent = traces.values()
        cost = Cost(evaluations=steps, iterations=phi.shape[0] * (self.warmup + phi.shape[1]))
        if not self._converged(traces):
            raise NoEstimate(
                f"the chains have not converged (R-hat {r_hat:.3f}, effective draws {effective:.0f}, divergent "
                f"{divergent:.1%}): raise draws or blocks, or provide more data or a narrower prior",
                cost=cost,
            )
        return estimate_from_draws(posterior, thinned(phi, self.kept), traces, cost, self.curves)

    def _converged(self, traces: dict[str, float]) -> bool:
        r_hat, effective, divergent = traces.values()
        return r_hat <= self.r_hat and effective >= self.effective and divergent <= self.divergent

    def _chains(
        self, posterior: Posterior, proposal: Mixture, rng: np.random.Generator
    ) -> tuple[np.ndarray, dict[str, float], int]:
        """Return draws of phi (chains, steps, size), their :func:`diagnostics`, and the number of gradients."""
        import jax

        jax.config.update("jax_enable_x64", True)
        layout, problem = prepare(posterior)
        best = int(np.argmax(proposal.log_weights))
        centre, root = proposal.centres[best], proposal.roots[best]
        # the chains start in the modes by their weights, without the least weight of the proposal
        weights = np.maximum(proposal.weights - 0.1 / len(proposal.weights), 1e-12)
        random = np.random.RandomState(int(rng.integers(2**31)))
        draws = replace(proposal, log_weights=np.log(weights)).draw(self.chains, random)
        z = np.linalg.solve(root, (draws - centre).T).T
        data = {"problem": problem, "centre": centre, "root": root}
        warm, sample = compiled(layout, self.warmup, self.draws)
        key, fresh = jax.random.split(jax.random.key(int(rng.integers(2**31))))
        states, tuned = warm(jax.random.split(fresh, self.chains), z, data)
        blocks, gradients = [], 0
        for _ in range(self.blocks):
            key, fresh = jax.random.split(key)
            # as NumPy arrays, so that the code is compiled once for results of warm-up and of a block
            states, tuned = jax.tree.map(np.asarray, (states, tuned))
            states, (positions, diverged, count) = sample(jax.random.split(fresh, self.chains), states, tuned, data)
            blocks.append((np.asarray(positions), np.asarray(diverged)))
            gradients += int(np.sum(count))
            path, divergent = (np.concatenate(parts, axis=1) for parts in zip(*blocks, strict=True))
            traces = diagnostics(path, divergent)
            if self._converged(traces):
                break
        return centre + path @ root.T, traces, gradients


def diagnostics(path: np.ndarray, divergent: np.ndarray) -> dict[str, float]:
    """Return the worst R-hat and bulk effective sample size over the unknowns, and the share of divergent transitions.

    Args:
        path: Draws, (chains, steps, size).
        divergent: Whether each transition diverged, (chains, steps).
    """
    from blackjax.diagnostics import ess_bulk, rhat

    r_hat, effective = np.inf, 0.0
    if np.all(np.isfinite(path)) and np.all(np.ptp(path, axis=(0, 1)) > 0):
        worst = float(np.max(np.asarray(rhat(path)))), float(np.min(np.asarray(ess_bulk(path))))
        r_hat, effective = worst if np.all(np.isfinite(worst)) else (r_hat, effective)
    return {"r_hat": r_hat, "effective_sample_size": effective, "divergent": float(np.mean(divergent))}


@cache
def compiled(layout: DensityLayout, warmup: int, draws: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the compiled functions for warm-up and sampling, of keys (chains,), positions or states, and data."""
    import blackjax
    import jax

    def target(data: Any) -> Callable[[Any], Any]:
        return lambda z: log_density(layout, data["problem"], data["centre"] + data["root"] @ z)

    def warm(key: Any, z: Any, data: Any) -> tuple[Any, Any]:
        adapted, _ = blackjax.window_adaptation(blackjax.nuts, target(data)).run(key, z, warmup)
        return adapted.state, adapted.parameters

    def sample(key: Any, state: Any, tuned: Any, data: Any) -> tuple[Any, Any]:
        step = blackjax.nuts(target(data), **tuned).step

        def once(state: Any, key: Any) -> tuple[Any, Any]:
            state, info = step(key, state)
            return state, (state.position, info.is_divergent, info.num_integration_steps)

        return jax.lax.scan(once, state, jax.random.split(key, draws))

    return jax.jit(jax.vmap(warm, in_axes=(0, 0, None))), jax.jit(jax.vmap(sample, in_axes=(0, 0, 0, None)))
