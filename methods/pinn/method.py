"""Inverse PINN: a network of time and the parameters, trained on the data and on the equation of motion together.

The paper's method (Karkadakattil 2026; Raissi, Perdikaris and Karniadakis, J. Comput. Phys. 378:686, 2019): a tanh
network x(t), 1-64-64-1, its loss the squared misfit to the data, to the equation of motion at 200 collocation
points, to the told start, and to the prior. What differs from the usual code, and why:

- **Weights of the terms** follow from the noise, which is estimated along the way: the loss is minus the log
  posterior with the physics as a nearly hard constraint (the equation may be off by so little white noise that its
  effect over the record is a fraction ``slack`` of the measurement noise; weak-constraint data assimilation:
  Tremolet, Q. J. R. Meteorol. Soc. 132:2483, 2006).
- **Optimiser**: Levenberg-Marquardt in residual space. There are about 230 residuals and 4,400 weights, so a step
  solves a system of size 230 (``optimizer="lm"``). The paper's Adam and L-BFGS on the very same residuals is
  ``optimizer="adam_lbfgs"``.
- **Order**: soft physics before hard, the output layer before all layers (its hidden features, spread over the
  record, already resolve the motion), log-parameters started at the damped wave that fits the data best.
- **A bad basin** shows in the residuals: the fit leaves more than twice what plain damped waves leave. It is then
  started again elsewhere, at most ``restarts`` times, and the best kept.

Uncertainty: covariance of the log-parameters from the linearisation at the solution with the weights profiled out,
Student's t with N - p degrees of freedom. Free vibration without a prior gives the identifiable groups only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from bench import Card, Cost, Estimate, Identifier, InitialState, Normal, Problem, Record, Serves, Status
from methods.pinn.spectral import Guess, scan

if TYPE_CHECKING:
    from methods.pinn.engine import Fit

DIGITS = 10
"""Digits that are kept of every number in natural units."""
SUSPECT = 2.0
"""A fit that leaves this many times what plain damped waves leave is in a bad basin."""
DETOURS = (1.0, 1.6, 0.625)
"""Where a system of several modes is started again: the dominant wave may be a high or a low one."""


@dataclass(frozen=True)
class PINN(Identifier):
    """The settings; see the module for the method.

    ``slack``: how far the physics may drift over the record, in noise standard deviations. ``softness``: how many times
    that in the first stage. ``tolerance``: decrease of minus the log posterior below which a stage ends.
    """

    optimizer: Literal["lm", "adam_lbfgs"] = "lm"
    width: int = 64
    depth: int = 2
    collocation: int = 200
    slack: float = 0.2
    softness: float = 30.0
    output_iterations: int = 12
    iterations: int = 60
    tolerance: float = 1e-3
    restarts: int = 2
    adam_steps: int = 500
    adam_rate: float = 1e-3
    lbfgs_steps: int = 2000
    device: str = "cpu"
    threads: int = 1

    card: ClassVar[Card] = Card(
        summary="physics-informed network trained on data, equation of motion, start and prior together",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="Gauss-Newton covariance of the log-parameters, network weights profiled out, Student's t",
        settings_source="architecture and collocation: the paper's Table 1; the rest chosen on development data",
        tuning="first weights: 26 combinations; slack, damping, tolerance: 25; adam_lbfgs: 6; 3-12 records each,"
        " 5-120 dB, 2-11 cycles, damping 2-20 %, judged by maximum a posteriori from the truth on the same data",
    )
    serves: ClassVar[Serves] = Serves(
        measures=("displacement", "velocity", "acceleration"),
        several_records=True,
        several_channels=True,
        offsets=True,
        max_dof=None,
    )
    requires: ClassVar[tuple[str, ...]] = ("torch",)
    extra: ClassVar[str] = "torch"

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """The estimate for one problem; status ``diverged`` or ``nonfinite`` where none was found."""
        units = problem.natural_units()
        scaled = _rounded(problem.expressed_in(units))
        if not any(np.any(c.values) for record in problem.records for c in record.channels):
            return _failed(problem, "every measured value is zero: there is no motion to identify; check the sensor")
        if self.device != "cpu" and not _has_device(self.device):
            sentence = f"device={self.device} is not available here: use device=cpu"
            return Estimate.failed(problem.system, Status.INVALID, sentence)
        with np.errstate(all="ignore"):
            estimate = self._identified(scaled, rng)
        offsets = problem.offsets_from(units, estimate.offsets)
        return replace(estimate, offsets=offsets).expressed_in(units.inverse)

    def _identified(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        from methods.pinn import engine

        free = _free(problem)
        dof = float(max(problem.n - _n_estimated(problem), 1))
        guesses, reference = scan(problem, problem.system.n_dof)
        fits: list[Fit] = []
        for guess in _starts(guesses, problem.system.n_dof)[: 1 + self.restarts]:
            fits.append(engine.fit(problem, guess, free, dof, self, rng))
            if np.isfinite(fits[-1].loss) and fits[-1].left <= SUSPECT * reference + 1e-9:
                break
        finite = [fit for fit in fits if np.isfinite(fit.loss) and np.all(np.isfinite(fit.covariance))]
        cost = Cost(sum(fit.evaluations for fit in fits), sum(fit.iterations for fit in fits))
        if not finite:
            sentence = "no attempt gave finite numbers; try other restarts, or check the record for outliers"
            return Estimate.failed(problem.system, Status.NONFINITE, sentence, cost)
        best = min(finite, key=lambda fit: fit.loss)
        return self._estimate(problem, best, free, dof, len(fits) - 1, reference, cost)

    def _estimate(
        self, problem: Problem, fit: Fit, free: Sequence[str], dof: float, restarts: int, reference: float, cost: Cost
    ) -> Estimate:
        system = problem.system
        message = fit.reason + (f"; {restarts} restart(s)" if restarts else "")
        if fit.left > SUSPECT * reference + 1e-9:
            message += "; it leaves more than damped waves do, so this may be a local minimum"
        belief: dict[str, Any]
        if len(free) == len(system.names):
            belief = {"parameters": Normal(system.names, fit.logs, fit.covariance, log=True, dof=dof)}
        else:
            belief = {"groups": _groups(problem, fit, free, dof)}
        starts = [
            record.initial_state or InitialState(own[0], own[1])
            for record, own in zip(problem.records, fit.starts, strict=True)
        ]
        flags = [c.offset for record in problem.records for c in record.channels]
        offsets = np.zeros(len(flags))
        offsets[np.flatnonzero(flags)] = fit.offsets
        return Estimate(
            system,
            **belief,
            reconstructions=fit.responses,
            initial_states=tuple(starts),
            offsets=tuple(map(float, offsets)) if any(flags) else None,
            message=message,
            cost=cost,
            traces={f"loss_{name}": values for name, values in fit.history.items()},
        )


def _rounded(problem: Problem) -> Problem:
    """The problem (in natural units) with every number to ten digits.

    Thousands of steps of Adam and L-BFGS magnify the last bit of the data to a hundredth of a standard error. Rounded
    like this, a record in other units is the same record to the last bit, and so is the answer.
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
            )
        )
    prior = problem.prior
    if prior is not None:
        prior = replace(prior, nominal={name: float(f"{v:.{DIGITS}g}") for name, v in prior.nominal.items()})
    return replace(problem, records=tuple(records), prior=prior)


