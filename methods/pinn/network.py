"""A tanh network of time that returns x, x', x'' together, with the pieces of its Jacobian in closed form.

The three quantities are carried forward through the layers as a truncated Taylor series (Taylor-mode
differentiation: Griewank and Walther, Evaluating Derivatives, 2nd edition, chapter 13), so no derivative needs a
second backward pass. Three numbers a neuron, its value and its first and second time derivative, are called its
*streams* here, and stand along the first axis of a tensor: shape (3, n_points, width).

For ``z = W h + b`` all streams are mapped by W, and b adds to the first. For ``h = tanh(z)``, with ``s = 1 - h²``
and ``s' = -2 h s``: ``h' = s z'`` and ``h'' = s z'' + s' z'²``. The adjoint is the transpose of the same linear maps.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

Layers = list[tuple[Tensor, Tensor]]
"""Weights (n_out, n_in) and biases (n_out,), layer by layer; the last layer is linear."""


def initial_layers(
    widths: Sequence[int], cycles: float, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Random weights for a function of time on [-1, 1] with about ``cycles`` oscillations; numpy, float64.

    First layer: slopes near ``gain = 1 + cycles / 2`` of either sign, and biases that put the centres of the tanh
    evenly over the interval (zero biases put all of them at its middle, where the ends of the record cannot be fitted).
    Hidden layers: normal with variance 4/n_in, biases of variance 1. Last layer: zero, so that the first response is
    the state of rest. These sizes were chosen so that a linear combination of the last hidden layer alone already
    solves an oscillator's equation; with larger slopes it oscillates between the collocation points instead.
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


def count(widths: Sequence[int]) -> int:
    """Number of weights and biases."""
    return sum((n_in + 1) * n_out for n_in, n_out in itertools.pairwise(widths))


def flat(layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """All weights and biases as one vector, layer by layer, weights (row by row) before biases."""
    return np.concatenate([part.ravel() for layer in layers for part in layer])


def unflat(theta: Tensor, widths: Sequence[int]) -> Layers:
    """Views of the vector ``theta`` (see :func:`flat`) as layers."""
    layers, at = [], 0
    for n_in, n_out in itertools.pairwise(widths):
        weight = theta[at : at + n_in * n_out].view(n_out, n_in)
        bias = theta[at + n_in * n_out : at + (n_in + 1) * n_out]
        layers.append((weight, bias))
        at += (n_in + 1) * n_out
    return layers


EXPLICIT = 2
"""Layers no wider than this on one side enter J Jᵀ through explicit columns."""


@dataclass
class Tape:
    """What a forward pass leaves for the adjoint: the streams into each layer, and tanh's factors of each hidden one.

    ``inputs[l]`` has shape (3, n_points, n_in of layer l); ``factors[l]`` are the tensors (s, s' z', s' z'' + s'' z'²,
    2 s' z') that the adjoint of tanh needs, each of shape (n_points, width). ``output`` is (3, n_points, n_out).
    """

    inputs: list[Tensor]
    factors: list[tuple[Tensor, Tensor, Tensor]]
    output: Tensor


def forward(layers: Layers, tau: Tensor, rate: float) -> Tape:
    """Streams at the points ``tau`` (n_points,), the scaled time, whose derivative by time is ``rate``."""
    h = torch.zeros(3, tau.shape[0], 1, dtype=tau.dtype, device=tau.device)
    h[0, :, 0], h[1] = tau, rate
    inputs, factors = [h], []
    for weight, bias in layers[:-1]:
        z = h @ weight.T
        z[0] += bias
        h = torch.empty_like(z)
        torch.tanh(z[0], out=h[0])
        s = 1.0 - h[0] * h[0]
        s1 = h[0] * s
        s1 *= -2.0
        s1z1 = s1 * z[1]
        torch.mul(s, z[1], out=h[1])
        torch.mul(s, z[2], out=h[2])
        h[2] += s1z1 * z[1]
        # s'' = s (6 h² - 2) = s (4 - 6 s)
        mixed = s1 * z[2] + s * (4.0 - 6.0 * s) * z[1] * z[1]
        inputs.append(h)
        factors.append((s, s1z1, mixed))
    weight, bias = layers[-1]
    out = h @ weight.T
    out[0] += bias
    return Tape(inputs, factors, out)


def adjoint(layers: Layers, tape: Tape, seeds: Tensor, points: Tensor | None = None) -> list[Tensor]:
    """Adjoints of the linear parts of all layers, each of shape (3, n_rows, n_out of the layer).

    Row k is a scalar ``sum(seeds[:, k] * output[:, points[k]])`` of the network's streams; ``points`` None means
    one row a point, in order. The gradient of row k by a layer's weights is ``sum over streams of
    outer(adjoint[s, k], input[s, points[k]])``, by its biases ``adjoint[0, k]``.
    """
    adjoints = [seeds]
    for (weight, _), (s, s1z1, mixed) in zip(reversed(layers[1:]), reversed(tape.factors), strict=True):
        if points is not None:
            s, s1z1, mixed = s[points], s1z1[points], mixed[points]
        h = adjoints[-1] @ weight
        z = h * s
        z[0] += s1z1 * h[1] + mixed * h[2]
        z[1] += 2.0 * s1z1 * h[2]
        adjoints.append(z)
    return adjoints[::-1]


def gram(tape: Tape, adjoints: Sequence[Tensor], points: Tensor, only_output: bool = False) -> Tensor:
    """``J Jᵀ`` over the weights, (n_rows, n_rows), as a sum over layers of Gram products; J is never formed.

    For one layer, ``(J Jᵀ)[i, j] = sum over streams s, t of (a_s[i]·a_t[j]) (h_s[i]·h_t[j])``, with a the adjoints and
    h the inputs, the biases adding 1 to the inputs' product at s = t = 0. With ``only_output`` just the last layer's
    share.
    """
    n = points.shape[0]
    half = torch.zeros(n, n, dtype=tape.output.dtype, device=tape.output.device)
    layers = range(len(adjoints))
    for layer in layers[-1:] if only_output else layers:
        a, h = adjoints[layer], tape.inputs[layer].index_select(1, points)
        if min(a.shape[2], h.shape[2]) <= EXPLICIT:
            columns = torch.cat([(a.transpose(0, 1).mT @ h.transpose(0, 1)).flatten(1), a[0]], 1)
            half.addmm_(columns, columns.T, alpha=0.5)
            continue
        for s in range(3):
            for t in range(s + 1):
                product = h[s] @ h[t].T
                if s == t == 0:
                    product += 1.0
                half.addcmul_(product, a[s] @ a[t].T, value=0.5 if s == t else 1.0)
    return half + half.T


def pull_back(tape: Tape, adjoints: Sequence[Tensor], points: Tensor | None, dual: Tensor | None = None) -> Tensor:
    """``Jᵀ dual`` as one vector over all weights (order of :func:`flat`); ``dual`` None means all ones."""
    parts = []
    for a, h in zip(adjoints, tape.inputs, strict=True):
        weighted = a if dual is None else a * dual[:, None]
        at_rows = h if points is None else h.index_select(1, points)
        parts += [(weighted.flatten(0, 1).T @ at_rows.flatten(0, 1)).reshape(-1), weighted[0].sum(0)]
    return torch.cat(parts)


def jacobian(tape: Tape, adjoints: Sequence[Tensor], points: Tensor) -> Tensor:
    """J explicitly, (n_rows, n_weights), in the order of :func:`flat`; for checks and small problems."""
    parts = []
    for a, h in zip(adjoints, tape.inputs, strict=True):
        outer = torch.einsum("sko,ski->koi", a, h[:, points])
        parts += [outer.reshape(points.shape[0], -1), a[0]]
    return torch.cat(parts, 1)
