"""Trajectory methods, spline collocation and the PINN against certified values of nonlinear least squares.

NIST Statistical Reference Datasets, MGH17 (generated data, level "average"; M. R. Osborne, 1972):
``y = b1 + b2 exp(-x b4) + b3 exp(-x b5)`` is the free motion of an overdamped oscillator seen by a sensor with an
offset: ``k/m = b4 b5``, ``c/m = b4 + b5``, and the offset is b1.
"""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Identifier, Problem, Record
from bench.systems import SDOF
from methods.trajectory.output_error import SingleShooting

pytest.importorskip("casadi")
pytest.importorskip("torch")
from methods.pinn.collocation import Collocation
from methods.pinn.method import PINN
from methods.trajectory.shooting import Shooting

READINGS = np.array([
    0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.850, 0.818, 0.784, 0.751, 0.718, 0.685, 0.658, 0.628, 0.603,
    0.580, 0.558, 0.538, 0.522, 0.506, 0.490, 0.478, 0.467, 0.457, 0.448, 0.438, 0.431, 0.424, 0.420, 0.414, 0.411,
    0.406,
])  # fmt: skip
B1, B4, B5 = 3.7541005211e-01, 1.2867534640e-02, 2.2122699662e-02
DEGREES_OF_FREEDOM = 28
DIGITS = 1e-6


@pytest.mark.parametrize(
    "method",
    [Shooting(), SingleShooting(), SingleShooting(cold=True), Collocation(), PINN()],
    ids=["shooting", "screened", "cold", "collocation", "pinn"],
)
def test_certified_digits(method: Identifier) -> None:
    channel = Channel(10.0 * np.arange(READINGS.size), READINGS, offset=True)
    problem = Problem(SDOF(), (Record((channel,)),))
    estimate = method.identify(problem, np.random.default_rng(0))
    for name, certified in (("k_over_m", B4 * B5), ("c_over_m", B4 + B5)):
        marginal = estimate.marginal(problem.system.quantity(name))
        assert marginal.value == pytest.approx(certified, rel=DIGITS), name
    assert estimate.offsets == pytest.approx((B1,), rel=DIGITS)
    assert estimate.groups.dof == pytest.approx(DEGREES_OF_FREEDOM, abs=1e-6)
