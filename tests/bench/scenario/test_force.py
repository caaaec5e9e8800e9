"""Kinds of force against what defines them, the cubic hold against Duhamel's integral, and sensors on some masses."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad
from scipy.interpolate import make_interp_spline

from bench import Estimate, Force, InitialState, InputError, Normal, simulate
from bench.config.experiment import expand
from bench.dynamics.simulate import SimulatedResponse
from bench.information.fisher import compute_bound
from bench.scenario.force import ForceSpec
from bench.scenario.scenario import Scenario
from bench.scenario.truth import reference_response
from bench.scoring.score import score
from bench.store.cell import Cell
from bench.systems import SDOF, Chain, Duffing

P = {"m": 1.4, "c": 0.7, "k": 11.0}
CHAIN = {"m1": 1.1, "m2": 0.7, "c1": 0.3, "c2": 0.2, "k1": 13.0, "k2": 8.0}
RNG = np.random.default_rng(3)
TIMES = np.linspace(0.0, 6.0, 31)
BASE = Scenario("sdof", P, ((0.0,), (0.0,)), 20.0, samples=40, force=ForceSpec(1.0, 0.1, 1.0), dense=40)
PAIR = Scenario("chain", CHAIN, ((1.0, 0.0), (0.0, 0.5)), 20.0, 4.0, 40, dense=40, forecast=0.5, options={"n": 2})


def impulse_response(t: float) -> float:
    """``e^(-at) sin(wd t) / (m wd)`` (Inman, equation 3.6)."""
    a = P["c"] / (2 * P["m"])
    wd = math.sqrt(P["k"] / P["m"] - a * a)
    return math.exp(-a * t) * math.sin(wd * t) / (P["m"] * wd)


def test_a_swept_sine_has_its_cycles_and_its_mean_square() -> None:
    """From 0.5 to 3 Hz in 20 s: 35 cycles, the later ones shorter; the frequency passes 1.75 Hz half-way."""
    force = ForceSpec(2.0, 0.5, 3.0, samples=20001, kind="swept_sine").draw(20.0, RNG)
    up = force.times[1:][(force.values[:-1] < 0) & (force.values[1:] >= 0)]
    assert up.size == 34  # the first cycle starts with the record, the last ends with it
    assert np.sqrt(np.mean(force.values**2)) == pytest.approx(2.0, rel=0.02)
    middle = np.searchsorted(up, 10.0)
    assert 1.0 / (up[middle] - up[middle - 1]) == pytest.approx(1.75, rel=0.03)


def test_band_limited_noise_is_gaussian_inside_its_band_and_nothing_outside() -> None:
    spec = ForceSpec(3.0, 2.0, 6.0, samples=4000, kind="band_limited_noise")
    draws = [spec.draw(100.0, np.random.default_rng(seed)).values for seed in range(20)]
    for values in draws:
        assert np.sqrt(np.mean(values**2)) == pytest.approx(3.0, rel=1e-12)
    power = np.mean([np.abs(np.fft.rfft(values)) ** 2 for values in draws], axis=0)
    lines = np.fft.rfftfreq(4000, 100.0 / 3999)
    inside = (lines >= 2.0) & (lines <= 6.0)
    assert np.max(power[~inside]) < 1e-20 * np.max(power)
    low, high = power[inside][:200].mean(), power[inside][-200:].mean()
    assert low / high == pytest.approx(1.0, abs=0.15)  # 4000 squares of normals a side: 2 % each
    assert stats.kstest(np.concatenate(draws)[::37] / 3.0, "norm").pvalue > 1e-3


def test_an_impulse_is_a_half_sine_of_its_momentum_and_leaves_a_mass_with_it() -> None:
    """``2 F T / pi``; a pulse of a hundredth of the period starts the free vibration of velocity impulse / m."""
    force = ForceSpec(50.0, samples=20001, kind="impulse", start_s=0.5, length_s=0.02).draw(10.0, RNG)
    momentum = 2 * 50.0 * 0.02 / math.pi
    assert np.trapezoid(force.values, force.times) == pytest.approx(momentum, rel=1e-3)
    assert np.max(force.values) == pytest.approx(50.0, rel=1e-3)
    rest = InitialState(np.zeros(1), np.zeros(1))
    x = simulate(SDOF(), P, rest, np.array([0.4, 1.5, 3.0]), [force]).displacement[0]
    assert x[0] == 0.0
    expected = [momentum * impulse_response(t - 0.51) for t in (1.5, 3.0)]  # as if struck at the middle of the pulse
    np.testing.assert_allclose(x[1:], expected, rtol=3e-3)


def test_a_step_is_held_and_ends_in_the_static_deflection() -> None:
    force = ForceSpec(5.0, samples=401, hold="zero_order", kind="step", start_s=1.0).draw(40.0, RNG)
    rest = InitialState(np.zeros(1), np.zeros(1))
    x = simulate(SDOF(), P, rest, np.array([0.99, 39.9]), [force]).displacement[0]
    assert x[0] == 0.0
    assert x[1] == pytest.approx(5.0 / P["k"], rel=1e-4)


def test_a_column_is_read_and_known_by_its_numbers_not_by_its_place(tmp_path: Path) -> None:
    values = np.random.default_rng(0).standard_normal(30)
    for name in ("a.txt", "b.txt"):
        np.savetxt(tmp_path / name, values, header="force in N")
    one, two = (ForceSpec(2.0, kind="column", file=str(tmp_path / name)) for name in ("a.txt", "b.txt"))
    force = one.draw(10.0, RNG)
    np.testing.assert_allclose(force.values, 2.0 * values)
    np.testing.assert_allclose(force.times, np.linspace(0.0, 10.0, 30))
    cells = [Cell(replace(BASE, force=spec), "ls", {}, 2, 0, "ls") for spec in (one, two)]
    assert cells[0].identity == cells[1].identity
    np.savetxt(tmp_path / "b.txt", values + 1e-9)
    assert Cell(replace(BASE, force=two), "ls", {}, 2, 0, "ls").identity != cells[0].identity


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ({"kind": "hammer"}, "system.force.kind"),
        ({"kind": "multisine"}, "system.force.low_hz"),
        ({"kind": "step", "low_hz": 1.0}, "system.force.low_hz"),
        ({"kind": "impulse", "length_s": 0.01}, "system.force.length_s"),
        ({"kind": "step", "start_s": 10.0}, "system.force.start_s"),
        ({"kind": "swept_sine", "low_hz": 2.0, "high_hz": 1.0}, "system.force.high_hz"),
        ({"kind": "band_limited_noise", "low_hz": 1.0, "high_hz": 50.0}, "system.force.high_hz"),
        ({"kind": "column", "file": "nowhere.txt"}, "system.force.file"),
        ({"kind": "step", "dof": 1}, "system.force.dof"),
    ],
)
def test_a_force_that_makes_no_sense_is_refused(settings: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        replace(BASE, force=ForceSpec(1.0, **settings))
    assert caught.value.field == field
    assert len(str(caught.value).splitlines()) == 1


def test_a_noisy_force_is_told_but_the_motion_follows_the_clean_one() -> None:
    assert BASE.force is not None
    noisy = replace(BASE, force=replace(BASE.force, noise_db=20.0))
    clean = BASE.forces(0)[0].values
    pairs, plain = noisy.replicates(0, 60), BASE.replicates(0, 60)
    told = np.array([problem.records[0].forces[0].values for problem, _ in pairs])
    z = (told - clean) / (0.1 * np.sqrt(np.mean(clean**2)))
    assert np.var(z) == pytest.approx(1.0, abs=5 * math.sqrt(2 / z.size))
    assert not np.array_equal(told[0], told[1])
    for (problem, truth), (quiet, same) in zip(pairs, plain, strict=True):  # paired: motion and its noise are the same
        np.testing.assert_array_equal(problem.records[0].channels[0].values, quiet.records[0].channels[0].values)
        np.testing.assert_array_equal(truth.dense_displacement, same.dense_displacement)
    assert noisy.data_identity() != BASE.data_identity()


def test_cubic_is_the_spline_and_exact_for_a_cubic() -> None:
    times = np.array([0.3, 0.8, 1.0, 1.9, 2.6, 4.0])
    values = np.random.default_rng(1).standard_normal(6)
    inside = np.linspace(0.3, 4.0, 50)
    force = Force(times, values, "cubic")
    np.testing.assert_allclose(force(inside), make_interp_spline(times, values, k=3)(inside), atol=1e-12)
    assert np.all(force(np.array([0.0, 0.2999, 4.0001])) == 0.0)
    cubic = Force(times, times**3 - 2 * times, "cubic")
    np.testing.assert_allclose(cubic(inside), inside**3 - 2 * inside, atol=1e-12)


def test_a_cubic_force_by_duhamels_integral() -> None:
    """``x(t) = ∫ h(t - s) f(s) ds`` by adaptive quadrature from sample to sample."""
    times = np.array([0.3, 0.8, 1.0, 1.9, 2.6, 4.0])
    force = Force(times, np.random.default_rng(1).standard_normal(6), "cubic")
    wanted = np.array([0.2, 0.9, 2.0, 3.9, 5.5])

    def response(t: float) -> float:
        pieces = [p for p in zip(times, np.minimum(times[1:], t), strict=False) if p[0] < t]
        return sum(quad(lambda s: impulse_response(t - s) * float(force(s)), a, b, epsabs=1e-13)[0] for a, b in pieces)

    expected = [response(t) for t in wanted]
    rest = InitialState(np.zeros(1), np.zeros(1))
    np.testing.assert_allclose(simulate(SDOF(), P, rest, wanted, [force]).displacement[0], expected, atol=1e-11)
    np.testing.assert_allclose(reference_response(SDOF(), P, rest, wanted, [force])[0], expected, atol=1e-11)
    almost_linear = {**P, "k3": 1e-13}
    np.testing.assert_allclose(
        reference_response(Duffing(), almost_linear, rest, wanted, [force])[0], expected, atol=1e-9
    )
    np.testing.assert_allclose(
        simulate(Duffing(), almost_linear, rest, wanted, [force]).displacement[0], expected, atol=1e-5
    )


@pytest.mark.parametrize(
    "hold", ["linear", *(pytest.param(hold, marks=pytest.mark.slow) for hold in ("zero_order", "cubic"))]
)
def test_with_a_force_of_any_hold_the_bound_on_the_samples_is_a_projections(hold: str) -> None:
    """``sigma √(p / N)``: m, c, k and, in the second case, k3, all told by the force."""
    for system, p in (("sdof", P), ("duffing", {**P, "k3": 3.0})):
        spec = ForceSpec(3.0, 0.1, 1.0, samples=41, hold=hold)
        scenario = replace(BASE, system=system, parameters=p, force=spec, duration=5.0, forecast=0.5)
        sigma = scenario.sigmas(0)[0]
        assert compute_bound(scenario).rmse == pytest.approx(sigma * math.sqrt(len(p) / 40), rel=1e-6)


def test_a_sensor_on_the_first_mass_only_reads_what_it_would_read_beside_the_other() -> None:
    one = replace(PAIR, measured=(0,))
    (problem, truth), (full, _) = one.replicates(0, 1)[0], PAIR.replicates(0, 1)[0]
    (channel,) = problem.records[0].channels
    assert channel.dof == 0
    np.testing.assert_array_equal(channel.values, full.records[0].channels[0].values)
    assert truth.dense_displacement.shape == (2, 40)
    assert truth.scored(truth.dense_displacement).shape == (1, 40)
    assert truth.sigma == (PAIR.sigmas(0)[0],)
    assert one.data_identity() != PAIR.data_identity()


def test_errors_and_bound_are_over_the_masses_with_a_sensor() -> None:
    """An error of a known size on each mass; on the samples the bound is ``sigma √(p/N)``.

    p: the five groups where the start is told, else the eight numbers of two damped waves, all that one mass shows.
    """
    one = replace(PAIR, measured=(1,))
    problem, truth = one.replicates(0, 1)[0]

    class Off(SimulatedResponse):
        def __call__(self, times: np.ndarray) -> np.ndarray:
            return super().__call__(times) + np.array([[7.0], [0.25]])

    own = Off(Chain(2), CHAIN, one.start)
    distribution = Normal(tuple(CHAIN), np.log(list(CHAIN.values())), np.eye(6) * 1e-6, log=True)
    scores = score(Estimate(Chain(2), parameters=distribution, reconstructions=(own,)), problem, truth)
    assert scores["rmse"] == pytest.approx(0.25, rel=1e-6)
    assert scores["rmse_simulated"] == pytest.approx(0.0, abs=1e-6)
    for told, unknowns in (("known", 5), ("unknown", 8)):
        bound = compute_bound(replace(one, initial_state=told))
        assert bound.rmse == pytest.approx(one.sigmas(0)[1] * math.sqrt(unknowns / 40), rel=1e-5)


@pytest.mark.parametrize("system", ["sdof_impulse", "sdof_step", "sdof_sweep", "sdof_noise", "duffing_forced"])
def test_the_configured_forces_tell_every_parameter(system: str) -> None:
    """To a quarter of its value at 20 dB, with the start unknown and no prior."""
    (cell,) = [job.cell() for job in expand(["method=oracle", f"system={system}", "initial_state=unknown"], False)]
    scenario = replace(cell.scenario, dense=40, forecast=0.5)
    bound = compute_bound(scenario)
    assert scenario.prior is None
    assert max(bound.relative_sd.values()) < 0.25
