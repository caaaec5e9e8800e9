"""What the PINN and spline collocation share: settings, from a Problem to fits and back to an Estimate, uncertainty.

The loss is minus the log posterior, whatever represents x(t):

- **Weights of the terms** follow from the noise, which is estimated along the way: the physics is a nearly hard
  constraint (the equation may be off by so little white noise that its effect over the record is a fraction ``slack``
  of the measurement noise; weak-constraint data assimilation: Tremolet, Q. J. R. Meteorol. Soc. 132:2483, 2006).
- **Optimiser**: Levenberg-Marquardt, in residual space where that is the smaller one (:mod:`methods.pinn.levenberg`).
- **Order**: soft physics before hard, the output layer before all layers, log-parameters started at the damped wave
  that fits the data best.
- **A known force** is carried by functions of its own, added to what represents x(t): steps, pulses and rough forces
  would otherwise ask for an acceleration that no smooth function has (:mod:`methods.pinn.forced`).
- **Open parameters**: with a known force or an added mass there may be no prior, and noise may hide a damping. The
  likelihood then rises on towards zero; such a record is fitted again with a very wide prior, and the answer says so.
- **Hidden states** are paths of the ansatz beside the displacements, held to their own rates.
- **A bad basin** shows in the residuals: the fit leaves more than twice what plain damped waves leave. It is then
  started again elsewhere, at most ``restarts`` times, and the best kept.

Uncertainty (``uncertainty=``): ``laplace``, covariance from the linearisation at the solution with the coefficients
profiled out; ``ensemble``, spread over ``members`` random initialisations, the paper's way; ``bootstrap``, spread over
fits to ``members`` records simulated from the fitted response with the estimated noise. Intervals use Student's t with
N - p degrees of freedom, those of the ensemble with ``members`` - 1.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from bench import (
    Cost,
    Estimate,
    Identifier,
    InitialState,
    InputError,
    Normal,
    Problem,
    Record,
    Serves,
    Status,
    report_progress,
)
from methods.network.response import Band, Function
from methods.pinn.spectral import Guess, scan
from methods.starts.open_parameters import left_open, very_wide
from methods.starts.spectral import records_by_load

if TYPE_CHECKING:
    from methods.pinn.ansatz import Ansatz
    from methods.pinn.engine import Attempt, Fit
    from methods.pinn.residuals import Block

DIGITS = 10
"""Digits that are kept of every number in natural units."""
SUSPECT = 2.0
"""A fit that leaves this many times what plain damped waves leave is in a bad basin."""
DETOURS = (1.0, 1.6, 0.625)
"""Where a system of several modes is started again: the dominant wave may be a high or a low one."""
POINTS_A_CYCLE = 20
"""Collocation points a cycle of the fastest motion that matters, where ``collocation`` would give fewer."""


@dataclass(frozen=True)
class PhysicsInformed(Identifier):
    """The settings; see the module.

    ``collocation``: points where the equation of motion is asked for (more where a cycle would have fewer than 20).
    ``slack``: how far the physics may drift over the record, in noise standard deviations. ``softness``: how many times
    that in the first stage. ``start``: a told start as a residual (``penalty``) or built into the response (``exact``).
    ``tolerance``: decrease of minus the log posterior below which a stage ends. ``batch``: fits solved together.
    """

    collocation: int = 200
    slack: float = 0.2
    softness: float = 30.0
    start: Literal["penalty", "exact"] = "penalty"
    output_iterations: int = 12
    iterations: int = 60
    tolerance: float = 1e-3
    restarts: int = 2
    uncertainty: Literal["laplace", "ensemble", "bootstrap"] = "laplace"
    members: int = 20
    batch: int = 1
    device: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        least = {
            "collocation": 10,
            "output_iterations": 1,
            "iterations": 1,
            "restarts": 0,
            "members": 2,
            "batch": 1,
            "threads": 1,
        }
        self._at_least(least)
        for name in ("slack", "softness", "tolerance"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"method.{name}", getattr(self, name), "a positive number")

    def _at_least(self, least: Mapping[str, int]) -> None:
        for name, bound in least.items():
            if getattr(self, name) < bound:
                raise InputError(f"method.{name}", getattr(self, name), f"a whole number of at least {bound}")

    serves: ClassVar[Serves] = Serves(
        measures=("displacement", "velocity", "acceleration"),
        several_records=True,
        several_channels=True,
        offsets=True,
        max_dof=None,
        added_mass=True,
        hidden_states=True,
    )
    requires: ClassVar[tuple[str, ...]] = ("torch",)
    extra: ClassVar[str] = "torch"

    @property
    def problems_at_once(self) -> int:
        """``batch``; where members of one problem fill it, a single problem is enough."""
        return self.batch if self.uncertainty == "laplace" else 1

    @abstractmethod
    def ansatz(self, block: Block, resolution: int) -> Ansatz:
        """What represents the response in a record of at most ``resolution`` oscillations."""

    @abstractmethod
    def first_coefficients(
        self, n_paths: int, resolution: int, cycles: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> np.ndarray:
        """The coefficients to start from, (B, count), for responses of ``cycles`` (B,) oscillations."""

    @abstractmethod
    def response(self, coefficients: np.ndarray, n_paths: int, resolution: int, duration: float) -> Function:
        """The paths by time, in numpy: displacements, then hidden states."""

    def train(self, attempt: Attempt) -> None:
        """Minimise."""
        attempt.levenberg()

    def points(self, resolution: int) -> int:
        """How many collocation points so many oscillations get."""
        return max(self.collocation, POINTS_A_CYCLE * resolution)

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """The estimate for one problem; status ``diverged`` or ``nonfinite`` where none was found."""
        return self.identify_many([problem], [rng])[0]

    def identify_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimates for all problems, ``batch`` of the same structure solved at a time; each is the same as alone."""
        found: dict[int, Estimate] = {}
        tasks: list[tuple[int, Task]] = []
        with np.errstate(all="ignore"):
            for i, (problem, rng) in enumerate(zip(problems, rngs, strict=True)):
                objection = self._obstacle(problem)
                if objection is not None:
                    found[i] = objection
                else:
                    tasks.append((i, Task(problem, rng)))
            self.attempt([task for _, task in tasks])
            opened = [task for _, task in tasks if task.open]
            for task in opened:
                task.hold()
            self.attempt(opened)
            if self.uncertainty != "laplace":
                for _, task in tasks:
                    self._resample(task)
            for i, task in tasks:
                found[i] = self._estimate(task)
        return [found[i] for i in range(len(problems))]

    def objection(self, problem: Problem) -> str | None:
        if problem.system.n_hidden and self.start == "exact":
            return "start=exact cannot start hidden states; use start=penalty"
        return super().objection(problem)

    def _obstacle(self, problem: Problem) -> Estimate | None:
        if not any(np.any(c.values) for record in problem.records for c in record.channels):
            sentence = "every measured value is zero: there is no motion to identify; check the sensor"
            return Estimate.failed(problem.system, Status.DIVERGED, sentence)
        if self.device != "cpu" and not _has_device(self.device):
            sentence = f"device={self.device} is not available here: use device=cpu"
            return Estimate.failed(problem.system, Status.INVALID, sentence)
        return None

    def attempt(self, tasks: Sequence[Task]) -> None:
        """Fit each, and start those in a bad basin again elsewhere."""
        from methods.pinn import engine
        from methods.pinn.residuals import structure

        for n in range(1 + self.restarts):
            groups: dict[object, list[Task]] = {}
            for task in tasks:
                if not task.settled and n < len(task.guesses):
                    key = structure(task.scaled), engine.resolution(engine.cycles(task.scaled, task.guesses[n]))
                    groups.setdefault(key, []).append(task)
            for group in groups.values():
                for at in range(0, len(group), self.batch):
                    own = group[at : at + self.batch]
                    problems, guesses = [t.scaled for t in own], [t.guesses[n] for t in own]
                    fits = engine.fit(problems, guesses, self, [t.rng for t in own], partial(self._report, own))
                    for task, fit in zip(own, fits, strict=True):
                        task.fits.append(fit)

    def _report(self, tasks: Sequence[Task], results: Callable[[], list[Fit]]) -> None:
        """Say how far the fits have come."""
        for i, task in enumerate(tasks):
            report_progress(task.problem, lambda i=i, task=task: self._estimate(task.with_fit(results()[i])))  # type: ignore[misc]

    def _resample(self, task: Task) -> None:
        """Spread of the parameters and of the response over an ensemble or a bootstrap, in place of the linearised."""
        from methods.pinn import engine

        best = task.best
        if best is None:
            return
        problems = [
            _simulated(task.scaled, best, task.rng) if self.uncertainty == "bootstrap" else task.scaled
            for _ in range(self.members)
        ]
        guess = task.guesses[task.fits.index(best)]
        rngs = task.rng.spawn(self.members)
        fits: list[Fit] = []
        for at in range(0, self.members, self.batch):
            chunk = problems[at : at + self.batch]
            fits += engine.fit(chunk, [guess] * len(chunk), self, rngs[at : at + self.batch])
        task.members = [fit for fit in fits if np.all(np.isfinite(fit.logs))]

    def _estimate(self, task: Task) -> Estimate:
        problem, best = task.scaled, task.best
        every = [*task.given_up, *task.fits]
        cost = Cost(sum(fit.evaluations for fit in every), sum(fit.iterations for fit in every))
        if best is None:
            sentence = "no attempt gave finite numbers; try other restarts, or check the record for outliers"
            return Estimate.failed(problem.system, Status.NONFINITE, sentence, cost)
        message = best.reason + (f"; {len(task.fits) - 1} restart(s)" if len(task.fits) > 1 else "")
        if task.given_up:
            message += "; the data leave a parameter open: held by a very wide prior, a factor of 20"
        if task.scaled.system.n_hidden and not task.scaled.system.smooth:
            message += "; its smooth paths cannot follow the kinks of a hysteresis, so the intervals may be too narrow"
        if not task.good(best):
            message += "; it leaves more than damped waves do, so this may be a local minimum"
        starts = [
            record.initial_state or InitialState(own[0], own[1])
            for record, own in zip(problem.records, best.starts, strict=True)
        ]
        offsets = np.zeros(len(task.offset_flags))
        offsets[np.flatnonzero(task.offset_flags)] = best.offsets
        estimate = Estimate(
            problem.system,
            **self._belief(task, best),
            reconstructions=best.responses,
            bands=self._bands(task, best),
            initial_states=tuple(starts),
            offsets=tuple(map(float, offsets)) if any(task.offset_flags) else None,
            message=message,
            cost=cost,
            traces=best.history,
        )
        offsets_back = task.problem.offsets_from(task.units, estimate.offsets)
        return replace(estimate, offsets=offsets_back).expressed_in(task.units.inverse)

    def _belief(self, task: Task, best: Fit) -> dict[str, Any]:
        """All parameters, or the groups where the data alone cannot tell the scale."""
        from methods.pinn import engine

        system, free = task.scaled.system, engine.free_parameters(task.scaled)
        dof = engine.degrees_of_freedom(task.scaled)
        mean, covariance = best.logs, best.covariance
        if task.members:
            which = [system.names.index(name) for name in free]
            logs = np.array([fit.logs for fit in task.members])
            covariance = np.atleast_2d(np.cov(logs[:, which].T))
            if self.uncertainty == "ensemble":
                mean, dof = logs.mean(0), len(logs) - 1.0
        if len(free) == len(system.names):
            return {"parameters": Normal(system.names, mean, covariance, log=True, dof=dof)}
        parameters = dict(zip(system.names, np.exp(mean), strict=True))
        values = np.array([group.value(parameters) for group in system.groups])
        slopes = values[:, None] * np.array([group.vector(free) for group in system.groups])
        names = tuple(group.name for group in system.groups)
        return {"groups": Normal(names, values, slopes @ covariance @ slopes.T, log=False, dof=dof)}

    def _bands(self, task: Task, best: Fit) -> tuple[Function, ...]:
        if not task.members:
            return best.bands
        bands = []
        for k, band in enumerate(best.bands):
            paths = np.array([fit.responses[k](band.times) for fit in task.members])
            bands.append(Band(band.times, paths.std(0, ddof=1)))
        return tuple(bands)


