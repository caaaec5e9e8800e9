"""Inverse PINN: a network x(t) and the parameters, trained jointly on the data and on the equation of motion.

The paper's method (Karkadakattil 2026; Raissi, Perdikaris and Karniadakis, J. Comput. Phys. 378:686, 2019) is a tanh
network x(t), 1-64-64-1, whose loss is the squared misfit to the data, to the equation of motion at 200 collocation
points, to the known initial state, and to the prior. Weights of the terms, stages, restarts and uncertainty:
:mod:`methods.pinn.physics`. ``optimizer="lm"`` is Levenberg-Marquardt in residual space, where a step solves some 230
equations instead of 4,400; records of many cycles are divided into windows, whose hidden layers keep their random
weights (:mod:`methods.pinn.windows`). ``optimizer="adam_lbfgs"``, the variant ``pinn_adam``, is the paper's Adam and
L-BFGS on the same residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from bench import Card, InputError
from methods.network.response import Function, NetworkResponse
from methods.pinn.physics import PhysicsInformed
from methods.pinn.windows import Windows, WindowsResponse

if TYPE_CHECKING:
    from methods.network.ansatz import Ansatz
    from methods.pinn.block import Block


UNITS_A_CYCLE = 12
"""Least number of units in a hidden layer per oscillation in the record."""


MOST_CYCLES = 15
"""Largest number of oscillations in a record that one network represents; longer records use windows."""


@dataclass(frozen=True)
class PINN(PhysicsInformed):
    """The inverse PINN; ``width``: units of a hidden layer, at least 12 per oscillation in the record."""

    version: ClassVar[int] = 4
    optimizer: Literal["lm", "adam_lbfgs"] = "lm"
    width: int = 64
    depth: int = 2
    adam_steps: int = 500
    adam_rate: float = 1e-3
    lbfgs_steps: int = 2000

    card: ClassVar[Card] = Card(
        summary="physics-informed network trained on data, equation of motion, initial state and prior",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="Gauss-Newton covariance of the log-parameters, network weights profiled out, Student's t",
        settings_source="architecture and collocation: the paper's Table 1; the rest chosen on development data",
        tuning="initial weights: 26 combinations; slack, damping, tolerance: 25; units per cycle: 9; adam_lbfgs: 12;"
        " 3-16 records each, 5-120 dB, 2-30 cycles, damping 2-20 %, compared with the maximum a posteriori estimate;"
        " first stage at low SNR, rival guesses: 5 on 3 scenarios, -2 and 0 dB, 30-60 samples; frequencies above half"
        " the sampling rate: 3 on 8 scenarios, 1.55-1.9 samples per cycle",
        title="PINN",
        order=40,
        remarks=True,
        paper="pinn",
        variants={
            "pinn_adam": {"title": "PINN (paper's training)", "order": 50},
            "pinn_ensemble": {
                "title": "PINN, ensemble",
                "order": 60,
                "paper": "",
            },
            "pinn_adam_converged": {
                "title": "PINN (paper's training, converged)",
                "order": 55,
                "paper": "",
            },
            "pinn_ensemble_adam": {
                "title": "PINN, ensemble (paper's training)",
                "order": 65,
                "paper": "",
            },
        },
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least({"width": 2, "depth": 1, "adam_steps": 0, "lbfgs_steps": 3})
        if not (np.isfinite(self.adam_rate) and self.adam_rate > 0):
            raise InputError("method.adam_rate", self.adam_rate, "a positive number")

    def _widths(self, n_paths: int, resolution: int) -> tuple[int, ...]:
        return (1, *[max(self.width, UNITS_A_CYCLE * resolution)] * self.depth, n_paths)

    def _windows(self, resolution: int) -> Windows | None:
        """Return the windows of a record too long for one network; None in an ensemble, which uses whole networks."""
        if self.optimizer != "lm" or self.uncertainty == "ensemble" or resolution <= MOST_CYCLES:
            return None
        return Windows((self.width,) * self.depth, resolution)

    def ansatz(self, block: Block, resolution: int) -> Ansatz:
        import torch

        from methods.network.tanh import Network

        if windows := self._windows(resolution):
            return block.local_ansatz(windows.local_functions, windows.count)
        tau = 2.0 * block.times / block.duration[:, None] - 1.0
        device = block.values.device
        rate = torch.as_tensor(2.0 / block.duration, device=device)
        return Network(self._widths(block.n_paths, resolution), torch.as_tensor(tau, device=device), rate)

    def first_coefficients(
        self, n_paths: int, resolution: int, cycles: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> np.ndarray:
        from methods.network import tanh

        if windows := self._windows(resolution):
            return np.zeros((cycles.size, n_paths * windows.count))
        widths = self._widths(n_paths, resolution)
        return np.stack(
            [tanh.flat(tanh.initial_layers(widths, count, rng)) for count, rng in zip(cycles, rngs, strict=True)]
        )

    def response(self, coefficients: np.ndarray, n_paths: int, resolution: int, duration: float) -> Function:
        from methods.network import tanh

        if windows := self._windows(resolution):
            return WindowsResponse(windows, coefficients.reshape(n_paths, windows.count), duration)
        return NetworkResponse(tuple(tanh.layers_of(coefficients, self._widths(n_paths, resolution))), duration)

    def convergence(self, resolution: int) -> float:
        """Return the tolerance, larger for windows, whose overlap slows the convergence."""
        return self.tolerance if self._windows(resolution) else super().convergence(resolution)

    @property
    def first_order(self) -> tuple[int, float, int] | None:
        return None if self.optimizer == "lm" else (self.adam_steps, self.adam_rate, self.lbfgs_steps)
