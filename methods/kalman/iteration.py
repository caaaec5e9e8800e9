"""Joint estimation of state and parameters by iterated Kalman smoothers.

**Joint state.** Displacements, velocities and hidden states, then the log-parameters, then the offsets of sensors (R.
E. Kopp, R. J. Orford, AIAA J. 1:2300, 1963). Several records form one chain: between them the motion is reset to its
prior and the constants continue.

**Iteration.** Every pass over the records starts from the prior and linearises about the smoothed trajectory of the
previous pass: the iterated extended Kalman smoother (B. M. Bell, SIAM J. Optimization 4:626, 1994), which without
process noise is a Gauss-Newton method for the posterior mode, or its counterpart with sigma points (A. F.
Garcia-Fernandez, L. Svensson, S. Sarkka, IEEE Trans. Automatic Control 62:2056, 2017). Starting a pass from the result
of the previous one would count the data twice.

**Initial guesses.** The misfit has a minimum for each half-cycle that the phase may slip over the record, in which a
filter remains. The first pass is therefore linearised about the trajectories of the few best guesses of the scan that
multiple shooting also uses, in parallel; the prior is the same for all. The most probable end is kept. (The likelihood
of the innovations, by which D. T. Magill weights a bank of filters, IEEE Trans. Automatic Control 10:434, 1965, also
counts the volume of the posterior: at 0 dB it prefers a motion that decays at once, and fits nothing, to the true one.)
Ends that are nearly as probable increase its covariance, as components of a Gaussian sum (D. L. Alspach, H. W.
Sorenson, IEEE Trans. Automatic Control 17:439, 1972), with a message.

**Noise.** The first noise variances are those of the residuals of each guess; afterwards each channel's variance is its
residual sum of squares over N minus its fitted degrees of freedom, ``sum H P H' / R``: the fixed point of the EM step
of R. H. Shumway, D. S. Stoffer (J. Time Series Analysis 3:253, 1982).

**Prior.** Without a prior of the problem, log-parameters have the standard deviation ``open_sd`` about the first
candidate from the data; where the scale is not identifiable, the gauge mass is 1 and the groups are estimated. An
unknown initial state has zero mean and a standard deviation of :data:`methods.kalman.joint.START` times the largest
displacement (times the fastest rate for velocities).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from bench import (
    EVERY_PROBLEM,
    SIGMA_FLOOR,
    Cost,
    Estimate,
    InputError,
    NoEstimate,
    OutputError,
    Problem,
    Scope,
    estimate_at,
)
from methods.kalman.core import Rule, outer
from methods.kalman.joint import Joint, Nodes, fastest_rate
from methods.kalman.smoother import smooth
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.candidates import NOISE_SHARE, candidates, head, screening
from methods.starts.distinct_minima import distinct_minima
from methods.starts.evidence import most_probable
from methods.starts.integration import RADIANS_A_STEP, radians_a_step
from methods.starts.long_records import is_long, thinned
from methods.starts.search_range import is_unresolved

STARTS = 3
"""Largest number of distinct initial guesses."""
SCREENING = 5
"""Output-error iterations of each candidate before the best are selected."""
MARGIN = 15.0
"""A guess is kept if minus twice its log-posterior is within this of the best."""
ROUNDING = 1e-9
"""Relative tolerance within which a noise level equals the least one resolved."""
APART = 1.0
"""Ends are distinct if a log-parameter differs by more than this many standard deviations."""
RIVAL = 0.05
"""Odds above which a less likely end widens the covariance, since a 95 % interval must cover it."""
ADRIFT = 0.1
"""Largest change by the last pass, in standard deviations, at which a poor fit is still returned."""
POOR = 0.5
"""A fit is poor if its residuals exceed this fraction of the data's mean square."""
FINEST = 0.02
"""The shortest integration step, in radians of the fastest rate."""
PART = (0.2, 3.0)
"""Limits of the relaxation factor of a pass."""
SPARE = 1.15
"""Integration steps are chosen for a motion faster by this factor, and kept while they suffice."""


