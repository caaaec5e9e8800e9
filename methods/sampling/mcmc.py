"""Bayesian sampling of the posterior with emcee (D. Foreman-Mackey et al., PASP 125:306, 2013).

The posterior, and the answer made of draws from it, are those of :mod:`methods.sampling.posterior`, for all walkers at
once; the response of a nonlinear system is integrated as finely as the noise asks for
(:func:`methods.starts.candidates.as_fine_as_noise`).

Moves: mostly independent Metropolis-Hastings with a proposal that stands on the modes of the posterior, a mixture of
multivariate Student t around each half-period that could still be true, so walkers change from one to the other;
mixed with differential evolution and snooker moves (C. ter Braak, J. Vrugt, Statistics and Computing 18:435, 2008),
which do not rely on the modes. The modes come from the data alone (:mod:`methods.starts.candidates`).

Convergence is judged over independent ensembles, each from an overdispersed start: the split R-hat of
rank-normalised draws and of their distances from the median (A. Vehtari et al., Bayesian Analysis 16:667, 2021), the
integrated autocorrelation time (emcee's estimate, A. Sokal's window), and the effective sample size that it implies.
A chain that has not converged is extended; one that never does is a failure with a sentence.

The response of a nonlinear system is integrated step by step, which takes about as long for many walkers as for few:
it has ``STEPPED`` times the walkers, in blocks of half the length.

Walkers that propose from each other mix ever more slowly as the unknowns grow beyond some ten (D. Huijser et al.,
arXiv:1509.02230). Here most moves do not, but where the posterior is far from its Laplace approximation little else is
left. The autocorrelation time against the length of the chain tells, and the sentence of a failure says so and names
the way out, a sampler with gradients.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bench import (
    EVERY_PROBLEM,
    Card,
    Cost,
    Estimate,
    Identifier,
    NoEstimate,
    OutputError,
    Problem,
    Serves,
    report_progress,
)
from methods.sampling.diagnostics import Health
from methods.sampling.posterior import Posterior, estimate_from_draws, modes_of
from methods.sampling.proposal import Proposal
from methods.starts.candidates import as_fine_as_noise

STEPPED = 4


@dataclass(frozen=True)
class MCMC(Identifier):
    """Ensemble sampling; settings below, the method in the module's docstring.

    ``ensembles`` independent ensembles of at least ``walkers`` each run ``burn`` steps that are dropped, then blocks of
    ``block`` steps until converged: R-hat at most ``r_hat``, effective sample size at least ``effective`` and
    ``autocorrelations`` autocorrelation times in each chain, for every unknown; at most ``blocks`` blocks.
    ``independent`` is the share of independent moves. At most ``draws`` draws are kept, and ``curves`` of them
    are averaged in the reconstruction.
    """

    ensembles: int = 2
    walkers: int = 32
    burn: int = 20
    block: int = 60
    blocks: int = 40
    r_hat: float = 1.02
    effective: float = 400.0
    autocorrelations: float = 15.0
    independent: float = 0.8
    draws: int = 2000
    curves: int = 100

    card: ClassVar[Card] = Card(
        summary="Posterior sampling by emcee with the noise level unknown",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="quantiles of the posterior draws (without a prior in free vibration: their covariance)",
        settings_source="convergence criteria from the literature; lengths for a fit in half a second",
        tuning="two shares of moves, three lengths; on development systems (40 to 5 dB, damping 2-20 %, 2-10 cycles)",
        title="Bayesian MCMC",
        order=20,
        colour="#56B4E9",
        marker="v",
    )
    serves: ClassVar[Serves] = EVERY_PROBLEM
    requires: ClassVar[tuple[str, ...]] = ("emcee",)
    extra: ClassVar[str] = "mcmc"
    works_in = "natural units"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Sample the posterior: draws of all parameters, or a normal over the groups where no mass is known."""
        model = OutputError(problem)
        modes = modes_of(model)
        posterior = Posterior(as_fine_as_noise(model, modes[0][1]), modes[0][1])
        proposal = Proposal.around(posterior, modes)
        many, few = (1, 1) if model.system.linear else (STEPPED, 2)
        burn, block = -(-self.burn // few), -(-self.block // few)
        walkers = 2 * max(many * self.walkers // 2, posterior.size + 1)
        chains = [self._ensemble(posterior, proposal, walkers, burn, rng) for _ in range(self.ensembles)]
        steps = burn
        for _ in range(self.blocks):
            for chain in chains:
                chain(block)
            steps += block
            paths = np.stack([chain.path() for chain in chains])
            health = Health.of(paths)
            if health.converged(self, paths.shape[1]):
                break
            drawn = self._kept(paths)
            report_progress(problem, lambda drawn=drawn: estimate_from_draws(posterior, drawn, {}, Cost(), self.curves))  # type: ignore[misc]
        cost = Cost(evaluations=posterior.calls, iterations=steps * self.ensembles)
        if not health.converged(self, paths.shape[1]):
            sentence = health.sentence(self, paths.shape[1], posterior.size)
            raise NoEstimate(sentence, cost=cost)
        traces = {
            "r_hat": np.array([health.r_hat]),
            "effective_sample_size": np.array([health.effective]),
            "autocorrelation_time": np.array([health.time]),
        }
        return estimate_from_draws(posterior, self._kept(paths), traces, cost, self.curves)

    def _kept(self, paths: np.ndarray) -> np.ndarray:
        """So many draws of all chains, evenly spread over them."""
        flat = paths.reshape(-1, paths.shape[-1])
        return np.asarray(flat[np.linspace(0, len(flat) - 1, min(self.draws, len(flat))).astype(int)])

    def _ensemble(
        self, posterior: Posterior, proposal: Proposal, walkers: int, burn: int, rng: np.random.Generator
    ) -> Ensemble:
        return Ensemble(posterior, proposal, walkers, burn, self.independent, int(rng.integers(2**31)))


class Ensemble:
    """One emcee ensemble, from an overdispersed start; call it to run more steps."""

    def __init__(
        self, posterior: Posterior, proposal: Proposal, walkers: int, burn: int, independent: float, seed: int
    ) -> None:
        import emcee

        random = np.random.RandomState(seed)
        moves = [
            (emcee.moves.MHMove(proposal, ndim=posterior.size), independent),
            (emcee.moves.DEMove(), 0.8 * (1 - independent)),
            (emcee.moves.DESnookerMove(), 0.2 * (1 - independent)),
        ]
        self.sampler = emcee.EnsembleSampler(walkers, posterior.size, posterior, moves=moves, vectorize=True)
        start = proposal.draw(walkers, random, spread=2.0)
        self.state: Any = emcee.State(start, random_state=random.get_state())
        if burn:
            self(burn)
            self.sampler.reset()

    def __call__(self, steps: int) -> None:
        self.state = self.sampler.run_mcmc(self.state, steps, skip_initial_state_check=True)

    def path(self) -> np.ndarray:
        """The chain since burning in, shape (steps, walkers, size)."""
        return np.asarray(self.sampler.get_chain())
