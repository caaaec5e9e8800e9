"""Motions by steps with their derivatives, against closed forms and numpy's own steps; and how many steps are taken."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from bench import Channel, Force, InitialState, Problem, Record, Steps, System, acceleration, numpy_ops
from bench.dynamics.linear_motion import linear_motion
from bench.dynamics.stepper import rk4_path
from bench.systems import SDOF, BoucWen, Coulomb, Duffing, Pendulum

pytest.importorskip("casadi")
from methods.trajectory.runge_kutta import SUBSTEPS, SteppedOutputError, stepped_accelerations, stepped_motion

KNOTS = np.linspace(0.0, 2.0, 21)
GRID = np.linspace(0.0, 2.0, 41)
PUSH = Force(KNOTS, 3.0 * np.sin(4.0 * KNOTS))
SYSTEMS: dict[System, tuple[float, ...]] = {
    Duffing(): (1.3, 0.5, 9.0, 7.0),
    Pendulum(): (0.8, 0.15, 11.0, 0.9),
    Coulomb(smoothing_velocity=0.05): (1.2, 0.25, 9.0, 0.22),
    BoucWen(): (1.1, 0.35, 4.5, 7.0, 1.1, 0.8),
}
EACH = pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)


def steps_of(count: int, forces: list[Force]) -> Steps:
    return Steps.over(GRID, np.full(GRID.size - 1, count), forces, 1)


def shifted(p: np.ndarray, start: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Each parameter and each part of the start moved up, then down: (2, unknowns, ...)."""
    k, moves = p.size, size * np.eye(p.size + start.size)
    both = [(p * np.exp(sign * moves[:, :k]), start + sign * moves[:, k:]) for sign in (1, -1)]
    return np.stack([computed for computed, _ in both]), np.stack([computed for _, computed in both])


def numpys(system: System, p: np.ndarray, start: np.ndarray, steps: Steps) -> np.ndarray:
    """The states at the grid by numpy's own steps, shape (n_state, *sets, n_grid)."""
    named: Mapping[str, np.ndarray] = dict(zip(system.names, np.moveaxis(p, -1, 0), strict=True))
    hidden = [np.zeros(p.shape[:-1])] * system.n_hidden
    return rk4_path(system, named, [*np.moveaxis(start, -1, 0), *hidden], steps, np.arange(GRID.size))


@EACH
@pytest.mark.parametrize("forces", [[], [PUSH]], ids=["free", "forced"])
def test_the_steps_are_numpys_and_their_derivatives_those_of_the_steps(system: System, forces: list[Force]) -> None:
    """Derivatives against central differences of numpy's steps; away from kinks, to their own error."""
    p, start, steps = np.array(SYSTEMS[system]), np.array([0.9, 0.4]), steps_of(4, forces)
    path = stepped_motion(system, p[None], start[None], steps, by_start=True)[0]
    np.testing.assert_allclose(path[:, 0].T, numpys(system, p, start, steps), rtol=1e-12, atol=1e-12)
    up, down = np.moveaxis(numpys(system, *shifted(p, start, 1e-6), steps), 1, 0)
    np.testing.assert_allclose(np.moveaxis(path[:, 1:], 0, -1), np.moveaxis((up - down) / 2e-6, 1, 0), atol=2e-5)


def test_fine_steps_of_a_linear_system_are_its_exact_motion() -> None:
    rng = np.random.default_rng(3)
    p, start = np.array([1.3, 0.5, 9.0]) * np.exp(0.2 * rng.standard_normal((3, 3))), rng.standard_normal((3, 2))
    path = stepped_motion(SDOF(), p, start, steps_of(40, [PUSH]), by_start=True)
    exact, slopes = linear_motion(SDOF(), dict(zip(SDOF().names, p.T, strict=True)), start, GRID, [PUSH])
    np.testing.assert_allclose(path[:, :, 0], exact, atol=1e-9)
    np.testing.assert_allclose(np.swapaxes(path[:, :, 1:], 2, 3), slopes, atol=1e-8)


def test_derivatives_by_a_told_start_are_left_out() -> None:
    p, start = np.array([SYSTEMS[Duffing()]]), np.array([[0.9, 0.4]])
    whole, known = (stepped_motion(Duffing(), p, start, steps_of(2, []), by_start=part) for part in (True, False))
    np.testing.assert_array_equal(known, whole[:, :, :5])


