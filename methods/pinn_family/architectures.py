"""Architectures besides the paper's tanh network, each as features combined by a linear output layer.

An architecture defines its initial coefficients and its features as jets in scaled time; rows, Jacobian and output
layer are common to all (:class:`FeatureAnsatz`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from methods.network.ansatz import Adjoints, Ansatz, Basis, Tape
from methods.pinn.block import Block
from methods.pinn_family.choices import TrainingComponent

Parts = Sequence[Tensor]
"""Coefficients of the layers."""


@dataclass
class Jet:
    """A function of time at points; ``streams`` (3, ...): value, first and second time derivative.

    The three are propagated through a network together (Taylor mode).
    """

    streams: Tensor

    @staticmethod
    def of_time(tau: Tensor, rate: Tensor) -> Jet:
        """Return scaled time (n_points, 1), with time derivative ``rate``."""
        return Jet(torch.stack([tau, rate.expand_as(tau), torch.zeros_like(tau)]))

    @property
    def value(self) -> Tensor:
        """Return the value."""
        return self.streams[0]

    def linear(self, weight: Tensor, bias: Tensor | float = 0.0) -> Jet:
        """Return ``W h + b`` over the last axis."""
        mapped = self.streams @ weight.mT
        return Jet(torch.cat([mapped[:1] + bias, mapped[1:]]))

    def through(self, value: Tensor, slope: Tensor, curvature: Tensor) -> Jet:
        """Apply a function, given its value and its first two derivatives at this value."""
        _, first, second = self.streams
        return Jet(torch.stack([value, slope * first, slope * second + curvature * first**2]))

    def tanh(self) -> Jet:
        """Return the hyperbolic tangent."""
        h = torch.tanh(self.value)
        slope = 1.0 - h * h
        return self.through(h, slope, -2.0 * h * slope)

    def sin(self) -> Jet:
        """Return the sine."""
        s, c = torch.sin(self.value), torch.cos(self.value)
        return self.through(s, c, -s)

    def gaussians(self, n: int) -> Jet:
        """Return n Gaussians of each entry of the last axis, with even centres on [-1, 1]: (..., k) to (..., k n)."""
        like, width = self.streams, 2.0 / (n - 1)
        centres = torch.linspace(-1.0, 1.0, n, dtype=like.dtype, device=like.device)
        u = (self.value[..., None] - centres) / width
        g = torch.exp(-0.5 * u * u)
        bumps = Jet(self.streams[..., None]).through(g, -u * g / width, (u * u - 1.0) * g / width**2)
        return Jet(bumps.streams.flatten(-2))

    def __add__(self, other: Jet) -> Jet:
        return Jet(self.streams + other.streams)

    def __sub__(self, other: Jet) -> Jet:
        return Jet(self.streams - other.streams)

    def __mul__(self, other: Jet) -> Jet:
        """Return the product, by the product rule."""
        (a, a1, a2), (b, b1, b2) = self.streams, other.streams
        return Jet(torch.stack([a * b, a1 * b + a * b1, a2 * b + 2.0 * a1 * b1 + a * b2]))

    def scaled(self, factor: Tensor | float) -> Jet:
        """Return the product with a number."""
        return Jet(self.streams * factor)

    def concatenate(self, other: Jet) -> Jet:
        """Concatenate two jets along the last axis."""
        return Jet(torch.cat([self.streams, other.streams], -1))

    def with_one(self) -> Jet:
        """Append the constant 1 along the last axis."""
        zero = torch.zeros_like(self.value[..., :1])
        return self.concatenate(Jet(torch.stack([zero + 1.0, zero, zero])))


@dataclass(frozen=True)
class Features(TrainingComponent, ABC):
    """``width`` features of scaled time on [-1, 1], from ``depth`` layers."""

    width: int = 64
    depth: int = 2

    @abstractmethod
    def start(self, cycles: float, rng: np.random.Generator) -> list[np.ndarray]:
        """Return the initial coefficients of the layers for a function of about ``cycles`` oscillations."""

    @abstractmethod
    def jet(self, parts: Parts, time: Jet) -> Jet:
        """Return the features (..., n_features) of time (..., 1), from coefficients of the shapes of ``start``."""

    def n_features(self) -> int:
        """Return the number of features."""
        return self.width


def _glorot(n_out: int, n_in: int, rng: np.random.Generator) -> np.ndarray:
    """Draw normal weights of variance 2 / (n_in + n_out): X. Glorot and Y. Bengio, AISTATS 2010."""
    return rng.standard_normal((n_out, n_in)) * math.sqrt(2.0 / (n_in + n_out))


def _frequencies(n: int, cycles: float, rng: np.random.Generator) -> np.ndarray:
    """Draw angular frequencies (n, 1) in scaled time, of the size of ``cycles`` oscillations."""
    return rng.standard_normal((n, 1)) * math.pi * max(cycles, 1.0)


def _waves(frequencies: Tensor, time: Jet) -> Jet:
    """Return sines and cosines of time; the frequencies are not trained."""
    fixed = frequencies.detach()
    return time.linear(fixed).sin().concatenate(time.linear(fixed, 0.5 * math.pi).sin())


@dataclass(frozen=True)
class Sine(Features):
    """Sine activations: V. Sitzmann et al., NeurIPS 2020. First frequencies are at most twice the record's."""

    def start(self, cycles: float, rng: np.random.Generator) -> list[np.ndarray]:
        fastest = 2.0 * math.pi * max(cycles, 1.0)  # twice the record's angular frequency in scaled time
        parts = [rng.uniform(-fastest, fastest, (self.width, 1)), rng.uniform(-math.pi, math.pi, self.width)]
        for _ in range(self.depth - 1):
            weights = rng.uniform(-1.0, 1.0, (self.width, self.width)) * math.sqrt(6.0 / self.width)
            parts += [weights, np.zeros(self.width)]
        return parts

    def jet(self, parts: Parts, time: Jet) -> Jet:
        for weight, bias in zip(parts[::2], parts[1::2], strict=True):
            time = time.linear(weight, bias).sin()
        return time


