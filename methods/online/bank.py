"""A compiled bank of Kalman filters of the joint state, with weights and their mixture.

The joint state is that of :class:`bench.DiscreteModel`. The members of a bank are filters by one of three rules
(:mod:`methods.kalman.core`): ``extended``, with Jacobians by automatic differentiation; ``unscented``; and
``square_root``, the extended filter that propagates a square root of the covariance.

Weights follow the likelihood of the innovations, with forgetting (A. E. Raftery, M. Karny, P. Ettler, Technometrics
52:52, 2010), or a Markov chain between members whose distributions are mixed before each prediction (interacting
multiple models: H. A. P. Blom, Y. Bar-Shalom, IEEE Trans. Automatic Control 33:780, 1988).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np

from bench import DiscreteModel, Layout
from methods.kalman.core import COVARIANCE, ROOT, Affine, SpreadForm, apply, mixture, regression

Rule = Literal["extended", "unscented", "square_root"]
MIXTURE_SHARE = 0.99
"""Total weight of the members that make the mixture's mean and covariance."""
LEAST_SHARE = 1e-3
"""Weight below which a member is left out of a mixed distribution, whose variance it would dominate."""
GATE = 6.0
"""A value further from its prediction than this many standard deviations is an outlier."""
FLOOR = -600.0
"""Least log-weight of a member, above underflow."""
LEAST_SPREAD = 1e-6
"""Least spread of the sigma points in any direction, relative to the largest standard deviation."""
WIDE = 4.0
"""Members whose predicted variance exceeds the least one by this factor do not decide on outliers."""
Outcome = np.void
"""Results of a step except the new state, a record with the fields of :attr:`Bank.outcome`."""


