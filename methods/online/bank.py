"""Kalman filters of the joint state, several side by side, compiled: prediction, update, weights and their mixture.

The joint state is that of :class:`bench.HeldModel`; each member of a bank is a filter with its own belief. Three rules:

- ``extended``: maps replaced by their tangents at the mean, by automatic differentiation; Joseph's form of the update.
- ``unscented``: mean and covariance of the maps at ``2 d`` points of equal weight, ``sqrt(d)`` standard deviations off
  (the cubature rule: I. Arasaratnam, S. Haykin, IEEE Trans. Automatic Control 54:1254, 2009).
- ``square_root``: the extended filter, carrying a root of the covariance by orthogonal triangularisation (P. Kaminski,
  A. Bryson, S. Schmidt, IEEE Trans. Automatic Control 16:727, 1971).

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

Rule = Literal["extended", "unscented", "square_root"]
HELD = 0.99
FLOOR = -600.0
"""Least log-weight of a member: a number that can still be summed."""
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

    def coast(self, means: Any, spreads: Any, force: Any, interval: Any, noise: Any) -> tuple[Any, Any]:
        """An interval (s) on: beliefs before the next sample.

        ``noise``: variances of the process noise of each member (M, d), and what the unknown force keeps of itself.
        """
        import jax

        walk, memory = noise
        predict = {"extended": self._extended, "unscented": self._unscented, "square_root": self._rooted}[self.rule]
        return jax.vmap(predict, in_axes=(0, 0, 0, None, None, None))(means, spreads, walk, force, interval, memory)

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

        c, f = self.model.n_sensors, len(self.model.layout.forced)
        values, there = sample[:c], sample[c : 2 * c] > 0
        force, before = sample[2 * c : 2 * c + f], sample[2 * c + f :]
        interval, noise, (variances, chain, gate) = constants
        means, spreads, weights = state
        if self.mixes:
            means, spreads, weights = self._mixed(means, spreads, weights, chain)
        means, spreads = self.coast(means, spreads, before, interval, noise)
        seen, slopes, extra = jax.vmap(self._observed, in_axes=(0, 0, None))(means, spreads, force)
        covs = self._covariances(spreads)
        diagonal = jnp.einsum("mij,mjk,mik->mi", slopes, covs, slopes) + extra + variances
        left = values - seen
        share = jnp.exp(weights - jax.scipy.special.logsumexp(weights))
        expected = share @ seen
        spread = share @ (diagonal + (seen - expected) ** 2)
        sure = (diagonal <= WIDE * jnp.min(diagonal, axis=0)) | self.mixes  # a fast rate is no hypothesis just opened
        outlier = there & (jnp.min(jnp.where(sure, left**2 / diagonal, jnp.inf), axis=0) > gate)
        used = there & ~outlier
        means, spreads, gained, moves = jax.vmap(self._updated, in_axes=(0, 0, 0, 0, 0, None, None))(
            means, spreads, jnp.where(used, left, 0.0), slopes, extra, used, variances
        )
        weights = (weights if self.mixes else chain * weights) + gained
        total = jax.scipy.special.logsumexp(weights)
        weights = jnp.maximum(weights - total, FLOOR)
        share = jnp.exp(weights - jax.scipy.special.logsumexp(weights))
        mean, cov = _mixture(_weighty(share), means, self._covariances(spreads))
        surprise = jnp.where(used, jnp.abs(values - expected) / jnp.sqrt(spread), 0.0)
        told = [mean, cov.ravel(), expected, spread, surprise, 1.0 * outlier, total[None], gained, moves.ravel()]
        return (means, spreads, weights), jnp.concatenate(told)

    def _covariances(self, spreads: Any) -> Any:
        import jax.numpy as jnp

        return jnp.einsum("mij,mkj->mik", spreads, spreads) if self.rule == "square_root" else spreads

    def _mixed(self, means: Any, spreads: Any, weights: Any, chain: Any) -> tuple[Any, Any, Any]:
        """Beliefs of each member given where the chain may have come from; ``chain[i, j]`` from i to j."""
        import jax
        import jax.numpy as jnp

        share = jnp.exp(weights - jax.scipy.special.logsumexp(weights))
        joint = share[:, None] * chain
        after = jnp.sum(joint, axis=0)
        given = (joint / after).T
        mixed = jax.vmap(_mixture, in_axes=(0, None, None))(given, means, self._covariances(spreads))
        covs = (
            jnp.linalg.cholesky(mixed[1] + 1e-18 * jnp.eye(self.model.size)) if self.rule == "square_root" else mixed[1]
        )
        return mixed[0], covs, jnp.log(after)

    # -------------------------------------------------------------------------------------------- prediction by rule

    def _extended(self, mean: Any, cov: Any, walk: Any, force: Any, h: Any, memory: Any) -> Any:
        import jax
        import jax.numpy as jnp

        f = jax.jacfwd(self.model.advance)(mean, force, h, memory)
        return self.model.advance(mean, force, h, memory), f @ cov @ f.T + jnp.diag(walk)

    def _unscented(self, mean: Any, cov: Any, walk: Any, force: Any, h: Any, memory: Any) -> Any:
        import jax
        import jax.numpy as jnp

        moved = jax.vmap(lambda point: self.model.advance(point, force, h, memory))(_points(mean, cov))
        new = jnp.mean(moved, axis=0)
        off = moved - new
        return new, off.T @ off / len(moved) + jnp.diag(walk)

    def _rooted(self, mean: Any, root: Any, walk: Any, force: Any, h: Any, memory: Any) -> Any:
        import jax
        import jax.numpy as jnp

        f = jax.jacfwd(self.model.advance)(mean, force, h, memory)
        wide = jnp.concatenate([f @ root, jnp.diag(jnp.sqrt(walk))], axis=1)
        return self.model.advance(mean, force, h, memory), jnp.linalg.qr(wide.T, mode="r").T

    # ------------------------------------------------------------------------------------------- measurement by rule

    def _observed(self, mean: Any, spread: Any, force: Any) -> tuple[Any, Any, Any]:
        """What is expected, its slopes, and the variance of what the slopes leave out, by sensor."""
        import jax
        import jax.numpy as jnp

        if self.rule != "unscented":
            slopes = jax.jacfwd(self.model.observe)(mean, force)
            return self.model.observe(mean, force), slopes, jnp.zeros(self.model.n_sensors)
        points = _points(mean, spread)
        seen = jax.vmap(lambda point: self.model.observe(point, force))(points)
        expected = jnp.mean(seen, axis=0)
        off, moved = seen - expected, points - mean
        values, axes = jnp.linalg.eigh(spread)
        known = jnp.where(values > 1e-12 * values[-1], 1.0 / jnp.maximum(values, 1e-300), 0.0)
        slopes = (axes * known @ axes.T @ (moved.T @ off / points.shape[0])).T
        return expected, slopes, jnp.mean((off - moved @ slopes.T) ** 2, axis=0)

    def _updated(
        self, mean: Any, spread: Any, left: Any, slopes: Any, extra: Any, used: Any, variances: Any
    ) -> tuple[Any, Any, Any, Any]:
        """Mean and spread after the used values, their log-likelihood, and normalised moves of the log-parameters.

        The sensors' noises are independent, so their values are taken one by one, and nothing is inverted.
        """
        import jax.numpy as jnp

        begun, gained, rooted = mean, 0.0, self.rule == "square_root"
        before = spread @ spread.T if rooted else spread
        for i in range(self.model.n_sensors):
            h, r = slopes[i] * used[i], variances[i] + extra[i]
            seen = spread.T @ h if rooted else h
            cross = spread @ seen
            s = (seen @ seen if rooted else h @ cross) + r
            gain = cross / s
            off = left[i] - h @ (mean - begun)
            gained = gained - jnp.where(used[i], 0.5 * (off**2 / s + jnp.log(2.0 * jnp.pi * s)), 0.0)  # type: ignore[assignment]
            mean = mean + gain * off
            if rooted:  # Potter's form
                spread = spread - jnp.outer(gain / (1.0 + jnp.sqrt(r / s)), seen)
            else:
                keep = jnp.eye(mean.size) - jnp.outer(gain, h)
                spread = keep @ spread @ keep.T + r * used[i] * jnp.outer(gain, gain)
        logs = self.model.logs
        after = jnp.sum(spread[logs] ** 2, axis=1) if rooted else jnp.diagonal(spread)[logs]
        told = jnp.maximum(jnp.diagonal(before)[logs] - after, 1e-300)
        return mean, spread, gained, (mean - begun)[logs] / jnp.sqrt(told)


def _points(mean: Any, cov: Any) -> Any:
    """The points of the cubature rule, (2 d, d); a direction that is certain has none off the mean."""
    import jax.numpy as jnp

    values, axes = jnp.linalg.eigh(cov)
    moves = (axes * jnp.sqrt(jnp.maximum(values, 0.0) * mean.size)).T
    return jnp.concatenate([mean + moves, mean - moves])


def _weighty(share: Any) -> Any:
    """The shares of the fewest members that hold :data:`HELD` of the weight, which sum to 1.

    A 95 % interval of a mixture does not show what has a hundredth of the weight; a variance is made of it.
    """
    import jax.numpy as jnp

    largest = jnp.sort(share)[::-1]
    least = largest[jnp.searchsorted(jnp.cumsum(largest), HELD)]
    kept = jnp.where(share >= least, share, 0.0)
    return kept / jnp.sum(kept)


def _mixture(share: Any, means: Any, covs: Any) -> tuple[Any, Any]:
    """Mean and covariance of a mixture."""
    import jax.numpy as jnp

    mean = share @ means
    off = means - mean
    return mean, jnp.einsum("m,mij->ij", share, covs + off[:, :, None] * off[:, None])
