"""The answer that draws from a posterior are.

The point value of a quantity is the posterior median (:class:`bench.Draws`); the reconstruction is the mean response
over draws: of all curves the one of least expected square error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench import Cost, Draws, Estimate, Force, InitialState, Normal, System, simulate
from methods.sampling.posterior import Posterior


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
