"""A tanh network of time that computes x, x', x'' together, with a Jacobian in closed form.

The three streams are propagated through the layers as a truncated Taylor series (Taylor-mode differentiation:
Griewank and Walther, Evaluating Derivatives, 2nd edition, chapter 13), so no derivative needs a second backward pass.

For ``z = W h + b`` all streams are mapped by W, and b adds to the first. For ``h = tanh(z)``, with ``s = 1 - h²``
and ``q = -2 h h'``: ``h' = s z'`` and ``h'' = s z'' + q z'``. The adjoint is the transpose of these maps; it maps
a row's adjoints (a, a', a'') to ``(s a + q a' - 2 (h h'' + h'²) a'', s a' + 2 q a'', s a'')``.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from methods.network.ansatz import Adjoints, Ansatz, Basis, Tape

EXPLICIT = 2
"""Layers with at most this number of inputs or outputs contribute to J Jᵀ by explicit columns."""


def initial_layers(
    widths: Sequence[int], cycles: float, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return random weights for a function of time on [-1, 1] with about ``cycles`` oscillations.

    First layer: slopes near ``gain = 1 + cycles / 2`` of either sign, and biases that distribute the centres of tanh
    evenly over the interval. Hidden layers: normal with variance 4/n_in, biases of variance 1. Last layer: zero, so
    that the initial response is zero. With these sizes a linear combination of the last hidden layer already solves an
    oscillator's equation; with larger slopes it oscillates between the collocation points.
    """
    layers = []
    gain = 1.0 + 0.5 * cycles
    for i, (n_in, n_out) in enumerate(itertools.pairwise(widths)):
        if i == len(widths) - 2:
            weight, bias = np.zeros((n_out, n_in)), np.zeros(n_out)
        elif i == 0:
            weight = gain * rng.uniform(0.5, 1.5, (n_out, n_in)) * rng.choice([-1.0, 1.0], (n_out, n_in))
            centres = np.linspace(-1.05, 1.05, n_out) + rng.uniform(-1.0, 1.0, n_out) / n_out
            bias = -weight[:, 0] * centres
        else:
            weight = 2.0 * rng.standard_normal((n_out, n_in)) / np.sqrt(n_in)
            bias = rng.standard_normal(n_out)
        layers.append((weight, bias))
    return layers


