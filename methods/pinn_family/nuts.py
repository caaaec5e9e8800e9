"""A Bayesian PINN: Hamiltonian Monte Carlo over all weights and parameters.

L. Yang, X. Meng and G. Karniadakis, J. Comput. Phys. 425:109913, 2021: a standard normal prior of the weights, and the
likelihood of data and equation of motion. The sampler is blackjax's NUTS (M. D. Hoffman and A. Gelman, J. Mach. Learn.
Res. 15:1593, 2014), in :class:`Coordinates`, from the trained point.

These are the output layer relative to the hidden ones. Nearly hard physics ties the output layer's weights and the
parameters to each other and to the hidden layers: at fixed hidden layers h they vary over ranges that differ by a
factor of 10^5, and which combinations are stiff changes with h. Here they are ``y = y*(h) + L(h)^-T v``, where y*
minimises the residuals linearised about the trained response, with the prior, and ``L Lᵀ`` is the Gauss-Newton matrix
there (a non-centred parametrisation: O. Papaspiliopoulos, G. Roberts and M. Sköld, Stat. Sci. 22:59, 2007). Of a linear
system v is nearly a standard normal, whatever h. The change of variables is exact for any system: its determinant
enters the density.

The hidden weights are stiff even so, and what the step size allows them would hold up the parameters: a first warm-up
finds their step, and they are then as heavy as makes it that of the others.

Two chains. Whether they agree is judged on parameters, offsets, the displacement at :data:`PLACES` times, and the log
density, by the split R-hat and the effective draws of A. Vehtari et al., Bayesian Analysis 16:667, 2021; not on
weights, of which many permutations give the same function of time. The answer says where they do not.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bench import NoEstimate, Status
from methods.network.ansatz import Ansatz, SumAnsatz
from methods.network.tanh import Network, layers_of
from methods.pinn_family.architectures import Jet
from methods.pinn_family.training import TrainedFit
from methods.pinn_family.uncertainty import LEAST_PRECISION, TrainedPosterior, from_draws

CHAINS = 2
WARMUP = (60, 40)
"""Steps of the two warm-ups of a chain."""
DRAWS = 150
"""Draws of a chain."""
DOUBLINGS = 4
"""The most doublings of a path: up to 15 gradients a draw."""
STEP = 0.3
"""The step that output layer and parameters should have."""
R_HAT, EFFECTIVE = 1.05, 50.0
"""The largest R-hat and the least effective draws that are believed."""
PLACES = 10


def stated(posterior: TrainedPosterior, fit: TrainedFit, rng: np.random.Generator, members: int) -> TrainedFit:
    """Draw all weights and parameters."""
    coordinates, n_free = Coordinates(posterior), len(posterior.residuals.free)
    positions, densities, gradients = zip(*(_chain(coordinates, rng) for _ in range(CHAINS)), strict=True)
    paths, density = np.stack(positions), np.stack(densities)[..., None]
    draws = [coordinates.point(u) for u in paths.reshape(-1, paths.shape[-1])]
    judged = np.array([_judged(posterior, z) for z in draws]).reshape(*paths.shape[:2], -1)
    groups = {"parameters": judged[..., :n_free], "displacement": judged[..., n_free:], "density": density}
    health = {name: _health(values) for name, values in groups.items()}
    bad = [
        f"{name} R-hat {r_hat:.2f}, {effective:.0f} effective draws"
        for name, (r_hat, effective) in health.items()
        if not (r_hat <= R_HAT and effective >= EFFECTIVE)
    ]
    remark = f"; the chains have not converged ({'; '.join(bad)})" if bad else "; the chains have converged"
    worst = np.array(list(health.values()))
    traces = {"r_hat": worst[:, 0], "effective_sample_size": worst[:, 1], "log_density": density[..., 0]}
    answer = from_draws(posterior, fit, draws, sum(gradients))
    answer.reason, answer.history = fit.reason + remark, {**fit.history, **traces}
    answer.draws = np.array([posterior.parameters(z) for z in draws])
    return answer


def _judged(posterior: TrainedPosterior, z: Any) -> np.ndarray:
    """Return free log-parameters, offsets, and displacements at some times."""
    logs = posterior.parameters(z)[posterior.residuals.free]
    few = [x[:, np.linspace(0, x.shape[1] - 1, PLACES).astype(int)].ravel() for x in posterior.motion(z)[0]]
    return np.concatenate([logs, *few, posterior.offsets(z)])


def _health(paths: np.ndarray) -> tuple[float, float]:
    """Return the worst R-hat and effective draws of (chains, draws, size)."""
    from blackjax.diagnostics import ess_bulk, rhat

    moving = np.ptp(paths, axis=(0, 1)) > 0  # an initial state that the ansatz has exactly does not
    if not np.any(moving):
        return float("inf"), 0.0
    r_hat, effective = np.asarray(rhat(paths[..., moving])), np.asarray(ess_bulk(paths[..., moving]))
    worst = float(np.max(r_hat)), float(np.min(effective))
    return worst if np.all(np.isfinite(worst)) else (float("inf"), 0.0)


def _chain(coordinates: Coordinates, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, int]:
    """Return positions u (draws, n), log densities (draws,), and how many gradients they took."""
    try:
        import blackjax  # noqa: F401
    except ImportError as error:
        sentence = "uncertainty=nuts needs blackjax: pip install 'vibration-bench[nuts]'"
        raise NoEstimate(sentence, Status.MISSING_DEPENDENCY) from error
    import jax

    jax.config.update("jax_enable_x64", True)
    first = np.asarray(coordinates.first.cpu())
    asked = 0

    def target(u: Any) -> tuple[np.float64, np.ndarray]:
        nonlocal asked
        asked += 1
        value, slope = coordinates.value_and_slope(np.array(u))
        return np.float64(value), slope

    warm, sample = compiled(first.size)
    hidden = np.arange(first.size) < coordinates.n_hidden
    metric = np.ones(first.size)
    begun = 0.1 if not coordinates.n_hidden else 0.01
    HELD.append(target)
    try:
        u, step = first, begun
        for steps in WARMUP:
            keys = jax.random.split(jax.random.key(int(rng.integers(2**31))), steps)
            place, tuned = warm(keys, u, step, metric)
            u, step = np.asarray(place), float(tuned)
            if steps == WARMUP[0] and coordinates.n_hidden:
                metric = np.where(hidden, min(1.0, (step / STEP) ** 2), 1.0)
                step = STEP
        keys = jax.random.split(jax.random.key(int(rng.integers(2**31))), DRAWS)
        path, density = map(np.asarray, sample(keys, u, step, metric))
    finally:
        HELD.pop()
    return path, density, asked


HELD: list[Callable[[Any], tuple[np.float64, np.ndarray]]] = []
"""The log density and gradient that the compiled code asks: the last; so that it is compiled once for all problems."""


@cache
def compiled(n: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Compile warm-up and sampling in n dimensions, as functions of keys, position, step and inverse masses (n,)."""
    import blackjax
    import jax
    import jax.numpy as jnp
    from blackjax.adaptation.step_size import dual_averaging_adaptation

    shapes = jax.ShapeDtypeStruct((), jnp.float64), jax.ShapeDtypeStruct((n,), jnp.float64)

    def asked(u: Any) -> Any:
        return jax.pure_callback(lambda position: HELD[-1](position), shapes, u)

    @jax.custom_vjp
    def log_density(u: Any) -> Any:
        return asked(u)[0]

    log_density.defvjp(asked, lambda slope, weight: (weight * slope,))
    kernel = blackjax.mcmc.nuts.build_kernel()
    begin, update, finish = dual_averaging_adaptation(0.8)

    def moved(key: Any, state: Any, step: Any, metric: Any) -> Any:
        return kernel(key, state, log_density, step, metric, max_num_doublings=DOUBLINGS)

    def warm(keys: Any, u: Any, step: Any, metric: Any) -> Any:
        def once(carry: Any, key: Any) -> Any:
            state, tuned = carry
            state, info = moved(key, state, jnp.exp(tuned.log_step_size), metric)
            return (state, update(tuned, info.acceptance_rate)), None

        first = blackjax.nuts.init(u, log_density), begin(step)
        (state, tuned), _ = jax.lax.scan(once, first, keys)
        return state.position, finish(tuned)

    def sample(keys: Any, u: Any, step: Any, metric: Any) -> Any:
        def once(state: Any, key: Any) -> Any:
            state, _ = moved(key, state, step, metric)
            return state, (state.position, state.logdensity)

        return jax.lax.scan(once, blackjax.nuts.init(u, log_density), keys)[1]

    return jax.jit(warm), jax.jit(sample)


