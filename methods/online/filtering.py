"""Common parts of the joint filters: initialisation, loss of the mode, outliers, rest and gaps.

**Initialisation.** The likelihood of the last samples is maximised (:mod:`methods.online.likelihood`) over windows of
growing length, until it determines the parameters (:data:`VAGUE`) and its predictions are as good as those of an
autoregression and better than the mean (:func:`explained`). Until then there is no estimate.

**Loss of the mode.** The same comparison is applied to the running filter. Where it fails, the mode is lost: the status
says so, the covariance is increased, and the last samples are searched again unless the filter recovers before.

**Unknown force.** Free motion is treated as motion under an unknown force, so that unmeasured impacts are possible.
The force's standard deviation follows the mean square of the innovations; so does the sensor noise, within what the
first samples leave open. Updates of the parameters that accumulate faster than white noise widen the interval.

**Outliers.** A value more than :data:`GATE` standard deviations from the prediction of every member is omitted; members
with a recently increased covariance, which would accept any value, are not considered. After :data:`IN_A_ROW` outliers
in a row, the variance of the sensor's offset is increased, and that of the motion where the force is unknown, since an
impact changes the motion and not the stiffness. If outliers continue, the variances of parameters and motion are
increased too.

**Rest.** Where the predicted motion is below the noise, the samples contain next to no information about the
parameters, and the status says so (:data:`REST`). Under an unknown force their variance then grows.

**Gaps.** The filter predicts across a gap. Since the known force is missing there, the variance of the motion is then
increased to the mean square of the motion. After a failed step the force is known.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from math import isfinite
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Interval

from bench import Layout, Normal, OnlineIdentifier, Sample, SampleStatus, Tracker, TrackerOutput
from methods.online.bank import FLOOR, GATE, Bank, Outcome, Rule
from methods.online.likelihood import Head, beginning, without_spikes

WIDTH = 6.0
"""Standard deviation of a sensor's offset after a jump, over the root mean square of its first values."""
IN_A_ROW = 5
OPENED = 0.3
"""Standard deviation added to log-parameters after a jump."""
VAGUE = 0.05
"""Standard deviation of a log-stiffness or log-mass above which more first samples are needed."""
OPEN_ABOVE, OPEN_RATIO, OPEN_DAMPING = 0.7, 0.01, 1.5
"""A log-damping with a standard deviation above the first starts at this damping ratio or more, with the last as its
standard deviation: few cycles hardly determine damping, and a filter linearised at zero damping cannot correct it."""
NOISE_KNOWN, PUSH_KNOWN = 1.2, 1e3
"""Factors within which the first samples determine the sensor noise and the unknown force."""
FEWEST = 10
"""Least number of samples from which predictions are assessed."""
UNMODELLED = 0.01
"""Tolerated unmodelled part of the mean square of the samples: a tenth of the amplitude."""
SCATTERED, FORGOTTEN = 2.0, 0.05
"""Mean square of summed normalised updates above which intervals are widened, and the weight of each new sum."""
FAR_OFF = 4.0
"""Predictions are worse if the log-ratio of mean squares exceeds this many standard deviations, 2 / sqrt(n)."""
MOST = 8
REMEMBERED = 0.998
"""Forgetting factor of the mean square of the motion."""
PEAK_MEMORY = 0.99
"""Forgetting factor of the largest predicted square of a sensor."""
REST = 0.7
"""The system is at rest where every sensor's predicted motion is below this multiple of its noise."""
REST_RATE = 2e-3
"""Standard deviation per sample added to log-parameters at rest under an unknown force."""
RESTING = "no motion above the noise: the estimate relies on earlier samples"
OPENING = "several successive samples are outliers: the sensor's zero or the system has jumped; intervals are widened"


Probability = Annotated[float, Interval(gt=0.0, lt=1.0)]


@dataclass(frozen=True)
class FilterIdentifier(OnlineIdentifier):
    """``warm_up``: samples before the filters start; half of them where no force is known."""

    warm_up: Annotated[int, Interval(ge=20)] = 150
    requires: ClassVar[tuple[str, ...]] = ("jax",)
    extra: ClassVar[str] = "jax"
    version: ClassVar[int] = 4
    """4: under a known force the sensor noise is estimated from all samples, not from the first alone."""


