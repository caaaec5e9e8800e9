"""Joint estimation of state and parameters by Kalman filters: what the extended and the unscented filter share.

**Joint state.** Displacements, velocities and hidden states, then the log-parameters, then the offsets of sensors:
constants that the measurements of the motion tell of, once the equation of motion carries the state from sample to
sample (R. E. Kopp, R. J. Orford, AIAA J. 1:2300, 1963). The equation is the system's residual and nothing else
(:func:`bench.rk4_step`), so any system, known force and irregular times are served alike. Several records are one
chain: between two of them the motion starts anew and the constants carry over.

**Iteration.** The record is passed again and again, each time from the original belief, with the maps taken about the
smoothed trajectory of the pass before: the iterated extended Kalman smoother (B. M. Bell, SIAM J. Optimization 4:626,
1994), which without process noise is a Gauss-Newton method for the most probable parameters, or its counterpart with
sigma points (A. F. Garcia-Fernandez, L. Svensson, S. Sarkka, IEEE Trans. Automatic Control 62:2056, 2017). Nothing is
counted twice, as it would be if a pass began at the end of the one before.

**Starts.** The misfit has a minimum for each half-cycle that the phase may slip over the record, and a filter from a
wrong one stays there. So the first maps are taken about the trajectories that the starts of
:mod:`methods.kalman.starts` give, a few separate ones side by side. They are where the maps are taken and no more:
the belief that each pass begins with is the prior. Of their ends the most probable one is kept, as every search here
does. (The likelihood of the innovations, by which D. T. Magill weighs a bank of filters, IEEE Trans. Automatic Control
10:434, 1965, adds the volume of what the data leave open: at 0 dB it prefers a motion that dies at once, and explains
nothing, to the true one.) The ends that are nearly as probable widen its covariance, as components of a Gaussian sum do
(D. L. Alspach, H. W. Sorenson, IEEE Trans. Automatic Control 17:439, 1972), and the answer says so.

**Noise.** Not told. At first what the trajectory of a start leaves; from then on each channel's variance is its
residual sum of squares over N less the part of them that was fitted, ``sum H P H' / R``: the fixed point of the EM step
of R. H. Shumway, D. S. Stoffer (J. Time Series Analysis 3:253, 1982). Parameters are constants, so their process noise,
``drift``, is zero unless it is asked for.

**First belief.** Log-parameters: the prior. Without one: ``open_sd``, a factor of ``e``, about the first candidate as
the data gave it, moved by no search; where nothing tells the scale the gauge mass is 1 and the answer is the groups. A
start that is not told: rest, with a standard deviation of :data:`methods.kalman.joint.START` times the largest
displacement (times the fastest rate for velocities).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from bench import SIGMA_FLOOR, Cost, Estimate, InputError, NoEstimate, OutputError, Problem, estimate_at
from methods.kalman.core import Rule
from methods.kalman.filtering import filtered, noise
from methods.kalman.joint import Joint, Nodes, fastest_rate, first_belief
from methods.kalman.starts import MARGIN, screened_starts
from methods.starts.candidates import NOISE_SHARE
from methods.starts.rough import RADIANS_A_STEP, radians_a_step

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
class Settings:
    """At most ``passes``, until the log-parameters move by less than ``tolerance`` of their standard deviations.

    ``drift``: standard deviation of the random walk of each log-parameter over the longest record. ``open_sd``: that
    of a log-parameter at first, where there is no prior.
    """

    passes: int
    tolerance: float
    drift: float
    open_sd: float

    def __post_init__(self) -> None:
        if self.passes < 1:
            raise InputError("method.passes", self.passes, "at least 1")
        if not (np.isfinite(self.drift) and self.drift >= 0):
            raise InputError("method.drift", self.drift, "a standard deviation, 0 for constant parameters")
        for name in ("tolerance", "open_sd"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"method.{name}", getattr(self, name), "a positive number")


def estimate(problem: Problem, rule: Rule, settings: Settings) -> Estimate:
    """Estimate parameters (or groups) by passes of the filter that ``rule`` makes; a problem in natural units."""
    model = OutputError(problem)
    thetas = screened_starts(model)
    joint = first_belief(model, thetas[0], settings.drift, settings.open_sd)
    nodes = Nodes.of(joint, longest_step(model, thetas, np.ones((1, 1))))
    bank = started(joint, nodes, thetas)
    passes = 0
    while passes < settings.passes and np.any(bank.moved > settings.tolerance):
        thetas = np.stack([joint.theta(own, nodes) for own in bank.about])
        longest = longest_step(model, thetas, bank.sigma / model.rms)
        if not longest / SPARE**2 <= nodes.longest <= longest:
            nodes = Nodes.of(joint, longest / SPARE)
        bank = passed(joint, nodes, rule, bank)
        passes += 1
    return answer(joint, nodes, bank, passes, settings)


# --------------------------------------------------------------------------------------------- filters side by side


@dataclass(frozen=True, eq=False)
class FilterBatch:
    """Filters from B starts, side by side, after a pass: means (B, K, d), covariances (B, K, d, d), noise (B, C).

    ``about``, ``width``: the means and covariances that the maps of the next pass are taken about. ``used`` (B,):
    degrees of freedom that the data spent; ``shift`` (B, constants): how far the pass took the constants from where its
    maps were taken, in their standard deviations; ``part`` (B,) of it was followed.
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
    """The trajectories of starts (B, size), known exactly so far as the maps are concerned, and what they leave."""
    model, count = joint.model, len(thetas)
    means = nodes.trajectories(thetas)
    seen = nodes.observe(means.swapaxes(0, 1), np.arange(nodes.number)).swapaxes(0, 1)
    here = np.isfinite(nodes.values)
    rss = np.sum(np.where(here, nodes.values - seen, 0.0) ** 2, axis=1)
    share = max(1.0 - model.size / model.data.size, 1.0 / model.data.size)
    sigma = np.maximum(np.sqrt(rss / (np.maximum(model.counts, 1) * share)), SIGMA_FLOOR * model.rms)
    covariances = np.zeros((*means.shape, joint.size))
    far, none, whole = np.full((count, joint.constants.size), np.inf), np.zeros(count), np.ones(count)
    finite = np.all(np.isfinite(means), axis=(1, 2))
    return _alive(FilterBatch(means, covariances, means, covariances, sigma, none, far, whole), finite)


