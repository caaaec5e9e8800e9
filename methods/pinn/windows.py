"""Windows for long records: the features of one small network in each, blended by a partition of unity.

One network for hundreds of cycles needs thousands of units per layer, and the cost of a step is cubic in that number.
With windows the cost is proportional to the record's length (finite-basis PINNs: B. Moseley, A. Markham and T.
Nissen-Meyer, Adv. Comput. Math. 49:62, 2023). The response ``x(t) = sum_j w_j(t) n_j(t)`` and its derivatives are
continuous; ``w_j`` is a quintic step up and down about the centre of window j. Only the output layers are trained, as
in local extreme learning machines (S. Dong and Z. Li, Comput. Methods Appl. Mech. Eng. 387:114129, 2021): with 64 units
for six cycles, training the hidden layers gains less than the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

CYCLES = 3.0
"""Distance of the windows' centres in cycles; a window extends to the neighbouring centres."""
RANK = 1e-4
"""Least singular value of the features over the largest: 31 combinations remain, ten per cycle. With more than the
twenty collocation points per cycle the response would be undetermined between them."""
GRID = 400
"""Points in a window at which the features are orthonormalised."""


@dataclass(frozen=True)
class Windows:
    """Windows for ``resolution`` oscillations, with features of hidden layers of these ``widths``."""

    widths: tuple[int, ...]
    resolution: int

    @cached_property
    def n(self) -> int:
        """Return the number of windows."""
        return int(np.ceil(self.resolution / CYCLES)) + 1

    def _features(self, tau: np.ndarray) -> np.ndarray:
        """Compute the last hidden layer and a constant, with two derivatives by tau, (3, n_points, n_features).

        All windows share the hidden layers.
        """
        import torch

        from methods.network import tanh

        widths = (1, *self.widths, 1)
        layers = tanh.flat(tanh.initial_layers(widths, 2.0 * CYCLES, np.random.default_rng(0)))
        network = tanh.Network(widths, torch.as_tensor(tau)[None], torch.ones(1, dtype=torch.float64))
        return network.head(torch.as_tensor(layers)[None])[0].functions[0].numpy()

    @cached_property
    def _mixing(self) -> np.ndarray:
        """Return combinations of features orthonormal with their second derivatives, (n_features, rank)."""
        value, _, second = self._features(np.linspace(-1.0, 1.0, GRID))
        omega = 2.0 * np.pi * CYCLES
        _, sizes, axes = np.linalg.svd(np.concatenate([value, second / omega**2]), full_matrices=False)
        kept = sizes > RANK * sizes[0]
        return np.asarray(axes[kept].T / sizes[kept] * np.sqrt(GRID))

    @property
    def count(self) -> int:
        """Return the number of coefficients per path."""
        return self.n * self._mixing.shape[1]

    def local_functions(self, times: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the non-zero functions: values, two derivatives (3, n, 2 rank), index of the first one (n,)."""
        step = duration / (self.n - 1)
        first = np.clip((times / step).astype(int), 0, self.n - 2)
        parts = []
        for window in (first, first + 1):
            tau = times / step - window
            x, x1, x2 = self._features(tau) @ self._mixing
            w, w1, w2 = (part[:, None] for part in _bump(tau))
            scaled = [w * x, (w1 * x + w * x1) / step, (w2 * x + 2.0 * w1 * x1 + w * x2) / step**2]
            parts.append(np.stack(scaled))
        return np.concatenate(parts, 2), first * self._mixing.shape[1]


def _bump(tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a quintic step from 0 at -1 to 1 at 0 to 0 at 1, and two derivatives; neighbouring ones sum to 1."""
    u, sign = np.clip(np.abs(tau), 0.0, 1.0), np.sign(tau)
    value = 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return value, -30.0 * sign * u**2 * (1.0 - u) ** 2, -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)


@dataclass(frozen=True, eq=False)
class WindowsResponse:
    """The response as a function of time, with ``coefficients`` (n_paths, count)."""

    windows: Windows
    coefficients: np.ndarray
    duration: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the paths, (n_paths, n_times), at times (n_times,)."""
        values, first = self.windows.local_functions(np.asarray(times, float), self.duration)
        places = first[:, None] + np.arange(values.shape[2])
        return np.einsum("tk,ptk->pt", values[0], self.coefficients[:, places])
