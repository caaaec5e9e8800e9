"""Value, first and second time derivative carried through a network together (Taylor mode; see the tanh network)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class Jet:
    """A function of time at points: value, first and second derivative by time, of any common shape."""

    value: Tensor
    first: Tensor
    second: Tensor

    @staticmethod
    def of_time(tau: Tensor, rate: Tensor) -> Jet:
        """Scaled time (..., 1) itself, whose derivative by time is ``rate``."""
        return Jet(tau, rate.expand_as(tau), torch.zeros_like(tau))

    def linear(self, weight: Tensor, bias: Tensor | None = None) -> Jet:
        """``W h + b`` over the last axis."""
        value = self.value @ weight.mT
        return Jet(value if bias is None else value + bias, self.first @ weight.mT, self.second @ weight.mT)

    def through(self, value: Tensor, slope: Tensor, curvature: Tensor) -> Jet:
        """A function of this, given its value and its two derivatives by this value."""
        return Jet(value, slope * self.first, slope * self.second + curvature * self.first**2)

    def tanh(self) -> Jet:
        """Hyperbolic tangent."""
        h = torch.tanh(self.value)
        slope = 1.0 - h * h
        return self.through(h, slope, -2.0 * h * slope)

    def sin(self) -> Jet:
        """Sine."""
        s, c = torch.sin(self.value), torch.cos(self.value)
        return self.through(s, c, -s)

    def gaussians(self, centres: Tensor, width: float) -> Jet:
        """Gaussian bumps of the last axis' entries, (..., n) to (..., n * n_centres)."""
        u = (self.value[..., None] - centres) / width
        g = torch.exp(-0.5 * u * u)
        wide = Jet(self.value[..., None], self.first[..., None], self.second[..., None])
        own = wide.through(g, -u * g / width, (u * u - 1.0) * g / width**2)
        return Jet(own.value.flatten(-2), own.first.flatten(-2), own.second.flatten(-2))

    def __add__(self, other: Jet) -> Jet:
        return Jet(self.value + other.value, self.first + other.first, self.second + other.second)

    def __sub__(self, other: Jet) -> Jet:
        return Jet(self.value - other.value, self.first - other.first, self.second - other.second)

    def __mul__(self, other: Jet) -> Jet:
        """Product, by the product rule."""
        return Jet(
            self.value * other.value,
            self.first * other.value + self.value * other.first,
            self.second * other.value + 2.0 * self.first * other.first + self.value * other.second,
        )

    def scaled(self, by: Tensor | float) -> Jet:
        """Times a number."""
        return Jet(self.value * by, self.first * by, self.second * by)

    def beside(self, other: Jet) -> Jet:
        """Both, along the last axis."""
        pairs = ((self.value, other.value), (self.first, other.first), (self.second, other.second))
        return Jet(*(torch.cat(pair, -1) for pair in pairs))

    def stacked(self) -> Tensor:
        """The three along an axis in front of the last two."""
        return torch.stack([self.value, self.first, self.second], -3)
