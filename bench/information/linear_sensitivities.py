"""The response of a linear system and its exact derivatives by parameters and start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.contract.problem import Force, InitialState
from bench.dynamics.linear_motion import linear_motion
from bench.systems import System


def linear_sensitivities(
    system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of a linear system and its derivatives, at increasing times >= 0 (s).

    Args:
        system: one that is linear, of any residual that numpy can run on complex numbers.
        p: the parameters, in SI units.
        start: the state at time 0.
        times: where the displacement is wanted, shape (n_times,).
        forces: the known forces; each is zero after its last sample.

    Returns:
        The displacement (m), shape (n_dof, n_times), and its derivatives, shape (n_dof, n_times, n_parameters +
        2 n_dof): by the log-parameters, then by the initial displacement and velocity of each DOF.
    """
    one = {name: np.array([p[name]]) for name in system.names}
    state = np.concatenate([start.displacement, start.velocity])[None]
    path, slopes = linear_motion(system, one, state, times, forces)
    n = system.n_dof
    return path[0, :, :n].T, np.moveaxis(slopes[0, :, :n], 1, 0)
