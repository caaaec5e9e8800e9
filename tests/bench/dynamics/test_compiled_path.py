"""Compiled steps: those of numpy, whatever the numbers of sets and of steps are rounded up to."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Force, Steps, rk4_path
from bench.dynamics.stepper import compiled_path, padded
from bench.systems import BoucWen, Duffing, System

pytest.importorskip("jax")
GRID = np.linspace(0.0, 2.0, 23)
KNOTS = np.linspace(0.0, 2.0, 12)
STEPS = Steps.over(GRID, np.full(22, 5), [Force(KNOTS, 2.0 * np.cos(3.0 * KNOTS))], 1)
BOUC_WEN = {"m": 1.1, "c": 0.35, "k": 4.5, "kz": 7.0, "beta": 1.1, "gamma": 0.8}


def spread(p: dict[str, float], shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    return {name: value * np.exp(0.2 * rng.standard_normal(shape)) for name, value in p.items()}


@pytest.mark.parametrize("coarse", [False, True])
@pytest.mark.parametrize("shape", [(1,), (5,), (2, 3)])
@pytest.mark.parametrize("wanted", [np.arange(23), np.array([0, 7, 22])], ids=["all", "some"])
def test_they_are_numpys(shape: tuple[int, ...], wanted: np.ndarray, coarse: bool) -> None:
    systems: tuple[tuple[System, dict[str, float]], ...] = (
        (BoucWen(), BOUC_WEN),
        (Duffing(), {"m": 1.3, "c": 0.5, "k": 9.0, "k3": 7.0}),
    )
    for system, p in systems:
        state = [np.full(shape, 0.9), np.full(shape, -0.2), *[np.zeros(shape)] * system.n_hidden]
        ours = compiled_path(system, spread(p, shape), state, STEPS, wanted, coarse)
        theirs = rk4_path(system, spread(p, shape), state, STEPS, wanted)
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-12)


def test_a_set_that_diverges_is_not_finite_and_disturbs_no_other() -> None:
    p = {name: np.array([value, value]) for name, value in {"m": 1.0, "c": 0.4, "k": 8.0, "k3": 5.0}.items()}
    state = [np.array([0.9, 1e9]), np.zeros(2)]
    with np.errstate(all="ignore"):
        path, theirs = (carry(Duffing(), p, state, STEPS, np.arange(23)) for carry in (compiled_path, rk4_path))
    np.testing.assert_allclose(path[:, 0], theirs[:, 0], rtol=1e-11, atol=1e-12)
    assert not np.all(np.isfinite(path[:, 1]))


@pytest.mark.parametrize("number", [1, 7, 1000, 1024, 9999])
def test_at_most_a_fourth_more_steps_are_taken(number: int) -> None:
    lengths, forces = padded(Steps(np.ones(number), np.ones((number, 3, 1)), np.arange(number + 1)))
    assert number <= lengths.size <= 1.25 * number
    assert len(forces) == lengths.size
    assert lengths.sum() == number


@pytest.mark.parametrize(("number", "rounded"), [(1, 1), (2, 4), (4, 4), (5, 16), (1000, 1024), (1025, 4096)])
def test_coarse_numbers_of_steps_are_powers_of_four(number: int, rounded: int) -> None:
    lengths, _ = padded(Steps(np.ones(number), np.ones((number, 3, 1)), np.arange(number + 1)), coarse=True)
    assert lengths.size == rounded
    assert lengths.sum() == number
