"""Spline collocation: the PINN's residual vector and optimiser with a quintic B-spline in place of the network.

An ablation of the network: data, equation of motion at the same points, initial state, prior, noise, stages, restarts
and uncertainty are those of :mod:`methods.pinn.physics`. The response is linear in its coefficients, so for a linear
system the problem is nonlinear only in the parameters. Spline collocation for parameter estimation is decades older
than the PINN (J. M. Varah, SIAM J. Sci. Stat. Comput. 3:28, 1982; J. O. Ramsay et al., J. R. Stat. Soc. B 69:741,
2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.interpolate import BSpline

from bench import Card
from methods.network.response import Function, SplineResponse
from methods.pinn.physics import PhysicsInformed

if TYPE_CHECKING:
    from methods.network.ansatz import Ansatz
    from methods.pinn.block import Block


@dataclass(frozen=True)
class Collocation(PhysicsInformed):
    """Spline collocation; ``degree`` of the spline, and collocation points per knot interval."""

    version: ClassVar[int] = 4
    degree: int = 5
    points_an_interval: int = 3

    card: ClassVar[Card] = Card(
        summary="quintic B-spline fitted to data, equation of motion, initial state and prior (the PINN's residuals)",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="Gauss-Newton covariance of the log-parameters, spline coefficients profiled out, Student's t",
        settings_source="those of the PINN; degree and intervals from the spline's resolution",
        tuning="as the PINN: rival initial guesses and frequencies above half the sampling rate",
        title="Spline collocation",
        order=70,
        remarks=True,
        variants={
            "collocation_bootstrap": {
                "title": "Spline collocation, bootstrap",
                "order": 80,
            },
        },
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least({"degree": 3, "points_an_interval": 1})

    def _knots(self, resolution: int, duration: float) -> np.ndarray:
        """Return uniform knots, with the end knots repeated ``degree`` more times."""
        inner = np.linspace(0.0, duration, self.points(resolution) // self.points_an_interval + 1)
        return np.concatenate([np.zeros(self.degree), inner, np.full(self.degree, duration)])

    def _count(self, resolution: int) -> int:
        return self.points(resolution) // self.points_an_interval + self.degree

    def ansatz(self, block: Block, resolution: int) -> Ansatz:
        def functions(times: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
            return local_functions(self._knots(resolution, duration), self.degree, times)

        return block.local_ansatz(functions, self._count(resolution))

    def first_coefficients(
        self, n_paths: int, resolution: int, cycles: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> np.ndarray:
        return np.zeros((cycles.size, n_paths * self._count(resolution)))

    def response(self, coefficients: np.ndarray, n_paths: int, resolution: int, duration: float) -> Function:
        return SplineResponse(self._knots(resolution, duration), coefficients.reshape(n_paths, -1), self.degree)


def local_functions(knots: np.ndarray, degree: int, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate the non-zero B-splines: values and two derivatives (3, n, degree + 1), index of the first one (n,)."""
    count = knots.size - degree - 1
    first = np.clip(np.searchsorted(knots, times, "right") - 1 - degree, 0, count - degree - 1)
    values = np.empty((3, times.size, degree + 1))
    for phase in range(degree + 1):
        # functions degree + 1 apart do not overlap, so one curve evaluates all of them
        spline = BSpline(knots, (np.arange(count) % (degree + 1) == phase).astype(float), degree)
        column = (phase - first) % (degree + 1)
        values[:, np.arange(times.size), column] = [spline(times, order) for order in range(3)]
    return values, first
