"""What the filters of the joint state share: how they begin, what a gap does to them, and samples that are far off.

**Beginning.** The likelihood of the last samples is maximised (:mod:`methods.online.likelihood`), over longer windows
by and by, until it determines the parameters (:data:`VAGUE`) and its predictions are as good as an autoregression's and
better than the mean (:func:`explained`). Until then there is no answer.

**Losing the mode.** The same comparison judges the running filter. Where it fails the mode is lost: counted, said, the
distribution widened, and the last samples searched anew, unless the filter finds back before.

**Unknown force.** Free motion is that under an unknown force, since blows come untold. The force's level follows the
mean square of the innovations; so does the sensors' noise, within what the first samples leave open. Moves of the
parameters that add up faster than white noise widen the interval.

**Far-off samples.** A value more than :data:`GATE` standard deviations from what every member expects is left out; a
member that has just been opened, and would explain any, is not asked. :data:`IN_A_ROW` of them are no spikes: something
has jumped. The sensor's offset is opened first, and the motion where the force is not known: a blow makes that unknown,
not the stiffness. If that explains nothing, parameters and motion are opened too.

**Rest.** Where the motion that is expected falls below the noise, the samples say next to nothing of the parameters,
and the status says so (:data:`REST`). Where the force is not known the distribution then grows wider.

**Gaps.** The distribution coasts. A known force is not known in a gap, so behind one the motion is open by as much as
it has been moving. Behind a step that failed it is known.
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
"""Standard deviation by which a sensor's offset is opened, over the root mean square of its first values."""
IN_A_ROW = 5
OPENED = 0.3
"""Standard deviation by which log-parameters are opened behind a jump."""
VAGUE = 0.05
"""Standard deviation of a log-stiffness, or log-mass, above which the first samples do not tell enough."""
OPEN_ABOVE, OPEN_RATIO, OPEN_DAMPING = 0.7, 0.01, 1.5
"""A log-damping whose standard deviation is above the first is begun at this damping ratio or more, with the last for a
standard deviation: a few cycles hardly tell a damping, and a filter about a damping of nothing would never learn."""
NOISE_KNOWN, PUSH_KNOWN = 1.2, 1e3
"""Factors within which the first samples tell the noise of a sensor and an unknown force."""
FEWEST = 10
"""Samples from which predictions are judged."""
UNMODELLED = 0.01
"""Of the mean square of what is seen, what an unmodelled part may leave: a tenth of the amplitude."""
SCATTERED, FORGOTTEN = 2.0, 0.05
"""Above the first the mean square of sums of normalised moves widens the intervals; what each new sum weighs in it."""
FAR_OFF = 4.0
"""Standard deviations of the logarithm of a ratio of mean squares, 2 / sqrt(n), at which predictions are worse."""
MOST = 8
REMEMBERED = 0.998
"""Forgetting of the mean square of the motion."""
HELD = 0.99
"""Forgetting of the largest square that a sensor was expected to show."""
REST = 0.7
"""Standard deviations of its noise: where every sensor is expected to show less, the samples tell nothing."""
REST_RATE = 2e-3
"""Standard deviation that the log-parameters gain a sample at rest, where the force is not told."""
RESTING = "nothing moves beyond the noise: the distribution rests on what was learned before"
OPENING = "several samples in a row are far off: the sensor's zero or the system has jumped, the distribution is opened"


Probability = Annotated[float, Interval(gt=0.0, lt=1.0)]


@dataclass(frozen=True)
class FilterIdentifier(OnlineIdentifier):
    """``warm_up``: samples before the filters begin; half of them where no force is known."""

    warm_up: Annotated[int, Interval(ge=20)] = 150
    requires: ClassVar[tuple[str, ...]] = ("jax",)
    extra: ClassVar[str] = "jax"
    version: ClassVar[int] = 4
    """4: under a known force the sensors' noise is learned from all samples, not from the first alone."""


