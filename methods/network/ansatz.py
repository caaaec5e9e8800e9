"""Ansatz functions x(t) with trainable coefficients, and products with their Jacobian for the optimisers.

Every tensor has a leading axis over fits (B). The value and the first two time derivatives of a function are its
*streams*, (B, 3, n_points, n_paths). A *row* is a scalar ``sum(seeds[:, :, k] * streams[:, :, points[k]])`` of the
streams at one point. One reverse pass gives the adjoints of all rows, and these the Jacobian of the rows by the
coefficients, its Gram matrix, or its transpose times a vector.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor


@dataclass
class Tape:
    """Intermediate results of a forward pass for the adjoint.

    ``inputs[l]`` (B, 3, n_points, n_in): streams into layer l. ``slopes[l]`` (B, n_points, width): derivative of tanh
    in hidden layer l. ``output`` (B, 3, n_points, n_paths).
    """

    inputs: list[Tensor]
    slopes: list[Tensor]
    output: Tensor


RANK = 1e-12
"""Least singular value over the largest; combinations of functions below it are rounding errors."""

Adjoints = list[Tensor]
"""Adjoints of the linear part of each layer, (B, 3, n_rows, n_out) each."""


class Ansatz(ABC):
    """A function of time at fixed points. ``count`` is the number of its coefficients."""

    count: int
    local: bool = False
    """True where the Jacobian is banded: each row depends on few, neighbouring coefficients."""

    @abstractmethod
    def forward(self, theta: Tensor) -> Tape:
        """Compute the streams at the points for coefficients (B, count)."""

    @abstractmethod
    def adjoint(self, theta: Tensor, tape: Tape, seeds: Tensor, points: Tensor | None = None) -> Adjoints:
        """Compute adjoints of rows with seeds (B, 3, n_rows, n_paths) at points (n_rows,); None: a row per point."""

    @abstractmethod
    def pull_back(self, tape: Tape, adjoints: Adjoints, points: Tensor | None, dual: Tensor | None = None) -> Tensor:
        """Compute ``Jᵀ dual``, (B, count), for ``dual`` (B, n_rows); None means all ones."""

    @abstractmethod
    def jacobian(self, tape: Tape, adjoints: Adjoints, points: Tensor, rows: slice = slice(None)) -> Tensor:
        """Compute the given rows of J, (B, n_rows, count)."""

    def gram(self, tape: Tape, adjoints: Adjoints, points: Tensor) -> Tensor:
        """Compute ``J Jᵀ``, (B, n_rows, n_rows)."""
        j = self.jacobian(tape, adjoints, points)
        return j @ j.mT

    def mixed(self, theta: Tensor) -> Tensor:
        """Return the coefficients of a :class:`MixedAnsatz` for those of its inner ansatz; unchanged for others."""
        return theta

    def unmixed(self, theta: Tensor) -> Tensor:
        """Return the coefficients of the inner ansatz of a :class:`MixedAnsatz`; unchanged for others."""
        return theta

    @abstractmethod
    def take(self, who: Tensor) -> Ansatz:
        """Return the ansatz of the fits with indices ``who``."""

    def head(self, theta: Tensor) -> tuple[Any, Tensor]:
        """Return the last, linear layer as an ansatz, with its coefficients; the whole ansatz where it is linear."""
        return self, theta

    def with_head(self, theta: Tensor, coefficients: Tensor) -> Tensor:
        """Return the coefficients with the last layer replaced."""
        return coefficients


@dataclass
class Basis(Ansatz):
    """A linear combination of fixed functions with given streams (B, 3, n_points, n_functions).

    The coefficients are ordered by path.
    """

    functions: Tensor
    n_paths: int

    def __post_init__(self) -> None:
        self.count = self.n_paths * self.functions.shape[-1]

    def forward(self, theta: Tensor) -> Tape:
        coefficients = theta.unflatten(1, (self.n_paths, -1))
        return Tape([self.functions], [], self.functions @ coefficients.mT[:, None])

    def adjoint(self, theta: Tensor, tape: Tape, seeds: Tensor, points: Tensor | None = None) -> Adjoints:
        return [seeds]

    def pull_back(self, tape: Tape, adjoints: Adjoints, points: Tensor | None, dual: Tensor | None = None) -> Tensor:
        seeds = adjoints[0] if dual is None else adjoints[0] * dual[:, None, :, None]
        functions = self.functions if points is None else self.functions[:, :, points]
        return (seeds.flatten(1, 2).mT @ functions.flatten(1, 2)).flatten(1)

    def jacobian(self, tape: Tape, adjoints: Adjoints, points: Tensor, rows: slice = slice(None)) -> Tensor:
        at_rows = self.functions[:, :, points[rows]]
        return torch.einsum("bsro,bsrk->brok", adjoints[0][:, :, rows], at_rows).flatten(2)

    def take(self, who: Tensor) -> Basis:
        return replace(self, functions=self.functions[who])

    def dense(self) -> Basis:
        """Return this basis."""
        return self


@dataclass
class MixedAnsatz(Ansatz):
    """A linear ``inner`` ansatz with coefficients ``mixing @ theta``; ``weights`` is the inverse of ``mixing``."""

    inner: Ansatz
    mixing: Tensor
    weights: Tensor

    def __post_init__(self) -> None:
        self.count = self.mixing.shape[2]

    @staticmethod
    def of(inner: Ansatz, jacobian: Tensor) -> MixedAnsatz:
        """Mix the coefficients so that a Jacobian (B, n_rows, count) becomes orthonormal.

        Combinations with a singular value below :data:`RANK` of the largest are left out.
        """
        _, sizes, axes = torch.linalg.svd(torch.linalg.qr(jacobian, mode="r")[1], full_matrices=False)
        inverse = torch.where(sizes < RANK * sizes[:, :1], 0.0, 1.0 / sizes)
        return MixedAnsatz(inner, axes.mT * inverse[:, None], sizes[..., None] * axes)

    def mixed(self, theta: Tensor) -> Tensor:
        return (self.weights @ theta[..., None])[..., 0]

    def unmixed(self, theta: Tensor) -> Tensor:
        return (self.mixing @ theta[..., None])[..., 0]

    def forward(self, theta: Tensor) -> Tape:
        return self.inner.forward(self.unmixed(theta))

    def adjoint(self, theta: Tensor, tape: Tape, seeds: Tensor, points: Tensor | None = None) -> Adjoints:
        return self.inner.adjoint(self.unmixed(theta), tape, seeds, points)

    def pull_back(self, tape: Tape, adjoints: Adjoints, points: Tensor | None, dual: Tensor | None = None) -> Tensor:
        return (self.inner.pull_back(tape, adjoints, points, dual)[:, None] @ self.mixing)[:, 0]

    def jacobian(self, tape: Tape, adjoints: Adjoints, points: Tensor, rows: slice = slice(None)) -> Tensor:
        return self.inner.jacobian(tape, adjoints, points, rows) @ self.mixing

    def take(self, who: Tensor) -> MixedAnsatz:
        return MixedAnsatz(self.inner.take(who), self.mixing[who], self.weights[who])


@dataclass
class Local(Ansatz):
    """A linear combination of ``n_functions`` fixed functions of local support, such as B-splines.

    ``values`` (B, 3, n_points, n_local): streams of the functions from index ``first`` (B, n_points) on.
    """

    values: Tensor
    first: Tensor
    n_functions: int
    n_paths: int
    local = True

    def __post_init__(self) -> None:
        self.count = self.n_paths * self.n_functions

    def _places(self, points: Tensor | None) -> Tensor:
        """Return the indices (B, n_rows, n_local) of the functions at points."""
        first = self.first if points is None else self.first[:, points]
        return first[..., None] + torch.arange(self.values.shape[-1], device=first.device)

    def forward(self, theta: Tensor) -> Tape:
        coefficients, places = theta.unflatten(1, (self.n_paths, -1)), self._places(None)
        by_path = [path.gather(1, places.flatten(1)).view(places.shape) for path in coefficients.unbind(1)]
        return Tape([], [], torch.stack([(self.values * part[:, None]).sum(3) for part in by_path], 3))

    def adjoint(self, theta: Tensor, tape: Tape, seeds: Tensor, points: Tensor | None = None) -> Adjoints:
        return [seeds]

    def slopes(self, seeds: Tensor, points: Tensor | None) -> Tensor:
        """Return the slopes of rows by the coefficients that they depend on, (B, n_rows, n_paths, n_local)."""
        return torch.einsum("bsro,bsrk->brok", seeds, self.values if points is None else self.values[:, :, points])

    def pull_back(self, tape: Tape, adjoints: Adjoints, points: Tensor | None, dual: Tensor | None = None) -> Tensor:
        seeds = adjoints[0] if dual is None else adjoints[0] * dual[:, None, :, None]
        slopes, places = self.slopes(seeds, points), self._places(points).flatten(1)
        total = seeds.new_zeros(seeds.shape[0], self.n_paths, self.n_functions)
        for path in range(self.n_paths):
            total[:, path].scatter_add_(1, places, slopes[:, :, path].flatten(1))
        return total.flatten(1)

    def jacobian(self, tape: Tape, adjoints: Adjoints, points: Tensor, rows: slice = slice(None)) -> Tensor:
        slopes, places = self.slopes(adjoints[0][:, :, rows], points[rows]), self._places(points[rows])
        j = slopes.new_zeros(*slopes.shape[:3], self.n_functions)
        return j.scatter_(3, places[:, :, None].expand_as(slopes), slopes).flatten(2)

    def take(self, who: Tensor) -> Local:
        return replace(self, values=self.values[who], first=self.first[who])

    def dense(self) -> Basis:
        """Return the same functions without the local storage."""
        places = self._places(None)[:, None].expand_as(self.values)
        whole = self.values.new_zeros(*self.values.shape[:3], self.n_functions).scatter_(3, places, self.values)
        return Basis(whole, self.n_paths)


@dataclass
class SumAnsatz(Ansatz):
    """The sum of a trainable ansatz and a linear combination of fixed functions, with coefficients in that order."""

    inner: Ansatz
    fixed: Basis

    def __post_init__(self) -> None:
        self.count = self.inner.count + self.fixed.count

    def _split(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        return theta[:, : self.inner.count], theta[:, self.inner.count :]

    def forward(self, theta: Tensor) -> Tape:
        trainable, rest = self._split(theta)
        tape, added = self.inner.forward(trainable), self.fixed.forward(rest)
        return Tape([*tape.inputs, *added.inputs], tape.slopes, tape.output + added.output)

    @staticmethod
    def _inner(tape: Tape) -> Tape:
        return replace(tape, inputs=tape.inputs[:-1])

    def adjoint(self, theta: Tensor, tape: Tape, seeds: Tensor, points: Tensor | None = None) -> Adjoints:
        return [*self.inner.adjoint(self._split(theta)[0], self._inner(tape), seeds, points), seeds]

    def gram(self, tape: Tape, adjoints: Adjoints, points: Tensor) -> Tensor:
        gram = self.inner.gram(self._inner(tape), adjoints[:-1], points)
        return gram + self.fixed.gram(tape, adjoints[-1:], points)

    def pull_back(self, tape: Tape, adjoints: Adjoints, points: Tensor | None, dual: Tensor | None = None) -> Tensor:
        trainable = self.inner.pull_back(self._inner(tape), adjoints[:-1], points, dual)
        return torch.cat([trainable, self.fixed.pull_back(tape, adjoints[-1:], points, dual)], 1)

    def jacobian(self, tape: Tape, adjoints: Adjoints, points: Tensor, rows: slice = slice(None)) -> Tensor:
        trainable = self.inner.jacobian(self._inner(tape), adjoints[:-1], points, rows)
        return torch.cat([trainable, self.fixed.jacobian(tape, adjoints[-1:], points, rows)], 2)

    def take(self, who: Tensor) -> SumAnsatz:
        return SumAnsatz(self.inner.take(who), self.fixed.take(who))

    def head(self, theta: Tensor) -> tuple[Basis, Tensor]:
        trainable, rest = self._split(theta)
        whole, coefficients = self.inner.head(trainable)
        basis = whole.dense()
        both = [part.unflatten(1, (basis.n_paths, -1)) for part in (coefficients, rest)]
        functions = torch.cat([basis.functions, self.fixed.functions], 3)
        return Basis(functions, basis.n_paths), torch.cat(both, 2).flatten(1)

    def with_head(self, theta: Tensor, coefficients: Tensor) -> Tensor:
        trainable, _ = self._split(theta)
        by_dof = coefficients.unflatten(1, (self.fixed.n_paths, -1))
        added = self.fixed.functions.shape[-1]
        inner = self.inner.with_head(trainable, by_dof[..., :-added].flatten(1))
        return torch.cat([inner, by_dof[..., -added:].flatten(1)], 1)
