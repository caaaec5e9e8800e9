"""Training of a batch of inverse PINNs, in natural units."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from bench import Problem
from methods.network.ansatz import Ansatz, Basis, SumAnsatz
from methods.network.response import Assisted, Band, Displacements, ExactStart, Function
from methods.pinn import descent, levenberg
from methods.pinn.block import Block, Spread
from methods.pinn.equations import equations
from methods.pinn.levenberg import Walk
from methods.pinn.residuals import TERMS, Residuals
from methods.pinn.settings import PhysicsSettings
from methods.pinn.task import Fit, channels_of, cycles, degrees_of_freedom, first_logs, free_parameters, resolution
from methods.starts.forced_motion import ForcedMotion, forced_dofs
from methods.starts.waves import ORDER, Guess

FIRST_NOISE = 0.1
"""Initial noise of a channel over its root mean square."""
LEAST_NOISE = 1e-6
"""Least noise of a channel over its root mean square, the resolution of ansatz and collocation."""
START = 0.1
"""Standard deviation of a known initial state over the noise; small, since the state is known exactly."""
DAMPING = (1e-3, 1e-6, 1e-7, 1e-8)
"""Initial damping of the four stages, relative to the largest squared row of J. The later stages start near the
minimum, where larger damping would end a stage early by the small predicted decrease of a damped step."""
BEFORE_HARDENING = 1e-7
"""Predicted decrease of minus the log posterior below which splines and windows are ready for multipliers."""
HARDENING = 6
"""Largest number of iterations with multipliers; they converge slowly if no response satisfies all equations."""
ROUNDS = 6
"""Largest number of alternations of noise estimation and fit."""
SETTLED = 0.03
"""Relative change of the noise below which the alternation ends."""


Watch = Callable[[Callable[[], list[Fit]]], None]


class Attempt:
    """The training of problems of one structure: residual vectors, noise estimates and current iterates."""

    def __init__(
        self,
        problems: Sequence[Problem],
        guesses: Sequence[Guess],
        settings: PhysicsSettings,
        rngs: Sequence[np.random.Generator],
        watch: Watch,
    ) -> None:
        self.problems, self.settings, self.watch = problems, settings, watch
        self.firm = np.array([guess.firm for guess in guesses])
        first = problems[0]
        self.omega = np.array([guess.omega for guess in guesses])
        self.duration = np.array([max(record.duration for record in p.records) for p in problems])
        self.cycles = np.array([cycles(p, guess) for p, guess in zip(problems, guesses, strict=True)])
        self.resolution = resolution(float(self.cycles[0]))
        self.collocation = settings.points(self.resolution)
        free = free_parameters(first)
        logs = np.stack([first_logs(p, guess) for p, guess in zip(problems, guesses, strict=True)])
        if len(free) < logs.shape[1]:
            gauge = first.system.names.index(first.system.gauge)
            logs = logs - logs[:, gauge : gauge + 1]
        self.forced = [self._forced_motions(k, guesses) for k in range(len(first.records))]
        self.residuals = Residuals(
            problems, self._ansatz, self.collocation, free, logs, self.omega, settings.device, settings.start == "exact"
        )
        self.n_paths = first.system.n_dof + first.system.n_hidden
        weights = [self._first_coefficients(k, rngs) for k in range(len(first.records))]
        offsets = np.zeros((len(problems), self.residuals.n_offsets))
        z = np.concatenate([*weights, logs[:, self.residuals.free], offsets], 1)
        self.walk = Walk(torch.as_tensor(z, device=settings.device))
        self._measure(degrees_of_freedom(first), guesses)

    def _forced_motions(self, k: int, guesses: Sequence[Guess]) -> list[ForcedMotion]:
        """Return each fit's motion under the forces of record k from rest; empty without forces."""
        if not forced_dofs(self.problems[0].records[k].forces):
            return []
        records = [problem.records[k] for problem in self.problems]
        return [
            ForcedMotion.of(r.forces, complex(-g.decay, g.omega), np.linspace(0.0, r.duration, self.collocation))
            for r, g in zip(records, guesses, strict=True)
        ]

    def _ansatz(self, k: int, block: Block) -> Ansatz:
        """Return the ansatz of the response in record k, including the motion under its forces from rest."""
        inner = self.settings.ansatz(block, self.resolution)
        if not self.forced[k]:
            return inner
        streams = np.stack([motion.streams(times) for motion, times in zip(self.forced[k], block.times, strict=True)])
        return SumAnsatz(inner, Basis(torch.as_tensor(streams, device=block.values.device), block.n_paths))

    def _first_coefficients(self, k: int, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        inner = self.settings.first_coefficients(self.n_paths, self.resolution, self.cycles, rngs)
        return np.concatenate([inner, np.zeros((len(inner), self.n_paths * self._n_forced(k)))], 1)

    def _n_forced(self, k: int) -> int:
        """Return the number of functions per path added by the forces of record k."""
        return self.forced[k][0].sizes.size if self.forced[k] else 0

    def _measure(self, dof: float, guesses: Sequence[Guess]) -> None:
        """Set the sizes of the channels, (B, n_channels), and the initial noise."""
        channels = [channels_of(problem) for problem in self.problems]
        self.n = np.array([c.n for c in channels[0]])
        # a measured quantity has the size of the displacement times this power of the frequency
        power = np.array([ORDER[c.measures] for c in channels[0]], float)
        self.to_displacement = self.omega[:, None] ** -power
        self.rms = np.array(
            [[np.sqrt(np.mean(c.values**2)) if c.n else 0.0 for c in of_problem] for of_problem in channels]
        )
        largest = np.max(self.rms * self.to_displacement, axis=1, keepdims=True)
        self.rms = np.maximum(self.rms, 1e-3 * largest / self.to_displacement)
        self.share = dof / self.problems[0].n
        residual_share = np.array([guess.left if guess.firm else 0.0 for guess in guesses])
        self.sigmas = np.clip(np.sqrt(residual_share), FIRST_NOISE, 1.0)[:, None] * self.rms

    def spread(self, softness: float = 1.0) -> Spread:
        """Return the standard deviations of the rows at the current noise.

        The physics is a nearly hard constraint: the equation of motion has a white acceleration error of standard
        deviation a at each of n collocation points. Over a record of duration T this displaces an undamped mode of
        frequency w by a standard deviation of ``a T / (w sqrt(2 n))``; a is chosen so that this equals ``slack`` times
        the noise, in the first stage ``softness`` times more. Hidden states, which are not measured, are never soft.
        """
        noise = np.min(self.sigmas * self.to_displacement, axis=1)
        soft, hard = (
            self.settings.slack * share * noise * self.omega * np.sqrt(2.0 * self.collocation) / self.duration
            for share in (softness, 1.0)
        )
        return Spread(self.sigmas, soft, hard, START * noise, START * noise * self.omega)

    def errors(self, rows: Tensor, deviations: Tensor) -> np.ndarray:
        """Return the sum of squared data residuals of each channel, (B, n_channels), in natural units."""
        squares = np.asarray((rows * deviations).cpu()) ** 2
        kinds = self.residuals.kinds
        return np.stack([squares[:, kinds == i].sum(1) for i in range(self.residuals.n_channels)], 1)

    def estimate_noise(self, residuals: Residuals, deviations: Tensor, who: np.ndarray) -> np.ndarray:
        """Set the noise of the fits ``who`` from their data residuals; return its largest relative change in each."""
        state = residuals.evaluate(self.walk.z, deviations)
        sigmas = np.sqrt(self.errors(state.rows, deviations) / np.maximum(self.n * self.share, 1e-300))
        sigmas = np.clip(np.nan_to_num(sigmas, nan=np.inf), LEAST_NOISE * self.rms, self.rms)
        change = np.abs(np.log(sigmas / self.sigmas)).max(1)
        self.sigmas[who] = sigmas[who]
        return np.asarray(change[who])

    def run(
        self,
        residuals: Residuals,
        softness: float,
        iterations: int,
        damping: float,
        tolerance: float,
        who: np.ndarray,
    ) -> np.ndarray:
        """Minimise at the current noise, then estimate the noise; return its change."""
        deviations = residuals.deviations(self.spread(softness))
        self.walk.damping[who] = damping
        levenberg.minimise(residuals, self.walk, deviations, iterations, tolerance, who)
        return self.estimate_noise(residuals, deviations, who) if softness == 1.0 else np.zeros(who.size)

    def respond(self, heads: Residuals, iterations: int, damping: float, who: np.ndarray) -> None:
        """Fit the response of the fits ``who`` with fixed parameters."""
        self.walk.damping[who] = damping
        deviations = heads.deviations(self.spread())
        levenberg.minimise(heads.hold(), self.walk, deviations, iterations, self.settings.tolerance, who)

    def train(self) -> None:
        """Minimise by the optimiser of the settings."""
        if first_order := self.settings.first_order:
            self.adam_lbfgs(*first_order)
        else:
            self.levenberg()

    def levenberg(self) -> None:
        """Minimise over the output layer with soft and then nearly hard physics, then over all coefficients.

        With soft physics the loss has one basin, with hard physics many. With fixed hidden layers an iteration is
        cheap, and the features already resolve the motion. The next stage trains all weights, which matters where the
        features do not resolve the motion to the noise. The last stage trains output layer and parameters again, with a
        step of the method of multipliers (M. Hestenes, J. Optim. Theory Appl. 4:303, 1969), which makes physics and
        initial state hard constraints. A non-smooth motion cannot satisfy its equation so closely and has no
        multipliers.

        With noise as large as the motion, a fit with soft physics follows the noise, and with fewer than two samples
        per cycle the smoothest curve through the samples. A ``firm`` fit therefore starts with hard physics, from the
        response at the parameters of the scan's wave.
        """
        s = self.settings
        far, near, close, hard = DAMPING
        converged, smooth = s.convergence(self.resolution), self.residuals.system.smooth
        heads, whole = self._heads()

        def combined() -> Tensor:
            return self.residuals.with_heads(whole, heads.unmixed(self.walk.z))

        free, firm = np.flatnonzero(~self.firm), np.flatnonzero(self.firm)
        if free.size:
            self.run(heads, s.softness, s.output_iterations, far, s.tolerance, free)
        if firm.size:
            self.respond(heads, s.output_iterations, near, firm)
        several_layers = heads.n_z < self.residuals.n_z
        first = s.tolerance if several_layers else max(converged, BEFORE_HARDENING)
        self.rounds(heads, s.iterations, near, first if smooth else converged, combined)
        self.walk.z = combined()
        if several_layers:
            self.rounds(self.residuals, s.iterations, close, s.tolerance)
        if several_layers or smooth:
            heads, whole = self._heads()
            if smooth:
                heads.shift = self._multipliers(heads)
            reasons = self.walk.reasons[:]
            self.rounds(heads, HARDENING if smooth else s.iterations, hard if smooth else near, converged, combined)
            self.walk.reasons = reasons if smooth else self.walk.reasons
            self.walk.z = combined()

    def _multipliers(self, residuals: Residuals) -> Tensor:
        """Return the violations of physics and initial state, in natural units, (B, n_rows)."""
        deviations = residuals.deviations(self.spread())
        rows = residuals.plain(residuals.evaluate(self.walk.z, deviations), deviations)
        return rows * (residuals.term_rows[:, 1] + residuals.term_rows[:, 2])

    def _heads(self) -> tuple[Residuals, Tensor]:
        """Restrict z to the output layers, in orthonormal combinations; return the residuals and the full z."""
        whole = self.walk.z
        heads, z = self.residuals.heads(whole)
        mixed, self.walk.z = heads.mixed(z, heads.deviations(self.spread()))
        return mixed, whole

    def rounds(
        self,
        residuals: Residuals,
        iterations: int,
        damping: float,
        tolerance: float,
        coefficients: Callable[[], Tensor] | None = None,
    ) -> None:
        """Minimise with hard physics, repeatedly where the estimated noise changes.

        Args:
            residuals: Residuals of all coefficients, or of the output layer alone.
            iterations: Largest number of iterations of a round.
            damping: First damping.
            tolerance: Relative decrease at which a round ends.
            coefficients: Gives all coefficients for a report, where ``walk.z`` holds those of the output layer alone.
        """
        who = np.arange(len(self.problems))
        for _ in range(ROUNDS):
            change = self.run(residuals, 1.0, iterations, damping, tolerance, who)
            self.watch(lambda: self.results(coefficients and coefficients()))
            who = who[change >= SETTLED]
            if not who.size:
                break

    def adam_lbfgs(self, adam_steps: int, adam_rate: float, lbfgs_steps: int) -> None:
        """Train as in the paper, by Adam and then L-BFGS; the noise is estimated in between."""
        everyone = np.arange(len(self.problems))
        deviations = self.residuals.deviations(self.spread())
        descent.adam(self.residuals, self.walk, deviations, adam_steps, adam_rate)
        for share in (1 / 3, 2 / 3):
            self.estimate_noise(self.residuals, deviations, everyone)
            self.watch(self.results)
            deviations = self.residuals.deviations(self.spread())
            descent.lbfgs(self.residuals, self.walk, deviations, int(share * lbfgs_steps))
        self.estimate_noise(self.residuals, deviations, everyone)

    def record(self) -> None:
        """Append the current residual vectors to the history."""
        deviations = self.residuals.deviations(self.spread())
        state = self.residuals.evaluate(self.walk.z, deviations)
        self.walk.record(np.arange(len(self.problems)), state.rows * deviations)

    def results(self, z: Tensor | None = None) -> list[Fit]:
        """Return the fits at z, by default the current one."""
        residuals, walk = self.residuals, self.walk
        z = walk.z if z is None else z
        deviations = residuals.deviations(self.spread())
        state = residuals.evaluate(z, deviations)
        posterior = equations(residuals, state, deviations).posterior()
        n = len(residuals.free)
        covariance = np.asarray(posterior.covariance[:, :n, :n].cpu())
        bands = [sd.reshape(len(sd), self.problems[0].system.n_dof, -1) for sd in posterior.deviations]
        parts, logs, offsets = residuals.split(z)
        coefficients = [np.asarray(part.cpu()) for part in parts]
        n_dof = self.problems[0].system.n_dof
        starts = [np.asarray(out[:, :2, 0, :n_dof].cpu()) for out in state.outputs]
        errors, terms = self.errors(state.rows, deviations), np.asarray(state.terms.cpu())
        # minus the log likelihood at the estimated noise, with the determinant that a comparison of fits requires
        counts = np.maximum(self.n, 1)
        loss = 0.5 * np.sum(self.n * np.log(np.maximum(errors / counts, 1e-300)), 1) + 0.5 * terms[:, 1:].sum(1)
        residual_share = np.mean(errors / np.maximum(self.n * self.rms**2, 1e-300), 1)
        return [
            Fit(
                logs=np.asarray(logs[i].cpu()),
                covariance=covariance[i],
                responses=tuple(self._response(i, k, part[i]) for k, part in enumerate(coefficients)),
                bands=tuple(
                    Band(b.times[i, : b.collocation], sd[i]) for b, sd in zip(residuals.blocks, bands, strict=True)
                ),
                starts=[start[i] for start in starts],
                offsets=np.asarray(offsets[i].cpu()),
                left=float(residual_share[i]),
                loss=float(loss[i]),
                sigmas=self.sigmas[i],
                evaluations=int(walk.evaluations[i]),
                iterations=int(walk.iterations[i]),
                reason=walk.reasons[i],
                history=_history(
                    walk.history[i], np.asarray(deviations[i].cpu()), np.asarray(residuals.term_rows.cpu())
                ),
            )
            for i in range(len(self.problems))
        ]

    def _response(self, i: int, k: int, coefficients: np.ndarray) -> Function:
        """Return the response of fit i in record k."""
        block = self.residuals.blocks[k]
        duration, system = float(block.duration[i]), self.problems[i].system
        n_inner = coefficients.size - self.n_paths * self._n_forced(k)
        inner = self.settings.response(coefficients[:n_inner], self.n_paths, self.resolution, duration)
        if self.forced[k]:
            inner = Assisted(inner, self.forced[k][i], coefficients[n_inner:].reshape(self.n_paths, -1))
        if system.n_hidden:
            inner = Displacements(inner, system.n_dof)
        known = self.problems[i].records[k].initial_state
        if known is None or self.settings.start != "exact":
            return inner
        return ExactStart(inner, known.displacement, known.velocity, float(self.omega[i]))


def _history(records: list[np.ndarray], deviations: np.ndarray, terms: np.ndarray) -> dict[str, np.ndarray]:
    """Return the traces of a fit: evaluations, loss at the final weights, mean squares in natural units.

    ``deviations`` (n_rows,): final standard deviations; ``terms`` (n_rows, 4): indicators of each row's term.
    """
    evaluations, rows = np.array(records)[:, 0], np.array(records)[:, 1:]
    squares = rows**2 @ (terms / np.maximum(terms.sum(0), 1.0))
    named = {f"mean_square_{term}": square for term, square in zip(TERMS, squares.T, strict=True)}
    return {"evaluations": evaluations, "loss": 0.5 * np.sum((rows / deviations) ** 2, 1), **named}


@contextmanager
def torch_threads(n: int) -> Iterator[None]:
    """Run torch on n threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(n)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def fit(
    problems: Sequence[Problem],
    guesses: Sequence[Guess],
    settings: PhysicsSettings,
    rngs: Sequence[np.random.Generator],
    watch: Watch = lambda results: None,
) -> list[Fit]:
    """Fit each problem once from its initial guess; all have the same structure and resolution.

    ``watch`` is called between stages, with a function that returns the current fits.
    """
    with torch_threads(settings.threads), torch.no_grad():
        attempt = Attempt(problems, guesses, settings, rngs, watch)
        attempt.record()
        attempt.train()
        attempt.record()
        return attempt.results()