class FilterTracker(Tracker):
    """A bank of filters of the joint state; subclasses define the members and their weights.

    ``walk`` (M, n_free): process noise of each member's log-parameters per sample, as a variance. ``chain``: forgetting
    factor of the weights, or a transition matrix where members mix.
    """

    state_names: ClassVar[tuple[str, ...]] = (
        "begun", "lacking", "rows", "count", "searching", "losses", "block", "levels", "scatter", "wider",
        "means", "spreads", "weights", "sigma", "push", "memory", "square",
        "before", "far", "width", "moving", "resting", "asking",
    )  # fmt: skip
    mixes: ClassVar[bool] = False

    def __init__(self, layout: Layout, warm_up: int, walk: np.ndarray, chain: Any, rule: Rule = "extended") -> None:
        super().__init__(layout)
        self.warm_up, self.walk, self.chain = warm_up, walk, chain
        unforced = not (layout.forced or layout.ambient)
        driven = replace(layout, ambient=tuple(range(layout.system.n_dof))) if unforced else layout
        self.bank = Bank(driven, len(walk), rule, self.mixes)
        self.model, (self._step, self._coast) = self.bank.model, self.bank.functions()
        members, d, c = len(walk), self.model.size, len(layout.sensors)
        self.begun, self.far, self.asking, self.searching, self.losses, self.resting = False, 0, 0, False, 0, False
        self.lacking = "collecting the first samples"
        self.scatter = self.wider = np.ones(len(layout.free))
        self.block, self.levels = list[np.ndarray](), np.ones(c + len(driven.ambient))
        self.columns, self.count = c + len(layout.forced), 0
        self.rows = np.full((MOST * warm_up, self.columns + c), np.nan)
        self.means, self.spreads = np.zeros((members, d)), np.tile(np.eye(d), (members, 1, 1))
        self.weights = np.zeros(members)
        self.sigma, self.width, self.moving = np.ones(c), np.ones(c), np.ones(c)
        self.push, self.memory = np.zeros(len(driven.ambient)), np.zeros(len(driven.ambient))
        self.square, self.before = np.zeros(self.model.n_motion), [0.0] * len(layout.forced)
        self.rebuild()

    def prepare(self) -> None:
        """Compile the search and the step by running them on noise; the results are discarded."""
        rng = np.random.default_rng(0)
        shortest = self.warm_up if self.layout.forced else self.warm_up // 2
        values = rng.standard_normal((shortest, self.sigma.size))
        forces = rng.standard_normal((shortest, len(self.before)))
        beginning(Head(self.bank.layout, values, forces))
        row = np.concatenate([values[0], np.ones(self.sigma.size), forces[0], self.before])
        state, _ = self._step((self.means, self.spreads, self.weights), row, self.constants)
        self._step(state, row, self.constants)

    def rebuild(self) -> None:
        """Compute the constants of the compiled step as JAX arrays."""
        import jax

        walk = np.zeros((len(self.walk), self.model.size))
        walk[:, self.model.logs] = self.walk + (REST_RATE**2 if self.resting and not self.layout.forced else 0.0)
        walk[:, self.model.ambient] = self.push**2 * (1.0 - self.memory**2)
        levels = self.sigma**2, self.chain, GATE**2
        self.constants = jax.tree.map(jax.numpy.asarray, (self.layout.interval, (walk, self.memory), levels))
        self.ungated = (*self.constants[:2], (*self.constants[2][:2], jax.numpy.asarray(np.inf)))

    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Search until a mode is found; then predict across a gap, update, and call :meth:`judged`."""
        self._kept(sample, steps)
        if not self.begun:
            self.before, lacking = list(sample.forces), self._searched()
            if not lacking:
                return TrackerOutput(sample.time, SampleStatus.OK, self._belief_of_first())
            self.lacking = lacking
            return TrackerOutput(sample.time, SampleStatus.WARMING_UP, message=f"no estimate yet: {lacking}")
        if steps > 1:
            self._gap(steps - 1)
        valid = [isfinite(value) for value in sample.values]
        filled = [value if known else 0.0 for value, known in zip(sample.values, valid, strict=True)]
        row = np.array([*filled, *valid, *sample.forces, *self.before], float)
        constants, state = self.ungated if self.asking else self.constants, (self.means, self.spreads, self.weights)
        after, numbers = self._step(state, row, constants)
        if not (outcome := np.asarray(numbers).view(self.bank.outcome)[0])["finite"]:
            after, numbers = self._step(self._without_diverged(after, outcome), row, constants)
            outcome = np.asarray(numbers).view(self.bank.outcome)[0]
        self.means, self.spreads, self.weights = after
        self.asking = max(self.asking - 1, 0)
        self.before = list(sample.forces)
        if not outcome["finite"]:
            self.begun, self.far, self.losses = False, 0, self.losses + 1
            return TrackerOutput(sample.time, SampleStatus.FAILED, message="the filter diverged and is restarted")
        self.block.append(np.asarray(numbers))
        alarm = self.judged(outcome)
        status, message = (SampleStatus.AT_REST, RESTING) if self.resting else (SampleStatus.OK, "")
        if outcome["outlier"]:
            status, message = self._outlying()
        else:
            self.rows[(self.count - 1) % len(self.rows), self.columns :] = outcome["expected"]
            self.far = max(self.far - 1, 0)
        self._judge()
        distribution = self.distribution(outcome["mean"], outcome["covariance"])
        if self.searching:
            status, message = SampleStatus.LOST, f"the mode is lost ({self.losses} so far); searching again"
            if not self._searched():
                return TrackerOutput(sample.time, SampleStatus.OK, self._belief_of_first())
        return TrackerOutput(sample.time, status, distribution, outcome["expected"], outcome["sd"], alarm, message)

    def distribution(self, mean: np.ndarray, cov: np.ndarray) -> Normal:
        """Return the distribution of the log-parameters from mean and covariance of the joint state."""
        logs = self.model.logs
        covariance = cov[logs, logs] * self.wider * self.wider[:, None]
        if self.searching:
            covariance += OPENED**2 * np.eye(len(covariance))
        return Normal(self.layout.free, mean[logs], covariance, log=True)

    def _belief_of_first(self) -> Normal:
        """Return the distribution after initialisation, which all members share."""
        return self.distribution(np.asarray(self.means)[0], self.bank.form.covariance(np.asarray(self.spreads))[0])

    def afresh(self) -> None:
        """Reset the state of the subclass after a new initialisation. By default nothing."""

    @abstractmethod
    def judged(self, outcome: Outcome) -> float:
        """Process the results of a step; return the alarm, NaN where the method has none."""

    def _kept(self, sample: Sample, steps: int) -> None:
        """Store a sample; a gap with unknown forces restarts the storage."""
        if steps > 1 and (self.layout.forced or steps > self.warm_up) and len(self.skipped) != steps - 1:
            self.count = 0
        for _ in range(steps if self.count else 1):
            place, self.count = self.count % len(self.rows), self.count + 1
            self.rows[place] = np.nan
        self.rows[place, : self.columns] = *sample.values, *sample.forces

    def _latest(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return values, forces and predictions of the last n stored samples, the oldest first."""
        rows = self.rows[np.arange(self.count - n, self.count) % len(self.rows)]
        values, forces, expected = np.split(rows, [self.sigma.size, self.columns], axis=1)
        return values, forces, expected

    def _searched(self) -> str:
        """Search the last samples for a mode and restart the filter there; return the reason where there is none."""
        n, half = self.count, self.warm_up // 2
        shortest = self.warm_up if self.layout.forced else half
        if n < shortest or n % half:
            return self.lacking
        length = shortest if self.begun else min(max(half * (n // half & -(n // half)), shortest), len(self.rows))
        values, forces, _ = self._latest(length)
        if np.sum(np.isfinite(values)) < length // 2 or not np.nanmax(np.abs(values)) > 0:
            return "no sensor shows any motion"
        values, forces = without_spikes(values), np.nan_to_num(forces)
        if self.layout.scale_known and not np.any(forces):
            return "the known force is zero over the last samples, which then do not determine the mass"
        best = beginning(Head(self.bank.layout, values, forces))
        variances = np.diag(best.covariance)
        if not (np.all(np.isfinite(best.mean)) and np.all(variances[self.model.logs] > 0)):
            return "no parameters explain the last samples"
        if not explained(values, best.expected, moving=True):
            return "the last samples show no mode that explains them"
        if length < len(self.rows) and self._vague(variances):
            return "the last samples do not determine the parameters well enough"
        mean, covariance = self._with_learnable_damping(best.mean, best.covariance)
        members, squares = len(self.walk), (values - np.nanmean(values, axis=0)) ** 2
        self.means = np.tile(mean, (members, 1))
        self.spreads = np.tile(self.bank.form.spread(covariance), (members, 1, 1))
        self.weights = np.log(self.first_weights())
        self.sigma, self.push, self.memory = best.levels.sigma, best.levels.push, best.levels.memory
        self.moving, self.width = np.nanmax(squares, axis=0), WIDTH * np.sqrt(np.nanmean(squares, axis=0))
        self.square = np.maximum(best.mean**2, variances)[: self.model.n_motion]
        self.begun, self.searching, self.resting, self.far = True, False, False, 0
        self.levels, self.block = np.concatenate([self.sigma, self.push]), []
        self.scatter = self.wider = np.ones(self.scatter.size)
        self.rows[np.arange(n - length, n) % len(self.rows), self.columns :] = best.expected
        self.afresh()
        self.rebuild()
        return ""

    def _judge(self) -> None:
        """Every few samples, update the noise levels and compare the predictions with those of an autoregression."""
        span = self.warm_up // 2
        if len(self.block) < max(span // 5, 1):
            return
        block, self.block = np.array(self.block).view(self.bank.outcome)[:, 0], []
        n, motion = len(block), block["mean"][:, : self.model.n_motion]
        kept = REMEMBERED**n
        self.square = kept * self.square + (1.0 - kept) * np.mean(motion**2, axis=0)
        shown = np.max((block["expected"] - block["mean"][:, self.model.offsets]) ** 2, axis=0)
        self.moving = np.maximum(PEAK_MEMORY**n * self.moving, shown)
        self.resting = bool(np.all(self.moving < (REST * self.sigma) ** 2))
        self.scatter = self.scatter + FORGOTTEN * (block["moves"].sum(axis=0) ** 2 / n - self.scatter)
        self.wider = np.sqrt(np.where(self.scatter > SCATTERED, self.scatter, 1.0))
        if self.push.size:
            factor = np.exp(0.5 * block["excess"].sum() / span)
            sigma, push = np.split(self.levels, [self.sigma.size])
            self.sigma = np.clip(factor * self.sigma, sigma / NOISE_KNOWN, sigma * NOISE_KNOWN)
            self.push = np.clip(factor * self.push, push / PUSH_KNOWN, push * PUSH_KNOWN)
        else:  # recursive maximum likelihood; the first samples give the noise to 10 %
            self.sigma = self.sigma * np.exp(0.5 * block["excess"].sum() / max(self.count, self.warm_up))
        self.rebuild()
        if self.count < span:
            return
        values, _, expected = self._latest(span)
        if self.searching:
            self.searching = not explained(values, expected, moving=True)
        elif not explained(values, expected):
            self.searching, self.losses = True, self.losses + 1
            self.opened(motion=self.square, logs=OPENED**2)

    def _without_diverged(self, after: Any, outcome: Outcome) -> tuple[np.ndarray, ...]:
        """Return the state before a step, with members that became non-finite reset to the most probable other one."""
        means, spreads, weights = (np.array(part) for part in (self.means, self.spreads, self.weights))
        covariances = self.bank.form.covariance(np.asarray(after[1]))
        diverged = ~np.isfinite(np.sum(after[0], axis=1) + np.sum(covariances, axis=(1, 2)) + outcome["gained"])
        diverged |= np.min(np.diagonal(covariances, axis1=1, axis2=2), axis=1) < 0
        best = int(np.argmax(np.where(diverged, -np.inf, weights)))
        means[diverged], spreads[diverged], weights[diverged] = means[best], spreads[best], FLOOR
        return means, spreads, weights

    @property
    def _kinds(self) -> list[str]:
        """Return the kind of each free parameter: mass, damping or stiffness."""
        kinds = {p.name: p.kind for p in self.layout.system.parameters}
        return [kinds[name] for name in self.layout.free]

    def _vague(self, variances: np.ndarray) -> bool:
        sds = np.sqrt(variances[self.model.logs])
        return any(sd > VAGUE for kind, sd in zip(self._kinds, sds, strict=True) if kind in ("mass", "stiffness"))

    def _with_learnable_damping(self, mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reset dampings that the first samples do not determine to a value from which the filter can correct them."""
        mean, covariance, system = mean.copy(), covariance.copy(), self.layout.system
        logs = dict.fromkeys(system.names, 0.0) | dict(zip(self.layout.free, mean[self.model.logs], strict=True))
        sizes = {kind: [logs[p.name] for p in system.parameters if p.kind == kind] for kind in ("mass", "stiffness")}
        for place, kind in enumerate(self._kinds, self.model.logs.start):
            if kind != "damping" or not all(sizes.values()) or covariance[place, place] <= OPEN_ABOVE**2:
                continue
            size = 0.5 * (np.mean(sizes["mass"]) + np.mean(sizes["stiffness"])) + np.log(2.0 * OPEN_RATIO)
            mean[place] = max(mean[place], size)
            covariance[place], covariance[:, place] = 0.0, 0.0
            covariance[place, place] = OPEN_DAMPING**2
        return mean, covariance

    def first_weights(self) -> np.ndarray:
        """Return the initial weights of the members; equal by default."""
        return np.full(len(self.walk), 1.0 / len(self.walk))

    def opened(self, motion: Any = 0.0, offsets: Any = 0.0, logs: Any = 0.0) -> None:
        """Add variances to the covariance of every member."""
        covariances = self.bank.form.covariance(np.asarray(self.spreads))
        self.spreads = self.bank.form.spread(covariances + np.diag(self.variances(motion, offsets, logs)))

    def variances(self, motion: Any = 0.0, offsets: Any = 0.0, logs: Any = 0.0) -> np.ndarray:
        """Return variances of motion, sensors' zeros and log-parameters as a vector of the joint state, (d,)."""
        joint, model = np.zeros(self.model.size), self.model
        joint[: model.n_motion], joint[model.offsets], joint[model.logs] = motion, offsets, logs
        return joint

    def _gap(self, missing: int) -> None:
        (interval, noise, _), known = self.constants, len(self.skipped) == missing
        for i in range(missing):
            before = np.array(self.before)
            self.means, self.spreads = self._coast(self.means, self.spreads, before, interval, noise)
            if known:
                self.before = self.skipped[i]
        if self.layout.forced and not known:
            self.opened(motion=self.square)

    def _outlying(self) -> tuple[SampleStatus, str]:
        """Omit single outliers; treat several in a row as a jump."""
        self.far += 1
        if self.far % IN_A_ROW:
            return SampleStatus.OUTLIER, "a value is an outlier from its prediction; omitted"
        self.jumped()
        return SampleStatus.SENSOR_JUMP, OPENING

    def jumped(self) -> None:
        """Increase the variances of the sensors' zeros, at a second jump those of parameters and motion too."""
        if self.far > IN_A_ROW:
            self.far = 0
            self.opened(self.square, self.zero_variance(), OPENED**2)
        else:
            self.opened(0.0 if self.layout.forced else self.square, self.zero_variance())

    def zero_variance(self) -> np.ndarray:
        """Return the variances added to the sensors' zeros; none for acceleration, whose bursts are no jumps."""
        moves = [sensor.measures == "displacement" for sensor in self.layout.sensors]
        return np.asarray(np.where(moves, self.width**2, 0.0))

    def reset_motion(self) -> None:
        """After a long gap reset the motion to zero mean and its mean square; parameters are unchanged."""
        self.count = 0
        if not self.begun:
            return
        means = np.array(self.means)
        means[:, : self.model.n_motion] = 0.0
        self.means = means
        self.opened(motion=self.square)


def explained(values: np.ndarray, expected: np.ndarray, moving: bool = False) -> bool:
    """Return True where predictions are as good as those of an autoregression of order two fitted to the values.

    Args:
        values: Samples, (n, c), NaN where missing.
        expected: Their predictions, (n, c).
        moving: Require predictions better than the sensors' means too, so that there is motion and not noise alone.
    """
    # the ratios of mean squares, averaged over the sensors, follow an F distribution
    against, of_mean = [], []
    for y, predicted in zip(values.T, expected.T, strict=True):
        columns = np.stack([y[1:-1], y[:-2], np.ones(y.size - 2)], axis=1)
        valid = np.isfinite(columns.sum(axis=1) + y[2:] + predicted[2:])
        n, measured = int(valid.sum()), int(np.isfinite(columns.sum(axis=1) + y[2:]).sum())
        if n < FEWEST or n < measured // 3:  # outliers have no prediction
            return not moving and measured < FEWEST
        columns, target, residual = columns[valid], y[2:][valid], (y - predicted)[2:][valid]
        rival = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        square, whole = float(np.mean(residual**2)), float(np.var(target)) or 1e-300
        against.append(square / (float(rival @ rival) / (n - 3) + UNMODELLED * whole))
        of_mean.append(square / whole)
    most = float(np.exp(FAR_OFF * 2.0 / np.sqrt(n)))
    return bool(np.mean(against) < most and (not moving or np.mean(of_mean) < 1.0 / most))
