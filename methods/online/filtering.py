"""What the filters of the joint state share: how they begin, what a gap does to them, and samples that are far off.

**Beginning.** The first samples are kept until they tell the parameters well enough (:data:`VAGUE`), at most
:data:`MOST` times as many as asked for; then the likelihood is maximised (:mod:`methods.online.likelihood`), and from
there on a sample is an update and nothing is kept.

**Far-off samples.** A value more than :data:`GATE` standard deviations from what every member expects is left out; a
member that has just been opened, and would explain any, is not asked. :data:`IN_A_ROW` of them are no spikes: something
has jumped. The sensor's offset is opened first, and if that
explains nothing, parameters and motion too.

**Rest.** Where the motion that is expected falls below the noise, the samples tell next to nothing of the parameters,
and the status says so (:data:`REST`).

**Gaps.** The belief coasts. A known force is not known in a gap, so behind one the motion is open by as much as it has
been moving. Behind a step that failed it is known.
"""

from __future__ import annotations

from abc import abstractmethod
from math import isfinite
from typing import Any, ClassVar

import numpy as np

from bench import HeldModel, Layout, Normal, Sample, SampleStatus, Standing, Tracker
from methods.online.bank import FLOOR, Bank, Rule, Told
from methods.online.likelihood import Head, beginning

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

    def __init__(self, layout: Layout, warm_up: int, rule: Rule, walk: np.ndarray, chain: Any) -> None:
        super().__init__(layout)
        self.model, self.warm_up, self.rule, self.chain = HeldModel(layout), warm_up, rule, chain
        self.walk = walk
        self.begun = False
        self.head_values, self.head_forces = np.zeros((0, len(layout.sensors))), np.zeros((0, len(layout.forced)))
        members, d = len(walk), self.model.size
        self.means, self.spreads, self.weights = np.zeros((members, d)), np.zeros((members, d, d)), np.zeros(members)
        self.sigma, self.push = np.zeros(len(layout.sensors)), np.zeros(len(layout.ambient))
        self.memory, self.square = np.zeros(len(layout.ambient)), np.zeros(self.model.n_motion)
        self.before, self.far = [0.0] * len(layout.forced), 0
        self.width = np.ones(len(layout.sensors))
        self.moving = np.ones(len(layout.sensors))
        self._bank = Bank(layout, members, rule, self.mixes)
        self._step, self._coast = self._bank.functions()
        self.asking = 0
        self._constants: Any = None
        self._logs = self.model.logs
        kinds = {p.name: p.kind for p in layout.system.parameters}
        self._kinds = [kinds[name] for name in layout.free]

    def prepare(self) -> None:
        """Compile, by a search in noise and a step from nowhere, neither of which is kept."""
        rng = np.random.default_rng(0)
        values = rng.standard_normal((self.warm_up, self.sigma.size))
        forces = rng.standard_normal((self.warm_up, len(self.before)))
        beginning(Head(self.layout, values, forces))
        row = np.concatenate([values[0], np.ones(self.sigma.size), forces[0], self.before])
        begun = np.tile(np.eye(self.model.size), (len(self.walk), 1, 1))
        levels = np.ones(self.sigma.size), self.chain, GATE**2
        import jax

        constants = jax.tree.map(jax.numpy.asarray, (self.layout.interval, (self._noise(), self.memory), levels))
        state, _ = self._step((self.means, begun, self.weights), row, constants)
        self._step(state, row, constants)

    def step(self, sample: Sample, steps: int) -> Standing:
        """Keep the first samples; then coast over a gap, update, and let the subclass have its say."""
        if not self.begun:
            return self._collected(sample, np.asarray(sample.values), np.asarray(sample.forces), steps)
        if steps > 1:
            self._gap(steps - 1)
        there = [isfinite(value) for value in sample.values]
        filled = [value if known else 0.0 for value, known in zip(sample.values, there, strict=True)]
        row = np.array([*filled, *there, *sample.forces, *self.before], float)
        state = (self.means, self.spreads, self.weights)
        constants = self._ungated() if self.asking else self.constants
        after, numbers = self._step(state, row, constants)
        told = self._bank.told(np.asarray(numbers))
        if not _whole(told):
            after, numbers = self._step(_mended(state, after), row, constants)
            told = self._bank.told(np.asarray(numbers))
        self.means, self.spreads, self.weights = after
        self.asking = max(self.asking - 1, 0)
        self.before = list(sample.forces)
        if not _whole(told):
            return self._lost(sample)
        moved = told.mean[: self.model.n_motion]
        self.square = REMEMBERED * self.square + (1.0 - REMEMBERED) * moved * moved
        self.moving = np.maximum(HELD * self.moving, told.expected**2)
        alarm = self.judged(told)
        status, message = SampleStatus.OK, ""
        if np.all(self.moving < (REST * self.sigma) ** 2):
            status, message = SampleStatus.AT_REST, RESTING
        if told.outlier.any():
            status, message = self._outlying()
        elif self.far:
            self.far = max(self.far - 1, 0)
        belief = self.belief(told.mean, told.covariance)
        return Standing(sample.time, status, belief, told.expected, np.sqrt(told.spread), alarm, message)

    @property
    def constants(self) -> Any:
        """What a compiled step needs beside state and sample, as arrays of the library that compiled it."""
        if self._constants is None:
            import jax

            noise, levels = (self._noise(), self.memory), (self.sigma**2, self.chain, GATE**2)
            self._constants = jax.tree.map(jax.numpy.asarray, (self.layout.interval, noise, levels))
        return self._constants

    def _ungated(self) -> Any:
        """The constants of a step that leaves no value out."""
        import jax

        interval, noise, (variances, chain, gate) = self.constants
        return interval, noise, (variances, chain, jax.numpy.full_like(gate, np.inf))

    def rebuild(self) -> None:
        """The constants follow from what is held."""
        self._constants = None

    def belief(self, mean: np.ndarray, cov: np.ndarray) -> Normal:
        """The log-parameters of a joint belief."""
        logs = self._logs
        return Normal(self.layout.free, mean[logs], cov[logs, logs], log=True)

    @abstractmethod
    def judged(self, told: Told) -> float:
        """Do what the method does between samples; the alarm, NaN where it has none."""

    def _noise(self) -> np.ndarray:
        walk = np.zeros((len(self.walk), self.model.size))
        walk[:, self.model.logs] = self.walk
        walk[:, self.model.ambient] = self.push**2 * (1.0 - self.memory**2)
        return walk

    def _collected(self, sample: Sample, values: np.ndarray, forces: np.ndarray, steps: int) -> Standing:
        if steps > 1:  # rows without values; under a known force the motion of a gap is anybody's: begin again
            rows = steps - 1
            if self.layout.forced or rows > self.warm_up:
                self.head_values, self.head_forces = self.head_values[:0], self.head_forces[:0]
            else:
                self.head_values = np.concatenate([self.head_values, np.full((rows, values.size), np.nan)])
                self.head_forces = np.concatenate([self.head_forces, np.zeros((rows, forces.size))])
        self.head_values = np.concatenate([self.head_values, values[None]])
        self.head_forces = np.concatenate([self.head_forces, forces[None]])
        n = len(self.head_values)
        waiting = Standing(sample.time, SampleStatus.WARMING_UP, message="the first samples are kept")
        if n not in (self.warm_up << i for i in range(MOST.bit_length())):  # at each doubling
            return waiting
        size = float(np.nanmax(np.abs(self.head_values), initial=0.0))
        if size == 0.0 or np.sum(np.isfinite(self.head_values)) < self.warm_up // 2:
            self.head_values, self.head_forces = self.head_values[-1:], self.head_forces[-1:]
            return Standing(sample.time, SampleStatus.WARMING_UP, message="no sensor shows any motion")
        found = beginning(Head(self.layout, _without_spikes(self.head_values), self.head_forces))
        finite = np.all(np.isfinite(found.mean)) and bool(np.all(np.diag(found.covariance)[self._logs] > 0))
        if n < MOST * self.warm_up and not (finite and not self._vague(found.covariance)):
            return Standing(sample.time, SampleStatus.WARMING_UP, message="the first samples do not tell enough yet")
        if not finite:
            self.head_values, self.head_forces = self.head_values[-1:], self.head_forces[-1:]
            return Standing(sample.time, SampleStatus.FAILED, message="no parameters explain the first samples")
        mean, covariance = self._settled(found.mean, found.covariance)
        self._begin(mean, covariance)
        self.sigma, self.push, self.memory = found.levels.sigma, found.levels.push, found.levels.memory
        self.moving = np.nanmax(self.head_values**2, axis=0)
        self.width = WIDTH * np.sqrt(np.nanmean(self.head_values**2, axis=0))
        self.square = found.mean[: self.model.n_motion] ** 2
        self.square = np.maximum(self.square, np.diag(found.covariance)[: self.model.n_motion])
        self.before, self.begun = forces.tolist(), True
        self.rebuild()
        self.head_values, self.head_forces = self.head_values[:0], self.head_forces[:0]
        return Standing(sample.time, SampleStatus.OK, self.belief(mean, covariance))

    def _vague(self, covariance: np.ndarray) -> bool:
        sds = np.sqrt(np.diag(covariance)[self._logs])
        return any(sd > VAGUE for kind, sd in zip(self._kinds, sds, strict=True) if kind in ("mass", "stiffness"))

    def _settled(self, mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The belief with dampings that the first samples left open put where they can be learned."""
        mean, covariance = mean.copy(), covariance.copy()
        values = self.layout.system
        logs = dict.fromkeys(values.names, 0.0) | dict(zip(self.layout.free, mean[self._logs], strict=True))
        sizes = {kind: [logs[p.name] for p in values.parameters if p.kind == kind] for kind in ("mass", "stiffness")}
        for i, kind in enumerate(self._kinds):
            at = self._logs.start + i
            if kind != "damping" or not all(sizes.values()) or covariance[at, at] <= OPEN_ABOVE**2:
                continue
            size = 0.5 * (np.mean(sizes["mass"]) + np.mean(sizes["stiffness"])) + np.log(2.0 * OPEN_RATIO)
            mean[at] = max(mean[at], size)
            covariance[at], covariance[:, at] = 0.0, 0.0
            covariance[at, at] = OPEN_DAMPING**2
        return mean, covariance

    def _begin(self, mean: np.ndarray, covariance: np.ndarray) -> None:
        """All members at one belief."""
        members = len(self.walk)
        self.means = np.tile(mean, (members, 1))
        self.spreads = np.tile(self.rooted(covariance), (members, 1, 1))
        self.weights = np.log(self.first_weights())

    def first_weights(self) -> np.ndarray:
        """Of the members at first: alike, unless a subclass knows better."""
        return np.full(len(self.walk), 1.0 / len(self.walk))

    def rooted(self, covariance: np.ndarray) -> np.ndarray:
        """The covariance, or its root, as the rule holds it."""
        if self.rule != "square_root":
            return covariance
        values, axes = np.linalg.eigh(covariance)
        return np.asarray(axes * np.sqrt(np.maximum(values, 0.0)))

    def covariances(self) -> np.ndarray:
        """Of all members, (M, d, d)."""
        spreads = np.asarray(self.spreads)
        return spreads @ spreads.swapaxes(1, 2) if self.rule == "square_root" else spreads

    def opened(self, added: np.ndarray) -> None:
        """Add variances (d,) to every member."""
        covs = self.covariances() + np.diag(added)
        self.spreads = np.stack([self.rooted(cov) for cov in covs])

    def _gap(self, missing: int) -> None:
        (interval, noise, _), known = self.constants, len(self.skipped) == missing
        for i in range(missing):
            before = np.array(self.before)
            self.means, self.spreads = self._coast(self.means, self.spreads, before, interval, noise)
            if known:
                self.before = self.skipped[i]
        if self.layout.forced and not known:
            self._open_motion()

    def _open_motion(self) -> None:
        added = np.zeros(self.model.size)
        added[: self.model.n_motion] = self.square
        self.opened(added)

    def _outlying(self) -> tuple[SampleStatus, str]:
        """Leave single values out; several in a row are a jump."""
        self.far += 1
        if self.far % IN_A_ROW:
            return SampleStatus.OUTLIER, "a value is too far off to be one of the motion; left out"
        self.jumped()
        return SampleStatus.SENSOR_JUMP, OPENING

    def jumped(self) -> None:
        """Open the sensors' zeros; parameters and motion too where that was not enough."""
        model, added = self.model, np.zeros(self.model.size)
        added[model.offsets] = self.zero_variance()
        if self.far > IN_A_ROW:
            self.far = 0
            added[: model.n_motion], added[model.logs] = self.square, OPENED**2
        self.opened(added)

    def zero_variance(self) -> np.ndarray:
        """By how much the sensors' zeros are opened: those of displacement. A burst of acceleration is no jump."""
        moves = [sensor.measures == "displacement" for sensor in self.layout.sensors]
        return np.asarray(np.where(moves, self.width**2, 0.0))

    def _lost(self, sample: Sample) -> Standing:
        """Begin again: no number of a bank that is not finite can be used."""
        self.begun, self.far = False, 0
        self.head_values, self.head_forces = np.zeros((0, self.sigma.size)), np.zeros((0, len(self.before)))
        return Standing(sample.time, SampleStatus.FAILED, message="the filter is lost; it begins again")

    def reset_motion(self) -> None:
        """Behind a long gap the motion is as open as it has been moving; parameters keep their belief."""
        if not self.begun:
            self.head_values, self.head_forces = self.head_values[:0], self.head_forces[:0]
            return
        means = np.array(self.means)
        means[:, : self.model.n_motion] = 0.0
        self.means = means
        self._open_motion()


State = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Means, covariances or roots, log-weights, of all members."""


def _whole(told: Told) -> bool:
    """Whether a step told numbers."""
    return isfinite(told.total) and isfinite(told.mean.sum()) and bool(told.spread.min() > 0)


def _mended(state: State, after: State) -> State:
    """The state before a step, with members that it took to no number where the weightiest of the others is."""
    means, spreads, weights = (np.array(part) for part in state)
    moved = np.sum(np.asarray(after[0]), axis=1) + np.sum(np.asarray(after[1]), axis=(1, 2))
    gone = ~np.isfinite(moved)
    best = int(np.argmax(np.where(gone, -np.inf, weights)))
    means[gone], spreads[gone], weights[gone] = means[best], spreads[best], FLOOR
    return means, spreads, weights


def _without_spikes(values: np.ndarray) -> np.ndarray:
    """The first samples without single values far beyond both of their neighbours, by the spread of such distances."""
    values = values.copy()
    for column in values.T:
        middle = 0.5 * (column[:-2] + column[2:])
        off = column[1:-1] - middle
        scale = 1.4826 * np.nanmedian(np.abs(off - np.nanmedian(off)))
        far = np.abs(off) > 8.0 * scale
        column[1:-1][far] = np.nan
    return values
