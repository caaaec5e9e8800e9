"""How the rows of the loss are weighed against each other, and how these weights change during training.

Except for ``noise``, which knows what each row's standard deviation should be, the terms are mean squares of numbers
without dimension: data over their root mean square, the equation of motion over the acceleration of a wave of that size
and of the scan's frequency, a told start likewise, and the prior in its standard deviations (:data:`PRIOR` of it, for
the paper's is mild). A weight w of a row stands in the loss as ``w r²``, so the row's standard deviation is divided by
its root.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from methods.pinn.residuals import TERMS, Residuals, State

PRIOR = 1e-3
"""Weight of the mean square of the prior's term where no noise is estimated."""
DATA, PHYSICS, START, BELIEF = range(len(TERMS))


@dataclass
class Sizes:
    """What weights are made of: the deviations (1, n_rows) that take the dimension off, and by the estimated noise.

    ``by_noise`` gives those at the present estimate of the noise; ``softness`` multiplies the physics' there.
    """

    plain: Tensor
    by_noise: Callable[[float], Tensor]


class Weighting(ABC):
    """Gives every row a standard deviation; ``every`` so many gradients it may change them (0: never).

    ``shift`` (1, n_rows), if any, is added to the rows.
    """

    every = 0
    shift: Tensor | None = None

    def __init__(self, sizes: Sizes, residuals: Residuals) -> None:
        self.sizes = sizes
        self.members = residuals.term_rows.T.bool()  # (4, n_rows)
        self.counts = residuals.term_rows.sum(0).clamp(min=1.0)
        self.present = residuals.term_rows.sum(0) > 0
        self.weights = torch.ones(len(TERMS), dtype=torch.float64)
        self.weights[BELIEF] = PRIOR
        self.deviations = self.scaled()

    def scaled(self, rows: Tensor | None = None) -> Tensor:
        """Deviations for the weights of the terms, and of the rows (n_rows,) besides."""
        by_row = (self.weights / self.counts) @ self.members.to(torch.float64)
        if rows is not None:
            by_row = by_row * rows
        return self.sizes.plain * by_row.clamp(min=1e-30).rsqrt()

    def begin(self, softness: float) -> None:
        """A stage begins: the noise is known better, and the physics may be asked for softly at first."""
        return  # most know no noise

    def squares(self, rows: Tensor) -> Tensor:
        """Mean square (4,) of each term without dimension, from plain rows (n_rows,)."""
        own = (rows / self.sizes.plain[0]) ** 2
        return (self.members.to(torch.float64) @ own) / self.counts

    @abstractmethod
    def update(self, residuals: Residuals, state: State) -> None:
        """Change the weights, from a state whose rows are divided by ``deviations``."""

    def plain_rows(self, state: State) -> Tensor:
        """The residual vector (n_rows,) as it is, without shift or weights."""
        rows = (state.rows * self.deviations)[0]
        return rows if self.shift is None else rows - self.shift[0]


class Noise(Weighting):
    """Minus the log posterior at the noise that the residuals of earlier stages show; the physics nearly hard."""

    def begin(self, softness: float) -> None:
        self.deviations = self.sizes.by_noise(softness)

    def update(self, residuals: Residuals, state: State) -> None:
        """Nothing: the noise is estimated between stages."""


class Paper(Weighting):
    """Fixed weights, all one: "selected empirically" is all that the paper says of its own."""

    def update(self, residuals: Residuals, state: State) -> None:
        """Nothing."""


class _Gradients(Weighting):
    """Weights from the gradients of the terms by the coefficients."""

    def norms(self, residuals: Residuals, state: State) -> Tensor:
        """Norm (4,) of the gradient of each term's mean square by all unknowns."""
        found = torch.zeros(len(TERMS), dtype=torch.float64)
        linear = residuals.linearise(state, self.deviations)
        ones = self.sizes.plain
        for term in range(len(TERMS)):
            if self.present[term]:
                # d/dz of mean (r/size)²: rows of J are divided by the deviations, so these are multiplied in again
                dual = 2.0 * self.members[term] * self.plain_rows(state) * self.deviations[0] / ones[0] ** 2
                found[term] = residuals.pull_back(state, linear, dual[None] / self.counts[term]).norm()
        return found


