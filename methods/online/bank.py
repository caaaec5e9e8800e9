"""Kalman filters of the joint state, several side by side, compiled: weights and their mixture.

The joint state is that of :class:`bench.DiscreteModel`; each member of a bank is a filter with its own distribution, by
one of three rules (:mod:`methods.kalman.core`): ``extended``, its tangents by automatic differentiation; ``unscented``;
and ``square_root``, the extended filter that carries a root of the covariance.

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
HELD = 0.99
LEAST_SHARE = 1e-3
"""Least weight of a member of the mixture; a normal cannot represent a component that is wide and this improbable."""
GATE = 6.0
"""Standard deviations from its prediction beyond which a value is an outlier."""
FLOOR = -600.0
"""Least log-weight of a member: a number that can still be summed."""
LEAST_SPREAD = 1e-6
"""Of a distribution's largest standard deviation: a direction of the unscented filter's points has at least this."""
WIDE = 4.0
"""A member that expects a value with so many times the variance of the surest may not explain it."""
Outcome = np.void
"""Results of a step beside the new state, by the names of :attr:`Bank.outcome`."""


@dataclass(frozen=True)
class Bank:
    """Filters of a layout by one rule. ``mixes``: whether members interact by a Markov chain.

    Members lead in all arrays: means (M, d), spreads (covariances, or roots) (M, d, d), log-weights (M,).
    """

    layout: Layout
    members: int
    rule: Rule = "extended"
    mixes: bool = False

    def functions(self) -> tuple[Any, Any]:
        """(step, coast), compiled: the one takes a sample, the other an interval without one."""
        return _compiled(self)

    @cached_property
    def model(self) -> DiscreteModel:
        return DiscreteModel(self.layout)

    @cached_property
    def outcome(self) -> np.dtype[np.void]:
        """The row that a step gives.

        Mean and covariance of the mixture; by sensor prediction, its standard deviation, and how many of them a value
        is from it that was used; whether (1 or 0) some value was taken for an outlier and whether all numbers are
        finite; by how much the mean of the squared normalised innovations is above 1; log-likelihood of each member;
        the likeliest member's normalised moves of the log-parameters.
        """
        d, c, m = self.model.size, len(self.layout.sensors), self.members
        shapes = {
            "mean": (d,), "covariance": (d, d), "expected": (c,), "sd": (c,), "surprise": (c,), "outlier": (),
            "finite": (), "excess": (), "gained": (m,), "moves": (self.model.n_free,),
        }  # fmt: skip
        return np.dtype([(name, float, shape) for name, shape in shapes.items()])

    @property
    def form(self) -> SpreadForm:
        """Return the form of the spread: a covariance or a root of it."""
        return ROOT if self.rule == "square_root" else COVARIANCE

    def _affine(self, function: Any, means: Any, spreads: Any) -> Affine:
        """A map of one joint state made affine about each member's distribution, by the rule."""
        import jax
        import jax.numpy as jnp

        if self.rule == "unscented":
            return regression(jax.vmap(jax.vmap(function)), means, spreads, least=0.0, relative=LEAST_SPREAD)
        slopes, values = jax.vmap(jax.jacfwd(function))(means), jax.vmap(function)(means)
        return Affine(slopes, values - apply(slopes, means), jnp.zeros_like(values)[:, None])

    def coast(self, means: Any, spreads: Any, force: Any, interval: Any, noise: Any) -> tuple[Any, Any]:
        """Carry distributions an interval (s) on, to before the next sample.

        ``noise``: variances of the process noise of each member (M, d), and what the unknown force keeps of itself.
        """
        walk, memory = noise
        affine = self._affine(lambda point: self.model.advance(point, force, interval, memory), means, spreads)
        return self.form.predict(affine, walk, means, spreads)

    def step(self, state: tuple[Any, Any, Any], sample: Any, constants: tuple[Any, Any, Any]) -> tuple[Any, Any]:
        """Go from one sample to the next.

        Args:
            state: means, spreads, log-weights.
            sample: values, which of them say something (1 or 0), known forces from now on, known forces since the
                sample before, one behind the other.
            constants: sampling interval (s), process noise (see :meth:`coast`), and the levels: variances of the
                sensors, forgetting or transition matrix, gate (squared standard deviations).

        Returns:
            The state after the sample, and the row of :attr:`outcome`.
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
        sure = (diagonal <= WIDE * jnp.min(diagonal, axis=0)) | self.mixes  # a fast rate is no hypothesis just opened
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
        mean, cov = mixture(_weighty(jax.nn.softmax(weights)), means, after)
        sd = jnp.sqrt(variance)
        off = jnp.abs(values - expected) / sd
        excess = jnp.mean(jnp.where(there, jnp.minimum(off, GATE) ** 2 - 1.0, 0.0))
        finite = jnp.isfinite(total + jnp.sum(mean)) & (jnp.min(variance) > 0)
        row = [mean, cov.ravel(), expected, sd, jnp.where(used, off, 0.0)]
        row += [jnp.stack([1.0 * jnp.any(outlier), 1.0 * finite, excess]), gained, moves]
        return (means, spreads, weights), jnp.concatenate(row)

    def _mixed(self, means: Any, spreads: Any, weights: Any, chain: Any) -> tuple[Any, Any, Any]:
        """Distributions of each member given where the chain may have come from; ``chain[i, j]`` from i to j.

        A member's share below :data:`LEAST_SHARE` is left out: the variance of a fast rate, however rare, would else
        be process noise of the constant parameters.
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
    jax.config.update("jax_cpu_enable_async_dispatch", False)  # a step is over sooner than a thread has taken it on
    return jax.jit(bank.step), jax.jit(bank.coast)


def _weighty(share: Any) -> Any:
    """The shares of the fewest members that hold :data:`HELD` of the weight, which sum to 1.

    A 95 % interval of a mixture does not show what has a hundredth of the weight; a variance is made of it.
    """
    import jax.numpy as jnp

    larger = jnp.sum(jnp.where(share > share[:, None], share, 0.0), axis=1)
    kept = jnp.where(larger < HELD, share, 0.0)
    return kept / jnp.sum(kept)
