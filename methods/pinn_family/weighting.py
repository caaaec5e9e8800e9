"""Weights of the rows of the loss, and their adaptation during training.

Except for ``noise``, which uses standard deviations of the rows, the terms are mean squares of dimensionless numbers:
data over their root mean square, the equation of motion over the acceleration of a wave of that size and of the scan's
frequency, a known initial state likewise, and the prior in standard deviations (with weight :data:`PRIOR`, since the
paper's is weak). A weight w of a row appears in the loss as ``w r²``, so the row's standard deviation is divided by its
square root.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from methods.pinn.residuals import TERMS, Residuals, State
from methods.pinn_family.choices import TrainingComponent

PRIOR = 1e-3
"""Weight of the prior's term where the weights do not follow from the noise."""
PHYSICS, PRIOR_TERM = TERMS.index("physics"), len(TERMS) - 1


class Weighting(TrainingComponent):
    """Base class of weightings, with fixed weights by default.

    ``sizes`` (1, n_rows): scales of the rows. ``weights`` (4,): weights of the terms (data, physics, initial state,
    prior). ``row_weights`` (n_rows,): additional weights of the rows. :meth:`update` may change both after ``every``
    gradients (0: never). ``members`` (4, n_rows): indicators of the rows of each term; ``counts`` (4,): their numbers.
    ``balanced`` (4,): terms that are present, without the prior. ``shift`` (1, n_rows): added to the rows, if any.
    """

    every = 0
    shift: Tensor | None = None

    def __init__(self, sizes: Tensor, residuals: Residuals) -> None:
        self.sizes = sizes
        self.members = residuals.term_rows.T
        self.counts = self.members.sum(1).clamp(min=1.0)
        self.balanced = (self.members.sum(1) > 0) & (torch.arange(len(TERMS)) != PRIOR_TERM)
        self.weights = torch.ones(len(TERMS), dtype=torch.float64)
        self.weights[PRIOR_TERM] = PRIOR
        self.row_weights = torch.ones(residuals.n_rows, dtype=torch.float64)
        self.deviations = self.scaled()

    def scaled(self) -> Tensor:
        """Return the deviations (1, n_rows) for the current weights."""
        by_row = ((self.weights / self.counts) @ self.members) * self.row_weights
        return self.sizes * by_row.clamp(min=1e-30).rsqrt()

    def begin(self, by_noise: Tensor) -> None:
        """Begin a stage; ``by_noise`` (1, n_rows): deviations of the rows at the current noise estimate."""
        self.deviations = self.scaled()

    def move(self, residuals: Residuals, state: State) -> None:
        """Update the weights, and the deviations with them."""
        self.update(residuals, state)
        self.deviations = self.scaled()

    def update(self, residuals: Residuals, state: State) -> None:
        """Change ``weights`` or ``row_weights``, from a state whose rows are divided by ``deviations``."""

    def plain_rows(self, state: State) -> Tensor:
        """Return the residual vector (n_rows,) without shift and weights."""
        rows = (state.rows * self.deviations)[0]
        return rows if self.shift is None else rows - self.shift[0]

    def squares(self, state: State) -> Tensor:
        """Return the squared dimensionless rows (n_rows,)."""
        return (self.plain_rows(state) / self.sizes[0]) ** 2

    def means(self, by_row: Tensor) -> Tensor:
        """Return the means over the rows of each balanced term."""
        return ((self.members @ by_row) / self.counts)[self.balanced]


class Noise(Weighting):
    """Minus the log posterior at the noise estimated in earlier stages, with nearly hard physics."""

    def begin(self, by_noise: Tensor) -> None:
        self.deviations = by_noise


class Paper(Weighting):
    """Fixed weights, all one; the paper states only that its weights were "selected empirically"."""


class GradientNorms(Weighting):
    """Equal gradient norms of the terms: S. Wang, Y. Teng and P. Perdikaris, SIAM J. Sci. Comput. 43:A3055, 2021.

    With their moving average of 0.9, in the form of S. Wang et al., arXiv:2308.08468 (norms instead of largest and
    mean entry). The prior keeps its weight.
    """

    every = 100

    def update(self, residuals: Residuals, state: State) -> None:
        linear, plain = residuals.linearise(state, self.deviations), self.plain_rows(state)
        # d/dz of (r/size)²: rows of J are divided by the deviations, so these are multiplied in again
        dual = 2.0 * plain * self.deviations[0] / self.sizes[0] ** 2
        terms = (self.members / self.counts[:, None])[self.balanced]
        norms = torch.stack([residuals.pull_back(state, linear, (term * dual)[None]).norm() for term in terms])
        balance = norms.sum() / norms.clamp(min=1e-12)
        self.weights[self.balanced] = 0.9 * self.weights[self.balanced] + 0.1 * balance


class TangentKernel(Weighting):
    """Equal traces of the terms' neural tangent kernel: S. Wang, X. Yu and P. Perdikaris, JCP 449:110768, 2022."""

    every = 100

    def update(self, residuals: Residuals, state: State) -> None:
        linear = residuals.linearise(state, self.deviations)
        squares = residuals.gram(state, linear).diagonal(dim1=1, dim2=2)[0]
        traces = self.means(squares * (self.deviations / self.sizes)[0] ** 2)
        self.weights[self.balanced] = traces.sum() / traces.clamp(min=1e-12)


