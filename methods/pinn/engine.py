"""One fit of an inverse PINN, from the data to the minimum, by either optimiser. Works in natural units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from bench import Problem
from methods.pinn import levenberg, network
from methods.pinn.residuals import TERMS, Residuals, Spread, State
from methods.pinn.response import NetworkResponse
from methods.pinn.spectral import Guess

if TYPE_CHECKING:
    from methods.pinn.method import PINN

FIRST_NOISE = 0.1
"""The noise of a channel over its root mean square, before anything is known of it."""
LEAST_NOISE = 1e-6
"""The least noise of a channel over its root mean square: what the network and its collocation can resolve."""
START = 0.1
"""Standard deviation of a told start, over the noise: the start is told exactly, so this is small beside it."""
WEIGHT_PRECISION = 1e-10
"""Precision of the network's weights, relative to the largest diagonal entry of J Jᵀ, when they are profiled out."""
DAMPING = (1e-3, 1e-6, 1e-7)
"""First damping of the three stages, relative to the largest diagonal entry of J Jᵀ. The later ones start near the
minimum; with more damping than this a stage ends early, for the little that a damped step promises."""
OVERTONES = 3.0
"""Highest frequency that matters over the dominant one, where there are several modes, harmonics or a force."""
ROUNDS = 3
"""How often the noise may be estimated anew and the fit polished with it."""
SETTLED = 0.03
"""Relative change of the noise below which it needs no further round."""


@dataclass
class Fit:
    """The outcome of one attempt, in numpy and natural units.

    ``logs`` (n_parameters,), ``covariance`` of the free log-parameters; ``left`` is the share of the data's sum of
    squares that the fit leaves; ``loss`` minus the log posterior at the noise in ``sigmas``, up to a constant.
    """

    logs: np.ndarray
    covariance: np.ndarray
    responses: tuple[NetworkResponse, ...]
    starts: list[np.ndarray]
    offsets: np.ndarray
    left: float
    loss: float
    sigmas: np.ndarray
    evaluations: int
    iterations: int
    converged: bool
    reason: str
    history: dict[str, np.ndarray] = field(default_factory=dict)


def first_logs(problem: Problem, guess: Guess) -> np.ndarray:
    """Log-parameters to start from: masses as the prior states them, the others from the damped wave.

    A parameter of dimension time^-n is of size omega^n in natural units, a damping 2 decay omega^(n - 1): for one mass
    this is the wave's own oscillator, for others the right order of magnitude. Without a prior a mass is 1, and under a
    force omega^-2: the unit of mass is then such that a force of one moves it by one in a unit of time, and the force
    is taken to be as large as that of the springs.
    """
    unit = guess.omega**-2.0 if problem.prior is None and problem.forced else 1.0
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