def functions(ansatz: Ansatz, theta: Tensor) -> Tensor:
    """Return streams (3, n_points, n_functions) of what the output layer combines, differentiable by theta (1, count).

    As ``Ansatz.head`` has them, but the tanh network's own are made in place, which autograd cannot follow.
    """
    if isinstance(ansatz, SumAnsatz):
        return torch.cat([functions(ansatz.inner, theta[:, : ansatz.inner.count]), ansatz.fixed.functions[0]], 2)
    if not isinstance(ansatz, Network):
        return ansatz.head(theta)[0].dense().functions[0]
    jet = Jet.of_time(ansatz.tau[0][:, None], ansatz.rate[0])
    for weight, bias in layers_of(theta, ansatz.widths)[:-1]:
        jet = jet.linear(weight[0], bias[0]).tanh()
    return jet.beside(Jet.one(jet.value[:, :1])).stacked()


class Coordinates:
    """Takes u (n,), hidden weights and then v, to the log posterior density; all weights have a standard normal prior.

    ``first`` is where u starts, the trained point; ``n_hidden`` of its entries are hidden weights. Weights that
    training never moves (random frequencies) are no unknowns.
    """

    def __init__(self, posterior: TrainedPosterior) -> None:
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
        self.seeds, first = [], 0
        self.constant = state.rows[0] - self.columns @ short[0, self.n_output :]
        for k, block in enumerate(residuals.blocks):
            rows = slice(first, first + block.n_rows)
            seeds = linear.seeds[k][0]
            self.constant[rows] -= (seeds * state.tapes[k].output[0][:, block.points]).sum((0, 2))
            self.seeds.append(seeds)
            first += block.n_rows
        precision = torch.full((self.n_short,), LEAST_PRECISION, dtype=z.dtype, device=z.device)
        precision[: self.n_output] = 1.0
        self.precision = torch.diag(precision)
        root, centre, _ = self._geometry(z)
        self.first = torch.cat([z[0, self.hidden], root.mT @ (short[0] - centre)])

    def _trained(self) -> Tensor:
        """Return the places in z of the hidden weights that the functions depend on."""
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
        """Return L (n_short, n_short), y* (n_short,) and the functions of each record, at the hidden weights of z."""
        residuals = self.posterior.residuals
        parts, _ = residuals.split_flat(z)
        streams, columns, first = [], [], 0
        for k, (block, ansatz, part) in enumerate(zip(residuals.blocks, residuals.ansatzes, parts, strict=True)):
            streams.append(functions(ansatz, part))
            rows = torch.einsum("sro,srk->rok", self.seeds[k], streams[-1][:, block.points]).flatten(1)
            columns.append(torch.nn.functional.pad(rows, (0, 0, first, residuals.n_rows - first - block.n_rows)))
            first += block.n_rows
        jacobian = torch.cat([*columns, self.columns], 1)
        root = torch.linalg.cholesky(jacobian.mT @ jacobian + self.precision)
        centre = -torch.cholesky_solve((jacobian.mT @ self.constant)[:, None], root)[:, 0]
        return root, centre, streams

    def _placed(self, u: Tensor) -> tuple[Tensor, Tensor, Tensor, list[Tensor]]:
        """Return z with the hidden weights of u, the output layer and other unknowns y, L, and the functions."""
        z = self.posterior.z.index_copy(1, self.hidden, u[None, : self.n_hidden])
        root, centre, streams = self._geometry(z)
        y = centre + torch.linalg.solve_triangular(root.mT, u[self.n_hidden :, None], upper=True)[:, 0]
        return z, y, root, streams

    def point(self, u: np.ndarray) -> Tensor:
        """Return z (1, n_z) at u."""
        z, y, _, _ = self._placed(torch.tensor(u, device=self.posterior.z.device))
        return self.posterior.residuals.with_heads(z, y[None])

    def density(self, u: Tensor) -> Tensor:
        """Return the log density at u, up to a constant."""
        residuals = self.posterior.residuals
        z, y, root, streams = self._placed(u)
        weights, rest = y[: self.n_output], y[None, self.n_output :]
        _, logs, offsets = residuals.split(torch.cat([z[:, : residuals.n_coefficients], rest], 1))
        sizes = [b.n_paths * stream.shape[-1] for b, stream in zip(residuals.blocks, streams, strict=True)]
        records = zip(residuals.blocks, streams, weights.split(sizes), strict=True)
        outputs = [b.response((stream @ own.reshape(b.n_paths, -1).mT)[None]) for b, stream, own in records]
        rows = residuals.rows(outputs, logs, offsets) / self.posterior.deviations
        squares = (rows**2).sum() + (weights**2).sum() + (u[: self.n_hidden] ** 2).sum()
        return -0.5 * squares - torch.log(root.diagonal()).sum()

    def value_and_slope(self, u: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the log density and its gradient (n,); minus infinity where they are not finite."""
        point = torch.tensor(u, dtype=torch.float64, device=self.posterior.z.device, requires_grad=True)
        try:
            with torch.enable_grad():
                value = self.density(point)
                gradient = np.asarray(torch.autograd.grad(value, point)[0].cpu())
        except torch.linalg.LinAlgError:
            return -np.inf, np.zeros_like(u)
        if not (torch.isfinite(value.detach()) and np.all(np.isfinite(gradient))):
            return -np.inf, np.zeros_like(u)
        return float(value.detach()), gradient