@dataclass(frozen=True)
class IteratedSmoother(SearchingIdentifier):
    """Make at most ``passes``, until no parameter changes by ``tolerance`` of its standard deviation.

    ``drift``: standard deviation of the random walk of a log-parameter over the longest record (its process noise).
    ``open_sd``: initial standard deviation of a log-parameter without a prior.
    """

    passes: int = 30
    tolerance: float = 1e-3
    drift: float = 0.0
    open_sd: float = 1.0

    scope: ClassVar[Scope] = EVERY_PROBLEM
    works_in = "natural units"

    def __post_init__(self) -> None:
        if self.passes < 1:
            raise InputError("method.passes", self.passes, "at least 1")
        if not (np.isfinite(self.drift) and self.drift >= 0):
            raise InputError("method.drift", self.drift, "a standard deviation, 0 for constant parameters")
        for name in ("tolerance", "open_sd"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"method.{name}", getattr(self, name), "a positive number")

    @property
    @abstractmethod
    def rule(self) -> Rule:
        """Return the rule of linearisation."""

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate all parameters, or the groups where the scale is not identifiable. Uses no randomness."""
        model = OutputError(problem)
        first, thetas = starting_points(model)
        joint = first_distribution(model, first, thetas[0], self.drift, self.open_sd)
        nodes = Nodes.of(model, longest_step(model, thetas, np.ones((1, 1))))
        bank = started(joint, nodes, thetas)
        passes = 0
        while passes < self.passes and np.any(bank.moved > self.tolerance):
            longest = longest_step(model, joint.theta(bank.about, nodes), bank.sigma / model.rms)
            if not longest / SPARE**2 <= nodes.longest <= longest:
                nodes = Nodes.of(model, longest / SPARE)
            bank = passed(joint, nodes, self.rule, bank)
            passes += 1
        return answer(joint, nodes, bank, passes, self)


def starting_points(model: OutputError) -> tuple[dict[str, float], np.ndarray]:
    """Return the first candidate parameters, and the vectors (B, size) to start from, best first.

    Each candidate is improved by a few output-error iterations, on decimated long records of a linear system, on the
    first samples of others. Raises NoEstimate where no candidate gives a finite response.
    """
    short = head(model)
    sets = candidates(short, STARTS + 1)
    quick = screening(short)
    if model.system.linear and is_long(model.problem):
        quick = OutputError(thinned(model.problem))
    thetas = np.zeros((len(sets), quick.size))
    thetas[:, : len(quick.free)] = np.log([[p[name] for name in quick.free] for p in sets])
    thetas = quick.settle(quick.with_initial_states(thetas), 1, SCREENING)
    values = quick.profile(thetas)
    best = distinct_minima(short, values, thetas)[:STARTS]
    if not best:
        raise NoEstimate("no initial guess gave a finite response; give a prior closer to the system")
    kept = [thetas[i] for i in best if values[i] <= values[best[0]] + MARGIN]
    if is_unresolved(short.problem):  # a few iterations do not order the basins of several degrees of freedom
        ends = most_probable(short, list(thetas[np.isfinite(values)]) if short.system.n_dof > 1 else kept)
        kept = ends if len(ends) == 1 else kept  # several where no basin has a covariance
    return sets[0], np.stack(kept)


def first_distribution(
    model: OutputError, candidate: dict[str, float], theta: np.ndarray, drift: float, open_sd: float
) -> Joint:
    """Return the joint model with its prior, or ``open_sd`` about a candidate.

    ``theta``: the best guess, whose fastest rate scales the prior of an unknown initial velocity. ``drift``: standard
    deviation of the random walk of a log-parameter over a unit of time, the longest record.
    """
    k = len(model.free)
    if model.prior is not None:
        logs, sds = model.prior.log_mean, model.prior.log_sds
    else:
        logs, sds = np.log([candidate[name] for name in model.free]), np.full(k, open_sd)
    return Joint(model, logs, sds, drift**2, fastest_rate(model, theta[:k]))


# ------------------------------------------------------------------------------------------------- parallel filters


@dataclass(frozen=True, eq=False)
class FilterBatch:
    """Filters from B initial guesses after a pass: means (B, K, d), covariances (B, K, d, d).

    ``sigma`` (B, C): noise. ``about``, ``width``: means and covariances about which the next pass is linearised.
    ``used`` (B,): degrees of freedom used by the data. ``shift`` (B, constants): change of the constants by the pass,
    in their standard deviations; ``part`` (B,): relaxation factor applied to it.
    """

    means: np.ndarray
    covariances: np.ndarray
    about: np.ndarray
    width: np.ndarray
    sigma: np.ndarray
    used: np.ndarray
    shift: np.ndarray
    part: np.ndarray

    @property
    def moved(self) -> np.ndarray:
        """Return the largest shift of each filter, (B,)."""
        return np.asarray(np.max(np.abs(self.shift), axis=1, initial=0.0))


def started(joint: Joint, nodes: Nodes, thetas: np.ndarray) -> FilterBatch:
    """Return filters about the trajectories of initial guesses (B, size), with the noise of their residuals."""
    model, count = joint.model, len(thetas)
    means = joint.trajectories(thetas, nodes)
    sigma = model.noise(model.data - model.predict(thetas), model.size)
    covariances = np.zeros((*means.shape, joint.size))
    far, none = np.full((count, joint.size - joint.states), np.inf), np.zeros(count)
    return _alive(FilterBatch(means, covariances, means, covariances, sigma, none, far, none + 1.0))


def passed(joint: Joint, nodes: Nodes, rule: Rule, bank: FilterBatch) -> FilterBatch:
    """Make one more pass; filters that do not stay finite are left out."""
    new = smooth(joint, nodes, rule, bank.sigma, bank.about, bank.width)
    variances = np.diagonal(new.covariances[:, -1], axis1=1, axis2=2)
    shift = ((new.means - bank.about)[:, -1] / np.sqrt(np.maximum(variances, 1e-24)))[:, joint.states :]
    part = _relaxation(bank, shift)
    about = bank.about + part[:, None, None] * (new.means - bank.about)
    width = bank.width + part[:, None, None, None] * (new.covariances - bank.width)
    sigma = bank.sigma * (new.sigma / bank.sigma) ** part[:, None]
    return _alive(FilterBatch(new.means, new.covariances, about, width, sigma, new.used, shift, part))


def _relaxation(bank: FilterBatch, shift: np.ndarray) -> np.ndarray:
    """Return the relaxation factor of a pass, (B,): small where passes alternate, large where they converge slowly.

    Aitken's relaxation in several dimensions (B. M. Irons, R. C. Tuck, Int. J. Numerical Methods in Engineering 1:275,
    1969): the factor with which, by the secant of the last two passes, the next change would be zero.
    """
    known = np.isfinite(bank.moved)
    last = np.where(known[:, None], bank.shift, 0.0)
    change = shift - last
    part = -bank.part * np.sum(last * change, axis=1) / np.maximum(np.sum(change**2, axis=1), 1e-300)
    # the formula does not apply to a change that grows from pass to pass
    return np.where(known & (part > 0), np.clip(part, *PART), 1.0)


def _alive(bank: FilterBatch) -> FilterBatch:
    """Select the finite filters. Raises NoEstimate where there is none."""
    parts = (bank.means, bank.covariances, bank.sigma)
    alive = np.logical_and.reduce([np.isfinite(part).reshape(len(part), -1).all(axis=1) for part in parts])
    if not np.any(alive):
        raise NoEstimate("the filter lost the motion: its state did not stay finite; give a prior closer to the system")
    return FilterBatch(*(getattr(bank, part.name)[alive] for part in fields(bank)))


def longest_step(model: OutputError, thetas: np.ndarray, noise_share: np.ndarray) -> float:
    """Return the integration step for the motions at ``thetas``, in natural units: the longest record is 1.

    Its error is ``NOISE_SHARE`` of the data's standard error, for noise of ``noise_share`` (B, C) of the data's size.
    """
    rate = max(fastest_rate(model, theta) for theta in thetas)
    allowed = NOISE_SHARE * float(np.min(noise_share)) / np.sqrt(model.data.size)
    return float(np.clip(radians_a_step(allowed, rate), FINEST, RADIANS_A_STEP)) / max(rate, 1e-9)


# ----------------------------------------------------------------------------------------------------- the estimate


def answer(joint: Joint, nodes: Nodes, bank: FilterBatch, passes: int, method: IteratedSmoother) -> Estimate:
    """Return the estimate at the most probable end, with messages."""
    model, settled = joint.model, bank.moved <= method.tolerance
    cost = Cost(passes * len(settled) * (2 * joint.size + 1), passes)
    thetas = joint.theta(bank.means, nodes)
    with np.errstate(all="ignore"):
        residuals = model.data - model.predict(thetas)
    logs = -0.5 * np.asarray(model.profile_of(thetas, residuals))
    best = int(np.argmax(logs - np.where(settled, 0.0, 0.5 * MARGIN)))
    residual_share = float(np.mean((residuals[best] / model.rms[model.channel_of]) ** 2))
    unsettled = method.passes > 1 and not settled[best]
    if unsettled and bank.moved[best] > ADRIFT and not residual_share < POOR:
        lost = f"the filter lost the motion: no convergence, residuals {residual_share:.0%} of the data's mean square"
        raise NoEstimate(lost, cost=cost)
    covariance, messages = _combined(joint, bank, logs, best)
    if not residual_share < POOR:
        messages.append(f"residuals are {residual_share:.0%} of the data's mean square: motion lost, or noise")
    if unsettled:
        moved = f"{bank.moved[best]:.1g} of its standard deviation"
        messages.append(f"no convergence: the last pass moved the estimate by {moved}; raise passes")
    if np.any(bank.sigma[best] <= SIGMA_FLOOR * model.rms * (1.0 + ROUNDING)):
        messages.append(f"the noise is set to {SIGMA_FLOOR:g} of the data, the least that the filter resolves")
    return estimate_at(model, thetas[best], covariance, float(bank.used[best]), cost, "; ".join(messages))


def _combined(joint: Joint, bank: FilterBatch, logs: np.ndarray, best: int) -> tuple[np.ndarray, list[str]]:
    """Return the covariance of the log-parameters about the best end, widened by rivals nearly as probable; messages.

    ``logs`` (B,): logarithms of the posterior at the ends.
    """
    places = joint.log_places
    means, covariances = bank.means[:, -1, places], bank.covariances[:, -1, places, places]
    away, covariance = means - means[best], covariances[best]
    distinct = np.max(np.abs(away) / np.sqrt(np.maximum(np.diag(covariance), 1e-24)), axis=1) > APART
    odds = np.exp(np.minimum(logs - logs[best], 0.0))
    rivals = distinct & (odds > RIVAL)
    if not np.any(rivals):
        return covariance, []
    weights = np.where(rivals, odds, 0.0)
    weights[best] = 1.0
    weights /= weights.sum()
    spread = covariances + outer(away, away)
    chance = f"{1.0 - weights[best]:.0%}"
    message = f"another motion is plausible (probability {chance}); the interval is widened to cover it"
    return np.einsum("b,bij->ij", weights, spread), [message]
