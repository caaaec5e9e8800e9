"""Bayesian sampling of the posterior by its gradient: the No-U-Turn sampler of blackjax.

The sampler: M. D. Hoffman, A. Gelman, J. Machine Learning Research 15:1593, 2014.

The posterior is :mod:`methods.sampling.posterior`, that of ``mcmc``, but its gradient is known
(:mod:`methods.sampling.differentiable`), so a chain moves far in each step, however many unknowns there are. Any
system, nonlinear ones included.

Sampling is in coordinates in which the Laplace approximation at the best mode is a standard normal; the modes come from
the data alone (:mod:`methods.starts.candidates`). ``chains`` chains start at draws from the Laplace approximations of
all modes that could be true, each with its own adaptation of step size and metric (Stan's windows) over ``warmup``
steps, then blocks of ``draws`` steps until the diagnostics hold.

**Diagnostics**, blackjax's: the rank-normalised split R-hat and the bulk effective sample size (A. Vehtari et al.,
Bayesian Analysis 16:667, 2021) for every unknown, and the share of divergent transitions. A gradient sampler does not
pass from one half-period to another, as the mixture proposal of ``mcmc`` does: chains that start in different modes
stay there, R-hat says so, and the fit is a failure with that sentence rather than a wrong answer.

The code is compiled once for all problems of one layout, replicates of a cell say; that takes longer than a fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar

import numpy as np

from bench import EVERY_PROBLEM, Card, Cost, Estimate, InputError, NoEstimate, OutputError, Problem, Serves
from methods.sampling.answer import estimate_from_draws
from methods.sampling.differentiable import DensityLayout, log_density, prepare
from methods.sampling.modes import modes_or_failure
from methods.sampling.posterior import Posterior
from methods.sampling.proposal import Proposal
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.rounding import rounded


@dataclass(frozen=True)
class NUTS(SearchingIdentifier):
    """Gradient sampling; settings below, the method in the module's docstring.

    It has converged when R-hat is at most ``r_hat``, the bulk effective sample size at least ``effective`` for every
    unknown, and at most a share ``divergent`` of the transitions diverged; at most ``blocks`` blocks are run. At most
    ``kept`` draws are kept, and ``curves`` of them are averaged in the reconstruction.
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
        colour="#332288",
        marker="4",
    )
    serves: ClassVar[Serves] = EVERY_PROBLEM
    requires: ClassVar[tuple[str, ...]] = ("blackjax",)
    extra: ClassVar[str] = "nuts"
    works_in = "natural units"

    def __post_init__(self) -> None:
        for name, least in (("chains", 2), ("warmup", 20), ("draws", 4), ("blocks", 1), ("kept", 2), ("curves", 1)):
            if getattr(self, name) < least:
                raise InputError(f"method.{name}", getattr(self, name), f"at least {least}")

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Sample the posterior: draws of all parameters, or a normal over the groups where no mass is known."""
        # to ten digits: a path of leapfrog steps magnifies the last bit of the data to other draws
        model = OutputError(rounded(problem))
        modes = modes_or_failure(model)
        posterior = Posterior(model, modes[0][1])
        phi, health, steps = self._chains(posterior, Proposal.around(posterior, modes), rng)
        cost = Cost(evaluations=steps, iterations=phi.shape[0] * (self.warmup + phi.shape[1]))
        if not health.converged(self):
            raise NoEstimate(health.sentence(), cost=cost)
        flat = phi.reshape(-1, phi.shape[-1])
        few = flat[np.linspace(0, len(flat) - 1, min(self.kept, len(flat))).astype(int)]
        traces = {
            "r_hat": np.array([health.r_hat]),
            "effective_sample_size": np.array([health.effective]),
            "divergent": np.array([health.divergent]),
        }
        return estimate_from_draws(posterior, few, traces, cost, self.curves)

    def _chains(
        self, posterior: Posterior, proposal: Proposal, rng: np.random.Generator
    ) -> tuple[np.ndarray, Diagnostics, int]:
        """Draws of phi (chains, steps, size), their diagnostics, and the gradients that they took."""
        import jax

        jax.config.update("jax_enable_x64", True)
        layout, data = prepare(posterior)
        best = int(np.argmax(proposal.weights))
        centre, root = proposal.centres[best], proposal.roots[best]
        # where the chains start: in the modes by their weight, without the floor that a proposal needs
        floor = 0.1 / len(proposal.weights)
        starts = replace(proposal, weights=np.maximum(proposal.weights - floor, 1e-12))
        random = np.random.RandomState(int(rng.integers(2**31)))
        z = np.linalg.solve(root, (starts.draw(self.chains, random) - centre).T).T
        data = {"problem": data, "centre": centre, "root": root}
        key = jax.random.key(int(rng.integers(2**31)))
        warm, sample = compiled(layout, self.warmup, self.draws)
        key, own = jax.random.split(key)
        states, tuned = warm(jax.random.split(own, self.chains), z, data)
        found, divergent, gradients = [], [], 0
        for _ in range(self.blocks):
            key, own = jax.random.split(key)
            # as plain arrays, or what comes from the warm-up and from a block would each be compiled for
            states, tuned = jax.tree.map(np.asarray, (states, tuned))
            states, (position, diverged, count) = sample(jax.random.split(own, self.chains), states, tuned, data)
            found.append(np.asarray(position))
            divergent.append(np.asarray(diverged))
            gradients += int(np.sum(count))
            path = np.concatenate(found, axis=1)
            health = Diagnostics.of(path, np.concatenate(divergent, axis=1))
            if health.converged(self):
                break
        return centre + path @ root.T, health, gradients


@dataclass(frozen=True)
class Diagnostics:
    """The worst over the unknowns: R-hat and bulk effective sample size; and the share of divergent transitions."""

    r_hat: float
    effective: float
    divergent: float

    @staticmethod
    def of(path: np.ndarray, divergent: np.ndarray) -> Diagnostics:
        """Of draws (chains, steps, size) and whether each transition diverged, (chains, steps)."""
        from blackjax.diagnostics import ess_bulk, rhat

        if not np.all(np.isfinite(path)) or np.any(np.ptp(path, axis=(0, 1)) == 0):
            return Diagnostics(float("inf"), 0.0, float(np.mean(divergent)))
        r_hat, effective = np.max(np.asarray(rhat(path))), np.min(np.asarray(ess_bulk(path)))
        bad = not (np.isfinite(r_hat) and np.isfinite(effective))
        return Diagnostics(np.inf if bad else float(r_hat), 0.0 if bad else float(effective), float(np.mean(divergent)))

    def converged(self, settings: NUTS) -> bool:
        """Whether a fit may be believed."""
        return (
            self.r_hat <= settings.r_hat
            and self.effective >= settings.effective
            and self.divergent <= settings.divergent
        )

    def sentence(self) -> str:
        """Why it may not, and what to do."""
        return (
            f"the chains have not converged (R-hat {self.r_hat:.3f}, effective draws {self.effective:.0f}, divergent "
            f"{self.divergent:.1%}): raise draws or blocks, or give more data or a narrower prior"
        )


@cache
def compiled(layout: DensityLayout, warmup: int, draws: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Warming up and sampling as compiled functions of keys (chains,), positions or states, and data."""
    import blackjax
    import jax

    def target(data: Any) -> Callable[[Any], Any]:
        return lambda z: log_density(layout, data["problem"], data["centre"] + data["root"] @ z)

    def warm(key: Any, z: Any, data: Any) -> tuple[Any, Any]:
        found, _ = blackjax.window_adaptation(blackjax.nuts, target(data)).run(key, z, warmup)
        return found.state, found.parameters

    def sample(key: Any, state: Any, tuned: Any, data: Any) -> tuple[Any, Any]:
        step = blackjax.nuts(target(data), **tuned).step

        def once(state: Any, key: Any) -> tuple[Any, Any]:
            state, info = step(key, state)
            return state, (state.position, info.is_divergent, info.num_integration_steps)

        return jax.lax.scan(once, state, jax.random.split(key, draws))

    return (
        jax.jit(jax.vmap(warm, in_axes=(0, 0, None))),
        jax.jit(jax.vmap(sample, in_axes=(0, 0, 0, None))),
    )
