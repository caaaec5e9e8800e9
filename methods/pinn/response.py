"""The trained network as a function of time, in plain numpy, so that it can be pickled and read without torch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class NetworkResponse:
    """Displacement by time: a tanh network of ``2 t / duration - 1``.

    ``layers`` holds weights (n_out, n_in) and biases (n_out,); the last layer is linear, with one output a DOF.
    """

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    duration: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Displacement, shape (n_dof, n_times), at times of shape (n_times,)."""
        h = (2.0 * np.asarray(times, float) / self.duration - 1.0)[:, None]
        for weight, bias in self.layers[:-1]:
            h = np.tanh(h @ weight.T + bias)
        weight, bias = self.layers[-1]
        return np.asarray((h @ weight.T + bias).T)