class FilterTracker(Tracker):
    """A bank of filters of the joint state. Subclasses say which members, and how they are weighted.

    ``walk`` (M, n_free): process noise of each member's log-parameters a sample, as a variance. ``chain``: forgetting
    of the weights, or a transition matrix where members mix.
    """

    holds: ClassVar[tuple[str, ...]] = (
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
        self.lacking = "the first samples are kept"
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
        """Compile, by a search in noise and a step from nowhere, neither of which is kept."""
        rng = np.random.default_rng(0)
        shortest = self.warm_up if self.layout.forced else self.warm_up // 2
        values = rng.standard_normal((shortest, self.sigma.size))
        forces = rng.standard_normal((shortest, len(self.before)))
        beginning(Head(self.bank.layout, values, forces))
        row = np.concatenate([values[0], np.ones(self.sigma.size), forces[0], self.before])
        state, _ = self._step((self.means, self.spreads, self.weights), row, self.constants)
        self._step(state, row, self.constants)

    def rebuild(self) -> None:
        """Make what a compiled step needs beside state and sample, as arrays of the library that compiled it."""
        import jax

        walk = np.zeros((len(self.walk), self.model.size))
        walk[:, self.model.logs] = self.walk + (REST_RATE**2 if self.resting and not self.layout.forced else 0.0)
        walk[:, self.model.ambient] = self.push**2 * (1.0 - self.memory**2)
        levels = self.sigma**2, self.chain, GATE**2
        self.constants = jax.tree.map(jax.numpy.asarray, (self.layout.interval, (walk, self.memory), levels))
        self.ungated = (*self.constants[:2], (*self.constants[2][:2], jax.numpy.asarray(np.inf)))

    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Search until a mode is found; then coast over a gap, update, and let the subclass have its say."""
        self._kept(sample, steps)
        if not self.begun:
            self.before, lacking = list(sample.forces), self._searched()
            if not lacking:
                return TrackerOutput(sample.time, SampleStatus.OK, self._distribution_of_first())
            self.lacking = lacking
            return TrackerOutput(sample.time, SampleStatus.WARMING_UP, message=f"no answer yet: {lacking}")
        if steps > 1:
            self._gap(steps - 1)
        there = [isfinite(value) for value in sample.values]
        filled = [value if known else 0.0 for value, known in zip(sample.values, there, strict=True)]
        row = np.array([*filled, *there, *sample.forces, *self.before], float)
        constants, state = self.ungated if self.asking else self.constants, (self.means, self.spreads, self.weights)
        after, numbers = self._step(state, row, constants)
        if not (outcome := np.asarray(numbers).view(self.bank.outcome)[0])["finite"]:
            after, numbers = self._step(self._mended(after, outcome), row, constants)
            outcome = np.asarray(numbers).view(self.bank.outcome)[0]
        self.means, self.spreads, self.weights = after
        self.asking = max(self.asking - 1, 0)
        self.before = list(sample.forces)
        if not outcome["finite"]:
            self.begun, self.far, self.losses = False, 0, self.losses + 1
            return TrackerOutput(sample.time, SampleStatus.FAILED, message="the filter is lost; it begins again")
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
            status, message = SampleStatus.LOST, f"the mode is lost ({self.losses} so far); the search goes on"
            if not self._searched():
                return TrackerOutput(sample.time, SampleStatus.OK, self._distribution_of_first())
        return TrackerOutput(sample.time, status, distribution, outcome["expected"], outcome["sd"], alarm, message)

    def distribution(self, mean: np.ndarray, cov: np.ndarray) -> Normal:
        """The log-parameters of a joint distribution."""
        logs = self.model.logs
        covariance = cov[logs, logs] * self.wider * self.wider[:, None]
        if self.searching:
            covariance += OPENED**2 * np.eye(len(covariance))
        return Normal(self.layout.free, mean[logs], covariance, log=True)

    def _distribution_of_first(self) -> Normal:
        """The distribution of a filter that has just begun: that of every member."""
        return self.distribution(np.asarray(self.means)[0], self.bank.form.covariance(np.asarray(self.spreads))[0])

    def afresh(self) -> None:
        """Forget what is held of an earlier filter. By default nothing."""

    @abstractmethod
    def judged(self, outcome: Outcome) -> float:
        """Do what the method does between samples; the alarm, NaN where it has none."""

    def _kept(self, sample: Sample, steps: int) -> None:
        """Keep a sample; under a known force the motion of a gap is anybody's: begin again behind it."""
        if steps > 1 and (self.layout.forced or steps > self.warm_up) and len(self.skipped) != steps - 1:
            self.count = 0
        for _ in range(steps if self.count else 1):
            place, self.count = self.count % len(self.rows), self.count + 1
            self.rows[place] = np.nan
        self.rows[place, : self.columns] = *sample.values, *sample.forces

    def _latest(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values, forces and what was expected of the last n samples kept, the oldest first."""
        rows = self.rows[np.arange(self.count - n, self.count) % len(self.rows)]
        values, forces, expected = np.split(rows, [self.sigma.size, self.columns], axis=1)
        return values, forces, expected

    def _searched(self) -> str:
        """Search the last samples for a mode, and begin anew where one is; else say why there is none."""
        n, half = self.count, self.warm_up // 2
        shortest = self.warm_up if self.layout.forced else half
        if n < shortest or n % half:
            return self.lacking
        length = shortest if self.begun else min(max(half * (n // half & -(n // half)), shortest), len(self.rows))
        values, forces, _ = self._latest(length)
        if np.sum(np.isfinite(values)) < length // 2 or not np.nanmax(np.abs(values)) > 0:
            return "no sensor shows any motion"
        values = without_spikes(values)
        best = beginning(Head(self.bank.layout, values, np.nan_to_num(forces)))
        variances = np.diag(best.covariance)
        if not (np.all(np.isfinite(best.mean)) and np.all(variances[self.model.logs] > 0)):
            return "no parameters explain the last samples"
        if not explained(values, best.expected, moving=True):
            return "the last samples show no mode that explains them"
        if length < len(self.rows) and self._vague(variances):
            return "the last samples do not determine the parameters well enough"
        mean, covariance = self._settled(best.mean, best.covariance)
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
        """Every few samples learn from the last, and compare their predictions with an autoregression's."""
        span = self.warm_up // 2
        if len(self.block) < max(span // 5, 1):
            return
        block, self.block = np.array(self.block).view(self.bank.outcome)[:, 0], []
        n, motion = len(block), block["mean"][:, : self.model.n_motion]
        kept = REMEMBERED**n
        self.square = kept * self.square + (1.0 - kept) * np.mean(motion**2, axis=0)
        shown = np.max((block["expected"] - block["mean"][:, self.model.offsets]) ** 2, axis=0)
        self.moving = np.maximum(HELD**n * self.moving, shown)
        self.resting = bool(np.all(self.moving < (REST * self.sigma) ** 2))
        self.scatter = self.scatter + FORGOTTEN * (block["moves"].sum(axis=0) ** 2 / n - self.scatter)
        self.wider = np.sqrt(np.where(self.scatter > SCATTERED, self.scatter, 1.0))
        if self.push.size:
            factor = np.exp(0.5 * block["excess"].sum() / span)
            sigma, push = np.split(self.levels, [self.sigma.size])
            self.sigma = np.clip(factor * self.sigma, sigma / NOISE_KNOWN, sigma * NOISE_KNOWN)
            self.push = np.clip(factor * self.push, push / PUSH_KNOWN, push * PUSH_KNOWN)
        else:  # recursive maximum likelihood: the first samples tell the noise to a tenth
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

    def _mended(self, after: Any, outcome: Outcome) -> tuple[np.ndarray, ...]:
        """The state before a step, with members that it took to no number where the weightiest of the others is."""
        means, spreads, weights = (np.array(part) for part in (self.means, self.spreads, self.weights))
        covariances = self.bank.form.covariance(np.asarray(after[1]))
        gone = ~np.isfinite(np.sum(after[0], axis=1) + np.sum(covariances, axis=(1, 2)) + outcome["gained"])
        gone |= np.min(np.diagonal(covariances, axis1=1, axis2=2), axis=1) < 0
        best = int(np.argmax(np.where(gone, -np.inf, weights)))
        means[gone], spreads[gone], weights[gone] = means[best], spreads[best], FLOOR
        return means, spreads, weights

    @property
    def _kinds(self) -> list[str]:
        """Return the kind of each free parameter: mass, damping or stiffness."""
        kinds = {p.name: p.kind for p in self.layout.system.parameters}
        return [kinds[name] for name in self.layout.free]

    def _vague(self, variances: np.ndarray) -> bool:
        sds = np.sqrt(variances[self.model.logs])
        return any(sd > VAGUE for kind, sd in zip(self._kinds, sds, strict=True) if kind in ("mass", "stiffness"))

    def _settled(self, mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The distribution with dampings that the first samples left open put where they can be learned."""
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
        """Of the members at first: alike, unless a subclass knows better."""
        return np.full(len(self.walk), 1.0 / len(self.walk))

    def opened(self, motion: Any = 0.0, offsets: Any = 0.0, logs: Any = 0.0) -> None:
        """Add variances to every member."""
        covariances = self.bank.form.covariance(np.asarray(self.spreads))
        self.spreads = self.bank.form.spread(covariances + np.diag(self.variances(motion, offsets, logs)))

    def variances(self, motion: Any = 0.0, offsets: Any = 0.0, logs: Any = 0.0) -> np.ndarray:
        """Variances of the motion, the sensors' zeros and the log-parameters as those of a joint state, (d,)."""
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
        """Leave single values out; several in a row are a jump."""
        self.far += 1
        if self.far % IN_A_ROW:
            return SampleStatus.OUTLIER, "a value is too far off to be one of the motion; left out"
        self.jumped()
        return SampleStatus.SENSOR_JUMP, OPENING

    def jumped(self) -> None:
        """Open the sensors' zeros; parameters and motion too where that was not enough."""
        if self.far > IN_A_ROW:
            self.far = 0
            self.opened(self.square, self.zero_variance(), OPENED**2)
        else:
            self.opened(0.0 if self.layout.forced else self.square, self.zero_variance())

    def zero_variance(self) -> np.ndarray:
        """By how much the sensors' zeros are opened: those of displacement. A burst of acceleration is no jump."""
        moves = [sensor.measures == "displacement" for sensor in self.layout.sensors]
        return np.asarray(np.where(moves, self.width**2, 0.0))

    def reset_motion(self) -> None:
        """Behind a long gap the motion is as open as it has been moving; parameters keep their distribution."""
        self.count = 0
        if not self.begun:
            return
        means = np.array(self.means)
        means[:, : self.model.n_motion] = 0.0
        self.means = means
        self.opened(motion=self.square)


def explained(values: np.ndarray, expected: np.ndarray, moving: bool = False) -> bool:
    """Whether predictions (n, c) are as good as those of an autoregression of order two fitted to the values.

    By an F test of the ratio of the mean squares, averaged over the sensors. With ``moving`` they must also be better
    than the sensors' means: something moves that is no noise.
    """
    against, of_mean = [], []
    for y, shown in zip(values.T, expected.T, strict=True):
        columns = np.stack([y[1:-1], y[:-2], np.ones(y.size - 2)], axis=1)
        there = np.isfinite(columns.sum(axis=1) + y[2:] + shown[2:])
        n, seen = int(there.sum()), int(np.isfinite(columns.sum(axis=1) + y[2:]).sum())
        if n < FEWEST or n < seen // 3:  # what was far off stands in no prediction
            return not moving and seen < FEWEST
        columns, target, left = columns[there], y[2:][there], (y - shown)[2:][there]
        rival = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        square, whole = float(np.mean(left**2)), float(np.var(target)) or 1e-300
        against.append(square / (float(rival @ rival) / (n - 3) + UNMODELLED * whole))
        of_mean.append(square / whole)
    most = float(np.exp(FAR_OFF * 2.0 / np.sqrt(n)))
    return bool(np.mean(against) < most and (not moving or np.mean(of_mean) < 1.0 / most))