def passed(joint: Joint, nodes: Nodes, rule: Rule, bank: FilterBatch) -> FilterBatch:
    """The bank after one more pass; filters that do not stay finite are left out."""
    smoothed = filtered(joint, nodes, rule, bank.sigma, bank.about, bank.width)
    means, covariances = smoothed.means, smoothed.covariances
    sigma, used = noise(joint, nodes, bank.sigma, smoothed)
    variances = np.diagonal(covariances[:, -1], axis1=1, axis2=2)[:, joint.constants]
    shift = (means - bank.about)[:, -1, joint.constants] / np.sqrt(np.maximum(variances, 1e-24))
    part = _part_to_follow(bank, shift)
    about = bank.about + part[:, None, None] * (means - bank.about)
    width = bank.width + part[:, None, None, None] * (covariances - bank.width)
    sigma = bank.sigma * (sigma / bank.sigma) ** part[:, None]
    return _alive(FilterBatch(means, covariances, about, width, sigma, used, shift, part), smoothed.finite)


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


def _alive(bank: FilterBatch, finite: np.ndarray) -> FilterBatch:
    """Those that are finite, and their noise too. Raises NoEstimate where none is."""
    alive = finite & np.all(np.isfinite(bank.sigma), axis=1)
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


def answer(joint: Joint, nodes: Nodes, bank: FilterBatch, passes: int, settings: Settings) -> Estimate:
    """The most probable end, with what the others say against it."""
    model, settled = joint.model, bank.moved <= settings.tolerance
    cost = Cost(passes * len(settled) * (2 * joint.size + 1), passes)
    thetas = np.stack([joint.theta(means, nodes) for means in bank.means])
    with np.errstate(all="ignore"):
        residuals = model.data - model.predict(thetas)
    logs = -0.5 * np.asarray(model.profile_of(thetas, residuals))
    best = int(np.argmax(logs - np.where(settled, 0.0, 0.5 * MARGIN)))
    left = float(np.mean((residuals[best] / model.rms[model.channel_of]) ** 2))
    unsettled = settings.passes > 1 and not settled[best]
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
    constants = joint.constants[: len(joint.model.free)]
    means, covariances = bank.means[:, -1, constants], bank.covariances[:, -1][:, constants][:, :, constants]
    away, covariance = means - means[best], covariances[best]
    apart = np.max(np.abs(away) / np.sqrt(np.maximum(np.diag(covariance), 1e-24)), axis=1) > APART
    odds = np.exp(np.minimum(logs - logs[best], 0.0))
    rivals = apart & (odds > RIVAL)
    if not np.any(rivals):
        return covariance, []
    weights = np.where(rivals, odds, 0.0)
    weights[best] = 1.0
    weights /= weights.sum()
    spread = covariances + away[:, :, None] * away[:, None, :]
    chance = f"{1.0 - weights[best]:.0%}"
    said = f"another motion may have made the data (a chance of {chance}); the interval is widened to hold it"
    return np.einsum("b,bij->ij", weights, spread), [said]
