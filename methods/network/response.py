"""Fitted responses as functions of time in NumPy, which can be unpickled without torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

Function = Callable[[np.ndarray], np.ndarray]
"""A function from times (n,) to paths (n_paths, n): displacements, then hidden states."""


@dataclass(frozen=True, eq=False)
class NetworkResponse:
    """A tanh network of ``2 t / duration - 1``.

    ``layers``: weights (n_out, n_in) and biases (n_out,); the last layer is linear, with one output per path.
    """

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    duration: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the paths, (n_paths, n_times), at times (n_times,)."""
        h = (2.0 * np.asarray(times, float) / self.duration - 1.0)[:, None]
        for weight, bias in self.layers[:-1]:
            h = np.tanh(h @ weight.T + bias)
        weight, bias = self.layers[-1]
        return np.asarray((h @ weight.T + bias).T)


@dataclass(frozen=True, eq=False)
class SplineResponse:
    """A B-spline with ``knots`` and ``coefficients`` (n_paths, n_functions)."""

    knots: np.ndarray
    coefficients: np.ndarray
    degree: int

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the paths, (n_paths, n_times), at times (n_times,)."""
        return np.asarray(BSpline(self.knots, self.coefficients.T, self.degree)(np.asarray(times, float)).T)


@dataclass(frozen=True, eq=False)
class Assisted:
    """A trained function plus a combination of fixed ones with ``coefficients`` (n_paths, n_fixed)."""

    inner: Function
    fixed: Function
    coefficients: np.ndarray

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the paths, (n_paths, n_times), at times (n_times,)."""
        return np.asarray(self.inner(times) + self.coefficients @ self.fixed(times))


@dataclass(frozen=True, eq=False)
class Displacements:
    """The first ``n_dof`` paths of ``inner``, without hidden states."""

    inner: Function
    n_dof: int

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the displacements, (n_dof, n_times), at times (n_times,)."""
        return self.inner(times)[: self.n_dof]


@dataclass(frozen=True, eq=False)
class ExactStart:
    """A response with an exact initial state: ``(x0 + v0 t) g + (1 - g) n(t)``, ``g = exp(-(omega t)²)``.

    ``displacement`` and ``velocity`` at time 0, (n_dof,) each; see :func:`methods.pinn.block.exact_start`.
    """

    inner: Function
    displacement: np.ndarray
    velocity: np.ndarray
    omega: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the displacements, (n_dof, n_times), at times (n_times,)."""
        t = np.asarray(times, float)
        g = np.exp(-((self.omega * t) ** 2))
        line = self.displacement[:, None] + self.velocity[:, None] * t
        return np.asarray(line * g + (1.0 - g) * self.inner(t))


@dataclass(frozen=True, eq=False)
class Band:
    """Standard deviation of the displacement, ``values`` (n_dof, n) at ``times`` (n,), linearly interpolated."""

    times: np.ndarray
    values: np.ndarray

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the standard deviation, (n_dof, n_times), at times (n_times,)."""
        return np.stack([np.interp(times, self.times, values) for values in self.values])