def flat(layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return all weights and biases as one vector, ordered by layer, weights (by row) before biases."""
    return np.concatenate([part.ravel() for layer in layers for part in layer])


def layers_of(theta: Any, widths: Sequence[int]) -> list[tuple[Any, Any]]:
    """Return views of coefficients (..., count) as layers: weights (..., n_out, n_in), biases (..., n_out)."""
    layers, place = [], 0
    for n_in, n_out in itertools.pairwise(widths):
        end = place + n_in * n_out
        weight = theta[..., place:end].reshape(*theta.shape[:-1], n_out, n_in)
        layers.append((weight, theta[..., end : end + n_out]))
        place = end + n_out
    return layers


@dataclass
class Network(Ansatz):
    """The network at points ``tau`` (B, n_points), scaled times with the time derivative ``rate`` (B,)."""

    widths: tuple[int, ...]
    tau: Tensor
    rate: Tensor

    def __post_init__(self) -> None:
        self.count = sum((n_in + 1) * n_out for n_in, n_out in itertools.pairwise(self.widths))
        self._input = torch.zeros(*self.tau.shape[:1], 3, self.tau.shape[1], 1, dtype=self.tau.dtype)
        self._input = self._input.to(self.tau.device)
        self._input[:, 0, :, 0], self._input[:, 1] = self.tau, self.rate[:, None, None]

    def take(self, who: Tensor) -> Network:
        return replace(self, tau=self.tau[who], rate=self.rate[who])

    def forward(self, theta: Tensor) -> Tape:
        h = self._input
        inputs, slopes = [h], []
        layers = layers_of(theta, self.widths)
        for weight, bias in layers[:-1]:
            z = _linear(h, weight, bias)
            h = torch.empty_like(z)
            value, first, second = h.unbind(1)
            torch.tanh(z[:, 0], out=value)
            s = torch.addcmul(value.new_ones(()), value, value, value=-1.0)
            torch.mul(s, z[:, 1], out=first)
            torch.mul(s, z[:, 2], out=second)
            second.addcmul_(value * first, z[:, 1], value=-2.0)
            inputs.append(h)
            slopes.append(s)
        return Tape(inputs, slopes, _linear(h, *layers[-1]))

    def adjoint(self, theta: Tensor, tape: Tape, seeds: Tensor, points: Tensor | None = None) -> Adjoints:
        adjoints = [seeds]
        layers = layers_of(theta, self.widths)
        for (weight, _), h, s in zip(
            reversed(layers[1:]), reversed(tape.inputs[1:]), reversed(tape.slopes), strict=True
        ):
            if points is not None:
                h, s = h.index_select(2, points), s.index_select(1, points)
            value, first, second = h.unbind(1)
            down = (adjoints[-1].flatten(1, 2) @ weight).unflatten(1, (3, -1))
            q = (value * first).mul_(-2.0)
            z = down * s[:, None]
            z[:, 0].addcmul_(q, down[:, 1])
            mixed = (value * second).addcmul_(first, first)
            z[:, 0].addcmul_(mixed, down[:, 2], value=-2.0)
            z[:, 1].addcmul_(q, down[:, 2], value=2.0)
            adjoints.append(z)
        return adjoints[::-1]

    def gram(self, tape: Tape, adjoints: Adjoints, points: Tensor) -> Tensor:
        """Compute ``J Jᵀ`` as a sum over layers of Gram products, without forming J.

        For one layer, ``(J Jᵀ)[i, j] = sum over streams s, t of (a_s[i]·a_t[j]) (h_s[i]·h_t[j])``, with a the adjoints
        and h the inputs, the biases adding 1 to the inputs' product at s = t = 0.
        """
        n = points.shape[0]
        half = torch.zeros(self.tau.shape[0], n, n, dtype=self.tau.dtype, device=self.tau.device)
        for layer, a in enumerate(adjoints):
            h = tape.inputs[layer].index_select(2, points)
            if min(a.shape[3], h.shape[3]) <= EXPLICIT:
                columns = _outer(a, h)
                half.baddbmm_(columns, columns.mT, alpha=0.5)
                continue
            for s in range(3):
                for t in range(s + 1):
                    product = h[:, s] @ h[:, t].mT
                    if s == t == 0:
                        product += 1.0
                    half.addcmul_(product, a[:, s] @ a[:, t].mT, value=0.5 if s == t else 1.0)
        return half + half.mT

    def pull_back(self, tape: Tape, adjoints: Adjoints, points: Tensor | None, dual: Tensor | None = None) -> Tensor:
        parts = []
        for a, h in zip(adjoints, tape.inputs, strict=True):
            weighted = a if dual is None else a * dual[:, None, :, None]
            at_rows = h if points is None else h.index_select(2, points)
            parts += [(weighted.flatten(1, 2).mT @ at_rows.flatten(1, 2)).flatten(1), weighted[:, 0].sum(1)]
        return torch.cat(parts, 1)

    def jacobian(self, tape: Tape, adjoints: Adjoints, points: Tensor, rows: slice = slice(None)) -> Tensor:
        parts = [
            _outer(a[:, :, rows], h.index_select(2, points[rows])) for a, h in zip(adjoints, tape.inputs, strict=True)
        ]
        return torch.cat(parts, 2)

    def head(self, theta: Tensor) -> tuple[Basis, Tensor]:
        h = self.forward(theta).inputs[-1]
        constant = torch.zeros_like(h[..., :1])
        constant[:, 0] = 1.0
        weight, bias = layers_of(theta, self.widths)[-1]
        return Basis(torch.cat([h, constant], 3), self.widths[-1]), torch.cat([weight, bias[..., None]], 2).flatten(1)

    def with_head(self, theta: Tensor, coefficients: Tensor) -> Tensor:
        last = coefficients.unflatten(1, (self.widths[-1], -1))
        body = theta[:, : self.count - coefficients.shape[1]]
        return torch.cat([body, last[..., :-1].flatten(1), last[..., -1]], 1)


def _linear(h: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    z = (h.flatten(1, 2) @ weight.mT).unflatten(1, (3, -1))
    z[:, 0] += bias[:, None]
    return z


def _outer(a: Tensor, h: Tensor) -> Tensor:
    """Return the Jacobian by one layer's weights and biases, (B, n_rows, n_out (n_in + 1))."""
    return torch.cat([torch.einsum("bsko,bski->bkoi", a, h).flatten(2), a[:, 0]], 2)