class Task:
    """One problem on its way: in natural units, with its guesses, its random stream, and the attempts so far."""

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        self.problem, self.rng, self.units = problem, rng, problem.natural_units()
        self.scaled = rounded(problem.expressed_in(self.units))
        loads = records_by_load(self.scaled)
        waves, self.reference = scan(self.scaled, self.scaled.system.n_dof * len(loads), forced=True)
        self.guesses = _starts(waves, self.scaled.system.n_dof)
        self.fits: list[Fit] = []
        self.given_up: list[Fit] = []  # before the parameters that were open were held
        self.members: list[Fit] = []
        self.offset_flags = [c.offset for record in problem.records for c in record.channels]

    def with_fit(self, fit: Fit) -> Task:
        """The same with one more attempt."""
        other = copy(self)
        other.fits = [*self.fits, fit]
        return other

    def good(self, fit: Fit) -> bool:
        """Whether a fit leaves about as little as plain damped waves."""
        return bool(np.isfinite(fit.loss) and fit.left <= SUSPECT * self.reference + 1e-9)

    @property
    def settled(self) -> bool:
        return any(self.good(fit) for fit in self.fits)

    @property
    def open(self) -> bool:
        """Whether the best fit leaves a parameter more open than the very wide prior would; only without a prior."""
        if self.scaled.prior is not None or not self.scaled.scale_told or self.best is None:
            return False
        return bool(np.any(left_open(np.diag(self.best.covariance))))

    def hold(self) -> None:
        """Begin again with the very wide prior: it bounds what the data leave open.

        It is about where a good fit ended, and for what that leaves open, or after a bad fit, about where it began.
        """
        from methods.pinn import engine

        best = self.best
        assert best is not None
        # as parameters, for with a prior the engine would take the masses from it
        begun = [replace(own, logs=engine.first_logs(self.scaled, own)) for own in self.guesses]
        at = self.fits.index(best)
        logs = engine.first_logs(self.scaled, self.guesses[at])
        if self.good(best):
            logs = np.where(left_open(np.diag(best.covariance)), logs, best.logs)
            begun = [replace(begun[at], logs=logs)]
        nominal = dict(zip(self.scaled.system.names, np.exp(logs), strict=True))
        self.scaled = replace(self.scaled, prior=very_wide(nominal))
        self.guesses, self.given_up, self.fits = begun, self.fits, []

    @property
    def best(self) -> Fit | None:
        finite = [fit for fit in self.fits if np.isfinite(fit.loss) and np.all(np.isfinite(fit.covariance))]
        return min(finite, key=lambda fit: fit.loss, default=None)


