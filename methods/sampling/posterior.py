"""The posterior that the samplers draw from, its modes, and the answer that draws from it are.

Sampled together: the log-parameters, the initial states and offsets that are not told, and the logarithm of each
channel's noise. Likelihood: independent normal errors about the simulated response. Priors, all proper but one: the
problem's nominal prior on the log-parameters (without one, a normal of standard deviation 3, a factor of 20, about the
best fit to the data); ``log sigma ~ Normal(log(rms of the channel / 10), 3²)``, its two standard deviations reach from
70 dB to -30 dB; flat on initial states and offsets, which the data fix.

The point value of a quantity is that of least expected squared relative error (:class:`bench.Draws`); the
reconstruction is the mean response over draws: of all curves the one of least expected square error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench import (
    LOG_LIMIT,
    Cost,
    Draws,
    Estimate,
    Force,
    InitialState,
    NoEstimate,
    Normal,
    OutputError,
    System,
    simulate,
)
from methods.starts.candidates import screened
from methods.starts.open_parameters import PRIORLESS_SD

NOISE_CENTRE = float(np.log(0.1))
NOISE_SD = 3.0


def modes_of(model: OutputError) -> list[tuple[float, np.ndarray]]:
    """Find minus twice the log-posterior and theta of the best modes, best first; NoEstimate where there is none."""
    modes = screened(model, n=3, rounds=3, iterations=12)
    if not modes:
        raise NoEstimate("no start gave a finite response; give a prior nearer to the system")
    return modes


class Posterior:
    """The log-density over ``phi = [theta, log sigma by channel]``, up to a constant; ``calls`` counts responses."""

    def __init__(self, model: OutputError, mode: np.ndarray) -> None:
        self.model, self.mode, self.calls = model, mode, 0
        self.noise_centre = NOISE_CENTRE + np.log(model.rms)
        k = len(model.free)
        self.centre = mode[:k] if model.prior is None else model.prior.log_mean
        self.sds = np.full(k, PRIORLESS_SD) if model.prior is None else model.prior.log_sds

    @property
    def size(self) -> int:
        return self.model.size + len(self.model.channels)

    def __call__(self, phi: np.ndarray) -> np.ndarray:
        """Log-density, shape (n,), of ``phi`` of shape (n, size); minus infinity where the response diverges."""
        model, d, k = self.model, self.model.size, len(self.model.free)
        theta, log_sigma = phi[:, :d], phi[:, d:]
        inside = np.all(np.abs(theta[:, :k]) < LOG_LIMIT, axis=1) & np.all(np.abs(log_sigma) < LOG_LIMIT, axis=1)
        self.calls += len(phi)
        with np.errstate(all="ignore"):
            predicted = model.predict(np.where(inside[:, None], theta, 0.0))
            r = (model.data - predicted) * np.exp(-log_sigma)[:, model.channel_of]
            value = -0.5 * np.einsum("ni,ni->n", r, r) - log_sigma @ model.counts
            value -= 0.5 * np.sum(((theta[:, :k] - self.centre) / self.sds) ** 2, axis=1)
            value -= 0.5 * np.sum(((log_sigma - self.noise_centre) / NOISE_SD) ** 2, axis=1)
        return np.where(inside & np.isfinite(value), value, -np.inf)


@dataclass(frozen=True, eq=False)
class MeanResponse:
    """The mean displacement over draws, as a function of time; can be pickled. Starts have shape (n_dof, n_draws)."""

    system: System
    parameters: dict[str, np.ndarray]
    displacement: np.ndarray
    velocity: np.ndarray
    forces: tuple[Force, ...] = ()

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Displacement (m), shape (n_dof, n_times), at increasing times (s)."""
        start = (self.displacement, self.velocity)
        return np.asarray(simulate(self.system, self.parameters, start, times, self.forces).displacement.mean(axis=1))


def estimate_from_draws(
    posterior: Posterior, phi: np.ndarray, traces: Mapping[str, np.ndarray], cost: Cost, curves: int
) -> Estimate:
    """Make the answer of draws of phi (n, size); the parameters at the mode are added to the traces."""
    model = posterior.model
    system, theta = model.system, phi[:, : model.size]
    p, starts = model.parameters(theta), model.starts(theta)
    few = np.linspace(0, len(phi) - 1, min(curves, len(phi))).astype(int)
    responses, states = [], []
    for record, start in zip(model.problem.records, starts, strict=True):
        if isinstance(start, InitialState):
            shape = (system.n_dof, len(few))
            x, v = (np.broadcast_to(part[:, None], shape) for part in (start.displacement, start.velocity))
            states.append(start)
        else:
            x, v = start[0][:, few], start[1][:, few]
            states.append(InitialState(np.median(start[0], axis=1), np.median(start[1], axis=1)))
        few_p = {name: value[few] for name, value in p.items()}
        responses.append(MeanResponse(record.rig(system), few_p, x, v, record.forces))
    parameters = groups = None
    if len(model.free) == len(system.names):
        parameters = Draws(system.names, np.stack([p[name] for name in system.names], axis=1))
    else:
        names = tuple(group.name for group in system.groups)
        values = np.stack([group.value(p) for group in system.groups], axis=1)
        groups = Normal(names, values.mean(axis=0), np.atleast_2d(np.cov(values.T)), log=False)
    return Estimate(
        system,
        parameters=parameters,
        groups=groups,
        reconstructions=tuple(responses),
        initial_states=tuple(states),
        offsets=tuple(map(float, np.median(model.offsets(theta), axis=0))),
        cost=cost,
        traces={"posterior_mode": np.array(list(model.parameters(posterior.mode).values())), **traces},
        dimensions={"posterior_mode": [parameter.dimension for parameter in system.parameters]},
    )
