"""What the filters of the joint state share: how they begin, what a gap does to them, and samples that are far off.

**Beginning.** The first samples are kept until they determine the parameters well enough (:data:`VAGUE`), at most
:data:`MOST` times as many as asked for; then the likelihood is maximised (:mod:`methods.online.likelihood`), and from
there on a sample is an update and nothing is kept.

**Far-off samples.** A value more than :data:`GATE` standard deviations from what every member expects is left out; a
member that has just been opened, and would explain any, is not asked. :data:`IN_A_ROW` of them are no spikes: something
has jumped. The sensor's offset is opened first, and if that explains nothing, parameters and motion too.

**Rest.** Where the motion that is expected falls below the noise, the samples say next to nothing of the parameters,
and the status says so (:data:`REST`).

**Gaps.** The belief coasts. A known force is not known in a gap, so behind one the motion is open by as much as it has
been moving. Behind a step that failed it is known.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar

import numpy as np

from bench import InputError, Layout, Normal, OnlineIdentifier, Sample, SampleStatus, Standing, Tracker
from methods.online.bank import FLOOR, Bank, Outcome, Rule
from methods.online.likelihood import Head, beginning, without_spikes

GATE = 6.0
"""Standard deviations."""
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
MOST = 8
REMEMBERED = 0.998
"""Forgetting of the mean square of the motion."""
HELD = 0.99
"""Forgetting of the largest square that a sensor was expected to show."""
REST = 0.3
"""Standard deviations of its noise: where every sensor is expected to show less, the samples tell nothing."""
RESTING = "nothing moves beyond the noise: the belief rests on what was learned before"
OPENING = "several samples in a row are far off: the sensor's zero or the system has jumped, the belief is opened"


@dataclass(frozen=True)
class FilterIdentifier(OnlineIdentifier):
    """``warm_up``: samples before the filters begin."""

    warm_up: int = 150

    def __post_init__(self) -> None:
        if self.warm_up < 20:
            raise InputError("method.warm_up", self.warm_up, "at least 20 samples")


class FilterTracker(Tracker):
    """A bank of filters of the joint state. Subclasses say which members, and how they are weighted.

    ``walk`` (M, n_free): process noise of each member's log-parameters a sample, as a variance. ``chain``: forgetting
    of the weights, or a transition matrix where members mix.
    """

    holds: ClassVar[tuple[str, ...]] = (
        "begun", "head_values", "head_forces", "means", "spreads", "weights", "sigma", "push", "memory", "square",
        "before", "far", "width", "moving", "asking",
    )  # fmt: skip
    mixes: ClassVar[bool] = False

    def __init__(self, layout: Layout, warm_up: int, walk: np.ndarray, chain: Any, rule: Rule = "extended") -> None:
        super().__init__(layout)
        self.warm_up, self.walk, self.chain = warm_up, walk, chain
        self.bank = Bank(layout, len(walk), rule, self.mixes)
        self.model, (self._step, self._coast) = self.bank.model, self.bank.functions()
        members, d, c = len(walk), self.model.size, len(layout.sensors)
        self.begun, self.far, self.asking = False, 0, 0
        self._forget_head()
        self.means, self.spreads = np.zeros((members, d)), np.tile(np.eye(d), (members, 1, 1))
        self.weights = np.zeros(members)
        self.sigma, self.width, self.moving = np.ones(c), np.ones(c), np.ones(c)
        self.push, self.memory = np.zeros(len(layout.ambient)), np.zeros(len(layout.ambient))
        self.square, self.before = np.zeros(self.model.n_motion), [0.0] * len(layout.forced)
        self.rebuild()

    def prepare(self) -> None:
        """Compile, by a search in noise and a step from nowhere, neither of which is kept."""
        rng = np.random.default_rng(0)
        values = rng.standard_normal((self.warm_up, self.sigma.size))
        forces = rng.standard_normal((self.warm_up, len(self.before)))
        beginning(Head(self.layout, values, forces))
        row = np.concatenate([values[0], np.ones(self.sigma.size), forces[0], self.before])
        state, _ = self._step((self.means, self.spreads, self.weights), row, self.constants)
        self._step(state, row, self.constants)

    def rebuild(self) -> None:
        """Make what a compiled step needs beside state and sample, as arrays of the library that compiled it."""
        import jax

        walk = np.zeros((len(self.walk), self.model.size))
        walk[:, self.model.logs] = self.walk
        walk[:, self.model.ambient] = self.push**2 * (1.0 - self.memory**2)
        levels = self.sigma**2, self.chain, GATE**2
        self.constants = jax.tree.map(jax.numpy.asarray, (self.layout.interval, (walk, self.memory), levels))
        self.ungated = (*self.constants[:2], (*self.constants[2][:2], jax.numpy.asarray(np.inf)))

    def step(self, sample: Sample, steps: int) -> Standing:
        """Keep the first samples; then coast over a gap, update, and let the subclass have its say."""
        if not self.begun:
            return self._collected(sample, steps)
        if steps > 1:
            self._gap(steps - 1)
        there = [isfinite(value) for value in sample.values]
        filled = [value if known else 0.0 for value, known in zip(sample.values, there, strict=True)]
        row = np.array([*filled, *there, *sample.forces, *self.before], float)
        constants, state = self.ungated if self.asking else self.constants, (self.means, self.spreads, self.weights)
        after, numbers = self._step(state, row, constants)
        if not _finite(outcome := np.asarray(numbers).view(self.bank.outcome)[0]):
            after, numbers = self._step(self._mended(after, outcome), row, constants)
            outcome = np.asarray(numbers).view(self.bank.outcome)[0]
        self.means, self.spreads, self.weights = after
        self.asking = max(self.asking - 1, 0)
        self.before = list(sample.forces)
        if not _finite(outcome):
            self.begun, self.far = False, 0
            self._forget_head()
            return Standing(sample.time, SampleStatus.FAILED, message="the filter is lost; it begins again")
        motion = outcome["mean"][: self.model.n_motion]
        self.square = REMEMBERED * self.square + (1.0 - REMEMBERED) * motion * motion
        self.moving = np.maximum(HELD * self.moving, outcome["expected"] ** 2)
        alarm = self.judged(outcome)
        status, message = SampleStatus.OK, ""
        if np.all(self.moving < (REST * self.sigma) ** 2):
            status, message = SampleStatus.AT_REST, RESTING
        if outcome["outlier"].any():
            status, message = self._outlying()
        elif self.far:
            self.far -= 1
        belief = self.belief(outcome["mean"], outcome["covariance"])
        expected, sd = outcome["expected"].copy(), np.sqrt(outcome["variance"])
        return Standing(sample.time, status, belief, expected, sd, alarm, message)

    def belief(self, mean: np.ndarray, cov: np.ndarray) -> Normal:
        """The log-parameters of a joint belief."""
        logs = self.model.logs
        return Normal(self.layout.free, mean[logs], cov[logs, logs], log=True)

    @abstractmethod
    def judged(self, outcome: Outcome) -> float:
        """Do what the method does between samples; the alarm, NaN where it has none."""

    def _forget_head(self) -> None:
        self.head_values = np.zeros((0, len(self.layout.sensors)))
        self.head_forces = np.zeros((0, len(self.layout.forced)))

    def _collected(self, sample: Sample, steps: int) -> Standing:
        def waiting(message: str, status: SampleStatus = SampleStatus.WARMING_UP) -> Standing:
            return Standing(sample.time, status, message=message)

        if steps > 1:  # rows without values; under a known force the motion of a gap is anybody's: begin again
            rows = steps - 1
            if self.layout.forced or rows > self.warm_up:
                self._forget_head()
            else:
                self._keep(np.full((rows, self.sigma.size), np.nan), np.zeros((rows, 0)))
        self._keep(np.array([sample.values]), np.array([sample.forces]))
        n = len(self.head_values)
        if n not in (self.warm_up << i for i in range(MOST.bit_length())):  # at each doubling
            return waiting("the first samples are kept")
        size = float(np.nanmax(np.abs(self.head_values), initial=0.0))
        if size == 0.0 or np.sum(np.isfinite(self.head_values)) < self.warm_up // 2:
            self.head_values, self.head_forces = self.head_values[-1:], self.head_forces[-1:]
            return waiting("no sensor shows any motion")
        best = beginning(Head(self.layout, without_spikes(self.head_values), self.head_forces))
        variances = np.diag(best.covariance)
        finite = bool(np.all(np.isfinite(best.mean)) and np.all(variances[self.model.logs] > 0))
        if n < MOST * self.warm_up and not (finite and not self._vague(variances)):
            return waiting("the first samples do not determine the parameters well enough yet")
        if not finite:
            self.head_values, self.head_forces = self.head_values[-1:], self.head_forces[-1:]
            return waiting("no parameters explain the first samples", SampleStatus.FAILED)
        mean, covariance = self._settled(best.mean, best.covariance)
        members, squares = len(self.walk), self.head_values**2
        self.means = np.tile(mean, (members, 1))
        self.spreads = np.tile(self.bank.form.spread(covariance), (members, 1, 1))
        self.weights = np.log(self.first_weights())
        self.sigma, self.push, self.memory = best.levels.sigma, best.levels.push, best.levels.memory
        self.moving, self.width = np.nanmax(squares, axis=0), WIDTH * np.sqrt(np.nanmean(squares, axis=0))
        self.square = np.maximum(best.mean**2, variances)[: self.model.n_motion]
        self.before, self.begun = list(sample.forces), True
        self.rebuild()
        self._forget_head()
        return Standing(sample.time, SampleStatus.OK, self.belief(mean, covariance))

    def _keep(self, values: np.ndarray, forces: np.ndarray) -> None:
        self.head_values = np.concatenate([self.head_values, values])
        self.head_forces = np.concatenate([self.head_forces, forces])

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
        """The belief with dampings that the first samples left open put where they can be learned."""
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
            self.opened(offsets=self.zero_variance())

    def zero_variance(self) -> np.ndarray:
        """By how much the sensors' zeros are opened: those of displacement. A burst of acceleration is no jump."""
        moves = [sensor.measures == "displacement" for sensor in self.layout.sensors]
        return np.asarray(np.where(moves, self.width**2, 0.0))

    def reset_motion(self) -> None:
        """Behind a long gap the motion is as open as it has been moving; parameters keep their belief."""
        if not self.begun:
            self._forget_head()
            return
        means = np.array(self.means)
        means[:, : self.model.n_motion] = 0.0
        self.means = means
        self.opened(motion=self.square)


def _finite(outcome: Outcome) -> bool:
    return isfinite(outcome["total"]) and isfinite(outcome["mean"].sum()) and bool(outcome["variance"].min() > 0)