def _simulated(problem: Problem, fit: Fit, rng: np.random.Generator) -> Problem:
    """The problem with measurements of the fitted response in place of the real ones, at the estimated noise."""
    records, at, offset = [], 0, 0
    for record, response in zip(problem.records, fit.responses, strict=True):
        channels = []
        for channel in record.channels:
            clean = _measured(response, channel.times, channel.measures, record.duration)[channel.dof]
            if channel.offset:
                clean = clean + fit.offsets[offset]
                offset += 1
            noise = fit.sigmas[at] * rng.standard_normal(channel.n)
            channels.append(replace(channel, values=np.round(clean + noise, DIGITS)))
            at += 1
        records.append(replace(record, channels=tuple(channels)))
    return replace(problem, records=tuple(records))


def _measured(response: Function, times: np.ndarray, measures: str, duration: float) -> np.ndarray:
    """The response or its derivative by time, the latter by central differences inside the record.

    Outside it no force is known, so a time at its very ends takes the differences about one that is a step inside.
    """
    if measures == "displacement":
        return response(times)
    h = 1e-3 * duration / 2.0
    inside = np.clip(times, h, duration - h)
    behind, here, ahead = (response(inside + side) for side in (-h, 0.0, h))
    acceleration = (ahead - 2.0 * here + behind) / h**2
    if measures == "acceleration":
        return np.asarray(acceleration)
    return np.asarray((ahead - behind) / (2.0 * h) + acceleration * (times - inside))


