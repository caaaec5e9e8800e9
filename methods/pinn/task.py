"""One problem on its way through the fits of a physics-informed method: where to start, what came of it, what next.

It starts at the waves of the scan, ordered by what data and prior say of them together. Noise as large as the motion,
or a sampling that does not separate a frequency from its alias, leaves several waves that are nearly as good. All of
these are then fitted, and the posterior of the fits decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bench import OutputError, Problem
from methods.network.response import Function
from methods.starts.evidence import log_evidence
from methods.starts.open_parameters import left_open, very_wide
from methods.starts.reach import expected_rate, resolved_cycles
from methods.starts.rounding import DIGITS, rounded
from methods.starts.scan import records_by_load
from methods.starts.separate import ALIAS_MARGIN
from methods.starts.waves import Guess, scan

if TYPE_CHECKING:
    from methods.pinn.engine import Fit

DETOURS = (1.0, 1.6, 0.625)
"""Where a system of several modes is started again: the dominant wave may be a high or a low one."""
LOUD = 0.4
"""Share of the data that plain damped waves leave beyond which noise is taken to be as large as the motion."""
RIVALS = 6.0
"""A wave whose minus log posterior is within this of the best is fitted too: odds of 400 to 1."""
SUSPECT = 2.0
"""A fit that leaves this many times what plain damped waves leave is in a bad basin."""


@dataclass(frozen=True)
class Starts:
    """Guesses, best first; how many of them are fitted in any case; the others only after a bad fit."""

    guesses: list[Guess]
    rivals: int = 1


def starts(problem: Problem, waves: Sequence[Guess], left: float) -> Starts:
    """The waves of the scan, which leave ``left`` of the data; or the dominant one and detours for several modes."""
    n_dof, loud = problem.system.n_dof, left > LOUD
    if n_dof > 1:
        return Starts([replace(waves[0], omega=waves[0].omega * by, left=left, firm=loud) for by in DETOURS])
    values = np.zeros(1)
    if problem.system.linear:
        values = np.array([_minus_log_posterior(problem, wave) for wave in waves])
        order = np.argsort(values, kind="stable")
        waves, values = [waves[i] for i in order], values[order]
    detours = [replace(waves[0], omega=waves[0].omega * by) for by in DETOURS[1:]]
    guesses = [replace(g, firm=loud or alias(problem, g)) for g in [*waves, *detours]]
    return Starts(guesses, int(np.sum(values <= values[0] + RIVALS)))


def alias(problem: Problem, guess: Guess) -> bool:
    """Whether a wave is above half the sampling rate."""
    return guess.omega > 2 * np.pi * max(resolved_cycles(record) for record in problem.records) * (1 + 1e-9)


def _minus_log_posterior(problem: Problem, wave: Guess) -> float:
    """At the best noise, of the wave's frequency alone: its decay is read from the grid too coarsely."""
    value = 0.5 * problem.n * np.log(max(wave.left, 1e-12))
    expected = expected_rate(problem)
    if expected is not None:
        centre, sd = expected
        value += 0.5 * ((0.5 * np.log(wave.omega**2 + wave.decay**2) - centre) / sd) ** 2
    return float(value)


class Task:
    """One problem in natural units, with its guesses, its random stream, and the attempts so far.

    ``problem`` is the one that was given, ``scaled`` the one that is fitted, to ten digits.
    """

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        self.problem, self.rng, self.scaled = problem, rng, rounded(problem)
        loads = records_by_load(self.scaled)
        waves, self.reference = scan(self.scaled, self.scaled.system.n_dof * len(loads), forced=True, beyond=True)
        found = starts(self.scaled, waves, self.reference)
        self.guesses, self.rivals = found.guesses, found.rivals
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

    def wants(self, attempt: int) -> bool:
        """Whether to start from the guess of this number: a rival of the best, or what is left after a bad fit."""
        return attempt < len(self.guesses) and (attempt < self.rivals or not self.settled)

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
        self.guesses, self.rivals, self.given_up, self.fits = begun, 1, self.fits, []

    @property
    def best(self) -> Fit | None:
        finite = [fit for fit in self.fits if np.isfinite(fit.loss) and np.all(np.isfinite(fit.covariance))]
        return min(finite, key=self._judged if self.rivals > 1 else lambda fit: fit.loss, default=None)

    def _judged(self, fit: Fit) -> float:
        """Return minus the logarithm of the evidence of a rival's parameters by their simulated response.

        The loss would not do: how closely a function follows the equation of motion hangs on how fast it turns. Without
        a prior there is no evidence, since a parameter that the data leave open has all the volume: the likelihood.
        """
        model = OutputError(self.scaled)
        theta = model.vector(dict(zip(self.scaled.system.names, map(float, np.exp(fit.logs)), strict=True)))
        if self.scaled.prior is None:
            return 0.5 * model.profile(theta)
        beyond = alias(self.scaled, self.guesses[self.fits.index(fit)])
        return (0.5 * ALIAS_MARGIN if beyond else 0.0) - log_evidence(model, theta)


def simulated(problem: Problem, fit: Fit, rng: np.random.Generator) -> Problem:
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
