"""Motions that dry friction ends, and a damping that the record does not need: the search without a programme."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Problem, Quantity, Record, Status
from bench.systems.sums import Sum
from methods.trajectory.shooting import Shooting

K, FRICTION, AMPLITUDE = 40.0, 0.16, 0.1


def dry_friction(times: np.ndarray) -> np.ndarray:
    """Displacement (m) under dry friction alone, released at rest: half cycles about a shifted centre, then rest.

    J. P. Den Hartog, Mechanical Vibrations, 1956, section 2.12: each half cycle loses ``2 friction / k``.
    """
    omega, shift = np.sqrt(K), FRICTION / K
    last = np.ceil((AMPLITUDE / shift - 1) / 2)
    half_cycle = np.minimum(np.floor(times * omega / np.pi), last)
    moving = (AMPLITUDE - (2 * half_cycle + 1) * shift) * np.cos(omega * times) + (-1) ** half_cycle * shift
    return np.where(half_cycle < last, moving, (-1) ** last * (AMPLITUDE - 2 * last * shift))


@pytest.mark.slow
@pytest.mark.parametrize("terms", [("coulomb",), ("quadratic", "coulomb")])
def test_a_motion_that_sticks_tells_its_friction(terms: tuple[str, ...]) -> None:
    times, rng = np.linspace(0, 6, 150), np.random.default_rng(7)
    channel = Channel(times, dry_friction(times) + 1e-4 * rng.standard_normal(times.size))
    problem = Problem(Sum(("viscous", "spring", *terms), smoothing_velocity=0.005), (Record((channel,)),))
    estimate = Shooting().identify(problem, rng)
    assert estimate.status is Status.OK

    def interval(name: str) -> tuple[float, float, float]:
        quantity: Quantity = problem.system.quantity(name)
        marginal = estimate.marginal(quantity)
        return (marginal.value, *marginal.interval(0.95))

    assert interval("k_over_m")[0] == pytest.approx(K, rel=1e-3)
    assert interval("mu_over_m")[0] == pytest.approx(FRICTION, rel=0.02)
    _, low, high = interval("c_over_m")
    assert low <= 0.0 <= high <= 0.05 * np.sqrt(K)
    assert "largest without c" in estimate.message
