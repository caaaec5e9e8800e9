"""Joint estimation of state and parameters by Kalman filters: what the extended and the unscented filter share.

**Joint state.** Displacements, velocities and hidden states, then the log-parameters, then the offsets of sensors:
constants that the measurements of the motion tell of, once the equation of motion carries the state from sample to
sample (R. E. Kopp, R. J. Orford, AIAA J. 1:2300, 1963). Several records are one chain: between two of them the motion
starts anew and the constants carry over.

**Iteration.** The record is passed again and again, each time from the original distribution, with the maps taken about
the smoothed trajectory of the pass before: the iterated extended Kalman smoother (B. M. Bell, SIAM J. Optimization
4:626, 1994), which without process noise is a Gauss-Newton method for the most probable parameters, or its counterpart
with sigma points (A. F. Garcia-Fernandez, L. Svensson, S. Sarkka, IEEE Trans. Automatic Control 62:2056, 2017). Nothing
is counted twice, as it would be if a pass began at the end of the one before.

**Starting points.** The misfit has a minimum for each half-cycle that the phase may slip over the record, and a filter
from a wrong one stays there. So the first maps are taken about the trajectories of a few separate starting points of
the scan that multiple shooting has, too, side by side. The distribution that each pass begins with is the prior all the
same. Of their ends the most probable one is kept, as every search here does. (The likelihood of the innovations, by
which D. T. Magill weighs a bank of filters, IEEE Trans. Automatic Control 10:434, 1965, adds the volume of what the
data leave open: at 0 dB it prefers a motion that dies at once, and explains nothing, to the true one.) The ends that
are nearly as probable widen its covariance, as components of a Gaussian sum do (D. L. Alspach, H. W. Sorenson, IEEE
Trans. Automatic Control 17:439, 1972), and the answer says so.

**Noise.** At first what the trajectory of a starting point leaves; from then on each channel's variance is its residual
sum of squares over N less the part of them that was fitted, ``sum H P H' / R``: the fixed point of the EM step of R. H.
Shumway, D. S. Stoffer (J. Time Series Analysis 3:253, 1982).

**First distribution.** Log-parameters: the prior. Without one: ``open_sd``, a factor of ``e``, about the first
candidate as the data gave it, moved by no search; where the scale is not identifiable the gauge mass is 1 and the
answer is the groups. An unknown initial state: rest, with a standard deviation of :data:`methods.kalman.joint.START`
times the largest displacement (times the fastest rate for velocities).
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
"""Separate starting points at most."""
SCREENING = 5
"""Output-error steps that each candidate is given before the best are taken."""
MARGIN = 15.0
"""A starting point is kept if minus twice its log-posterior is within this of the best."""
ROUNDING = 1e-9
"""Of a noise level, which is at the least that is resolved but for its last bits."""
APART = 1.0
"""Ends are two if a log-parameter differs by more than this many standard deviations,"""
RIVAL = 0.05
"""and the less likely one counts if its odds are above this: a 95 % interval has to hold it."""
ADRIFT = 0.1
"""Standard deviations by which the last pass may move an answer that is poor."""
POOR = 0.5
"""A response that leaves more than this part of the mean square of the data is said to be poor."""
FINEST = 0.02
"""The shortest integration step, in radians of the fastest rate."""
PART = (0.2, 3.0)
"""The least and the most of a pass's move that is followed."""
SPARE = 1.15
"""Steps are made for a motion so much faster than the one at hand, and serve while it stays so."""


@dataclass(frozen=True)
class IteratedSmoother(SearchingIdentifier):
    """At most ``passes`` over the record, until no parameter moves by ``tolerance`` of its standard deviation.

    ``drift``: standard deviation of the random walk of a log-parameter over the longest record (its process noise).
    ``open_sd``: that of a log-parameter at first, where no prior is given.
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
        """Rule by which the maps become affine."""

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
    """The first of the parameter sets that the data suggest, and the vectors (B, size) to start from, best first.

    Each candidate takes a few output-error steps, on the thinned samples of a long record of a linear system, on the
    first samples of another. Raises NoEstimate where no candidate gives a finite response.
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
        raise NoEstimate("no start gave a finite response; give a prior nearer to the system")
    kept = [thetas[i] for i in best if values[i] <= values[best[0]] + MARGIN]
    if is_unresolved(short.problem):  # a few steps do not yet order the basins of several degrees of freedom
        ends = most_probable(short, list(thetas[np.isfinite(values)]) if short.system.n_dof > 1 else kept)
        kept = ends if len(ends) == 1 else kept  # several where no basin has a covariance
    return sets[0], np.stack(kept)


