"""One problem with its initial guesses and its fits by a physics-informed method.

The waves of the scan are ordered by their posterior. With noise as large as the motion, or sampling that does not
distinguish a frequency from its alias, several waves are nearly as probable. All of these are then fitted, and the
posterior of the fits decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from bench import Channel, OutputError, Problem
from methods.network.response import Band, Function
from methods.starts.distinct_minima import ALIAS_MARGIN
from methods.starts.evidence import log_evidence
from methods.starts.rounding import DIGITS, rounded
from methods.starts.scan import records_by_load
from methods.starts.search_range import expected_rate, resolved_cycles
from methods.starts.waves import ORDER, Guess, scan
from methods.starts.wide_prior import left_open, very_wide

DETOURS = (1.0, 1.6, 0.625)
"""Frequency factors of the restarts of a system of several modes, whose dominant wave may be any of them."""
LOUD = 0.4
"""Residual share of damped waves above which the noise is taken to be as large as the motion."""
RIVALS = 6.0
"""Waves whose minus log posterior is within this of the best are fitted too: odds of 400 to 1."""
SUSPECT = 2.0
"""A fit is in a bad basin if its residual share exceeds that of damped waves by this factor."""
OVERTONES = 3.0
"""Highest relevant frequency over the dominant one, with several modes, harmonics or a force."""


@dataclass(eq=False)
class Fit:
    """The result of one attempt, in NumPy and natural units.

    ``logs`` (n_parameters,), ``covariance`` of the free log-parameters. ``left``: residual sum of squares over that of
    the data. ``loss``: minus the log posterior at the noise ``sigmas`` (n_channels,), up to a constant. ``responses``,
    ``bands`` and ``starts`` (2, n_dof), displacement and velocity at time 0, one per record.
    """

    logs: np.ndarray
    covariance: np.ndarray
    responses: tuple[Function, ...]
    bands: tuple[Band, ...]
    starts: list[np.ndarray]
    offsets: np.ndarray
    left: float
    loss: float
    sigmas: np.ndarray
    evaluations: int
    iterations: int
    reason: str
    history: dict[str, np.ndarray] = field(default_factory=dict)


def cycles(problem: Problem, guess: Guess) -> float:
    """Return the number of oscillations of the fastest relevant motion in the longest record."""
    plain = problem.system.linear and problem.system.n_dof == 1 and not problem.forced
    duration = max(record.duration for record in problem.records)
    return (1.0 if plain else OVERTONES) * guess.omega * duration / (2.0 * np.pi)


def resolution(cycles: float) -> int:
    """Round the number of oscillations up to a multiple of five, so that fits can be batched."""
    return 5 * int(np.ceil(cycles / 5.0))


def first_logs(problem: Problem, guess: Guess) -> np.ndarray:
    """Return initial log-parameters: masses from the prior, the others from the damped wave.

    A parameter of dimension time^-n has size omega^n in natural units, a damping 2 decay omega^(n - 1): for one mass
    this is the oscillator of the wave, for others the right order of magnitude. Without a prior a mass is 1, and under
    a force omega^-2 over the displacement, as if the force were as large as that of the springs. The displacement is 1
    where it is measured, and omega^-1 or omega^-2 where the largest signal is a velocity or an acceleration.
    """
    if guess.logs is not None:
        return guess.logs
    largest = max(channels_of(problem), key=lambda c: float(np.mean(c.values**2)) if c.n else -1.0)
    unit = guess.omega ** (ORDER[largest.measures] - 2.0) if problem.prior is None and problem.forced else 1.0
    values = []
    for parameter in problem.system.parameters:
        power = -parameter.dimension.time
        if parameter.kind == "mass":
            value = problem.prior.nominal[parameter.name] if problem.prior is not None else unit
        elif parameter.kind == "damping":
            value = unit * 2.0 * guess.decay * guess.omega ** (power - 1.0)
        else:
            value = unit * guess.omega**power
        values.append(value)
    return np.log(np.array(values))


def channels_of(problem: Problem) -> list[Channel]:
    """Return the channels of all records."""
    return [channel for record in problem.records for channel in record.channels]


def free_parameters(problem: Problem) -> tuple[str, ...]:
    """Return the parameters to estimate: all but the gauge mass where neither prior nor data determine the scale."""
    fixed = problem.system.gauge if problem.prior is None and not problem.scale_known else None
    return tuple(name for name in problem.system.names if name != fixed)


def degrees_of_freedom(problem: Problem) -> float:
    """Return the residual degrees of freedom: samples minus all estimated quantities, at least 1."""
    system = problem.system
    parameters = len(system.names) if problem.scale_known else len(system.groups)
    starts = sum(2 * system.n_dof for record in problem.records if record.initial_state is None)
    return float(max(problem.n - parameters - starts - sum(c.offset for c in channels_of(problem)), 1))


def starts(problem: Problem, waves: Sequence[Guess], left: float) -> tuple[list[Guess], int]:
    """Return guesses, best first, and the number of those always fitted; the others are used after a bad fit.

    They are the waves of the scan, with the residual share ``left``; for several modes, the dominant wave and detours.
    """
    n_dof, loud = problem.system.n_dof, left > LOUD
    if n_dof > 1:
        return [replace(waves[0], omega=waves[0].omega * by, left=left, firm=loud) for by in DETOURS], 1
    values = np.zeros(1)
    if problem.system.linear:
        values = np.array([_minus_log_posterior(problem, wave) for wave in waves])
        order = np.argsort(values, kind="stable")
        waves, values = [waves[i] for i in order], values[order]
    detours = [replace(waves[0], omega=waves[0].omega * by) for by in DETOURS[1:]]
    guesses = [replace(g, firm=loud or alias(problem, g)) for g in [*waves, *detours]]
    return guesses, int(np.sum(values <= values[0] + RIVALS))


def alias(problem: Problem, guess: Guess) -> bool:
    """Return True for a wave above half the sampling rate."""
    return guess.omega > 2 * np.pi * max(resolved_cycles(record) for record in problem.records) * (1 + 1e-9)


def _minus_log_posterior(problem: Problem, wave: Guess) -> float:
    """Return minus the log posterior of a wave's frequency at the best noise; the grid of decays is too coarse."""
    value = 0.5 * problem.n * np.log(max(wave.left, 1e-12))
    expected = expected_rate(problem)
    if expected is not None:
        centre, sd = expected
        value += 0.5 * ((0.5 * np.log(wave.omega**2 + wave.decay**2) - centre) / sd) ** 2
    return float(value)


