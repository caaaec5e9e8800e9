"""Forces that tell most: the closed form is the harness's bound, no other force is better, real methods agree."""

import math

import numpy as np
import pytest

from bench.commands.main import main
from bench.config.overrides import read_overrides
from bench.entrants.registry import make_method
from bench.information.fisher import compute_bound
from bench.planning.forced_test import ForcedTest, displacement, forced_errors
from bench.planning.forces import Forces, evaluate_force, half_sine
from bench.planning.free_decay import Oscillator
from bench.planning.multisine import ALL, criterion_columns
from bench.planning.search import Likely
from bench.planning.verify import simulate_forced_tests
from bench.records.problem import read_measured
from bench.records.request import request_of
from bench.scenario.force import ForceSpec
from bench.scenario.scenario import Scenario

SURE, UNSURE = Likely(2.0, 0.03), Likely(2.0, 0.03, 0.05, 0.3)
TEST = ForcedTest(80, 4.0, 1e6)
GIVEN = [
    "want=c_over_m:5%", "frequency=2", "damping=0.03", "noise=0.5mm", "force=optimal", "samples=60", "duration=4",
    "energy=4", "mass=2",
]  # fmt: skip


@pytest.mark.parametrize("ratio", [0.02, 0.4, 1.3])
def test_the_closed_form_is_the_bound_of_the_benchmark(ratio: float, tmp_path) -> None:
    own, test, mass = Oscillator(1.5, ratio), ForcedTest(50, 3.0, 1.0), 2.0
    force = np.random.default_rng(3).standard_normal(test.samples)
    path = tmp_path / "force.txt"
    np.savetxt(path, force, fmt="%.17g")
    values = displacement(own, test, force / mass)
    snr = 10 * math.log10(np.mean(values**2) / 0.05**2)
    scenario = Scenario(
        "sdof", {"m": mass, "c": mass * 2.0 * ratio * own.omega, "k": mass * own.omega**2}, ((0.0,), (0.0,)), snr,
        duration=test.duration, samples=test.samples, initial_state="unknown",
        force=ForceSpec(kind="column", amplitude=1.0, file=str(path)),
    )  # fmt: skip
    bound, found = compute_bound(scenario).relative_sd, forced_errors(own, test, force / mass / 0.05)
    for name, other in (("k_over_m", "k_over_m"), ("c_over_m", "c_over_m"), ("mass", "m")):
        assert found[name] == pytest.approx(bound[other], rel=1e-5)


def test_the_energy_is_the_integral_of_the_square() -> None:
    force = half_sine(TEST, 1.0)
    fine = np.linspace(0.0, TEST.duration, 200_001)
    integral = np.mean(np.interp(fine, TEST.times, force) ** 2) * TEST.duration
    assert TEST.energy_of(force) == pytest.approx(integral, rel=1e-4)
    assert TEST.energy_of(TEST.scale(force)) == pytest.approx(TEST.energy)


@pytest.mark.parametrize("quantity", ["c_over_m", ALL])
def test_the_gradient_is_that_of_differences(quantity: str) -> None:
    forces, columns = Forces(UNSURE, TEST), criterion_columns(quantity, 5)
    lines, step = np.random.default_rng(0).standard_normal(forces.basis.shape[1]), 1e-6
    found = forces._with_gradient(lines, columns)
    assert found[0] == pytest.approx(forces.value(forces.basis @ lines, quantity))
    for i in (0, 5, lines.size - 1):
        up, down = (forces._with_gradient(lines + s * np.eye(lines.size)[i], columns)[0] for s in (step, -step))
        assert found[1][i] == pytest.approx((up - down) / (2 * step), rel=1e-4, abs=1e-7)


