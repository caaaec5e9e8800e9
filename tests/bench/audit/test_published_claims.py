"""Bounds of published claims, against integration by scipy and central differences, from facts written down anew."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench.audit.claim import read_claim
from bench.audit.evidence import audit
from bench.config.files import read_user_yaml

FOLDER = Path(__file__).parents[3] / "claims"
TURN = 2 * np.pi
Acceleration = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def chain(x: np.ndarray, v: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Two masses, 20 and 10 kg, between two walls, under a unit force on the first."""
    damping = np.array([[c[0] + c[1], -c[1]], [-c[1], c[1] + c[2]]])
    stiffness = np.array([[3000.0, -1000.0], [-1000.0, 6000.0]])
    return (np.array([1.0, 0.0]) - damping @ v - stiffness @ x) / np.array([20.0, 10.0])


# by claim, case and quantity: the acceleration by the unknowns, their values, the state at time 0 and whether it is
# known, the sample times, and the standard deviation of the noise; the bound is that of the first unknown
KNOWN, UNKNOWN = True, False
GIVEN = {
    ("okazaki2025", "", "c"): (
        lambda x, v, p: -p[0] * v - x, [0.1], [1.0, 0.0], KNOWN, np.arange(0.5, 10.0), 0.05,
    ),
    ("physiker2026", "", "k"): (
        lambda x, v, p: -p[1] * v - p[0] * x, [100.0, 2.0], [1.0, 0.0], KNOWN, np.linspace(0.0, 2.0, 200), 0.02,
    ),
    ("piqml2026", "D4", "mu"): (
        lambda x, v, p: -p[0] * v - 1600.0 * x, [8.0], [1.0, 0.0], KNOWN, np.linspace(0.0, 1.0, 300)[:165:5], 0.02,
    ),
    ("guidotto2026_oscillator", "", "zeta"): (
        lambda x, v, p: -2 * p[0] * TURN * v - TURN**2 * x, [0.15], [1.0, 0.0], KNOWN, np.linspace(0.0, 5.0, 200), 0.02,
    ),
    ("guidotto2026_van_der_pol", "", "mu"): (
        lambda x, v, p: p[0] * (1 - x**2) * v - x, [1.0], [2.0, 0.0], KNOWN, np.linspace(0.0, 20.0, 400), 0.05,
    ),
    ("gerend2025", "", "omega"): (
        lambda x, v, p: -2 * p[1] * v - (p[0] ** 2 + p[1] ** 2) * x, [2.0, 0.5],
        [3 * np.cos(0.5), -1.5 * np.cos(0.5) - 6 * np.sin(0.5)], UNKNOWN, np.linspace(0.0, 10.0, 100), 0.3,
    ),
    ("nascimento2020", "", "c1"): (
        chain, [100.0, 110.0, 120.0], [0.0, 0.0, 0.0, 0.0], KNOWN, np.linspace(0.0, 2.0, 1001), 1.5e-5,
    ),
}  # fmt: skip


def bound(
    acceleration: Acceleration, p: Sequence[float], state: Sequence[float], known: bool, times: np.ndarray, sd: float
) -> float:
    """Return the standard deviation of the first unknown by the Cramér-Rao bound."""
    n, size = len(state) // 2, len(p)

    def displacement(unknown: np.ndarray) -> np.ndarray:
        start = state if known else unknown[size:]
        path = solve_ivp(
            lambda t, y: np.r_[y[n:], acceleration(y[:n], y[n:], unknown[:size])],
            (0.0, times[-1]), start, "DOP853", np.union1d(0.0, times), rtol=1e-10, atol=1e-13,
        )  # fmt: skip
        return path.y[:n, -times.size :].ravel()

    at = np.array([*p, *([] if known else state)])
    steps = np.diag(1e-5 * np.abs(at))
    slopes = [(displacement(at + step) - displacement(at - step)) / (2 * step.sum()) for step in steps]
    return float(np.sqrt(np.linalg.inv(np.array(slopes) @ np.transpose(slopes) / sd**2)[0, 0]))


@pytest.mark.parametrize("claim", GIVEN, ids="-".join)
def test_the_bound_of_a_claim_is_that_of_finite_differences(claim: tuple[str, str, str]) -> None:
    name, case, quantity = claim
    audited = audit(read_claim(name, read_user_yaml(str(FOLDER / f"{name}.yaml"), "claim", "a claim"), FOLDER))
    bounds = {f.bound for f in audited.of("") if (f.row.case, f.row.quantity) == (case, quantity)}
    assert list(bounds) == [pytest.approx(bound(*GIVEN[claim]), rel=2e-3)]
