"""A Bayesian PINN: Hamiltonian Monte Carlo over all weights and parameters.

L. Yang, X. Meng and G. Karniadakis, J. Comput. Phys. 425:109913, 2021: a standard normal prior of the weights, and the
likelihood of data and equation of motion. The sampler is blackjax's NUTS (M. D. Hoffman and A. Gelman, J. Mach. Learn.
Res. 15:1593, 2014), in :class:`Coordinates`, from the trained point.

These describe the output layer relative to the hidden layers h. Nearly hard physics couples output weights and
parameters to each other and to h: at fixed h their ranges differ by a factor of 10^5, and the stiff combinations depend
on h. The coordinates are ``y = y*(h) + L(h)^-T v``, where y* minimises the residuals linearised about the trained
response, with the prior, and ``L Lᵀ`` is the Gauss-Newton matrix there (a non-centred parametrisation: O.
Papaspiliopoulos, G. Roberts and M. Sköld, Stat. Sci. 22:59, 2007). For a linear system v is nearly a standard normal
for any h. The change of variables is exact for any system, with its determinant in the density.

The hidden weights are still stiffer than v and would reduce the common step size: a first warm-up estimates their step,
and their mass is then chosen so that a larger step is stable.

Convergence of the two chains is assessed on parameters, offsets, the displacement at :data:`PLACES` times, and the log
density, by the split R-hat and the effective sample size of A. Vehtari et al., Bayesian Analysis 16:667, 2021; not on
weights, which are not identifiable. A message states the result.
"""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bench import NoEstimate, Status
from methods.network.ansatz import Ansatz, Basis, SumAnsatz
from methods.network.tanh import Network, layers_of
from methods.pinn.residuals import Residuals
from methods.pinn_family.architectures import Jet
from methods.pinn_family.loss import plain
from methods.pinn_family.training import TrainedFit, TrainedPosterior

CHAINS = 2
WARMUP = (60, 40)
"""Steps of the two warm-up phases of a chain."""
DRAWS = 150
"""Draws per chain."""
DOUBLINGS = 4
"""Largest number of doublings of a trajectory: up to 15 gradients per draw."""
STEP = 0.3
"""Step size of output layer and parameters."""
R_HAT, EFFECTIVE = 1.05, 50.0
"""Largest R-hat and least effective sample size of converged chains."""
PLACES = 10
LEAST_PRECISION = 1e-12
"""Precision, over the largest, of an unknown that neither data nor prior determine."""


def sample(posterior: TrainedPosterior, fit: TrainedFit, rng: np.random.Generator) -> TrainedFit:
    """Draw all weights and parameters; return the fit with their distribution."""
    coordinates, n_free = Coordinates(posterior), len(posterior.residuals.free)
    positions, densities, gradients = zip(*(_chain(coordinates, rng) for _ in range(CHAINS)), strict=True)
    paths, density = np.stack(positions), np.stack(densities)[..., None]
    draws = [coordinates.point(u) for u in paths.reshape(-1, paths.shape[-1])]
    monitored = np.array([_monitored(posterior, z) for z in draws]).reshape(*paths.shape[:2], -1)
    groups = {"parameters": monitored[..., :n_free], "displacement": monitored[..., n_free:], "density": density}
    diagnostics = {name: _diagnostics(values) for name, values in groups.items()}
    bad = [
        f"{name} R-hat {r_hat:.2f}, {effective:.0f} effective draws"
        for name, (r_hat, effective) in diagnostics.items()
        if not (r_hat <= R_HAT and effective >= EFFECTIVE)
    ]
    remark = f"the chains have not converged ({'; '.join(bad)})" if bad else ""
    worst = np.array(list(diagnostics.values()))
    traces = {"r_hat": worst[:, 0], "effective_sample_size": worst[:, 1], "log_density": density[..., 0]}
    answer = posterior.from_draws(fit, draws, sum(gradients))
    answer.reason, answer.history = "; ".join(filter(None, [fit.reason, remark])), {**fit.history, **traces}
    answer.draws = np.array([posterior.unknowns(z)[0] for z in draws])
    return answer


def _monitored(posterior: TrainedPosterior, z: Tensor) -> np.ndarray:
    """Return free log-parameters, displacements at ``PLACES`` times, and offsets."""
    logs, offsets = posterior.unknowns(z)
    few = [x[:, np.linspace(0, x.shape[1] - 1, PLACES).astype(int)].ravel() for x in posterior.motion(z)[0]]
    return np.concatenate([logs[posterior.residuals.free], *few, offsets])