def _failed(problem: Problem, sentence: str) -> Estimate:
    return Estimate.failed(problem.system, Status.DIVERGED, sentence)


def _has_device(device: str) -> bool:
    import torch

    return device.startswith("cuda") and torch.cuda.is_available()


def _free(problem: Problem) -> tuple[str, ...]:
    """The parameters to estimate: without prior and force the gauge mass stays fixed, for the data cannot tell it."""
    names = problem.system.names
    if problem.prior is None and not problem.forced:
        return tuple(name for name in names if name != problem.system.gauge)
    return names


def _n_estimated(problem: Problem) -> int:
    """How many numbers the data decide: parameters or groups, unknown starts, offsets."""
    system = problem.system
    own = len(system.names) if problem.forced else len(system.groups)
    starts = sum(2 * system.n_dof for record in problem.records if record.initial_state is None)
    return own + starts + sum(c.offset for record in problem.records for c in record.channels)


def _starts(guesses: Sequence[Guess], n_dof: int) -> list[Guess]:
    """Where to start, best first: the waves of the scan, or the dominant one and detours from it for several modes."""
    if n_dof == 1:
        return [*guesses, *[Guess(guesses[0].omega * d, guesses[0].decay, 1.0) for d in DETOURS[1:]]]
    return [Guess(guesses[0].omega * d, guesses[0].decay, 1.0) for d in DETOURS]


def _groups(problem: Problem, fit: Fit, free: Sequence[str], dof: float) -> Normal:
    """The groups in themselves, with the first-order covariance of products of powers."""
    system = problem.system
    parameters = dict(zip(system.names, np.exp(fit.logs), strict=True))
    values = np.array([group.value(parameters) for group in system.groups])
    slopes = values[:, None] * np.array([group.vector(free) for group in system.groups])
    names = tuple(group.name for group in system.groups)
    return Normal(names, values, slopes @ fit.covariance @ slopes.T, log=False, dof=dof)
