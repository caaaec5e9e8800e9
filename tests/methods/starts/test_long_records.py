"""Starts for records too long to be scanned whole, on motions in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Force, InitialState, OutputError, Problem, Record
from bench.systems import SDOF
from methods.starts.candidates import candidates
from methods.starts.long_records import LONG, MOST_SAMPLES, is_long
from methods.trajectory.shooting import Shooting


def decay(n: int, cycles: float, ratio: float, noise: float, irregular: bool = False) -> Channel:
    """A free decay over 20 s of so many cycles: ``e^(-ratio w t) cos(w' t)``, with noise."""
    rng = np.random.default_rng(5)
    times = np.linspace(0.0, 20.0, n)
    if irregular:
        times = np.sort(rng.uniform(0.0, 20.0, n))
    w = 2 * np.pi * cycles / 20.0
    values = np.exp(-ratio * w * times) * np.cos(w * np.sqrt(1 - ratio**2) * times)
    return Channel(times, values + noise * rng.standard_normal(n))


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize(("cycles", "ratio"), [(3.0, 0.05), (60.0, 0.002), (700.0, 0.0002)])
def test_one_start_is_within_a_quarter_cycle_over_the_whole_record(
    cycles: float, ratio: float, irregular: bool
) -> None:
    problem = Problem(SDOF(), (Record((decay(20_000, cycles, ratio, 0.3, irregular),)),))
    assert is_long(problem)
    units = problem.natural_units()
    computed = candidates(OutputError(problem.expressed_in(units)), 4)
    best = min(abs(np.sqrt(p["k"] / p["m"]) / (2 * np.pi) - cycles) for p in computed)
    assert best < 0.25


def test_shooting_takes_a_long_record_and_its_interval_holds_the_truth() -> None:
    """700 cycles in 20,000 samples: the frequency to some parts in a million."""
    problem = Problem(SDOF(), (Record((decay(20_000, 700.0, 0.0002, 0.3),)),))
    answer = Shooting().identify(problem, np.random.default_rng(0))
    w, groups = 2 * np.pi * 35.0, answer.groups
    for i, truth in enumerate((2 * 0.0002 * w, w**2)):
        point = groups.names.index(("c_over_m", "k_over_m")[i])
        assert abs(groups.mean[point] - truth) < 4 * np.sqrt(groups.covariance[point, point])
        assert np.sqrt(groups.covariance[point, point]) < (0.05, 1e-4)[i] * truth


def test_a_force_is_averaged_over_what_is_left_out() -> None:
    """A slow force on a stiff rig: what its displacement follows is the force over the stiffness."""
    times = np.linspace(0.0, 20.0, 12_000)
    push = np.sin(0.8 * times)
    # far below resonance: m = 1, c = 0.5, k = 400
    w2, r = 400.0 - 0.64, 0.5 * 0.8
    values = (w2 * np.sin(0.8 * times) - r * np.cos(0.8 * times)) / (w2**2 + r**2)
    start = InitialState([-r / (w2**2 + r**2)], [0.8 * w2 / (w2**2 + r**2)])
    problem = Problem(SDOF(), (Record((Channel(times, values),), (Force(times, push, "linear"),), start),))
    units = problem.natural_units()
    scales = units.scales(problem.system)
    computed = [p["k"] * scales["k"] for p in candidates(OutputError(problem.expressed_in(units)), 4)]
    assert min(abs(np.log(k / 400.0)) for k in computed) < 0.2


def test_a_record_that_can_be_scanned_whole_is() -> None:
    assert MOST_SAMPLES < LONG
    assert not is_long(Problem(SDOF(), (Record((decay(LONG, 5.0, 0.02, 0.1),)),)))
