"""A long record in windows: the same small network's features in each, blended by a partition of unity.

One network for hundreds of cycles needs thousands of units a layer, and a step costs the cube of that. In windows the
cost grows with the record's length (finite-basis PINNs: B. Moseley, A. Markham and T. Nissen-Meyer, Adv. Comput. Math.
49:62, 2023). The response is continuous with its derivatives by construction: ``x(t) = sum_j w_j(t) n_j(t)``, with
``w_j`` a quintic step up and down again about window j's centre. Only the output layers are trained, as local extreme
learning machines do (S. Dong and Z. Li, Comput. Methods Appl. Mech. Eng. 387:114129, 2021): from 64 units for six
cycles, training the hidden layers too gains nothing that the noise lets be seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

CYCLES = 3.0
"""Distance of the windows' centres; each reaches to the centres beside it."""
RANK = 1e-4
"""Singular values of the features over the largest below which a combination is left out: 31 stay, ten a cycle. With
more than the twenty collocation points a cycle the response would be free between them."""
GRID = 400
"""Points in a window by which the features are made orthonormal."""


@dataclass(frozen=True)
class Windows:
    """Windows for ``resolution`` oscillations, with features of hidden layers of these ``widths``."""

    widths: tuple[int, ...]
    resolution: int

    @cached_property
    def n(self) -> int:
        """How many windows there are."""
        return int(np.ceil(self.resolution / CYCLES)) + 1

    def _features(self, tau: np.ndarray) -> np.ndarray:
        """Compute the last hidden layer and a constant with two derivatives by tau, (3, n_points, n_features).

        The hidden layers are the same in all windows: the motion in a window of this length is alike in each.
        """
        import torch

        from methods.network import tanh

        widths = (1, *self.widths, 1)
        layers = tanh.flat(tanh.initial_layers(widths, 2.0 * CYCLES, np.random.default_rng(0)))
        network = tanh.Network(widths, torch.as_tensor(tau)[None], torch.ones(1, dtype=torch.float64))
        return network.head(torch.as_tensor(layers)[None])[0].functions[0].numpy()

    @cached_property
    def _mixing(self) -> np.ndarray:
        """Combinations of the features that are orthonormal with their second derivatives, (n_features, rank)."""
        value, _, second = self._features(np.linspace(-1.0, 1.0, GRID))
        omega = 2.0 * np.pi * CYCLES
        _, sizes, axes = np.linalg.svd(np.concatenate([value, second / omega**2]), full_matrices=False)
        kept = sizes > RANK * sizes[0]
        return np.asarray(axes[kept].T / sizes[kept] * np.sqrt(GRID))

    @property
    def count(self) -> int:
        """How many coefficients a path has."""
        return self.n * self._mixing.shape[1]

    def local_functions(self, times: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """The functions that are not zero at the times: values, two derivatives (3, n, 2 rank), first ones (n,)."""
        step = duration / (self.n - 1)
        left = np.clip((times / step).astype(int), 0, self.n - 2)
        parts = []
        for window in (left, left + 1):
            tau = times / step - window
            x, x1, x2 = self._features(tau) @ self._mixing
            w, w1, w2 = (part[:, None] for part in _bump(tau))
            scaled = [w * x, (w1 * x + w * x1) / step, (w2 * x + 2.0 * w1 * x1 + w * x2) / step**2]
            parts.append(np.stack(scaled))
        return np.concatenate(parts, 2), left * self._mixing.shape[1]


def _bump(tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A quintic step from 0 at -1 up to 1 at 0 and down to 0 at 1, and its two derivatives; neighbours add up to 1."""
    u, sign = np.clip(np.abs(tau), 0.0, 1.0), np.sign(tau)
    value = 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return value, -30.0 * sign * u**2 * (1.0 - u) ** 2, -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)


@dataclass(frozen=True, eq=False)
class WindowsResponse:
    """Paths by time, with ``coefficients`` (n_paths, count)."""

    windows: Windows
    coefficients: np.ndarray
    duration: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Paths, shape (n_paths, n_times), at times of shape (n_times,)."""
        values, first = self.windows.local_functions(np.asarray(times, float), self.duration)
        places = first[:, None] + np.arange(values.shape[2])
        return np.einsum("tk,ptk->pt", values[0], self.coefficients[:, places])