class Attempt:
    """A residual vector, an unknown noise, and the place reached so far."""

    def __init__(
        self, problem: Problem, guess: Guess, free: Sequence[str], dof: float, settings: PINN, rng: np.random.Generator
    ) -> None:
        self.problem, self.settings, self.omega = problem, settings, guess.omega
        self.duration = max(record.duration for record in problem.records)
        logs = first_logs(problem, guess)
        if len(free) < logs.size:
            logs = logs - logs[problem.system.names.index(problem.system.gauge)]
        widths = (1, *[settings.width] * settings.depth, problem.system.n_dof)
        self.residuals = Residuals(problem, widths, settings.collocation, free, logs, settings.device)
        plain = problem.system.linear and problem.system.n_dof == 1 and not problem.forced
        cycles = (1.0 if plain else OVERTONES) * guess.omega * self.duration / (2.0 * np.pi)
        weights = [network.flat(network.initial_layers(widths, cycles, rng)) for _ in problem.records]
        z = np.concatenate([*weights, logs[self.residuals.free], np.zeros(len(self.residuals.offsets))])
        start = torch.as_tensor(z, device=settings.device)
        self.walk = levenberg.Walk(State(start, [], start[:0], {}))
        channels = [c for record in problem.records for c in record.channels]
        self.n = np.array([c.n for c in channels])
        power = np.array([-{"displacement": 0, "velocity": -1, "acceleration": -2}[c.measures] for c in channels])
        self.to_displacement = self.omega ** -power.astype(float)
        self.rms = np.array([np.sqrt(np.mean(c.values**2)) if c.n else 0.0 for c in channels])
        largest = float(np.max(self.rms * self.to_displacement))
        self.rms = np.maximum(self.rms, 1e-3 * largest / self.to_displacement)
        self.share = dof / problem.n
        self.sigmas = FIRST_NOISE * self.rms

    def spread(self, softness: float = 1.0) -> Spread:
        """Standard deviations of the rows at the present noise.

        The physics is a nearly hard constraint: the equation of motion may be off by a white acceleration of standard
        deviation a at each of n collocation points. Over a record of duration T this moves an undamped mode of
        frequency w by a standard deviation of ``a T / (w sqrt(2 n))``; a is such that this is ``slack`` noises.
        """
        noise = float(np.min(self.sigmas * self.to_displacement))
        drift = self.settings.slack * softness * noise
        acceleration = drift * self.omega * np.sqrt(2.0 * self.settings.collocation) / self.duration
        return Spread(tuple(self.sigmas), acceleration, START * noise, START * noise * self.omega)

    def errors(self, deviations: Tensor) -> np.ndarray:
        """Sum of squared data residuals of each channel, in natural units."""
        rows = (self.walk.state.rows * deviations).cpu().numpy()
        sums: list[float] = []
        at = 0
        for block, record in zip(self.residuals.blocks, self.problem.records, strict=True):
            own = rows[at : at + block.n_data] ** 2
            sums += [float(own[block.channel == i].sum()) for i in range(len(record.channels))]
            at += block.n_rows
        return np.array(sums)

    def estimate_noise(self, deviations: Tensor) -> float:
        """Set the noise from the data residuals; returns its largest relative change."""
        sigmas = np.sqrt(self.errors(deviations) / np.maximum(self.n * self.share, 1e-300))
        sigmas = np.clip(sigmas, LEAST_NOISE * self.rms, self.rms)
        change = float(np.max(np.abs(np.log(sigmas / self.sigmas))))
        self.sigmas = sigmas
        return change

    def run(self, softness: float, iterations: int, damping: float, output_only: bool) -> Tensor:
        """Levenberg-Marquardt at the present noise; returns the rows' standard deviations."""
        deviations = self.residuals.deviations(self.spread(softness))
        self.walk.damping = damping
        levenberg.minimise(
            self.residuals, self.walk, deviations, iterations, self.settings.tolerance, output_only=output_only
        )
        return deviations

    def levenberg(self) -> Tensor:
        """The default path: soft physics, then nearly hard, both on the output layer alone; then all weights.

        With soft physics the loss has one basin where the hard one has many; with the hidden layers fixed an iteration
        is cheap, and their spread features already resolve the motion. The last stage frees all weights.
        """
        s = self.settings
        far, near, close = DAMPING
        self.run(s.softness, s.output_iterations, far, True)
        self.estimate_noise(self.run(1.0, s.output_iterations, near, True))
        for _ in range(ROUNDS):
            deviations = self.run(1.0, s.iterations, close, False)
            if self.estimate_noise(deviations) < SETTLED:
                break
        return deviations

    def adam_lbfgs(self) -> Tensor:
        """The paper's training on the same residuals: Adam, then L-BFGS; the noise is estimated in between."""
        deviations = self.residuals.deviations(self.spread())
        self.adam(deviations)
        for share in (1 / 3, 2 / 3):
            self.estimate_noise(deviations)
            deviations = self.residuals.deviations(self.spread())
            self.lbfgs(deviations, int(share * self.settings.lbfgs_steps))
        self.estimate_noise(deviations)
        return deviations

    def _record(self, state: State) -> None:
        self.walk.history.append(state.terms)

    def adam(self, deviations: Tensor) -> None:
        """Adam (Kingma and Ba, 2015) with its usual moments; the loss is the mean of the squared rows."""
        z = self.walk.state.z.clone()
        first, second = torch.zeros_like(z), torch.zeros_like(z)
        for i in range(1, self.settings.adam_steps + 1):
            state, gradient = self.residuals.gradient(z, deviations)
            gradient /= self.residuals.n_rows
            first.lerp_(gradient, 0.1)
            second.mul_(0.999).addcmul_(gradient, gradient, value=0.001)
            size = self.settings.adam_rate / (1.0 - 0.9**i)
            z = z.addcdiv(first, (second / (1.0 - 0.999**i)).sqrt_().add_(1e-8), value=-size)
            if i % 10 == 0:
                self._record(state)
        self.walk.state = self.residuals.evaluate(z, deviations)
        self.walk.evaluations += self.settings.adam_steps
        self.walk.iterations += self.settings.adam_steps

    def lbfgs(self, deviations: Tensor, steps: int) -> None:
        """L-BFGS with a strong-Wolfe line search (scipy's L-BFGS-B without bounds), 30 pairs of memory."""
        last: dict[str, State] = {}

        def loss(z: np.ndarray) -> tuple[float, np.ndarray]:
            state, gradient = self.residuals.gradient(torch.as_tensor(z, device=self.settings.device), deviations)
            last["state"] = state
            return state.loss, gradient.cpu().numpy()

        def each(_: np.ndarray) -> None:
            self._record(last["state"])

        options = {"maxiter": steps, "maxfun": 2 * steps, "maxcor": 30, "ftol": 1e-9, "gtol": 1e-6}
        found = minimize(
            loss, self.walk.state.z.cpu().numpy(), jac=True, method="L-BFGS-B", callback=each, options=options
        )
        self.walk.state = self.residuals.evaluate(torch.as_tensor(found.x, device=self.settings.device), deviations)
        self.walk.evaluations += int(found.nfev)
        self.walk.iterations += int(found.nit)
        self.walk.converged = bool(found.success)
        self.walk.reason = "L-BFGS found no further decrease" if found.success else "the number of steps was reached"

    def covariance(self, deviations: Tensor) -> np.ndarray:
        """Covariance of the free log-parameters, the weights and offsets profiled out (Schur complement in the dual).

        The information is ``Jqᵀ (I + Jw Jwᵀ / precision)⁻¹ Jq``: the part of the parameters' columns that no change of
        the weights can imitate. The weights' small precision leaves smooth changes of x(t) free; a network of this size
        could imitate anything between its collocation points.
        """
        state = self.residuals.evaluate(self.walk.state.z, deviations)
        linear = self.residuals.linearise(state, deviations)
        gram = self.residuals.gram(state, linear, 0.0)
        matrix = gram / (WEIGHT_PRECISION * float(gram.diagonal().max()))
        matrix.diagonal().add_(1.0)
        information = linear.columns.T @ torch.linalg.solve(matrix, linear.columns)
        covariance = np.linalg.pinv(information.cpu().numpy(), hermitian=True, rcond=1e-14)
        n = len(self.residuals.free)
        return np.asarray(covariance[:n, :n])

    def result(self, deviations: Tensor) -> Fit:
        layers, logs, offsets = self.residuals.split(self.walk.state.z)
        responses = tuple(
            NetworkResponse(tuple((w.cpu().numpy().copy(), b.cpu().numpy().copy()) for w, b in own), block.duration)
            for own, block in zip(layers, self.residuals.blocks, strict=True)
        )
        errors = self.errors(deviations)
        history = {name: np.array([terms[name] for terms in self.walk.history]) for name in TERMS}
        # minus the log likelihood at the estimated noise: its determinant counts when fits of different noise are
        # compared
        loss = 0.5 * float(np.sum(self.n * np.log(np.maximum(errors / np.maximum(self.n, 1), 1e-300))))
        loss += 0.5 * (
            self.walk.state.terms["physics"] + self.walk.state.terms["initial"] + self.walk.state.terms["prior"]
        )
        return Fit(
            logs=logs.cpu().numpy(),
            covariance=self.covariance(deviations),
            responses=responses,
            starts=[tape.output[:2, 0].cpu().numpy() for tape in self.walk.state.tapes],
            offsets=offsets.cpu().numpy(),
            left=float(np.mean(errors / np.maximum(self.n * self.rms**2, 1e-300))),
            loss=loss,
            sigmas=self.sigmas,
            evaluations=self.walk.evaluations,
            iterations=self.walk.iterations,
            converged=self.walk.converged,
            reason=self.walk.reason,
            history=history,
        )


def fit(
    problem: Problem, guess: Guess, free: Sequence[str], dof: float, settings: PINN, rng: np.random.Generator
) -> Fit:
    """One attempt from one starting guess; ``dof`` is the number of samples less that of estimated quantities."""
    threads = torch.get_num_threads()
    torch.set_num_threads(settings.threads)
    try:
        with torch.no_grad():
            attempt = Attempt(problem, guess, free, dof, settings, rng)
            deviations = attempt.levenberg() if settings.optimizer == "lm" else attempt.adam_lbfgs()
            return attempt.result(deviations)
    finally:
        torch.set_num_threads(threads)
