"""Variable projection on random features: the hidden layers stay as they were drawn, the output layer is solved for.

An extreme learning machine (G.-B. Huang et al., Neurocomputing 70:489, 2006; as a PINN V. Dwivedi and B. Srinivasan,
Neurocomputing 391:96, 2020). For given physical parameters the output layer is that of a least-squares problem, a
linear one for a linear system; what is left is a function of the parameters alone (G. Golub and V. Pereyra, SIAM J.
Numer. Anal. 10:413, 1973), which scipy's trust-region least squares minimises.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from torch import Tensor

from methods.pinn.levenberg import Walk, minimise
from methods.pinn_family.loss import COSTS, Loss, tensor

INNER = 20
"""The most Levenberg-Marquardt steps to the output layer of given parameters."""


def variable_projection(loss: Loss, z: Tensor, tolerance: float) -> Tensor:
    """The minimum over physical parameters and the output layer."""
    loss.freeze()
    residuals, deviations = loss.residuals, loss.deviations
    heads, short = residuals.heads(z[None])
    n_free = len(residuals.free)
    where = slice(heads.n_coefficients, heads.n_coefficients + n_free)
    current = short.clone()

    def inner(logs: np.ndarray) -> Tensor:
        """All unknowns of the output layer's problem where the parameters are given."""
        point = current.clone()
        point[0, where] = tensor(logs, point)
        held, own = heads.held(point)
        walk = Walk.start(own, 1e-9)
        minimise(held, walk, deviations[:, : held.n_rows], INNER, 1e-9)
        loss.charge(COSTS["equations"] * float(walk.iterations[0]))
        return heads.with_responses(point, walk.z)

    def rows(logs: np.ndarray) -> np.ndarray:
        found = inner(logs)
        state = heads.evaluate(found, deviations)
        whole = residuals.with_heads(z[None], found)
        loss.seen(whole[0], state)
        return np.asarray(state.rows[0].cpu())

    first = np.asarray(short[0, where].cpu())
    found = least_squares(rows, first, method="trf", x_scale=1.0, ftol=tolerance, xtol=1e-10, diff_step=1e-6)
    return residuals.with_heads(z[None], inner(found.x))[0]