def rounded(problem: Problem) -> Problem:
    """The problem (in natural units) with every number to ten digits.

    Thousands of steps of Adam and L-BFGS magnify the last bit of the data to a hundredth of a standard error, and a
    gradient sampler's path magnifies it to other draws. Rounded like this, a record in other units is the same record
    to the last bit, and so is the answer.
    """

    def same(values: np.ndarray) -> np.ndarray:
        return np.round(values, DIGITS)

    records = []
    for record in problem.records:
        start = record.initial_state
        records.append(
            Record(
                tuple(replace(c, times=same(c.times), values=same(c.values)) for c in record.channels),
                tuple(replace(f, times=same(f.times), values=same(f.values)) for f in record.forces),
                InitialState(same(start.displacement), same(start.velocity)) if start is not None else None,
                None if record.added_mass is None else same(record.added_mass),
            )
        )
    prior = problem.prior
    if prior is not None:
        prior = replace(prior, nominal={name: float(f"{v:.{DIGITS}g}") for name, v in prior.nominal.items()})
    return replace(problem, records=tuple(records), prior=prior)


def _has_device(device: str) -> bool:
    import torch

    return device.startswith("cuda") and torch.cuda.is_available()


def _starts(guesses: Sequence[Guess], n_dof: int) -> list[Guess]:
    """Where to start, best first: the waves of the scan, or the dominant one and detours from it for several modes."""
    if n_dof == 1:
        return [*guesses, *[Guess(guesses[0].omega * d, guesses[0].decay, 1.0) for d in DETOURS[1:]]]
    return [Guess(guesses[0].omega * d, guesses[0].decay, 1.0) for d in DETOURS]
