"""Data-driven neural network: a tanh network fitted to displacement alone, then regression on its derivatives.

The training does not use the equation of motion. It has Bayesian regularisation: Gaussian priors on the weights about
their random initial values, with one precision per layer, and Gaussian noise, both estimated by the evidence (D. J. C.
MacKay, Neural Comput. 4:448, 1992; with Levenberg-Marquardt: F. D. Foresee and M. T. Hagan, Proc. ICNN 1997, p. 1930).
Early stopping and validation samples are therefore not needed. A step is solved in residual space, with the weights
scaled by their prior.

The exact x, x', x'' of the network on a dense grid then give the parameters by least squares on the equation of motion:
all of them where a force or an added mass is known, otherwise the groups, with the gauge mass fixed at one. This has
the bias of any regression on noisy regressors, and that of the smoothing: five samples per cycle do not determine the
curvature between them.

The uncertainty is the second moment about the estimate of the regression on draws of the weights from the linearised
(Laplace) posterior. It includes the bias from noisy derivatives as far as the posterior represents it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from bench import (
    Card,
    Cost,
    Estimate,
    InitialState,
    NoEstimate,
    Normal,
    Problem,
    Record,
    Scope,
    Status,
    regression_columns,
)
from methods.network.response import NetworkResponse
from methods.starts.band import BandIdentifier
from methods.starts.waves import scan

if TYPE_CHECKING:
    from torch import Tensor

    from methods.network.ansatz import Tape
    from methods.network.tanh import Network

LEAST_NOISE, MOST_NOISE = 1e-6, 0.7
"""Range of the noise over the root mean square of the data. The upper limit assumes that half of the data's power is
motion; without it, below 10 dB the evidence attributes everything to noise."""

BANDWIDTHS = (1.0, 2.0, 4.0, 6.0)
"""Slopes of the first layer over the cycles of the data; the evidence selects among networks with these."""
NOT_POSITIVE = "the regression gives a non-positive parameter; more samples per cycle or less noise are required"


@dataclass(frozen=True)
class DDNN(BandIdentifier):
    """Data-driven network; ``iterations`` of each fit, ``grid`` points of the regression, ``draws`` of its covariance.

    ``edge``: fraction of the record excluded from the regression at either end, where derivatives are worst.
    """

    width: int = 64
    depth: int = 2
    iterations: int = 60
    grid: int = 200
    edge: float = 0.1
    draws: int = 100
    threads: int = 1

    card: ClassVar[Card] = Card(
        summary="neural network on displacement alone, parameters by regression on its derivatives",
        start="not used",
        scale="groups",
        reconstruction="own",
        uncertainty="spread of the regression over draws of the weights from the Laplace posterior",
        settings_source="64-64 tanh: the paper; regularisation and first-layer slopes by the evidence, among multiples"
        " of the data's own frequency, from a scan up to half the sampling rate (no prior)",
        tuning="9 ranges of first-layer slopes, 2 initial noise levels, 7 regressions (ends, weights), on 9-64"
        " development records at 5-40 dB, by the errors of displacement and k/m",
        title="DDNN",
        order=160,
        remarks=True,
        paper="ddnn",
    )
    scope: ClassVar[Scope] = Scope(several_records=True, several_channels=True, max_dof=None, added_mass=True)
    requires: ClassVar[tuple[str, ...]] = ("torch",)
    extra: ClassVar[str] = "torch"
    works_in = "natural units"

    def objection(self, problem: Problem) -> str | None:
        system = problem.system
        if not system.affine_in_parameters:
            return (
                f"its regression requires an equation of motion affine in the parameters; that of {system.name} is not"
            )
        objection = super().objection(problem)
        if objection is None and any(
            {c.dof for c in record.channels} != set(range(system.n_dof)) for record in problem.records
        ):
            return "its regression requires the displacement of every DOF in every record"
        return objection

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Fit the network and regress on it; raises NoEstimate where an identifiable parameter is negative."""
        import torch

        threads = torch.get_num_threads()
        torch.set_num_threads(self.threads)
        try:
            with torch.no_grad():
                return self._fitted(problem, rng)
        finally:
            torch.set_num_threads(threads)

    def _fitted(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        omega, system = scan(problem)[0][0].omega, problem.system
        smoothers = [self._smoother(record, system.n_dof, omega, rng) for record in problem.records]
        grids = [np.linspace(self.edge, 1.0 - self.edge, self.grid) * record.duration for record in problem.records]
        paths = [s.paths(grid, self.draws, rng) for s, grid in zip(smoothers, grids, strict=True)]
        forces = [r.force(grid, system.n_dof) for r, grid in zip(problem.records, grids, strict=True)]
        values, draws = _regressions(problem, paths, forces)
        # second moment about the estimate, not about the draws' mean, to include the bias from noisy derivatives
        covariance = (draws - values).T @ (draws - values) / len(draws)
        used = sum(s.used for s in smoothers)
        cost = Cost(sum(s.evaluations for s in smoothers), sum(s.steps for s in smoothers))
        if not (np.all(np.isfinite(values)) and np.all(np.isfinite(covariance))):
            raise NoEstimate("the regression on the derivatives is not finite", Status.NONFINITE, cost)
        try:
            distribution = _distribution(problem, values, covariance, max(problem.n - used, 1.0))
        except NoEstimate as reason:
            raise NoEstimate(str(reason), cost=cost) from None
        return Estimate(
            system,
            parameters=distribution if problem.scale_known else None,
            groups=None if problem.scale_known else distribution,
            reconstructions=tuple(s.response() for s in smoothers),
            initial_states=tuple(InitialState(*s.streams(np.zeros(1))[:2, 0]) for s in smoothers),
            cost=cost,
            message=f"effective number of weights: {used:.1f}, for {problem.n} samples",
            traces={"sigma": np.concatenate([s.sigmas for s in smoothers])},
        )

    def _smoother(self, record: Record, n_dof: int, omega: float, rng: np.random.Generator) -> Smoother:
        """Fit networks to a record and return the one with the most probable slopes of the first layer."""
        cycles = omega * record.duration / (2.0 * np.pi)
        trials = [Smoother(record, n_dof, self.width, self.depth, factor * cycles, rng) for factor in BANDWIDTHS]
        for trial in trials:
            trial.fit(self.iterations)
        # a fit that attributes most of the data to noise is rejected, whatever its evidence
        return max(trials, key=lambda trial: (trial.residual_share < MOST_NOISE**2, trial.evidence))


def _regressions(
    problem: Problem, paths: Sequence[np.ndarray], forces: Sequence[list[np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Return parameters of the fitted paths, (n,), and of their draws, (n_draws, n); an unknown gauge mass is 1."""
    system = problem.system
    free = [i for i, name in enumerate(system.names) if problem.scale_known or name != system.gauge]
    full = np.ones((len(paths[0]), len(system.names)))
    for draw, values in enumerate(full):
        columns, rest = [], []
        for path, force, record in zip(paths, forces, problem.records, strict=True):
            x, v, a = (list(path[draw, s].T) for s in range(3))
            block, b = regression_columns(record.rig(system), x, v, a, force)
            columns.append(block[:, free])
            rest.append(b if problem.scale_known else b + block[:, system.names.index(system.gauge)])
        values[free] = np.linalg.lstsq(np.concatenate(columns), -np.concatenate(rest), rcond=None)[0]
    return full[0], full[1:]


def _distribution(problem: Problem, values: np.ndarray, covariance: np.ndarray, dof: float) -> Normal:
    """Return the distribution of groups, or of log-parameters where the scale is known, combined with a prior."""
    system = problem.system
    if not problem.scale_known:
        parameters = dict(zip(system.names, values, strict=True))
        means = np.array([group.value(parameters) for group in system.groups])
        # p ∂g/∂p = exponent g
        slopes = np.array([group.vector(system.names) for group in system.groups]) * means[:, None] / values
        names = tuple(group.name for group in system.groups)
        return Normal(names, means, slopes @ covariance @ slopes.T, log=False, dof=dof)
    if np.any(values <= 0):
        raise NoEstimate(NOT_POSITIVE)
    mean, logs = np.log(values), np.asarray(covariance / np.outer(values, values))
    if problem.prior is not None:
        precision, weigh = np.linalg.pinv(logs, hermitian=True), np.diag(problem.prior.log_sds**-2.0)
        logs = np.asarray(np.linalg.inv(precision + weigh))
        mean = logs @ (precision @ mean + weigh @ problem.prior.log_mean)
    return Normal(system.names, mean, logs, log=True, dof=dof)


class Smoother:
    """A network fitted to the displacement of one record by Bayesian regularisation.

    ``sds``: prior standard deviation of the weights of each layer about their initial values. ``sigma``: standard
    deviation of the noise over the root mean square of each channel.
    """

    def __init__(
        self, record: Record, n_dof: int, width: int, depth: int, cycles: float, rng: np.random.Generator
    ) -> None:
        import torch

        from methods.network import tanh

        self.tanh, self.torch = tanh, torch
        self.widths = (1, *[width] * depth, n_dof)
        self.duration = record.duration
        layers = tanh.initial_layers(self.widths, cycles, rng)
        self.first = torch.as_tensor(tanh.flat(layers))
        self.theta = self.first.clone()
        self.layer = np.concatenate([np.full(w.size + b.size, i) for i, (w, b) in enumerate(layers)])
        self.sds = np.full(len(layers), 1.0 / np.sqrt(width))
        times = np.concatenate([c.times for c in record.channels])
        self.ansatz = self._network(times)
        self.dof = torch.as_tensor(np.concatenate([np.full(c.n, c.dof) for c in record.channels]))
        self.values = torch.as_tensor(np.concatenate([c.values for c in record.channels]))
        sizes = np.array([np.sqrt(np.mean(c.values**2)) if c.n else 0.0 for c in record.channels])
        sizes = np.maximum(sizes, 1e-3 * max(float(sizes.max()), 1e-300))
        self.scale = torch.as_tensor(
            np.concatenate([np.full(c.n, s) for c, s in zip(record.channels, sizes, strict=True)])
        )
        self.n = int(times.size)
        self.sigma, self.used, self.residual_share, self.evidence = 0.1, 0.0, np.inf, -np.inf
        self.evaluations = self.steps = 0
        self.sigmas: list[float] = []

    def _network(self, times: np.ndarray) -> Network:
        """Return the network at given times."""
        tau = self.torch.as_tensor(2.0 * times / self.duration - 1.0)[None]
        return self.tanh.Network(self.widths, tau, self.torch.full((1,), 2.0 / self.duration, dtype=tau.dtype))

    def errors(self, theta: Tensor) -> tuple[Tape, Tensor]:
        """Return the forward pass and the residuals over each channel's size, (n_samples,)."""
        self.evaluations += 1
        tape = self.ansatz.forward(theta[None])
        index = self.torch.arange(self.n)
        return tape, (tape.output[0, 0, index, self.dof] - self.values) / self.scale

    def jacobian(self, tape: Tape) -> Tensor:
        """Return the Jacobian of the residuals, (n_samples, n_weights)."""
        seeds = self.torch.zeros_like(tape.output)
        index = self.torch.arange(self.n)
        seeds[0, 0, index, self.dof] = 1.0 / self.scale
        adjoints = self.ansatz.adjoint(self.theta[None], tape, seeds)
        return self.ansatz.jacobian(tape, adjoints, index)[0]

    def spread(self) -> Tensor:
        """Return the prior standard deviation of every weight, (n_weights,)."""
        return self.torch.as_tensor(self.sds[self.layer])

    def objective(self, theta: Tensor, errors: Tensor) -> float:
        """Return minus the log posterior of the weights at the current noise and precisions, up to a constant."""
        u = (theta - self.first) / self.spread()
        return 0.5 * float(errors @ errors) / self.sigma**2 + 0.5 * float(u @ u)

    def fit(self, iterations: int) -> None:
        """Make Levenberg-Marquardt steps in residual space, updating noise and precisions after each."""
        torch, damping = self.torch, 1e-2
        tape, errors = self.errors(self.theta)
        jacobian = self.jacobian(tape)
        for _ in range(iterations):
            self.steps += 1
            loss = self.objective(self.theta, errors)
            spread = self.spread()
            scaled = jacobian * spread / self.sigma
            u = (self.theta - self.first) / spread
            # (JᵀJ + (1 + d) I) step = -(Jᵀ r + u), by the push-through identity
            right = scaled.T @ (errors / self.sigma) + u
            matrix = scaled @ scaled.T
            matrix.diagonal().add_(1.0 + damping)
            step = (right - scaled.T @ torch.linalg.solve(matrix, scaled @ right)) / (1.0 + damping)
            trial = self.theta - spread * step
            trial_tape, trial_errors = self.errors(trial)
            after = self.objective(trial, trial_errors)
            if not after < loss:
                damping *= 4.0
                if damping > 1e8:
                    break
                continue
            damping = max(damping / 4.0, 1e-6)
            self.theta, errors, tape = trial, trial_errors, trial_tape
            jacobian = self.jacobian(tape)
            if self.update(jacobian, errors) < 1e-3 and loss - after < 1e-3:
                break

    def update(self, jacobian: Tensor, errors: Tensor) -> float:
        """Update noise, precisions and evidence by MacKay's fixed point; return the largest relative change."""
        torch = self.torch
        scaled = jacobian * self.spread() / self.sigma
        shares = [scaled[:, self.layer == i] @ scaled[:, self.layer == i].T for i in range(self.sds.size)]
        matrix = torch.stack(shares).sum(0)
        matrix.diagonal().add_(1.0)
        inverse = torch.linalg.inv(matrix)
        gammas = np.array([float((inverse * share).sum()) for share in shares])
        self.evidence = (
            -self.objective(self.theta, errors) - 0.5 * float(torch.logdet(matrix)) - self.n * np.log(self.sigma)
        )
        moved = ((self.theta - self.first) ** 2).numpy()
        squares = np.array([moved[self.layer == i].sum() for i in range(self.sds.size)])
        sds = np.clip(np.sqrt(squares / np.maximum(gammas, 1e-3)), 1e-4, 1e2)
        self.used = float(gammas.sum())
        self.residual_share = float(errors @ errors) / self.n
        sigma = float(np.sqrt(float(errors @ errors) / max(self.n - self.used, 0.5)))
        sigma = min(max(sigma, LEAST_NOISE), MOST_NOISE)
        change = max(abs(np.log(sigma / self.sigma)), float(np.max(np.abs(np.log(sds / self.sds)))))
        # half a step in the logarithm, since full steps may oscillate between extremes
        self.sigma = float(np.sqrt(sigma * self.sigma))
        self.sds = np.sqrt(sds * self.sds)
        self.sigmas.append(self.sigma)
        return change

    def paths(self, times: np.ndarray, draws: int, rng: np.random.Generator) -> np.ndarray:
        """Return x, x', x'' of the fit and of draws from the linearised posterior, (1 + draws, 3, n_times, n_dof).

        A draw is a prior draw corrected by the data (Matheron's rule), through the network's derivative by its weights.
        """
        torch = self.torch
        tape, _ = self.errors(self.theta)
        spread = self.spread()
        scaled = self.jacobian(tape) * spread / self.sigma
        matrix = scaled @ scaled.T
        matrix.diagonal().add_(1.0)
        prior = torch.as_tensor(rng.standard_normal((draws, self.theta.numel())))
        noise = torch.as_tensor(rng.standard_normal((draws, self.n)))
        moves = (prior - torch.linalg.solve(matrix, (prior @ scaled.T + noise).T).T @ scaled) * spread
        centre, size = self.streams(times), 1e-5
        paths = [(self.streams(times, size * move) - centre) / size for move in moves]
        return np.stack([centre, *[centre + path for path in paths]])

    def streams(self, times: np.ndarray, move: Tensor | float = 0.0) -> np.ndarray:
        """Return x, x', x'' of the fit, with its weights displaced by ``move``, (3, n_times, n_dof)."""
        return np.asarray(self._network(times).forward((self.theta + move)[None]).output[0])

    def response(self) -> NetworkResponse:
        return NetworkResponse(tuple(self.tanh.layers_of(self.theta.numpy().copy(), self.widths)), self.duration)
