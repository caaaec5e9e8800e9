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

The ensembles of all problems of one layout with a linear system step together (:mod:`methods.sampling.ensembles`): the
kind of move goes by turns, and each ensemble has its own random numbers, so an answer does not depend on its company.

The response of a nonlinear system is integrated step by step, which takes about as long for many walkers as for few:
it has ``STEPPED`` times the walkers, in blocks of half the length.

Walkers that propose from each other mix ever more slowly as the unknowns grow beyond some ten (D. Huijser et al.,
arXiv:1509.02230). Here most moves do not, but where the posterior is far from its Laplace approximation little else is
left. The autocorrelation time against the length of the chain tells, and the sentence of a failure says so and names
the way out, a sampler with gradients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np

from bench import (
    EVERY_PROBLEM,
    Card,
    Cost,
    Estimate,
    NoEstimate,
    OutputError,
    Problem,
    Serves,
    Status,
    layout,
    report_progress,
)
from methods.sampling.answer import estimate_from_draws
from methods.sampling.compiled import compiled
from methods.sampling.diagnostics import Health
from methods.sampling.ensembles import Ensemble, Lockstep
from methods.sampling.modes import Modes, coloured, found_or_failure, modes_of, sharpened, student_modes
from methods.sampling.posterior import NOISE_LEAST, Posterior, Target
from methods.sampling.proposal import Proposal
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.candidates import as_fine_as_noise
from methods.trajectory.student import NORMAL, STUDENT

STEPPED = 4
MOST_AT_ONCE = 1_000_000
"""Numbers in the chains of a block that are sampled together."""

NEAR_LEAST = 2.0
"""Times the least noise: chains that stay below want less of it."""
FLOOR = (
    f"the noise is below {NOISE_LEAST:g} of the motion, where rounding and integration take over: "
    "the intervals are those of that noise"
)