class GradientNorms(_Gradients):
    """Terms have gradients of equal length: S. Wang, Y. Teng and P. Perdikaris, SIAM J. Sci. Comput. 43:A3055, 2021.

    With their moving average of 0.9, in the form of S. Wang et al., arXiv:2308.08468 (norms instead of largest and
    mean entry). The prior keeps its weight.
    """

    every = 100

    def update(self, residuals: Residuals, state: State) -> None:
        norms = self.norms(residuals, state)
        used = self.present.clone()
        used[BELIEF] = False
        wanted = norms[used].sum() / norms[used].clamp(min=1e-12)
        self.weights[used] = 0.9 * self.weights[used] + 0.1 * wanted
        self.deviations = self.scaled()


class TangentKernel(_Gradients):
    """Terms have equal traces of the neural tangent kernel: S. Wang, X. Yu and P. Perdikaris, JCP 449:110768, 2022."""

    every = 100

    def update(self, residuals: Residuals, state: State) -> None:
        linear = residuals.linearise(state, self.deviations)
        squared = (
            residuals.gram(state, linear).diagonal(dim1=1, dim2=2)[0] * (self.deviations / self.sizes.plain)[0] ** 2
        )
        traces = (self.members.to(torch.float64) @ squared) / self.counts
        used = self.present.clone()
        used[BELIEF] = False
        self.weights[used] = traces[used].sum() / traces[used].clamp(min=1e-12)
        self.deviations = self.scaled()


class ReLoBRaLo(Weighting):
    """Relative loss balancing with random lookback: R. Bischof and M. Kraus, arXiv:2110.09813, 2021.

    Temperature 0.1, decay 0.99 (that of the published code for short runs), expected lookback 0.999. The lookback is
    drawn from a generator of its own.
    """

    every = 1
    temperature, decay, lookback = 0.1, 0.99, 0.999

    def __init__(self, sizes: Sizes, residuals: Residuals) -> None:
        super().__init__(sizes, residuals)
        self.first: Tensor | None = None
        self.last = torch.ones(len(TERMS), dtype=torch.float64)
        self.generator = torch.Generator().manual_seed(0)

    def update(self, residuals: Residuals, state: State) -> None:
        used = self.present.clone()
        used[BELIEF] = False
        losses = self.squares(self.plain_rows(state))[used].clamp(min=1e-30)
        if self.first is None:
            self.first = self.last = losses
        back = float(torch.rand((), generator=self.generator)) < self.lookback
        since_last, since_first = self._balance(losses, self.last), self._balance(losses, self.first)
        history = self.weights[used] if back else since_first
        self.weights[used] = self.decay * history + (1.0 - self.decay) * since_last
        self.last = losses
        self.deviations = self.scaled()

    def _balance(self, losses: Tensor, before: Tensor) -> Tensor:
        return losses.numel() * torch.softmax(losses / (self.temperature * before), 0)


class SelfAdaptive(Weighting):
    """A trained weight for each row, ascending while the network descends.

    L. McClenny and U. Braga-Neto, J. Comput. Phys. 474:111722, 2023, with the square as mask and Adam at 5e-3.
    """

    every = 1
    rate = 5e-3

    def __init__(self, sizes: Sizes, residuals: Residuals) -> None:
        super().__init__(sizes, residuals)
        self.masks = torch.ones(residuals.n_rows, dtype=torch.float64, requires_grad=True)
        self.optimizer = torch.optim.Adam([self.masks], lr=self.rate, maximize=True)

    def update(self, residuals: Residuals, state: State) -> None:
        own = (self.plain_rows(state) / self.sizes.plain[0]) ** 2 / (self.counts @ self.members.to(torch.float64))
        own[self.members[BELIEF]] = 0.0
        self.masks.grad = 2.0 * self.masks.detach() * own
        self.optimizer.step()
        self.deviations = self.scaled(self.masks.detach() ** 2)