@dataclass(frozen=True)
class Bank:
    """Filters of a layout by one rule; ``mixes``: members interact by a Markov chain.

    The first axis of all arrays is the member: means (M, d), spreads (covariances or roots, M, d, d), log-weights (M,).
    """

    layout: Layout
    members: int
    rule: Rule = "extended"
    mixes: bool = False

    def functions(self) -> tuple[Any, Any]:
        """Return the compiled functions :meth:`step` (a sample) and :meth:`coast` (an interval without a sample)."""
        return _compiled(self)

    @cached_property
    def model(self) -> DiscreteModel:
        return DiscreteModel(self.layout)

    @cached_property
    def outcome(self) -> np.dtype[np.void]:
        """Return the record type of a step's results.

        ``mean``, ``covariance``: of the mixture. ``expected``, ``sd``: prediction of each sensor and its standard
        deviation. ``surprise``: normalised innovation of each value used. ``outlier``, ``finite``: 1 where some value
        is an outlier, and where all numbers are finite. ``excess``: mean squared normalised innovation minus 1.
        ``gained``: log-likelihood of each member. ``moves``: normalised updates of the log-parameters of the most
        likely member.
        """
        d, c, m = self.model.size, len(self.layout.sensors), self.members
        shapes = {
            "mean": (d,), "covariance": (d, d), "expected": (c,), "sd": (c,), "surprise": (c,), "outlier": (),
            "finite": (), "excess": (), "gained": (m,), "moves": (self.model.n_free,),
        }  # fmt: skip
        return np.dtype([(name, float, shape) for name, shape in shapes.items()])

    @property
    def form(self) -> SpreadForm:
        """Return the form of the spread: a covariance or a square root of it."""
        return ROOT if self.rule == "square_root" else COVARIANCE

    def _affine(self, function: Any, means: Any, spreads: Any) -> Affine:
        """Approximate a map of the joint state by an affine one about each member's distribution."""
        import jax
        import jax.numpy as jnp

        if self.rule == "unscented":
            return regression(jax.vmap(jax.vmap(function)), means, spreads, least=0.0, relative=LEAST_SPREAD)
        slopes, values = jax.vmap(jax.jacfwd(function))(means), jax.vmap(function)(means)
        return Affine(slopes, values - apply(slopes, means), jnp.zeros_like(values)[:, None])

    def coast(self, means: Any, spreads: Any, force: Any, interval: Any, noise: Any) -> tuple[Any, Any]:
        """Predict over an interval (s) without a sample.

        ``noise``: variances of the process noise of each member (M, d), and the autocorrelation of the unknown force.
        """
        walk, memory = noise
        affine = self._affine(lambda point: self.model.advance(point, force, interval, memory), means, spreads)
        return self.form.predict(affine, walk, means, spreads)

    def step(self, state: tuple[Any, Any, Any], sample: Any, constants: tuple[Any, Any, Any]) -> tuple[Any, Any]:
        """Predict to a sample and update by it.

        Args:
            state: Means, spreads, log-weights.
            sample: Concatenated values, their validity (1 or 0), known forces from this sample on, and known forces
                since the previous sample.
            constants: Sampling interval (s), process noise (see :meth:`coast`), and a triple of the variances of the
                sensors, the forgetting factor or transition matrix, and the gate (squared standard deviations).

        Returns:
            The state after the sample, and the record of :attr:`outcome`.
        """
        import jax
        import jax.numpy as jnp

        c, f, logs = self.model.n_sensors, len(self.model.layout.forced), self.model.logs
        values, there = sample[:c], sample[c : 2 * c] > 0
        force, before = sample[2 * c : 2 * c + f], sample[2 * c + f :]
        interval, noise, (variances, chain, gate) = constants
        means, spreads, weights = state
        if self.mixes:
            means, spreads, weights = self._mixed(means, spreads, weights, chain)
        start, spreads = self.coast(means, spreads, before, interval, noise)
        slopes, offsets, scatter = self._affine(lambda point: self.model.observe(point, force), start, spreads)
        covs, levels = self.form.covariance(spreads), variances + jnp.sum(scatter**2, axis=-2)
        shown = apply(slopes, start) + offsets
        diagonal = jnp.sum((slopes @ covs) * slopes, axis=-1) + levels
        share = jax.nn.softmax(weights)
        expected = share @ shown
        variance = share @ (diagonal + (shown - expected) ** 2)
        sure = (diagonal <= WIDE * jnp.min(diagonal, axis=0)) | self.mixes  # mixed members are wide by their rate
        off = jnp.min(jnp.where(sure, (values - shown) ** 2 / diagonal, jnp.inf), axis=0)
        outlier = there & (off > gate)
        used = there & ~outlier
        means, spreads, *_, gained = self.form.update(start, spreads, slopes, offsets, levels, values, used)
        after = self.form.covariance(spreads)
        learned = jnp.diagonal(covs - after, axis1=1, axis2=2)[:, logs]
        weights = (weights if self.mixes else chain * weights) + gained
        total = jax.scipy.special.logsumexp(weights)
        weights = jnp.maximum(weights - total, FLOOR)
        best = jnp.argmax(weights)
        moves = (means - start)[best, logs] / jnp.sqrt(jnp.maximum(learned[best], 1e-300))
        mean, cov = mixture(_dominant(jax.nn.softmax(weights)), means, after)
        sd = jnp.sqrt(variance)
        off = jnp.abs(values - expected) / sd
        excess = jnp.mean(jnp.where(there, jnp.minimum(off, GATE) ** 2 - 1.0, 0.0))
        finite = jnp.isfinite(total + jnp.sum(mean)) & (jnp.min(variance) > 0)
        row = [mean, cov.ravel(), expected, sd, jnp.where(used, off, 0.0)]
        row += [jnp.stack([1.0 * jnp.any(outlier), 1.0 * finite, excess]), gained, moves]
        return (means, spreads, weights), jnp.concatenate(row)

    def _mixed(self, means: Any, spreads: Any, weights: Any, chain: Any) -> tuple[Any, Any, Any]:
        """Mix the distributions of the members by the transition matrix ``chain[i, j]`` from i to j.

        Weights below :data:`LEAST_SHARE` are set to zero, so that the variance of a fast rate does not become process
        noise of constant parameters.
        """
        import jax
        import jax.numpy as jnp

        joint = jax.nn.softmax(weights)[:, None] * chain
        after = jnp.sum(joint, axis=0)
        share = (joint / after).T
        share = jnp.where(share >= LEAST_SHARE, share, 0.0)
        means, covs = mixture(share / jnp.sum(share, axis=1, keepdims=True), means, self.form.covariance(spreads))
        return means, self.form.spread(covs), jnp.log(after)


@lru_cache(maxsize=64)
def _compiled(bank: Bank) -> tuple[Any, Any]:
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_cpu_enable_async_dispatch", False)  # a step is shorter than the dispatch to a thread
    return jax.jit(bank.step), jax.jit(bank.coast)


def _dominant(share: Any) -> Any:
    """Return the weights of the fewest members with :data:`MIXTURE_SHARE` of the total, normalised to 1.

    Members with a hundredth of the weight hardly change a 95 % interval of the mixture, but may dominate its variance.
    """
    import jax.numpy as jnp

    larger = jnp.sum(jnp.where(share > share[:, None], share, 0.0), axis=1)
    kept = jnp.where(larger < MIXTURE_SHARE, share, 0.0)
    return kept / jnp.sum(kept)