@dataclass(frozen=True)
class Fourier(Features):
    """Random Fourier features before a tanh network: S. Wang, H. Wang and P. Perdikaris, CMAME 384:113938, 2021."""

    def start(self, cycles: float, rng: np.random.Generator) -> list[np.ndarray]:
        parts, n_in = [_frequencies(self.width // 2, cycles, rng)], 2 * (self.width // 2)
        for _ in range(self.depth):
            parts += [_glorot(self.width, n_in, rng), np.zeros(self.width)]
            n_in = self.width
        return parts

    def jet(self, parts: Parts, time: Jet) -> Jet:
        h = _waves(parts[0], time)
        for weight, bias in zip(parts[1::2], parts[2::2], strict=True):
            h = h.linear(weight, bias).tanh()
        return h


@dataclass(frozen=True)
class KolmogorovArnold(Features):
    """A Kolmogorov-Arnold network (Z. Liu et al., ICLR 2025) with Gaussian edge functions.

    Gaussians in place of B-splines: Z. Li, arXiv:2405.06721, 2024. A tanh between layers keeps values on the grid of
    centres. The edges of the last layer are the output layer.
    """

    bumps: ClassVar[int] = 8

    def start(self, cycles: float, rng: np.random.Generator) -> list[np.ndarray]:
        hidden = max(self.width // self.bumps, 2)
        parts, n_in, n_bumps = [], 1, max(2 * self.bumps, 4 * math.ceil(cycles))
        for _ in range(self.depth - 1):
            parts.append(rng.standard_normal((hidden, n_in * n_bumps)) / math.sqrt(n_in * 2.0))
            n_in, n_bumps = hidden, self.bumps
        return parts

    def n_features(self) -> int:
        return max(self.width // self.bumps, 2) * self.bumps

    def jet(self, parts: Parts, time: Jet) -> Jet:
        for layer, weight in enumerate(parts):
            time = time.gaussians(self.bumps if layer else weight.shape[-1]).linear(weight).tanh()
        return time.gaussians(self.bumps)


@dataclass(frozen=True)
class Pirate(Features):
    """PirateNet: gated residual blocks, initially the identity, on Fourier features.

    S. Wang et al., J. Mach. Learn. Res. 25:402, 2024. ``depth`` counts blocks of three layers each.
    """

    def start(self, cycles: float, rng: np.random.Generator) -> list[np.ndarray]:
        n = 2 * (self.width // 2)
        parts = [_frequencies(n // 2, cycles, rng)]
        for _ in range(2 + 3 * max(1, self.depth - 1)):  # two gates, then three layers per block
            parts += [_glorot(n, n, rng), np.zeros(n)]
        return [*parts, np.zeros(max(1, self.depth - 1))]

    def n_features(self) -> int:
        return 2 * (self.width // 2)

    def jet(self, parts: Parts, time: Jet) -> Jet:
        h = _waves(parts[0], time)
        layers = list(zip(parts[1:-1:2], parts[2:-1:2], strict=True))
        u, v = (h.linear(*layer).tanh() for layer in layers[:2])
        for block in range(parts[-1].shape[-1]):
            first, second, third = layers[2 + 3 * block : 5 + 3 * block]
            inner = _gated(h.linear(*first).tanh(), u, v)
            inner = _gated(inner.linear(*second).tanh(), u, v)
            alpha = parts[-1][..., block]
            h = h + (inner.linear(*third).tanh() - h).scaled(alpha)
        return h


def _gated(f: Jet, u: Jet, v: Jet) -> Jet:
    return v + f * (u - v)


COMPONENTS: Mapping[str, type[Features]] = {
    "sine": Sine,
    "fourier": Fourier,
    "kolmogorov_arnold": KolmogorovArnold,
    "pirate": Pirate,
}


@dataclass
class FeatureAnsatz(Ansatz):
    """Linear combinations of trainable features at points ``tau`` (B, n_points), one per path.

    ``shapes``: shapes of the features' coefficients, which precede those of the output layer (for each path, weights
    and a constant).
    """

    features: Features
    shapes: Sequence[tuple[int, ...]]
    tau: Tensor
    rate: Tensor
    n_paths: int

    def __post_init__(self) -> None:
        self.sizes = [math.prod(shape) for shape in self.shapes]
        self.body = sum(self.sizes)
        self.count = self.body + self.n_paths * (self.features.n_features() + 1)

    def take(self, who: Tensor) -> FeatureAnsatz:
        return replace(self, tau=self.tau[who], rate=self.rate[who])

    def _features(self, body: Tensor, tau: Tensor, rate: Tensor) -> Tensor:
        """Return streams (3, n, n_features + 1) of features and of 1, for one fit's coefficients."""
        parts = [part.reshape(shape) for part, shape in zip(body.split(self.sizes), self.shapes, strict=True)]
        return self.features.jet(parts, Jet.of_time(tau[:, None], rate)).with_one().streams

    def _streams(self, theta: Tensor, tau: Tensor, rate: Tensor) -> Tensor:
        """Return streams (3, n, n_paths) for one fit's coefficients (count,)."""
        head = theta[self.body :].reshape(self.n_paths, -1)
        return self._features(theta[: self.body], tau, rate) @ head.mT

    def _all_streams(self, theta: Tensor) -> Tensor:
        """Return streams (B, 3, n, n_paths) for the coefficients (B, count) of all fits."""
        return torch.stack([self._streams(*fit) for fit in zip(theta, self.tau, self.rate, strict=True)])

    def forward(self, theta: Tensor) -> Tape:
        return Tape([theta], [], self._all_streams(theta))

    def adjoint(self, theta: Tensor, tape: Tape, seeds: Tensor, points: Tensor | None = None) -> Adjoints:
        return [seeds]

    def pull_back(self, tape: Tape, adjoints: Adjoints, points: Tensor | None, dual: Tensor | None = None) -> Tensor:
        seeds = adjoints[0] if dual is None else adjoints[0] * dual[:, None, :, None]
        if points is not None:
            at_points = seeds.new_zeros(*seeds.shape[:2], self.tau.shape[1], seeds.shape[3])
            seeds = at_points.index_add_(2, points, seeds)
        theta = tape.inputs[0].detach().requires_grad_(True)
        with torch.enable_grad():
            return torch.autograd.grad(self._all_streams(theta), theta, seeds)[0]

    def jacobian(self, tape: Tape, adjoints: Adjoints, points: Tensor, rows: slice = slice(None)) -> Tensor:
        def value(theta: Tensor, seed: Tensor, tau: Tensor, rate: Tensor) -> Tensor:
            return (self._streams(theta, tau[None], rate)[:, 0] * seed).sum()

        slopes = torch.func.vmap(torch.func.grad(value), (None, 0, 0, None))
        theta, seeds, tau = tape.inputs[0].detach(), adjoints[0][:, :, rows].transpose(1, 2), self.tau[:, points[rows]]
        with torch.enable_grad():
            return torch.stack([slopes(*fit) for fit in zip(theta, seeds, tau, self.rate, strict=True)])

    def head(self, theta: Tensor) -> tuple[Basis, Tensor]:
        fits = zip(theta[:, : self.body], self.tau, self.rate, strict=True)
        return Basis(torch.stack([self._features(*fit) for fit in fits]), self.n_paths), theta[:, self.body :]

    def with_head(self, theta: Tensor, coefficients: Tensor) -> Tensor:
        return torch.cat([theta[:, : self.body], coefficients], 1)


@dataclass(frozen=True, eq=False)
class FeatureFunction:
    """Representation of the response by features; see :class:`methods.pinn.settings.PhysicsSettings`."""

    features: Features

    def shapes(self, resolution: int) -> list[tuple[int, ...]]:
        """Return the shapes of the features' coefficients."""
        return [part.shape for part in self.features.start(resolution, np.random.default_rng(0))]

    def ansatz(self, block: Block, resolution: int) -> FeatureAnsatz:
        """Return the ansatz at the points of a record."""
        device = block.values.device
        tau = torch.as_tensor(2.0 * block.times / block.duration[:, None] - 1.0, device=device)
        rate = torch.as_tensor(2.0 / block.duration, device=device)
        return FeatureAnsatz(self.features, self.shapes(resolution), tau, rate, block.n_paths)

    def first_coefficients(
        self, n_paths: int, resolution: int, cycles: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> np.ndarray:
        """Return the initial coefficients, (B, count); those of the output layer are zero."""
        head = np.zeros(n_paths * (self.features.n_features() + 1))
        bodies = [[part.ravel() for part in self.features.start(resolution, rng)] for rng in rngs]
        return np.stack([np.concatenate([*body, head]) for body in bodies])

    def response(self, coefficients: np.ndarray, n_paths: int, resolution: int, duration: float) -> FeatureResponse:
        """Return the response as a function of time."""
        return FeatureResponse(self.features, self.shapes(resolution), coefficients, n_paths, duration)


@dataclass(frozen=True, eq=False)
class FeatureResponse:
    """A feature network with its coefficients as a function of time, (n,) to (n_paths, n)."""

    features: Features
    shapes: Sequence[tuple[int, ...]]
    coefficients: np.ndarray
    n_paths: int
    duration: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the paths at times (n,)."""
        tau = torch.as_tensor(2.0 * np.asarray(times, float) / self.duration - 1.0)[None]
        ansatz = FeatureAnsatz(self.features, self.shapes, tau, torch.ones(1, dtype=torch.float64), self.n_paths)
        with torch.no_grad():
            return np.asarray(ansatz.forward(torch.as_tensor(self.coefficients)[None]).output[0, 0].T)
