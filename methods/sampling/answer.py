"""The estimate from draws of a posterior.

The point estimate of a quantity is the posterior median (:class:`bench.Draws`); the reconstruction is the mean response
over draws, which minimises the expected squared error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench import Cost, Draws, Estimate, Force, InitialState, Normal, System, simulate
from methods.sampling.posterior import Posterior


@dataclass(frozen=True, eq=False)
class MeanResponse:
    """The mean displacement over draws as a function of time; states have shape (n_dof, n_draws)."""

    system: System
    parameters: dict[str, np.ndarray]
    displacement: np.ndarray
    velocity: np.ndarray
    forces: tuple[Force, ...] = ()

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the displacement, (n_dof, n_times), at increasing times."""
        start = (self.displacement, self.velocity)
        return np.asarray(simulate(self.system, self.parameters, start, times, self.forces).displacement.mean(axis=1))


def thinned(draws: np.ndarray, most: int) -> np.ndarray:
    """Select at most ``most`` evenly spaced draws of (..., size), as (n, size)."""
    flat = draws.reshape(-1, draws.shape[-1])
    return np.asarray(flat[np.linspace(0, len(flat) - 1, min(most, len(flat))).astype(int)])


def estimate_from_draws(
    posterior: Posterior, phi: np.ndarray, traces: Mapping[str, float], cost: Cost, curves: int, message: str = ""
) -> Estimate:
    """Return the estimate from draws of phi (n, size), with the parameters at the mode as a trace."""
    model = posterior.model
    system, n = model.system, model.system.n_dof
    theta, few = phi[:, : model.size], thinned(phi, curves)[:, : model.size]
    p, few_p = model.parameters(theta), model.parameters(few)
    responses, states = [], []
    for record, of_all, of_few in zip(model.problem.records, model.states(theta), model.states(few), strict=True):
        x, v = of_few[:, :n].T, of_few[:, n:].T
        responses.append(MeanResponse(record.rig(system), few_p, x, v, record.forces))
        middle = np.median(of_all, axis=0)
        known = record.initial_state
        states.append(InitialState(middle[:n], middle[n:]) if known is None else known)
    parameters = groups = None
    if len(model.free) == len(system.names):
        parameters = Draws(system.names, np.stack([p[name] for name in system.names], axis=1))
    else:
        names = tuple(group.name for group in system.groups)
        values = np.stack([group.value(p) for group in system.groups], axis=1)
        groups = Normal(names, values.mean(axis=0), np.atleast_2d(np.cov(values.T)), log=False)
    mode = np.array(list(model.parameters(posterior.mode).values()))
    return Estimate(
        system,
        parameters=parameters,
        groups=groups,
        reconstructions=tuple(responses),
        initial_states=tuple(states),
        offsets=tuple(map(float, np.median(model.offsets(theta), axis=0))),
        message=message,
        cost=cost,
        traces={"posterior_mode": mode, **{name: np.array([value]) for name, value in traces.items()}},
        dimensions={"posterior_mode": [parameter.dimension for parameter in system.parameters]},
    )