@pytest.mark.parametrize("likely", [SURE, pytest.param(UNSURE, marks=pytest.mark.slow)], ids=["sure", "unsure"])
@pytest.mark.parametrize("quantity", ["c_over_m", "k_over_m"])
def test_the_best_force_is_better_than_any_other(likely: Likely, quantity: str) -> None:
    forces = Forces(likely, TEST)
    best = forces.value(forces.best(quantity), quantity)
    pulse, multisine = forces.best_pulse(quantity), forces.best_multisine(quantity)
    blow, even = forces.hammer_blow(), forces.even_multisine(quantity)
    assert best < forces.value(multisine, quantity) < forces.value(even, quantity)
    assert best < forces.value(pulse, quantity) < forces.value(blow, quantity)
    for width in np.linspace(0.06, 3.0, 40):
        assert forces.value(half_sine(TEST, width), quantity) > forces.value(pulse, quantity) - 0.01
    rng = np.random.default_rng(1)
    for _ in range(30):
        assert forces.value(forces.basis @ rng.standard_normal(forces.basis.shape[1]), quantity) > best


def test_no_force_of_a_few_lines_on_a_fine_grid_is_better() -> None:
    """Three lines: every power on a grid, under phases that are drawn, then a search by drawing nearby."""
    likely, test = Likely(1.0, 0.1), ForcedTest(24, 1.6, 1e4)
    forces, rng = Forces(likely, test), np.random.default_rng(2)
    assert forces.frequencies.size == 3
    best = forces.value(forces.best("c_over_m"), "c_over_m")
    drawn = rng.standard_normal((2000, 6))
    near = min(drawn, key=lambda one: forces.value(forces.basis @ one, "c_over_m"))
    least = forces.value(forces.basis @ near, "c_over_m")
    for size in np.geomspace(1.0, 1e-3, 1500):
        tried = near + size * np.linalg.norm(near) * rng.standard_normal(6)
        if (value := forces.value(forces.basis @ tried, "c_over_m")) < least:
            near, least = tried, value
    assert best <= least + 1e-6
    assert least - best < 0.05


def test_who_wants_all_has_the_smallest_ellipsoid() -> None:
    forces = Forces(SURE, TEST)
    best = {quantity: forces.best(quantity) for quantity in (ALL, "c_over_m", "k_over_m")}
    for quantity in ("c_over_m", "k_over_m"):
        assert forces.value(best[ALL], ALL) < forces.value(best[quantity], ALL)
        assert forces.value(best[ALL], quantity) > forces.value(best[quantity], quantity)


def test_real_estimates_gain_what_the_bound_promises() -> None:
    forces, method = Forces(SURE, TEST), make_method("output_error", {})
    every = []
    for force in (forces.hammer_blow(), forces.best("c_over_m")):
        told = evaluate_force(SURE, TEST, force)
        errors = simulate_forced_tests(SURE, TEST, told.force, "c_over_m", method, 40, lambda: None)
        every.append(np.sqrt(np.mean(errors**2)))
        assert every[-1] == pytest.approx(told.median["c_over_m"], rel=0.4)  # three standard errors of 40
    assert every[1] < 0.6 * every[0]


def test_the_command_compares_forces_and_writes_the_best_as_a_record(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")  # headings and names stand on one line each
    path = tmp_path / "force.csv"
    assert main(["design", *GIVEN, f"out={path}", "verify=2"]) == 0
    said = capsys.readouterr().out
    for title in ("hammer blow", "band-limited noise", "even multisine", "best pulse for c/m", "counted, %"):
        assert title in said
    heading, *rows = path.read_text().splitlines()
    times, force = np.array([row.split(",") for row in rows], float).T
    test = ForcedTest(60, 4.0, 4.0)
    assert test.energy_of(force) == pytest.approx(4.0)
    motion = displacement(Oscillator(2.0, 0.03), test, force / 2.0)
    np.savetxt(path, np.c_[times, force, motion], delimiter=",", header=f"{heading},x (m)", comments="")
    read = read_measured(request_of(read_overrides([f"data={path}", "method=output_error"]))).problem.records[0]
    np.testing.assert_allclose(read.forces[0].values, force)
