"""Coordinates in which the posterior of all weights can be sampled: the output layer relative to the hidden ones.

Nearly hard physics ties the output layer's weights and the parameters to each other and to the hidden layers: at fixed
hidden layers h they vary over ranges that differ by a factor of 10^5, and which combinations are stiff changes with h.
Here they are ``y = y*(h) + L(h)^-T v``, where y* minimises the residuals linearised about the trained response, with
the prior, and ``L Lᵀ`` is the Gauss-Newton matrix there (a non-centred parametrisation: O. Papaspiliopoulos, G. Roberts
and M. Sköld, Stat. Sci. 22:59, 2007). Of a linear system v is nearly a standard normal, whatever h. The change of
variables is exact for any system: its determinant enters the density.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from methods.network.ansatz import Ansatz, Sum
from methods.network.tanh import Network
from methods.pinn_family.beliefs.trained import Posterior
from methods.pinn_family.jet import Jet

LEAST = 1e-12
"""Precision added for an unknown that neither data nor prior tell of."""


def functions(ansatz: Ansatz, theta: Tensor) -> Tensor:
    """Streams (3, n_points, n_functions) of what the output layer combines, for coefficients (1, count), to be derived.

    As ``Ansatz.head`` has them, but the tanh network's own are made in place, which autograd cannot follow.
    """
    if isinstance(ansatz, Sum):
        return torch.cat([functions(ansatz.inner, theta[:, : ansatz.inner.count]), ansatz.fixed.functions[0]], 2)
    if not isinstance(ansatz, Network):
        return ansatz.head(theta)[0].dense().functions[0]
    jet = Jet.of_time(ansatz.tau[0][:, None], ansatz.rate[0])
    for weight, bias in ansatz.layers(theta)[:-1]:
        jet = jet.linear(weight[0], bias[0]).tanh()
    one = torch.ones_like(jet.value[:, :1])
    return jet.beside(Jet(one, torch.zeros_like(one), torch.zeros_like(one))).stacked()


class Coordinates:
    """Takes u (n,), hidden weights and then v, to the log posterior density; all weights have a standard normal prior.

    ``first`` is where u starts, the trained point; ``n_hidden`` of its entries are hidden weights. Weights that
    training never moves (random frequencies) are no unknowns.
    """

    def __init__(self, posterior: Posterior) -> None:
        self.posterior = posterior
        residuals, z, deviations = posterior.residuals, posterior.z, posterior.deviations
        heads, short = residuals.heads(z)
        self.n_short, self.n_output = short.shape[1], heads.n_coefficients
        number = torch.arange(self.n_short, dtype=z.dtype, device=z.device)[None]
        self.places = residuals.with_heads(torch.full_like(z, -1.0), number)[0].long()
        self.hidden = self._trained()
        self.n_hidden = self.hidden.numel()
        state = residuals.evaluate(z, deviations)
        linear = residuals.linearise(state, deviations)
        self.columns = linear.columns[0]
        logs = residuals.split(z)[1]
        self.seeds, at = [], 0
        self.constant = state.rows[0] - self.columns @ short[0, self.n_output :]
        for k, block in enumerate(residuals.blocks):
            rows = slice(at, at + block.n_rows)
            seeds = residuals._seeds(block, state.outputs[k], logs)[0][0] / deviations[0, rows, None]
            self.constant[rows] -= (seeds * state.tapes[k].output[0][:, block.points]).sum((0, 2))
            self.seeds.append(seeds)
            at += block.n_rows
        precision = torch.full((self.n_short,), LEAST, dtype=z.dtype, device=z.device)
        precision[: self.n_output] = 1.0
        self.precision = torch.diag(precision)
        root, centre, _ = self._geometry(z)
        self.first = torch.cat([z[0, self.hidden], root.mT @ (short[0] - centre)])

    def _trained(self) -> Tensor:
        """Places in z of the hidden weights that the functions depend on."""
        with torch.enable_grad():
            z = self.posterior.z.clone().requires_grad_(True)
            parts, _ = self.posterior.residuals.split_flat(z)
            pairs = zip(self.posterior.residuals.ansatzes, parts, strict=True)
            total = torch.stack([torch.sin(functions(*pair)).sum() for pair in pairs]).sum()
            if not total.requires_grad:
                return torch.zeros(0, dtype=torch.long, device=z.device)
            slopes = torch.autograd.grad(total, z)[0][0]
        return torch.nonzero((self.places < 0) & (slopes != 0))[:, 0]

    def _geometry(self, z: Tensor) -> tuple[Tensor, Tensor, list[Tensor]]:
        """L (n_short, n_short), y* (n_short,) and the functions of each record, at the hidden weights of z."""
        residuals = self.posterior.residuals
        parts, _ = residuals.split_flat(z)
        found, columns, at = [], [], 0
        for k, (block, ansatz, part) in enumerate(zip(residuals.blocks, residuals.ansatzes, parts, strict=True)):
            own = functions(ansatz, part)
            rows = torch.einsum("sro,srk->rok", self.seeds[k], own[:, block.points]).flatten(1)
            columns.append(torch.nn.functional.pad(rows, (0, 0, at, residuals.n_rows - at - block.n_rows)))
            found.append(own)
            at += block.n_rows
        jacobian = torch.cat([*columns, self.columns], 1)
        root = torch.linalg.cholesky(jacobian.mT @ jacobian + self.precision)
        centre = -torch.cholesky_solve((jacobian.mT @ self.constant)[:, None], root)[:, 0]
        return root, centre, found

    def _placed(self, u: Tensor) -> tuple[Tensor, Tensor, Tensor, list[Tensor]]:
        """z with the hidden weights of u, the output layer and other unknowns y, L, and the functions."""
        z = self.posterior.z.index_copy(1, self.hidden, u[None, : self.n_hidden])
        root, centre, found = self._geometry(z)
        y = centre + torch.linalg.solve_triangular(root.mT, u[self.n_hidden :, None], upper=True)[:, 0]
        return z, y, root, found

    def point(self, u: np.ndarray) -> Tensor:
        """z (1, n_z) at u."""
        z, y, _, _ = self._placed(torch.tensor(u, device=self.posterior.z.device))
        return self.posterior.residuals.with_heads(z, y[None])

    def density(self, u: Tensor) -> Tensor:
        """The log density at u, up to a constant."""
        residuals = self.posterior.residuals
        z, y, root, found = self._placed(u)
        weights, rest = y[: self.n_output], y[None, self.n_output :]
        _, logs, offsets = residuals.split(torch.cat([z[:, : residuals.n_coefficients], rest], 1))
        outputs, at = [], 0
        for block, own in zip(residuals.blocks, found, strict=True):
            n = block.n_paths * own.shape[-1]
            combined = own @ weights[at : at + n].reshape(block.n_paths, -1).mT
            outputs.append(block.response(combined[None]))
            at += n
        rows = residuals._rows(outputs, residuals._physics(outputs, logs), logs, offsets) / self.posterior.deviations
        squares = (rows**2).sum() + (weights**2).sum() + (u[: self.n_hidden] ** 2).sum()
        return -0.5 * squares - torch.log(root.diagonal()).sum()

    def value_and_slope(self, u: np.ndarray) -> tuple[float, np.ndarray]:
        """The log density and its gradient (n,); minus infinity where they are not finite."""
        at = torch.tensor(u, dtype=torch.float64, device=self.posterior.z.device, requires_grad=True)
        try:
            with torch.enable_grad():
                value = self.density(at)
                (slope,) = torch.autograd.grad(value, at)
        except torch.linalg.LinAlgError:
            return -np.inf, np.zeros_like(u)
        found = np.asarray(slope.cpu())
        if not (torch.isfinite(value.detach()) and np.all(np.isfinite(found))):
            return -np.inf, np.zeros_like(u)
        return float(value.detach()), found
