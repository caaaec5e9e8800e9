"""Shooting under a force that is a cubic spline through its samples: exact, whatever acts beside it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from bench import Channel, Estimate, Force, InitialState, Problem, Record, Status
from bench.contract.problem import Hold
from bench.systems import SDOF, Duffing

pytest.importorskip("casadi")
import itertools

from methods.trajectory.shooting import Shooting

HARD = {"m": 1.2, "c": 0.5, "k": 6.0, "k3": 4.0}
KNOTS = np.arange(0.0, 12.01, 0.4)
PUSH = 3.0 * np.sin(2.2 * KNOTS) + 2.0 * np.cos(4.1 * KNOTS + 1.0)


def driven(p: dict[str, float], covered: np.ndarray | None = None) -> np.ndarray:
    """Displacement at the knots from 0.3 m at rest, by scipy alone; ``held`` is a second force, kept between knots."""
    spline, state = CubicSpline(KNOTS, PUSH), np.array([0.3, 0.0])
    path = [state[0]]
    for i, (a, b) in enumerate(itertools.pairwise(KNOTS)):
        step = 0.0 if covered is None else covered[i]

        def rate(t: float, s: np.ndarray, step: float = step) -> list[float]:
            x, v = s
            pull = p["c"] * v + p["k"] * x + p.get("k3", 0.0) * x**3
            return [v, (float(spline(t)) + step - pull) / p["m"]]

        state = solve_ivp(rate, (a, b), state, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        path.append(state[0])
    return np.array(path)


def fit(problem: Problem) -> Estimate:
    return Shooting().identify(problem, np.random.default_rng(0))


def errors(estimate: Estimate, p: dict[str, float]) -> np.ndarray:
    """Relative errors of the parameters."""
    assert estimate.status is Status.OK, estimate.message
    computed = [estimate.marginal(estimate.system.quantity(name)) for name in p]
    return np.array([f.value / p[name] - 1 for f, name in zip(computed, p, strict=True)])


@pytest.mark.parametrize(("hold", "least", "most"), [("cubic", 0.0, 1e-5), ("linear", 1e-2, np.inf)])
def test_a_nonlinear_system_under_a_spline(hold: Hold, least: float, most: float) -> None:
    """At 0.4 s a sample the line and the spline differ by a tenth of the force, so the line cannot give the truth."""
    record = Record((Channel(KNOTS, driven(HARD)),), (Force(KNOTS, PUSH, hold),))
    worst = np.max(np.abs(errors(fit(Problem(Duffing(), (record,))), HARD)))
    assert least <= worst <= most


def test_a_spline_beside_a_held_force() -> None:
    """Forces of both kinds in one record, on the same knots."""
    p = {"m": 1.3, "c": 0.6, "k": 9.0}
    covered = np.where(np.arange(KNOTS.size) % 5 < 2, 2.0, -1.0)
    forces = (Force(KNOTS, PUSH, "cubic"), Force(KNOTS, covered, "zero_order"))
    start = InitialState(np.array([0.3]), np.array([0.0]))
    record = Record((Channel(KNOTS[1:], driven(p, covered)[1:]),), forces, start)
    assert np.max(np.abs(errors(fit(Problem(SDOF(), (record,))), p))) < 1e-6