class ReLoBRaLo(Weighting):
    """Relative loss balancing with random lookback: R. Bischof and M. Kraus, arXiv:2110.09813, 2021.

    Temperature 0.1, decay 0.99 (that of the published code for short runs), expected lookback 0.999. The lookback is
    drawn from a separate generator.
    """

    every = 1
    temperature, decay, lookback = 0.1, 0.99, 0.999

    def __init__(self, sizes: Tensor, residuals: Residuals) -> None:
        super().__init__(sizes, residuals)
        self.first: Tensor | None = None
        self.last: Tensor = torch.empty(0)
        self.generator = torch.Generator().manual_seed(0)

    def update(self, residuals: Residuals, state: State) -> None:
        losses = self.means(self.squares(state)).clamp(min=1e-30)
        if self.first is None:
            self.first = self.last = losses
        back = float(torch.rand((), generator=self.generator)) < self.lookback
        since_last, since_first = self._balance(losses, self.last), self._balance(losses, self.first)
        history = self.weights[self.balanced] if back else since_first
        self.weights[self.balanced] = self.decay * history + (1.0 - self.decay) * since_last
        self.last = losses

    def _balance(self, losses: Tensor, before: Tensor) -> Tensor:
        return losses.numel() * torch.softmax(losses / (self.temperature * before), 0)


class SelfAdaptive(Weighting):
    """A trained weight for each row, by gradient ascent.

    L. McClenny and U. Braga-Neto, J. Comput. Phys. 474:111722, 2023, with the square as mask and Adam at 5e-3.
    """

    every = 1
    rate = 5e-3

    def __init__(self, sizes: Tensor, residuals: Residuals) -> None:
        super().__init__(sizes, residuals)
        self.masks = torch.ones(residuals.n_rows, dtype=torch.float64, requires_grad=True)
        self.optimizer = torch.optim.Adam([self.masks], lr=self.rate, maximize=True)

    def update(self, residuals: Residuals, state: State) -> None:
        squares = self.squares(state) / (self.counts @ self.members)
        squares[self.members[PRIOR_TERM] > 0] = 0.0
        self.masks.grad = 2.0 * self.masks.detach() * squares
        self.optimizer.step()
        self.row_weights = self.masks.detach() ** 2


class ResidualAttention(Weighting):
    """Residual-based attention: S. Anagnostopoulos et al., Comput. Methods Appl. Mech. Eng. 421:116805, 2024.

    Memory 0.999, learning rate 0.01; a row's weight is the square of its attention.
    """

    every = 1
    memory, rate = 0.999, 0.01

    def update(self, residuals: Residuals, state: State) -> None:
        size, attention = self.squares(state).sqrt(), self.row_weights.sqrt()
        for rows in self.members[self.balanced] > 0:
            largest = size[rows].max().clamp(min=1e-30)
            attention[rows] = self.memory * attention[rows] + self.rate * size[rows] / largest
        self.row_weights = attention**2


class AugmentedLagrangian(Weighting):
    """Physics as a constraint, with multipliers and a penalty that increases while violations persist.

    Method of multipliers (D. P. Bertsekas, Constrained Optimization and Lagrange Multiplier Methods, 1982, chapter 2);
    for inverse PINNs as in PINNverse, arXiv:2504.05248, 2025.
    """

    every = 200
    growth, wanted, largest = 2.0, 0.5, 1e4

    def __init__(self, sizes: Tensor, residuals: Residuals) -> None:
        super().__init__(sizes, residuals)
        self.shift = torch.zeros(1, residuals.n_rows, dtype=torch.float64)
        self.before = float("inf")

    def update(self, residuals: Residuals, state: State) -> None:
        physics = self.members[PHYSICS] > 0
        violations = self.plain_rows(state)[physics]
        assert self.shift is not None
        self.shift[0, physics] += violations
        violation = float(violations.norm())
        if violation > self.wanted * self.before and self.weights[PHYSICS] < self.largest:
            self.weights[PHYSICS] *= self.growth
            self.shift /= self.growth  # the multiplier, penalty times shift, is unchanged
        self.before = violation


class Causal(Weighting):
    """Causal weights: a collocation point has weight once the residuals before it are small.

    S. Wang, S. Sankaran and P. Perdikaris, Comput. Methods Appl. Mech. Eng. 421:116813, 2024: weights
    ``exp(-strictness * sum of earlier squares)``, the strictness raised tenfold each time the last weight exceeds 0.99.
    """

    every = 10
    strictness, largest = 1e-2, 1e2

    def update(self, residuals: Residuals, state: State) -> None:
        squares, first = self.squares(state), 0
        weights = torch.ones_like(squares)
        for block in residuals.blocks:
            physics = slice(first + block.slices["physics"].start, first + block.slices["physics"].stop)
            paths = squares[physics].reshape(block.n_paths, block.collocation).sum(0)
            earlier = torch.cumsum(paths, 0) - paths
            weights[physics] = torch.exp(-self.strictness * earlier).repeat(block.n_paths)
            first += block.n_rows
        if weights.min() > 0.99 and self.strictness < self.largest:
            self.strictness *= 10.0
        self.row_weights = weights.clamp(min=1e-12)


COMPONENTS: Mapping[str, type[Weighting]] = {
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