@dataclass(frozen=True)
class MCMC(SearchingIdentifier):
    """Ensemble sampling; settings below, the method in the module's docstring.

    ``ensembles`` independent ensembles of at least ``walkers`` each run ``burn`` steps that are dropped, then blocks of
    ``block`` steps until converged: R-hat at most ``r_hat``, effective sample size at least ``effective`` and
    ``autocorrelations`` autocorrelation times in each chain, for every unknown; at most ``blocks`` blocks.
    ``independent`` is the share of independent moves. At most ``draws`` draws are kept, and ``curves`` of them
    are averaged in the reconstruction. ``likelihood="student"`` takes the errors to be Student's t, not normal;
    ``"autoregressive"`` takes normal ones whose colour is that of the residuals at the best mode of a white fit, and
    then again at the best mode of that.
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
    likelihood: Literal["normal", "student", "autoregressive"] = "normal"

    version: ClassVar[int] = 3
    """3: modes end elsewhere by 1e-4 of a standard deviation, and chains part from there."""

    card: ClassVar[Card] = Card(
        summary="Posterior sampling by emcee with the noise level unknown",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="quantiles of the posterior draws, their median as the value (without a prior in free vibration: "
        "their covariance)",
        settings_source="convergence criteria from the literature; lengths for a fit in half a second",
        tuning="two shares of moves, three lengths; on development systems (40 to 5 dB, damping 2-20 %, 2-10 cycles)",
        title="Bayesian MCMC",
        order=20,
        colour="#56B4E9",
        marker="v",
        variants={
            "mcmc_student": {
                "summary": "posterior sampling by emcee with Student t errors, their scale unknown",
                "tuning": "none beyond mcmc's; 4 degrees of freedom of the errors are the literature's",
                "title": "Bayesian MCMC, t errors",
                "order": 25,
                "colour": "#A6CEE3",
                "marker": (10, 1, 0.0),
            },
            "mcmc_autoregressive": {
                "summary": "posterior sampling by emcee with autoregressive errors, their scale unknown",
                "tuning": "none beyond mcmc's; the order of the errors is that of least BIC",
                "title": "Bayesian MCMC, coloured errors",
                "order": 27,
                "colour": "#0F6B99",
                "marker": (11, 1, 0.0),
            },
        },
    )
    serves: ClassVar[Serves] = EVERY_PROBLEM
    requires: ClassVar[tuple[str, ...]] = ("emcee",)
    extra: ClassVar[str] = "mcmc"
    works_in = "natural units"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Sample the posterior: draws of all parameters, or a normal over the groups where no mass is known."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Sample the posteriors of linear systems of one layout together, all others one by one."""
        models = [compiled(OutputError(p)) if p.system.n_hidden else OutputError(p) for p in problems]
        together = self.likelihood != "autoregressive"  # each problem has a colour of its own
        answers: dict[int, Estimate] = {}
        groups: dict[object, list[_ChainFit]] = {}
        for i, (model, modes, rng) in enumerate(zip(models, modes_of(models), rngs, strict=True)):
            try:
                fit = _ChainFit.of(i, model, found_or_failure(modes), rng, self.likelihood)
            except NoEstimate as reason:
                answers[i] = Estimate.failed(model.system, reason.status, str(reason), reason.cost)
                continue
            groups.setdefault(layout(model.problem) if together and model.system.linear else i, []).append(fit)
        for fits in groups.values():
            walkers, burn, block = self._lengths(fits[0].posterior)
            size = max(1, MOST_AT_ONCE // (self.ensembles * walkers * block * fits[0].posterior.size))
            for at in range(0, len(fits), size):
                answers |= self._sampled(fits[at : at + size], walkers, burn, block)
        return [answers[i] for i in range(len(problems))]

    def _lengths(self, posterior: Posterior) -> tuple[int, int, int]:
        """Walkers, steps of burning in and steps of a block."""
        many, few = (1, 1) if posterior.model.system.linear else (STEPPED, 2)
        walkers = 2 * max(many * self.walkers // 2, posterior.size + 1)
        return walkers, -(-self.burn // few), -(-self.block // few)

    def _sampled(self, fits: Sequence[_ChainFit], walkers: int, burn: int, block: int) -> dict[int, Estimate]:
        """The answers by the number of the problem, of problems that can be simulated together."""
        ensembles = [
            Ensemble(i, fit.proposal, np.random.RandomState(int(fit.rng.integers(2**31))))
            for i, fit in enumerate(fits)
            for _ in range(self.ensembles)
        ]
        chains = Lockstep(Target([fit.posterior for fit in fits]), ensembles, walkers, self.independent)
        if burn:
            chains.run(burn)
        answers, going = dict[int, Estimate](), list(fits)
        for number in range(1, self.blocks + 1):
            paths = chains.run(block).reshape(len(going), self.ensembles, block, walkers, -1)
            for fit, path in zip(going, paths, strict=True):
                fit.path = np.concatenate([fit.path, path], axis=1) if fit.path.size else path
            last = number == self.blocks
            found = [self._judged(fit, burn + number * block, last) for fit in going]
            answers |= {fit.place: answer for fit, answer in zip(going, found, strict=True) if answer is not None}
            left = [i for i, answer in enumerate(found) if answer is None]
            if not left:
                break
            going = [going[i] for i in left]
            chains.keep([i * self.ensembles + j for i in left for j in range(self.ensembles)])
        return answers

    def _judged(self, fit: _ChainFit, steps: int, last: bool) -> Estimate | None:
        """The answer where the chains have converged, or where this was the ``last`` block; else None."""
        health, kept = Health.of(fit.path), fit.path.shape[1]
        converged = health.converged(self, kept)
        if not converged and not last:
            drawn = self._kept(fit.path)
            report_progress(fit.problem, lambda: estimate_from_draws(fit.posterior, drawn, {}, Cost(), self.curves))
            return None
        cost = Cost(evaluations=fit.posterior.calls, iterations=steps * self.ensembles)
        if not converged:
            sentence = health.sentence(self, kept, fit.posterior.size)
            return Estimate.failed(fit.problem.system, Status.DIVERGED, sentence, cost)
        traces = {
            "r_hat": np.array([health.r_hat]),
            "effective_sample_size": np.array([health.effective]),
            "autocorrelation_time": np.array([health.time]),
        }
        drawn, message = _at_floor(fit.posterior, self._kept(fit.path))
        return replace(estimate_from_draws(fit.posterior, drawn, traces, cost, self.curves), message=message)

    def _kept(self, paths: np.ndarray) -> np.ndarray:
        """So many draws of all chains, evenly spread over them."""
        flat = paths.reshape(-1, paths.shape[-1])
        return np.asarray(flat[np.linspace(0, len(flat) - 1, min(self.draws, len(flat))).astype(int)])


def _at_floor(posterior: Posterior, drawn: np.ndarray) -> tuple[np.ndarray, str]:
    """Where the noise is at its least, move draws (n, size) so that their medians are the mode, and say so.

    Draws of that width would err by more than the mode does, which is as exact as the integration.
    """
    size = posterior.model.size
    least = np.log(NOISE_LEAST * posterior.model.rms)
    if np.any(np.median(drawn[:, size:], axis=0) > least + np.log(NEAR_LEAST)):
        return drawn, ""
    centred = drawn.copy()
    centred[:, :size] += posterior.mode - np.median(drawn[:, :size], axis=0)
    return centred, FLOOR


@dataclass(eq=False)
class _ChainFit:
    """One problem, by its place among those given; ``path`` (ensembles, steps, walkers, size) since burning in."""

    place: int
    problem: Problem
    posterior: Posterior
    proposal: Proposal
    rng: np.random.Generator
    path: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def of(place: int, model: OutputError, modes: Modes, rng: np.random.Generator, likelihood: str) -> _ChainFit:
        """Prepare a problem with its modes. Raises NoEstimate where the data leave a parameter open."""
        fine = compiled(as_fine_as_noise(model, modes[0][1]))
        errors = STUDENT if likelihood == "student" else NORMAL
        modes = student_modes(fine, modes) if likelihood == "student" else modes
        if likelihood == "autoregressive":
            fine, modes = coloured(fine, modes)
        modes = sharpened(fine, modes, errors, NOISE_LEAST)
        posterior = Posterior(fine, modes[0][1], errors)
        return _ChainFit(place, model.problem, posterior, Proposal.around(posterior, modes), rng)