def first_distribution(
    model: OutputError, candidate: dict[str, float], theta: np.ndarray, drift: float, open_sd: float
) -> Joint:
    """The distribution before any sample: the prior, or ``open_sd`` about a candidate.

    ``theta``: the best starting point, whose fastest rate says how fast an unknown initial state may be. ``drift``:
    standard deviation of the random walk of a log-parameter over a unit of time, the longest record.
    """
    k = len(model.free)
    if model.prior is not None:
        logs, sds = model.prior.log_mean, model.prior.log_sds
    else:
        logs, sds = np.log([candidate[name] for name in model.free]), np.full(k, open_sd)
    return Joint(model, logs, sds, drift**2, fastest_rate(model, theta[:k]))


# --------------------------------------------------------------------------------------------- filters side by side


@dataclass(frozen=True, eq=False)
class FilterBatch:
    """Filters from B starting points, side by side, after a pass: means (B, K, d), covariances (B, K, d, d).

    ``sigma`` (B, C): noise. ``about``, ``width``: the means and covariances that the maps of the next pass are taken
    about. ``used`` (B,): degrees of freedom that the data spent; ``shift`` (B, constants): how far the pass took the
    constants from where its maps were taken, in their standard deviations; ``part`` (B,) of it was followed.
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
        """The largest shift of each, (B,)."""
        return np.asarray(np.max(np.abs(self.shift), axis=1, initial=0.0))


def started(joint: Joint, nodes: Nodes, thetas: np.ndarray) -> FilterBatch:
    """The trajectories of starting points (B, size), certain as far as the maps are concerned, and their residuals."""
    model, count = joint.model, len(thetas)
    means = joint.trajectories(thetas, nodes)
    sigma = model.noise(model.data - model.predict(thetas), model.size)
    covariances = np.zeros((*means.shape, joint.size))
    far, none = np.full((count, joint.size - joint.states), np.inf), np.zeros(count)
    return _alive(FilterBatch(means, covariances, means, covariances, sigma, none, far, none + 1.0))


def passed(joint: Joint, nodes: Nodes, rule: Rule, bank: FilterBatch) -> FilterBatch:
    """The bank after one more pass; filters that do not stay finite are left out."""
    new = smooth(joint, nodes, rule, bank.sigma, bank.about, bank.width)
    variances = np.diagonal(new.covariances[:, -1], axis1=1, axis2=2)
    shift = ((new.means - bank.about)[:, -1] / np.sqrt(np.maximum(variances, 1e-24)))[:, joint.states :]
    part = _part_to_follow(bank, shift)
    about = bank.about + part[:, None, None] * (new.means - bank.about)
    width = bank.width + part[:, None, None, None] * (new.covariances - bank.width)
    sigma = bank.sigma * (new.sigma / bank.sigma) ** part[:, None]
    return _alive(FilterBatch(new.means, new.covariances, about, width, sigma, new.used, shift, part))


def _part_to_follow(bank: FilterBatch, shift: np.ndarray) -> np.ndarray:
    """How much of a pass's move to take, (B,): less where the passes go to and fro, more where they creep.

    Aitken's relaxation in several dimensions (B. M. Irons, R. C. Tuck, Int. J. Numerical Methods in Engineering 1:275,
    1969): the part under which the move of this pass, after that of the last one, would have been nothing.
    """
    known = np.isfinite(bank.moved)
    last = np.where(known[:, None], bank.shift, 0.0)
    change = shift - last
    part = -bank.part * np.sum(last * change, axis=1) / np.maximum(np.sum(change**2, axis=1), 1e-300)
    # a move that grows on its way is far from its end yet, and the formula has nothing to say
    return np.where(known & (part > 0), np.clip(part, *PART), 1.0)


def _alive(bank: FilterBatch) -> FilterBatch:
    """Those that are finite. Raises NoEstimate where none is."""
    parts = (bank.means, bank.covariances, bank.sigma)
    alive = np.logical_and.reduce([np.isfinite(part).reshape(len(part), -1).all(axis=1) for part in parts])
    if not np.any(alive):
        raise NoEstimate("the filter lost the motion: its state did not stay finite; give a prior nearer to the system")
    return FilterBatch(*(getattr(bank, part.name)[alive] for part in fields(bank)))


def longest_step(model: OutputError, thetas: np.ndarray, noise_share: np.ndarray) -> float:
    """The integration step that serves the motions at ``thetas``, in natural units: the longest record is 1.

    Its error is ``NOISE_SHARE`` of the standard error that noise of ``noise_share`` (B, C) of the data allows.
    """
    rate = max(fastest_rate(model, theta) for theta in thetas)
    allowed = NOISE_SHARE * float(np.min(noise_share)) / np.sqrt(model.data.size)
    return float(np.clip(radians_a_step(allowed, rate), FINEST, RADIANS_A_STEP)) / max(rate, 1e-9)


# ------------------------------------------------------------------------------------------------------- the answer


def answer(joint: Joint, nodes: Nodes, bank: FilterBatch, passes: int, method: IteratedSmoother) -> Estimate:
    """The most probable end, with what the others say against it."""
    model, settled = joint.model, bank.moved <= method.tolerance
    cost = Cost(passes * len(settled) * (2 * joint.size + 1), passes)
    thetas = joint.theta(bank.means, nodes)
    with np.errstate(all="ignore"):
        residuals = model.data - model.predict(thetas)
    logs = -0.5 * np.asarray(model.profile_of(thetas, residuals))
    best = int(np.argmax(logs - np.where(settled, 0.0, 0.5 * MARGIN)))
    left = float(np.mean((residuals[best] / model.rms[model.channel_of]) ** 2))
    unsettled = method.passes > 1 and not settled[best]
    if unsettled and bank.moved[best] > ADRIFT and not left < POOR:
        lost = f"the filter lost the motion: its passes do not settle, and its response leaves {left:.0%} of the data"
        raise NoEstimate(lost, cost=cost)
    covariance, said = _combined(joint, bank, logs, best)
    if not left < POOR:
        said.append(f"the response leaves {left:.0%} of the data's mean square: motion lost, or noise")
    if unsettled:
        moved = f"{bank.moved[best]:.1g} of its standard deviation"
        said.append(f"the passes had not settled, the last moved the answer by {moved}: raise passes")
    if np.any(bank.sigma[best] <= SIGMA_FLOOR * model.rms * (1.0 + ROUNDING)):
        said.append(f"the noise is taken to be {SIGMA_FLOOR:g} of the data, the least that the filter resolves")
    return estimate_at(model, thetas[best], covariance, float(bank.used[best]), cost, "; ".join(said))


def _combined(joint: Joint, bank: FilterBatch, logs: np.ndarray, best: int) -> tuple[np.ndarray, list[str]]:
    """Covariance of the log-parameters about the best end, widened by rivals nearly as probable; and what to say.

    ``logs`` (B,): logarithms of the posterior at the ends.
    """
    at = joint.log_places
    means, covariances = bank.means[:, -1, at], bank.covariances[:, -1, at, at]
    away, covariance = means - means[best], covariances[best]
    apart = np.max(np.abs(away) / np.sqrt(np.maximum(np.diag(covariance), 1e-24)), axis=1) > APART
    odds = np.exp(np.minimum(logs - logs[best], 0.0))
    rivals = apart & (odds > RIVAL)
    if not np.any(rivals):
        return covariance, []
    weights = np.where(rivals, odds, 0.0)
    weights[best] = 1.0
    weights /= weights.sum()
    spread = covariances + outer(away, away)
    chance = f"{1.0 - weights[best]:.0%}"
    said = f"another motion may have made the data (a chance of {chance}); the interval is widened to hold it"
    return np.einsum("b,bij->ij", weights, spread), [said]
