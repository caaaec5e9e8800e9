"""Bayesian sampling of the posterior with emcee (D. Foreman-Mackey et al., PASP 125:306, 2013).

Most moves are independent Metropolis-Hastings moves with a proposal from the modes of the posterior, a mixture of
multivariate Student t distributions about each plausible half-period, so that walkers change between modes. They are
combined with differential evolution and snooker moves (C. ter Braak, J. Vrugt, Statistics and Computing 18:435, 2008),
which do not use the modes. The modes come from the data (:mod:`methods.starts.candidates`); nonlinear systems are
integrated as accurately as the noise requires (:func:`methods.starts.candidates.as_fine_as_noise`).

Convergence is assessed over independent ensembles with overdispersed initial positions, by the split R-hat of
rank-normalised draws and of their distances from the median (A. Vehtari et al., Bayesian Analysis 16:667, 2021), the
integrated autocorrelation time (emcee's estimate, A. Sokal's window), and the effective sample size. Chains are
extended until they converge or fail. Ensemble moves mix slowly beyond some ten unknowns (D. Huijser et al.,
arXiv:1509.02230), and independent moves are rarely accepted where the posterior is far from its Laplace approximation.

The ensembles of all problems of one layout with a linear system run in lockstep (:mod:`methods.sampling.ensembles`),
each with its own random numbers, so that an estimate does not depend on its batch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
    Scope,
    Status,
    layout,
    report_progress,
)
from methods.sampling.answer import estimate_from_draws, thinned
from methods.sampling.diagnostics import autocorrelation_times, rank_r_hat
from methods.sampling.ensembles import Ensemble, Lockstep
from methods.sampling.mixture import Mixture, laplace
from methods.sampling.modes import Modes, coloured, modes_of, require, sharpened, student_modes
from methods.sampling.posterior import NOISE_LEAST, Posterior, compiled
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.candidates import as_fine_as_noise
from methods.trajectory.student import NORMAL, STUDENT

STEPPED = 4
"""Factor of the walkers for a nonlinear system, in blocks of half the length; a step of many costs little more."""
MANY = 10
"""Number of unknowns above which slow mixing is attributed to it."""
MOST_AT_ONCE = 1_000_000
"""Largest number of values in the chains of one block."""

NEAR_LEAST = 2.0
"""Chains below this multiple of the least noise are at the limit of the noise prior."""
FLOOR = (
    f"the noise is below {NOISE_LEAST:g} of the motion, the limit set by rounding and integration: "
    "the intervals correspond to that noise"
)


@dataclass(frozen=True)
class MCMC(SearchingIdentifier):
    """Ensemble sampling of the posterior.

    ``ensembles`` independent ensembles of at least ``walkers`` make ``burn`` discarded steps, then at most ``blocks``
    blocks of ``block`` steps until, for every unknown, R-hat is at most ``r_hat``, the effective sample size at least
    ``effective``, and the chain at least ``autocorrelations`` autocorrelation times long. ``independent``: share of
    independent moves. At most ``draws`` draws are kept, ``curves`` of which are averaged in the reconstruction.
    ``likelihood``: normal errors, Student's t errors, or autoregressive errors estimated from the residuals at the best
    mode, in two rounds.
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
    """3: modes differ by 1e-4 of a standard deviation, and hence the chains."""
    parts: ClassVar[Mapping[str, int]] = {"prior": 2}
    """2: of several basins, the answer is the one that every search prefers."""

    card: ClassVar[Card] = Card(
        summary="Posterior sampling by emcee with the noise level unknown",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="quantiles of the posterior draws, their median as the value (without a prior in free vibration: "
        "their covariance)",
        settings_source="convergence criteria from the literature; lengths for a fit in half a second",
        tuning="two shares of moves, three lengths on development systems (40 to 5 dB, damping 2-20 %, 2-10 cycles)",
        title="Bayesian MCMC",
        order=20,
        variants={
            "mcmc_student": {
                "summary": "posterior sampling by emcee with Student t errors, their scale unknown",
                "tuning": "as mcmc; 4 degrees of freedom of the errors as in the literature",
                "title": "Bayesian MCMC, t errors",
                "order": 25,
            },
            "mcmc_autoregressive": {
                "summary": "posterior sampling by emcee with autoregressive errors, their scale unknown",
                "tuning": "as mcmc; order of the errors by BIC",
                "title": "Bayesian MCMC, coloured errors",
                "order": 27,
            },
        },
    )
    scope: ClassVar[Scope] = EVERY_PROBLEM
    requires: ClassVar[tuple[str, ...]] = ("emcee",)
    extra: ClassVar[str] = "mcmc"
    works_in = "natural units"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Sample the posterior: draws of all parameters, or a normal over the groups where no mass is known."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Sample the posteriors of linear systems of one layout in lockstep, all others one by one."""
        models = [compiled(OutputError(p)) if p.system.n_hidden else OutputError(p) for p in problems]
        together = self.likelihood != "autoregressive"  # error models differ between problems
        answers: dict[int, Estimate] = {}
        groups: dict[object, list[_ChainFit]] = {}
        for i, (model, modes, rng) in enumerate(zip(models, modes_of(models), rngs, strict=True)):
            try:
                fit = self._prepared(i, model, require(modes), rng)
            except NoEstimate as reason:
                answers[i] = Estimate.failed(model.system, reason.status, str(reason), reason.cost)
                continue
            groups.setdefault(layout(model.problem) if together and model.system.linear else i, []).append(fit)
        for fits in groups.values():
            # walkers, burn-in steps and block length
            posterior = fits[0].posterior
            many, few = (1, 1) if posterior.model.system.linear else (STEPPED, 2)
            walkers = 2 * max(many * self.walkers // 2, posterior.size + 1)
            burn, block = -(-self.burn // few), -(-self.block // few)
            size = max(1, MOST_AT_ONCE // (self.ensembles * walkers * block * posterior.size))
            for first in range(0, len(fits), size):
                answers |= self._sampled(fits[first : first + size], walkers, burn, block)
        return [answers[i] for i in range(len(problems))]

    def _prepared(self, place: int, model: OutputError, modes: Modes, rng: np.random.Generator) -> _ChainFit:
        """Find the modes of the posterior; raises NoEstimate where the data do not determine a parameter."""
        fine = compiled(as_fine_as_noise(model, modes[0][1]))
        errors = STUDENT if self.likelihood == "student" else NORMAL
        if self.likelihood == "student":
            modes = student_modes(fine, modes)
        if self.likelihood == "autoregressive":
            fine, modes = coloured(fine, modes)
        modes = sharpened(fine, modes, errors, NOISE_LEAST)
        posterior = Posterior([fine], [modes[0][1]], errors)
        return _ChainFit(place, posterior, laplace(posterior, modes), rng)

    def _sampled(self, fits: Sequence[_ChainFit], walkers: int, burn: int, block: int) -> dict[int, Estimate]:
        """Sample problems that can be simulated together; return the estimates by index of the problem."""
        ensembles = [
            Ensemble(i, fit.proposal, np.random.RandomState(int(fit.rng.integers(2**31))))
            for i, fit in enumerate(fits)
            for _ in range(self.ensembles)
        ]
        parts = [fit.posterior for fit in fits]
        target = Posterior([part.model for part in parts], [part.mode for part in parts], parts[0].errors)
        chains = Lockstep(target, ensembles, walkers, self.independent)
        chains.run(burn)
        answers, going = dict[int, Estimate](), list(range(len(fits)))
        for number in range(1, self.blocks + 1):
            paths = chains.run(block).reshape(len(going), self.ensembles, block, walkers, -1)
            unfinished = []
            for i, path in zip(going, paths, strict=True):
                fit = fits[i]
                fit.path = np.concatenate([fit.path, path], axis=1) if fit.path.size else path
                calls, steps = int(fit.posterior.calls[0] + target.calls[i]), self.ensembles * (burn + number * block)
                answer = self._judged(fit, Cost(evaluations=calls, iterations=steps), number == self.blocks)
                if answer is None:
                    unfinished.append(i)
                else:
                    answers[fit.place] = answer
            if not unfinished:
                break
            kept = [going.index(i) for i in unfinished]
            chains.keep([i * self.ensembles + j for i in kept for j in range(self.ensembles)])
            going = unfinished
        return answers

    def _judged(self, fit: _ChainFit, cost: Cost, last: bool) -> Estimate | None:
        """Return the estimate of converged chains, a failure after the ``last`` block, otherwise None."""
        steps, unknowns = fit.path.shape[1], fit.posterior.size
        times = np.max(autocorrelation_times(fit.path), axis=0)
        time = float(np.max(np.where(np.isfinite(times), np.maximum(times, 1.0), np.inf)))
        r_hat, effective = rank_r_hat(fit.path), fit.path[..., 0].size / time
        short = steps < self.autocorrelations * time
        if r_hat <= self.r_hat and effective >= self.effective and not short:
            drawn, message = _at_floor(fit.posterior, thinned(fit.path, self.draws))
            traces = {"r_hat": r_hat, "effective_sample_size": effective, "autocorrelation_time": time}
            return estimate_from_draws(fit.posterior, drawn, traces, cost, self.curves, message)
        if not last:
            drawn, posterior = thinned(fit.path, self.draws), fit.posterior
            report_progress(
                posterior.model.problem, lambda: estimate_from_draws(posterior, drawn, {}, Cost(), self.curves)
            )
            return None
        advice = "raise blocks, or provide more data or a narrower prior"
        if unknowns > MANY:
            advice = f"walkers mix slowly with {unknowns} unknowns; use a gradient-based sampler (nuts)"
        sentence = (
            f"the chains have not converged (R-hat {r_hat:.3f}, effective draws {effective:.0f}, autocorrelation time "
            f"{time:.0f} of {steps} steps{', too long for a reliable estimate' if short else ''}): {advice}"
        )
        return Estimate.failed(fit.posterior.model.system, Status.DIVERGED, sentence, cost)


def _at_floor(posterior: Posterior, drawn: np.ndarray) -> tuple[np.ndarray, str]:
    """Shift draws (n, size) to have the mode as median where the noise is at its lower limit; return a message.

    The median of so wide draws would be less accurate than the mode.
    """
    size = posterior.model.size
    if np.any(np.median(drawn[:, size:], axis=0) > posterior.least[0] + np.log(NEAR_LEAST)):
        return drawn, ""
    centred = drawn.copy()
    centred[:, :size] += posterior.mode - np.median(drawn[:, :size], axis=0)
    return centred, FLOOR


@dataclass(eq=False)
class _ChainFit:
    """One problem with its index among the given ones; ``path`` (ensembles, steps, walkers, size) after burn-in."""

    place: int
    posterior: Posterior
    proposal: Mixture
    rng: np.random.Generator
    path: np.ndarray = field(default_factory=lambda: np.zeros(0))