@EACH
def test_an_accelerometer_shows_what_the_equation_of_motion_says(system: System) -> None:
    p, start, steps = np.array(SYSTEMS[system]), np.array([0.9, 0.4]), steps_of(4, [PUSH])
    force = np.array(PUSH(GRID))
    states = stepped_motion(system, p[None], start[None], steps, by_start=True)
    shown = stepped_accelerations(system, p[None], states, force[:, None], 0)[0]

    def exact(p: np.ndarray, start: np.ndarray) -> np.ndarray:
        x, v, *z = numpys(system, p, start, steps)
        wide = dict(zip(system.names, np.moveaxis(p, -1, 0)[..., None], strict=True))
        return np.asarray(acceleration(system, wide, [x], [v], [force], z, numpy_ops)[0])

    np.testing.assert_allclose(shown[:, 0], exact(p, start), rtol=1e-11, atol=1e-11)
    up, down = exact(*shifted(p, start, 1e-6))
    np.testing.assert_allclose(shown[:, 1:].T, (up - down) / 2e-6, atol=1e-3)


def test_a_motion_that_diverges_is_not_finite_and_disturbs_no_other() -> None:
    p, start = np.array([[1.0, 0.4, 8.0, 5.0], [1.0, 0.4, 1e9, 1e12]]), np.array([[0.9, 0.0]] * 2)
    both = stepped_motion(Duffing(), p, start, steps_of(2, []), by_start=False)
    alone = stepped_motion(Duffing(), p[:1], start[:1], steps_of(2, []), by_start=False)
    np.testing.assert_array_equal(both[0], alone[0])
    assert not np.all(np.isfinite(both[1]))


@pytest.mark.parametrize("noise", [1e-4, 0.1])
def test_the_steps_err_by_what_the_noise_allows(noise: float) -> None:
    """An undamped oscillator, whose motion is a cosine: the error stays within a twentieth of a standard error."""
    times, w = np.linspace(0.0, 1.0, 30), 31.0
    record = Record((Channel(times, np.sqrt(2.0) * np.cos(w * times)),), initial_state=InitialState([1.0], [0.0]))
    model = SteppedOutputError.batch([SteppedOutputError(Problem(SDOF(), (record,)))])
    theta, start = np.log([[1e-12, w**2]]), np.array([[1.0, 0.0]])
    count = model.needed(np.zeros(1, int), theta, noise * model.rms[None, 0])
    allowed = 0.05 * noise / np.sqrt(30)
    coarser = SUBSTEPS[np.searchsorted(SUBSTEPS, count) - 1]
    errors = []
    for number in (int(count[0]), int(coarser[0])):
        steps = Steps.over(times, np.full(29, number), [], 1)
        path = stepped_motion(SDOF(), np.array([[1.0, 1e-12, w**2]]), start, steps, by_start=False)
        errors.append(float(np.max(np.abs(path[0, :, 0, 0] - np.cos(w * times)))))
    assert errors[0] < 1.2 * allowed
    assert errors[1] > 0.8 * allowed


def test_unknown_starts_and_offsets_are_those_that_fit_best() -> None:
    """Clean data of a pendulum with an offset: at the true parameters its start and offset are found."""
    system, times = Pendulum(), np.linspace(0.0, 3.0, 40)
    p, start = np.array(SYSTEMS[system]), np.array([0.3, 0.4])
    steps = Steps.over(times, np.full(39, 8), [], 1)
    values = stepped_motion(system, p[None], start[None], steps, by_start=False)[0, :, 0, 0] + 0.2
    problem = Problem(system, (Record((Channel(times, values, offset=True),)),))
    model = SteppedOutputError(problem, p[0])
    theta, first = np.concatenate([np.log(p[1:]), np.zeros(3)])[None], np.zeros(1, int)
    fine = SteppedOutputError.batch([model]).refined(first, theta, 1e-6 * model.rms[None])
    np.testing.assert_allclose(fine[first].with_initial_states(theta)[0, 3:], [0.3, 0.4, 0.2], atol=1e-6)