class ResidualAttention(Weighting):
    """Residual-based attention: S. Anagnostopoulos et al., Comput. Methods Appl. Mech. Eng. 421:116805, 2024.

    Memory 0.999, learning rate 0.01; a row's weight is the square of its attention.
    """

    every = 1
    memory, rate = 0.999, 0.01

    def __init__(self, sizes: Sizes, residuals: Residuals) -> None:
        super().__init__(sizes, residuals)
        self.attention = torch.ones(residuals.n_rows, dtype=torch.float64)

    def update(self, residuals: Residuals, state: State) -> None:
        size = (self.plain_rows(state) / self.sizes.plain[0]).abs()
        for term in (DATA, PHYSICS, START):
            own = self.members[term]
            if self.present[term]:
                self.attention[own] = self.memory * self.attention[own] + self.rate * size[own] / size[own].max().clamp(
                    min=1e-30
                )
        self.deviations = self.scaled(self.attention**2)


class AugmentedLagrangian(Weighting):
    """Physics as a constraint: multipliers for its rows, and a penalty that grows where the constraint is not met.

    Method of multipliers (D. P. Bertsekas, Constrained Optimization and Lagrange Multiplier Methods, 1982, chapter 2);
    for inverse PINNs as in PINNverse, arXiv:2504.05248, 2025.
    """

    every = 200
    growth, wanted, largest = 2.0, 0.5, 1e4

    def __init__(self, sizes: Sizes, residuals: Residuals) -> None:
        super().__init__(sizes, residuals)
        self.shift = torch.zeros(1, residuals.n_rows, dtype=torch.float64)
        self.before = float("inf")

    def update(self, residuals: Residuals, state: State) -> None:
        rows, own = self.plain_rows(state), self.members[PHYSICS]
        assert self.shift is not None
        self.shift[0, own] += rows[own]
        violation = float(rows[own].norm())
        if violation > self.wanted * self.before and self.weights[PHYSICS] < self.largest:
            self.weights[PHYSICS] *= self.growth
            self.shift /= self.growth  # the multiplier itself, penalty times shift, stays
            self.deviations = self.scaled()
        self.before = violation


class Causal(Weighting):
    """A point of the equation counts once those before it are met.

    S. Wang, S. Sankaran and P. Perdikaris, Comput. Methods Appl. Mech. Eng. 421:116813, 2024: weights
    ``exp(-strictness * sum of earlier squares)``, the strictness raised tenfold each time the last weight exceeds 0.99.
    """

    every = 10
    strictness, largest = 1e-2, 1e2

    def update(self, residuals: Residuals, state: State) -> None:
        size = (self.plain_rows(state) / self.sizes.plain[0]) ** 2
        weights, at = torch.ones_like(size), 0
        for block in residuals.blocks:
            physics = slice(at + block.slices["physics"].start, at + block.slices["physics"].stop)
            paths = size[physics].reshape(block.n_paths, block.collocation).sum(0)
            earlier = torch.cumsum(paths, 0) - paths
            weights[physics] = torch.exp(-self.strictness * earlier).repeat(block.n_paths)
            at += block.n_rows
        if weights.min() > 0.99 and self.strictness < self.largest:
            self.strictness *= 10.0
        self.deviations = self.scaled(weights.clamp(min=1e-12))


WEIGHTINGS: dict[str, type[Weighting]] = {
    "noise": Noise,
    "paper": Paper,
    "relobralo": ReLoBRaLo,
    "tangent_kernel": TangentKernel,
    "gradient_norms": GradientNorms,
    "self_adaptive": SelfAdaptive,
    "attention": ResidualAttention,
    "augmented_lagrangian": AugmentedLagrangian,
    "causal": Causal,
}