class Task:
    """One problem in natural units, with its guesses, random generator, and previous fits.

    ``problem`` is the given one, ``scaled`` the fitted one, rounded to ten digits.
    """

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        self.problem, self.rng, self.scaled = problem, rng, rounded(problem)
        loads = records_by_load(self.scaled)
        waves, self.reference = scan(self.scaled, self.scaled.system.n_dof * len(loads), forced=True, beyond=True)
        self.guesses, self.rivals = starts(self.scaled, waves, self.reference)
        self.fits: list[Fit] = []
        self.given_up: list[Fit] = []  # fits without the very wide prior
        self.members: list[Fit] = []

    def with_fit(self, fit: Fit) -> Task:
        """Return a copy of the task with one more fit."""
        other = copy(self)
        other.fits = [*self.fits, fit]
        return other

    def good(self, fit: Fit) -> bool:
        """Return True for a fit with residuals comparable to those of damped waves."""
        return bool(np.isfinite(fit.loss) and fit.left <= SUSPECT * self.reference + 1e-9)

    def wants(self, attempt: int) -> bool:
        """Return True where the guess of this index is a rival of the best, or all previous fits are bad."""
        settled = any(self.good(fit) for fit in self.fits)
        return attempt < len(self.guesses) and (attempt < self.rivals or not settled)

    @property
    def open(self) -> bool:
        """Return True where, without a prior, a parameter has a larger variance than under the very wide prior."""
        if self.scaled.prior is not None or not self.scaled.scale_known or self.best is None:
            return False
        return bool(np.any(left_open(np.diag(self.best.covariance))))

    def hold(self) -> None:
        """Restart with the very wide prior for parameters that the data do not determine.

        It is centred at a good fit; for parameters that the fit does not determine, or after a bad fit, at the guess.
        """
        best = self.best
        assert best is not None
        # guesses as log-parameters, since otherwise the masses would come from the new prior
        guesses = [replace(guess, logs=first_logs(self.scaled, guess)) for guess in self.guesses]
        number = self.fits.index(best)
        logs = first_logs(self.scaled, self.guesses[number])
        if self.good(best):
            logs = np.where(left_open(np.diag(best.covariance)), logs, best.logs)
            guesses = [replace(guesses[number], logs=logs)]
        nominal = dict(zip(self.scaled.system.names, np.exp(logs), strict=True))
        self.scaled = replace(self.scaled, prior=very_wide(nominal))
        self.guesses, self.rivals, self.given_up, self.fits = guesses, 1, self.fits, []

    @property
    def best(self) -> Fit | None:
        finite = [fit for fit in self.fits if np.isfinite(fit.loss) and np.all(np.isfinite(fit.covariance))]
        return min(finite, key=self._judged if self.rivals > 1 else lambda fit: fit.loss, default=None)

    def _judged(self, fit: Fit) -> float:
        """Return minus the log evidence of a fit's parameters by their simulated response.

        Without a prior it is minus the log likelihood, since undetermined parameters have an infinite volume. The
        losses are not comparable, since the accuracy of the ansatz depends on the frequency.
        """
        model, theta = self._simulation(fit)
        if self.scaled.prior is None:
            return 0.5 * model.profile(theta)
        beyond = alias(self.scaled, self.guesses[self.fits.index(fit)])
        return (0.5 * ALIAS_MARGIN if beyond else 0.0) - log_evidence(model, theta)

    def _simulation(self, fit: Fit) -> tuple[OutputError, np.ndarray]:
        """Return the likelihood of simulated responses, and its unknowns at the parameters of a fit."""
        model = OutputError(self.scaled)
        return model, model.vector(dict(zip(self.scaled.system.names, map(float, np.exp(fit.logs)), strict=True)))

    def violation(self, fit: Fit) -> float:
        """Return how much worse than the fitted response a simulation with its parameters fits the data.

        The unit is that of a standard deviation of a parameter, which lowers twice the log likelihood by 1. It is 0 for
        a response that satisfies the equation of motion.
        """
        model, theta = self._simulation(fit)
        rms = fit.sigmas * np.sqrt(degrees_of_freedom(self.scaled) / self.scaled.n)
        lost = model.profile(theta) - np.sum(model.penalty(theta) ** 2) - 2.0 * np.log(rms) @ model.counts
        return float(np.sqrt(np.maximum(lost, 0.0)))


def simulated(problem: Problem, fit: Fit, rng: np.random.Generator) -> Problem:
    """Replace the measurements of a problem by those of the fitted response, at the estimated noise."""
    records, sigmas, offsets = [], iter(fit.sigmas), iter(fit.offsets)
    for record, response in zip(problem.records, fit.responses, strict=True):
        channels = []
        for channel in record.channels:
            clean = _measured(response, channel.times, channel.measures, record.duration)[channel.dof]
            clean = clean + next(offsets) if channel.offset else clean
            noise = next(sigmas) * rng.standard_normal(channel.n)
            channels.append(replace(channel, values=np.round(clean + noise, DIGITS)))
        records.append(replace(record, channels=tuple(channels)))
    return replace(problem, records=tuple(records))


def _measured(response: Function, times: np.ndarray, measures: str, duration: float) -> np.ndarray:
    """Evaluate the response or its time derivative, the latter by central differences.

    Since the force is unknown outside the record, differences at its ends are taken one step inside.
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