def _diagnostics(paths: np.ndarray) -> tuple[float, float]:
    """Return the worst R-hat and effective sample size of (chains, draws, size)."""
    from blackjax.diagnostics import ess_bulk, rhat

    moving = np.ptp(paths, axis=(0, 1)) > 0  # an exact initial state is constant
    if not np.any(moving):
        return float("inf"), 0.0
    worst = float(np.max(rhat(paths[..., moving]))), float(np.min(ess_bulk(paths[..., moving])))
    return worst if np.all(np.isfinite(worst)) else (float("inf"), 0.0)


def _chain(coordinates: Coordinates, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, int]:
    """Return positions u (draws, n), log densities (draws,), and the number of gradients."""
    try:
        import blackjax  # noqa: F401
    except ImportError as error:
        sentence = "uncertainty=nuts requires blackjax: pip install 'vibration-bench[nuts]'"
        raise NoEstimate(sentence, Status.MISSING_DEPENDENCY) from error
    import jax
    from blackjax.adaptation.step_size import dual_averaging_adaptation

    jax.config.update("jax_enable_x64", True)
    n, hidden, evaluations = coordinates.first.numel(), coordinates.n_hidden, 0

    def target(u: Any) -> tuple[np.float64, np.ndarray]:
        nonlocal evaluations
        evaluations += 1
        value, slope = coordinates.value_and_slope(np.array(u))
        return np.float64(value), slope

    def keys(steps: int) -> Any:
        return jax.random.split(jax.random.key(int(rng.integers(2**31))), steps)

    begin, move = compiled(n)
    first, update, finish = dual_averaging_adaptation(0.8)
    step, metric = 0.01 if hidden else 0.1, np.ones(n)
    TARGETS.append(target)
    try:
        state, path = begin(plain(coordinates.first)), []
        for number, steps in enumerate(WARMUP):
            tuned = first(step)
            for key in keys(steps):
                state, info = move(key, state, float(np.exp(tuned.log_step_size)), metric)
                tuned = update(tuned, info.acceptance_rate)
            step = float(finish(tuned))
            if number == 0 and hidden:
                metric[:hidden], step = min(1.0, (step / STEP) ** 2), STEP
        for key in keys(DRAWS):
            state, _ = move(key, state, step, metric)
            path.append((np.asarray(state.position), float(state.logdensity)))
    finally:
        TARGETS.pop()
    positions, densities = zip(*path, strict=True)
    return np.array(positions), np.array(densities), evaluations


TARGETS: list[Callable[[Any], tuple[np.float64, np.ndarray]]] = []
"""Log density and gradient called by the compiled code (the last entry), so that it is compiled once."""


