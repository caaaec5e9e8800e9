"""Points of the atlas: the scenario is the test that they say, and its bound is the textbook's."""

import math

import numpy as np
import pytest

from bench import InputError
from bench.atlas.design import Slice, sobol
from bench.atlas.point import FreeDecay
from bench.atlas.run import bound_at

POINT = FreeDecay(200, 20.0, 0.02, 20.0, 0.7, False)


def test_the_scenario_is_the_test_that_the_numbers_say() -> None:
    made = POINT.scenario()
    m, c, k = (made.parameters[name] for name in ("m", "c", "k"))
    omega = math.sqrt(k / m)
    assert c / (2 * math.sqrt(k * m)) == pytest.approx(0.02)
    assert omega * made.duration / (2 * math.pi) == pytest.approx(20.0)
    (x0,), (v0,) = made.initial
    assert math.atan2(-v0 / omega, x0) == pytest.approx(0.7)
    problem, truth = made.maker(0)(0)
    assert len(problem.records[0].channels[0].values) == 200
    assert problem.records[0].initial_state is None
    assert truth.realised_snr_db == pytest.approx(20.0, abs=2.0)


def test_the_bound_of_a_light_damping_is_that_of_a_sinusoids_frequency() -> None:
    # S. Kay, Fundamentals of Statistical Signal Processing I, 1993, example 3.14: var(w) = 12 / (SNR N (N² - 1)),
    # with w in radians a sample; the logarithm of w² has twice the relative error
    n, cycles, snr = 400, 40.0, 100.0
    sd = bound_at(FreeDecay(n, cycles, 1e-5, 20.0, 0.3, False)).sds["k_over_m"]
    step = 2 * math.pi * cycles / (n - 1)
    assert sd == pytest.approx(2.0 * math.sqrt(12.0 / (snr * n * (n**2 - 1))) / step, rel=0.02)


def test_a_frequency_above_half_the_sampling_rate_is_ambiguous() -> None:
    assert FreeDecay(21, 10.0, 0.02, 20.0, 0.0, False).aliased
    assert not FreeDecay(22, 10.0, 0.02, 20.0, 0.0, False).aliased


def test_the_sequence_fills_the_box_evenly() -> None:
    points = sobol(FreeDecay, 256, 3)
    assert len(set(points)) == 256
    for axis in FreeDecay.AXES:
        values = np.array([getattr(point, axis.name) for point in points])
        assert np.all((values >= axis.low) & (values <= axis.high))
        half = axis.value(np.array([0.5]))[0]
        assert np.mean(values < half) == pytest.approx(0.5, abs=0.03)
    assert np.mean([point.start_known for point in points]) == pytest.approx(0.5, abs=0.01)
    assert sobol(FreeDecay, 16, 3) == points[:16]


def test_a_number_that_is_not_balanced_is_refused() -> None:
    with pytest.raises(InputError, match="power of two"):
        sobol(FreeDecay, 100, 3)


def test_a_slice_is_a_grid_with_the_rest_fixed() -> None:
    own = Slice("x", POINT, "cycles", "snr_db", (4, 3))
    points = own.points()
    assert len(points) == 12
    assert {point.samples for point in points} == {200}
    assert len({point.cycles for point in points}) == 4
    assert [point.snr_db for point in points[:4]] == [-5.0] * 4
    with pytest.raises(InputError, match=r"atlas\.slices"):
        Slice("x", POINT, "cycle", "snr_db", (4, 3)).points()
