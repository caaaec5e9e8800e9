"""Kalman filters of the joint state, several side by side, compiled: weights and their mixture.

The joint state is that of :class:`bench.HeldModel`; each member of a bank is a filter with its own belief, by one of
three rules (:mod:`methods.kalman.core`): ``extended``, its tangents by automatic differentiation; ``unscented``; and
``square_root``, the extended filter that carries a root of the covariance.

Weights follow the likelihood of the innovations, with forgetting (A. E. Raftery, M. Karny, P. Ettler, Technometrics
52:52, 2010), or a Markov chain between members whose beliefs are mixed before each prediction (interacting multiple
models: H. A. P. Blom, Y. Bar-Shalom, IEEE Trans. Automatic Control 33:780, 1988).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np

from bench import HeldModel, Layout
from methods.kalman.core import Affine, apply, mixture, predict, predict_root, regression, update, update_root

Rule = Literal["extended", "unscented", "square_root"]
HELD = 0.99
FLOOR = -600.0
"""Least log-weight of a member: a number that can still be summed."""
LEAST_SPREAD = 1e-6
"""Of a belief's largest standard deviation: a direction of the unscented filter's points has at least this."""
WIDE = 4.0
"""A member that expects a value with so many times the variance of the surest may not explain it."""


@dataclass(frozen=True)
class Bank:
    """The compiled functions of a layout by one rule. ``mixes``: whether members interact by a Markov chain."""

    layout: Layout
    members: int
    rule: Rule = "extended"
    mixes: bool = False

    def functions(self) -> tuple[Any, Any]:
        """(step, coast), compiled: the one takes a sample, the other an interval without one."""
        return _functions(self)

    @cached_property
    def size(self) -> int:
        """Of the joint state."""
        return HeldModel(self.layout).size

    @cached_property
    def _places(self) -> tuple[int, ...]:
        """Where the parts of a row end: those of :class:`Told`, in their order."""
        d, c = self.size, len(self.layout.sensors)
        return tuple(itertools.accumulate((d, d * d, c, c, c, c, 1, self.members)))

    def told(self, row: np.ndarray) -> Told:
        """What a step tells, from the row of numbers that it hands out."""
        d, cov, expected, spread, surprise, outlier, total, gained = self._places
        return Told(
            row[:d], row[d:cov].reshape(d, d), row[cov:expected], row[expected:spread], row[spread:surprise],
            row[surprise:outlier] > 0,
            float(row[outlier]), row[total:gained], row[gained:].reshape(self.members, -1),
        )  # fmt: skip


class Told(NamedTuple):
    """What a step tells of a sample.

    Mean and covariance of the mixture; by sensor prediction, its variance, how many standard deviations a value is from
    it that was used, and which were taken for outliers; log-likelihood of the mixture and of each member; each member's
    normalised moves of the log-parameters.
    """

    mean: np.ndarray
    covariance: np.ndarray
    expected: np.ndarray
    spread: np.ndarray
    surprise: np.ndarray
    outlier: np.ndarray
    total: float
    gained: np.ndarray
    moves: np.ndarray


@lru_cache(maxsize=64)
def _functions(bank: Bank) -> tuple[Any, Any]:
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_cpu_enable_async_dispatch", False)  # a step is over sooner than a thread has taken it on
    members = _Members(bank)
    return jax.jit(members.step), jax.jit(members.coast)


class _Members:
    """What is compiled. Members lead: means (M, d), roots or covariances (M, d, d), log-weights (M,)."""

    def __init__(self, bank: Bank) -> None:
        self.model, self.rule, self.mixes = HeldModel(bank.layout), bank.rule, bank.mixes

    def _affine(self, function: Any, means: Any, spreads: Any) -> Affine:
        """A map of one joint state made affine about each member's belief, by the rule."""
        import jax
        import jax.numpy as jnp

        if self.rule == "unscented":
            return regression(jax.vmap(jax.vmap(function)), means, spreads, least=0.0, relative=LEAST_SPREAD)
        slopes, values = jax.vmap(jax.jacfwd(function))(means), jax.vmap(function)(means)
        return Affine(slopes, values - apply(slopes, means), jnp.zeros((*values.shape, values.shape[-1])))

    def coast(self, means: Any, spreads: Any, force: Any, interval: Any, noise: Any) -> tuple[Any, Any]:
        """An interval (s) on: beliefs before the next sample.

        ``noise``: variances of the process noise of each member (M, d), and what the unknown force keeps of itself.
        """
        import jax.numpy as jnp

        walk, memory = noise
        affine = self._affine(lambda point: self.model.advance(point, force, interval, memory), means, spreads)
        if self.rule == "square_root":
            return predict_root(affine, means, spreads, walk)
        return predict(affine._replace(error=affine.error + walk[..., None] * jnp.eye(self.model.size)), means, spreads)

    def step(self, state: tuple[Any, Any, Any], sample: Any, constants: tuple[Any, Any, Any]) -> tuple[Any, Any]:
        """From one sample to the next.

        Args:
            state: means, covariances or roots, log-weights.
            sample: values, which of them say something (1 or 0), told forces from now on, told forces since the sample
                before, one behind the other.
            constants: sampling interval (s), process noise (see :meth:`coast`), and the levels: variances of the
                sensors, forgetting or transition matrix, gate (squared standard deviations).

        Returns:
            The state after the sample, and :class:`Told` as one row.
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
        means, spreads = self.coast(means, spreads, before, interval, noise)
        slopes, offsets, error = self._affine(lambda point: self.model.observe(point, force), means, spreads)
        covs, levels = self._covariances(spreads), variances + jnp.diagonal(error, axis1=1, axis2=2)
        seen = apply(slopes, means) + offsets
        diagonal = jnp.sum((slopes @ covs) * slopes, axis=-1) + levels
        left = values - seen
        share = jnp.exp(weights - jax.scipy.special.logsumexp(weights))
        expected = share @ seen
        spread = share @ (diagonal + (seen - expected) ** 2)
        sure = (diagonal <= WIDE * jnp.min(diagonal, axis=0)) | self.mixes  # a fast rate is no hypothesis just opened
        outlier = there & (jnp.min(jnp.where(sure, left**2 / diagonal, jnp.inf), axis=0) > gate)
        used = there & ~outlier
        start, measured = means, (slopes, offsets, levels, values, used)
        if self.rule == "square_root":
            means, spreads, gained = update_root(means, spreads, *measured)
        else:
            means, spreads, *_, gained = update(means, spreads, *measured)
        after = self._covariances(spreads)
        learned = jnp.diagonal(covs - after, axis1=1, axis2=2)[:, logs]
        moves = (means - start)[:, logs] / jnp.sqrt(jnp.maximum(learned, 1e-300))
        weights = (weights if self.mixes else chain * weights) + gained
        total = jax.scipy.special.logsumexp(weights)
        weights = jnp.maximum(weights - total, FLOOR)
        share = jnp.exp(weights - jax.scipy.special.logsumexp(weights))
        mean, cov = mixture(_weighty(share), means, after)
        surprise = jnp.where(used, jnp.abs(values - expected) / jnp.sqrt(spread), 0.0)
        told = [mean, cov.ravel(), expected, spread, surprise, 1.0 * outlier, total[None], gained, moves.ravel()]
        return (means, spreads, weights), jnp.concatenate(told)

    def _covariances(self, spreads: Any) -> Any:
        return spreads @ spreads.swapaxes(1, 2) if self.rule == "square_root" else spreads

    def _mixed(self, means: Any, spreads: Any, weights: Any, chain: Any) -> tuple[Any, Any, Any]:
        """Beliefs of each member given where the chain may have come from; ``chain[i, j]`` from i to j."""
        import jax
        import jax.numpy as jnp

        share = jnp.exp(weights - jax.scipy.special.logsumexp(weights))
        joint = share[:, None] * chain
        after = jnp.sum(joint, axis=0)
        means, covs = jax.vmap(mixture, in_axes=(0, None, None))((joint / after).T, means, self._covariances(spreads))
        if self.rule == "square_root":
            covs = jnp.linalg.cholesky(covs + 1e-18 * jnp.eye(self.model.size))
        return means, covs, jnp.log(after)


def _weighty(share: Any) -> Any:
    """The shares of the fewest members that hold :data:`HELD` of the weight, which sum to 1.

    A 95 % interval of a mixture does not show what has a hundredth of the weight; a variance is made of it.
    """
    import jax.numpy as jnp

    largest = jnp.sort(share)[::-1]
    least = largest[jnp.searchsorted(jnp.cumsum(largest), HELD)]
    kept = jnp.where(share >= least, share, 0.0)
    return kept / jnp.sum(kept)