@cache
def compiled(n: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return compiled functions: the state at a position (n,); a step by key, state, step size, inverse masses (n,)."""
    import blackjax
    import jax
    import jax.numpy as jnp

    shapes = jax.ShapeDtypeStruct((), jnp.float64), jax.ShapeDtypeStruct((n,), jnp.float64)

    def evaluate(u: Any) -> Any:
        return jax.pure_callback(lambda position: TARGETS[-1](position), shapes, u)

    @jax.custom_vjp
    def log_density(u: Any) -> Any:
        return evaluate(u)[0]

    log_density.defvjp(evaluate, lambda slope, weight: (weight * slope,))
    kernel = blackjax.mcmc.nuts.build_kernel()

    def moved(key: Any, state: Any, step: Any, metric: Any) -> Any:
        return kernel(key, state, log_density, step, metric, max_num_doublings=DOUBLINGS)

    return jax.jit(lambda u: blackjax.nuts.init(u, log_density)), jax.jit(moved)


def functions(ansatz: Ansatz, theta: Tensor) -> Tensor:
    """Return streams (3, n_points, n_functions) of the output layer's inputs, differentiable by theta (1, count).

    As in ``Ansatz.head``, without the in-place operations of the tanh network, which autograd does not support.
    """
    if isinstance(ansatz, SumAnsatz):
        return torch.cat([functions(ansatz.inner, theta[:, : ansatz.inner.count]), ansatz.fixed.functions[0]], 2)
    if not isinstance(ansatz, Network):
        return ansatz.head(theta)[0].dense().functions[0]
    jet = Jet.of_time(ansatz.tau[0][:, None], ansatz.rate[0])
    for weight, bias in layers_of(theta, ansatz.widths)[:-1]:
        jet = jet.linear(weight[0], bias[0]).tanh()
    return jet.with_one().streams


class Coordinates:
    """Map u (n,), hidden weights and then v, to the log posterior density; all weights have a standard normal prior.

    ``first``: u at the trained point; ``n_hidden`` of its entries are hidden weights. Weights that are not trained
    (random frequencies) are constants.
    """

    def __init__(self, posterior: TrainedPosterior) -> None:
        self.posterior, z = posterior, posterior.z
        self.hidden = self._trained()
        self.n_hidden = self.hidden.numel()
        heads, short = self._heads(z), posterior.residuals.heads(z)[1]
        self.state = heads.evaluate(short, posterior.deviations)
        self.linear = heads.linearise(self.state, posterior.deviations)
        self.constant = self.state.rows[0] - self._jacobian(heads) @ short[0]
        self.n_output = heads.n_coefficients
        self.precision = torch.full_like(short[0], LEAST_PRECISION)
        self.precision[: self.n_output] = 1.0
        root, centre = self._geometry(heads)
        self.first = torch.cat([z[0, self.hidden], root.mT @ (short[0] - centre)])

    def _trained(self) -> Tensor:
        """Return the indices in z of the hidden weights on which the functions depend."""
        residuals = self.posterior.residuals
        with torch.enable_grad():
            z = self.posterior.z.clone().requires_grad_(True)
            pairs = zip(residuals.ansatzes, residuals.split_flat(z)[0], strict=True)
            total = torch.stack([torch.sin(functions(*pair)).sum() for pair in pairs]).sum()
            slopes = torch.autograd.grad(total, z)[0] if total.requires_grad else torch.zeros_like(z)
        return torch.nonzero(slopes[0])[:, 0]

    def _heads(self, z: Tensor) -> Residuals:
        """Return the residual vector as a function of output layer and other unknowns, at the hidden weights of z."""
        heads = copy.copy(self.posterior.residuals)
        records = zip(heads.blocks, heads.ansatzes, heads.split_flat(z)[0], strict=True)
        heads.ansatzes = [Basis(functions(ansatz, part)[None], block.n_paths) for block, ansatz, part in records]
        return heads

    def _jacobian(self, heads: Residuals) -> Tensor:
        """Return the Jacobian (n_rows, n_short) of the residuals linearised about the trained response."""
        return torch.cat([part for _, part in heads.jacobian_parts(self.state, self.linear)], 1)[0]

    def _geometry(self, heads: Residuals) -> tuple[Tensor, Tensor]:
        """Return L (n_short, n_short) and y* (n_short,)."""
        jacobian = self._jacobian(heads)
        root = torch.linalg.cholesky(jacobian.mT @ jacobian + torch.diag(self.precision))
        return root, -torch.cholesky_solve((jacobian.mT @ self.constant)[:, None], root)[:, 0]

    def _placed(self, u: Tensor) -> tuple[Tensor, Tensor, Tensor, Residuals]:
        """Return z with the hidden weights of u, the output layer and other unknowns y, L, and the residual vector."""
        z = self.posterior.z.index_copy(1, self.hidden, u[None, : self.n_hidden])
        heads = self._heads(z)
        root, centre = self._geometry(heads)
        y = centre + torch.linalg.solve_triangular(root.mT, u[self.n_hidden :, None], upper=True)[:, 0]
        return z, y, root, heads

    def point(self, u: np.ndarray) -> Tensor:
        """Return z (1, n_z) at u."""
        z, y, _, _ = self._placed(torch.tensor(u, device=self.posterior.z.device))
        return self.posterior.residuals.with_heads(z, y[None])

    def density(self, u: Tensor) -> Tensor:
        """Return the log density at u, up to a constant."""
        _, y, root, heads = self._placed(u)
        rows = heads.evaluate(y[None], self.posterior.deviations).rows
        squares = (rows**2).sum() + (y[: self.n_output] ** 2).sum() + (u[: self.n_hidden] ** 2).sum()
        return -0.5 * squares - torch.log(root.diagonal()).sum()

    def value_and_slope(self, u: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the log density and its gradient (n,); minus infinity where they are not finite."""
        point = torch.tensor(u, dtype=torch.float64, device=self.posterior.z.device, requires_grad=True)
        with torch.enable_grad(), contextlib.suppress(torch.linalg.LinAlgError):
            value = self.density(point)
            gradient = torch.autograd.grad(value, point)[0]
            if torch.isfinite(value) and torch.all(torch.isfinite(gradient)):
                return float(value.detach()), plain(gradient)
        return -np.inf, np.zeros_like(u)
