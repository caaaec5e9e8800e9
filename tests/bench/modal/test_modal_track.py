"""Modal track: simulation, bound and scores, compared with formulas and numerical integration; its command."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

from bench.commands.main import main
from bench.config.modal import modal_scenario, modal_scenario_names
from bench.contract.modal import Blows
from bench.modal.bound import modal_bound
from bench.modal.scenario import ModalScenario, ModalTruth, blow_force, blow_waves, free_waves, motion, poles
from bench.modal.score import match, modal_scores

AMPLITUDE, SIGMA, STEP = 2.0, 0.1, 0.01


def single_wave(frequency: float, damping_ratio: float, n: int) -> ModalTruth:
    times = STEP * np.arange(n)
    waves = lambda pole: free_waves(times, pole)  # noqa: E731
    shapes = np.array([[AMPLITUDE * np.exp(0.7j)]])
    return ModalTruth(np.array([frequency]), np.array([damping_ratio]), waves, shapes, np.array([SIGMA]))


@pytest.mark.parametrize("name", modal_scenario_names())
def test_every_scenario_can_be_drawn_and_has_a_bound(name: str) -> None:
    problem, truth = modal_scenario(name).draw(0, 3)
    again, _ = modal_scenario(name).draw(0, 3)
    other, _ = modal_scenario(name).draw(0, 4)
    values, same, others = (
        part.data.responses if isinstance(part.data, Blows) else part.data.values for part in (problem, again, other)
    )
    assert np.array_equal(values, same)
    assert not np.allclose(values, others)
    bound = modal_bound(truth)
    assert np.all((bound > 1e-7) & (bound < 0.3))


def test_the_bound_of_an_undamped_wave_is_that_of_a_sine() -> None:
    """D. C. Rife, R. R. Boorstyn, IEEE Trans. Information Theory 20:591, 1974: 24 σ² / (A² n³) for a real sine."""
    n, frequency = 2000, 7.3
    bound = modal_bound(single_wave(frequency, 1e-7, n))
    expected = np.sqrt(24.0 * SIGMA**2 / (AMPLITUDE**2 * n**3)) / (2.0 * np.pi * frequency * STEP)
    assert bound[0, 0] == pytest.approx(expected, rel=0.01)


def test_the_bound_of_a_long_decay_is_the_closed_form() -> None:
    """Y.-X. Yao, S. M. Pandit, IEEE Trans. Signal Processing 43:878, 1995, in the limit of a long record.

    The derivative by the pole, ``t exp(pole t)``, orthogonal to ``exp(pole t)``, has the energy 1 / (8 rate³).
    """
    frequency, damping_ratio = 10.0, 0.02
    bound = modal_bound(single_wave(frequency, damping_ratio, 1000))
    size = 2.0 * np.pi * frequency
    by_pole = np.sqrt(16.0 * SIGMA**2 * STEP * (damping_ratio * size) ** 3) / AMPLITUDE
    assert bound[:, 0] == pytest.approx([by_pole / size, by_pole / (damping_ratio * size)], rel=0.03)


def test_the_response_to_a_blow_equals_a_numerical_integration() -> None:
    frequency, damping_ratio, constant = np.array([40.0]), np.array([0.02]), 1.7
    (pole,), rate = poles(frequency, damping_ratio), 65536.0
    times = np.arange(16384) / rate
    starts, peaks = np.array([0.0513]), np.array([1.3])
    response = motion(
        lambda p: blow_waves(times, starts, peaks, p), np.array([pole]), np.array([[constant / (1j * pole.imag)]])
    )
    size = abs(pole)
    system = ([constant, 0.0, 0.0], [1.0, -2.0 * pole.real, size**2])
    _, expected, _ = lsim(system, blow_force(times, starts, peaks)[0], times)
    assert np.abs(response[0, 0] - expected).max() < 1e-4 * np.abs(expected).max()


def test_noise_of_the_force_hardly_increases_the_bound_if_the_force_is_zero_outside_of_the_blow() -> None:
    """The samples of the force are nuisance parameters, measured with noise, within the blow or everywhere."""
    scenario = ModalScenario("", (40.0, 95.0), (0.01, 0.015), (1.0, 0.7), 2048.0, 1024, blows=1)
    problem, truth = scenario.draw(0, 0)
    data, roots = problem.data, poles(truth.frequencies, truth.damping_ratios)
    assert isinstance(data, Blows)
    times = data.step * np.arange(1024)
    noise = np.std(data.forces[0][times > 0.2])
    lag = times[:, None] - times
    constants = (truth.shapes[:, 0] * 1j * roots.imag).real
    by_force = np.where(lag == 0.0, constants.sum(), 0.0)
    for root, constant in zip(roots, constants, strict=True):
        after = data.step * constant * np.imag(root**2 * np.exp(root * np.maximum(lag, 0.0))) / root.imag
        by_force += np.where(lag >= 0.0, after, 0.0)
    derivatives = []
    for step in 1e-5 * np.eye(4):
        values = np.concatenate([truth.frequencies, truth.damping_ratios])
        ends = [values * (1.0 + sign * step) for sign in (1.0, -1.0)]
        high, low = (motion(truth.waves, poles(end[:2], end[2:]), truth.shapes)[0, 0] for end in ends)
        derivatives.append((high - low) / 2e-5)
    waves = [part for root in roots for part in (truth.waves(root)[0].real, truth.waves(root)[0].imag)]
    design = np.array([*derivatives, *waves, np.ones(1024)]).T
    bounds = []
    for unknown in (np.zeros(1024), np.abs(data.forces[0]) > 10 * noise, np.ones(1024)):
        covariance = truth.sigma[0] ** 2 * np.eye(1024) + noise**2 * (by_force * unknown) @ by_force.T
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), design)
        bounds.append(np.linalg.norm(np.linalg.pinv(whitened), axis=1)[:4])
    assert modal_bound(truth).ravel() == pytest.approx(bounds[0], rel=1e-3)
    assert bounds[1] == pytest.approx(bounds[0], rel=0.02)
    assert np.all(bounds[2] > 3.0 * bounds[0])


def test_missed_modes_spurious_modes_and_failed_fits_are_counted() -> None:
    truth = ModalTruth(np.array([10.0, 20.0]), np.array([0.01, 0.02]), np.abs, np.ones((2, 1)), np.ones(1))
    bound = np.array([[0.001, 0.001], [0.01, 0.01]])
    near = [[10.01, 0.01, 0.004, 0.0001], [20.0, 0.0202, 0.02, 0.0004]]
    spurious = [*near, [55.0, 0.01, 0.1, 0.1]]
    missed = [[15.0, 0.02, 0.1, 0.01], [20.0, 0.022, 0.02, np.nan]]
    assert match(np.array(spurious), truth, bound).tolist() == [0, 1]
    assert match(np.array(missed), truth, bound).tolist() == [-1, 1]
    answer = {"status": "ok", "degrees": np.inf, "wall_s": 0.1, "message": ""}
    failed = {**answer, "status": "diverged", "modes": []}
    fits = [{**answer, "modes": near}, {**answer, "modes": spurious}, {**answer, "modes": missed}, failed, None]
    frequency, damping_ratio = modal_scores(fits, [truth] * 5, [bound] * 5)
    assert frequency["outliers_pct"] == pytest.approx(100 * 6 / 10)  # one missed, one off in damping, two failures
    assert frequency["right_pct"] == pytest.approx(100 * 2 / 5)
    assert (frequency["ok"], frequency["replicates"]) == (3, 5)
    assert frequency["excess"] == pytest.approx(np.sqrt(2 / 5))
    assert damping_ratio["excess"] == pytest.approx(np.sqrt((1 + 1 + 100) / 5))
    assert frequency["coverage_pct"] == pytest.approx(100 * 3 / 5)
    assert damping_ratio["coverage_pct"] == pytest.approx(100.0)


def test_the_command_writes_the_table_and_resumes_from_stored_fits(tmp_path: Path, capsys) -> None:
    folders = [f"{name}={tmp_path / name}" for name in ("store", "out", "tex")]
    line = ["-m", "experiment=modal", "scenario=two_modes,hammer_blows", "method=waves", "workers=1", *folders]
    assert main([*line, "replicates=1"]) == 0
    page = (tmp_path / "out" / "table12.md").read_text(encoding="utf-8")
    assert "Not applicable: Damped waves: it is made for free decays, not records of force and response." in page
    assert "| 1/1" in page
    assert re.search(r"^Largest excess: [\d.]+ for Damped waves \(1 records\)\.$", page, re.MULTILINE)
    assert (tmp_path / "out" / "table12.csv").read_text(encoding="utf-8").count("two_modes,") == 4
    assert "two modes" in (tmp_path / "tex" / "table12.tex").read_text(encoding="utf-8")
    capsys.readouterr()
    assert main([*line, "replicates=2", "dry_run=true"]) == 0
    assert "2 fits, 1 tasks to do" in capsys.readouterr().err
    assert main([*line, "replicates=1", "fit=false"]) == 0
    assert (tmp_path / "out" / "table12.md").read_text(encoding="utf-8") == page
