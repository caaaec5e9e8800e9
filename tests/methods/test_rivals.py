"""The packages of others, where they are installed: short fits of a nearly noise-free decay, and what they carry."""

from __future__ import annotations

import pickle
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import Channel, Estimate, InitialState, Problem, Record, Status
from bench.entrants.registry import load_method, make_method
from bench.scenario.truth import closed_form
from bench.systems import SDOF, Duffing

PACKAGES = {"rival_deepxde": "deepxde", "rival_jinns": "jinns", "rival_pina": "pina"}
P = {"m": 1.0, "c": 0.5, "k": 7.0}  # a plant that is in no table
STEPS = {"rival_deepxde": (1500, 1000), "rival_jinns": (3000, 60), "rival_pina": (400, 1000)}
"""Of Adam and of the second optimiser: an answer that hangs on a clock would hang on the machine."""


def problem(start: bool = True) -> Problem:
    """Two and a half cycles from 0.9 m, 0.4 m/s, with noise of a thousandth of the motion."""
    times = np.linspace(0.0, 6.0, 30)
    noise = 5e-4 * np.random.default_rng(5).standard_normal(times.size)
    channel = Channel(times, closed_form(P, 0.9, 0.4, times) + noise)
    state = InitialState(np.array([0.9]), np.array([0.4])) if start else None
    return Problem(SDOF(), (Record((channel,), (), state),))


@cache
def fitted(name: str, start: bool) -> Estimate:
    """A short fit, made once for all tests that look at it."""
    pytest.importorskip(PACKAGES[name])
    adam, second = STEPS[name]
    method = make_method(name, {"seconds": 1e4, "adam_steps": adam, "second_steps": second})
    return method.identify(problem(start), np.random.default_rng(1))


def k_over_m(estimate: Estimate) -> float:
    assert estimate.status is Status.OK, estimate.message
    return estimate.groups.values()["k_over_m"]


@pytest.mark.parametrize(
    ("name", "start"), [(name, start) for name in PACKAGES for start in (True, False)], ids=lambda value: str(value)
)
def test_a_nearly_noise_free_decay_is_identified_with_and_without_a_told_start(name: str, start: bool) -> None:
    estimate = fitted(name, start)
    assert k_over_m(estimate) == pytest.approx(P["k"] / P["m"], rel=0.04)
    times = np.linspace(0.0, 6.0, 50)
    (response,) = pickle.loads(pickle.dumps(estimate.reconstructions))
    clean = closed_form(P, 0.9, 0.4, times)
    assert response(times).shape == (1, 50)
    assert np.sqrt(np.mean((response(times)[0] - clean) ** 2)) < 0.1 * np.sqrt(np.mean(clean**2))


@pytest.mark.parametrize("name", PACKAGES)
def test_the_path_runs_from_our_start_to_the_answer(name: str) -> None:
    estimate = fitted(name, False)
    seconds, parameters, loss = (estimate.traces[f"path_{part}"] for part in ("cpu_s", "parameters", "loss"))
    assert 5 < seconds.size < 250
    assert parameters.shape == (seconds.size, 3)
    assert loss.shape == seconds.shape
    assert np.all(np.diff(seconds) > 0)
    assert np.all(loss > 0)
    assert loss[-1] < 0.1 * loss[0]
    computed = estimate.groups.values()
    gauge, damping, stiffness = parameters.T
    np.testing.assert_array_equal(gauge, 1.0)
    np.testing.assert_allclose(stiffness[-1], computed["k_over_m"], rtol=1e-12)
    np.testing.assert_allclose(damping[-1], computed["c_over_m"], rtol=1e-12)
    # the scan's grid of frequencies is a quarter of half a cycle a record wide: k/m is in its square
    spacing = 2.0 * np.pi / 8.0 / 6.0
    assert abs(np.sqrt(stiffness[0]) - np.sqrt(P["k"] / P["m"])) < 2.0 * spacing


@pytest.mark.parametrize("name", PACKAGES)
def test_by_steps_the_answer_is_the_same_twice_and_nothing_is_left_behind(
    name: str, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not a word, no file here or at home; torch's and numpy's settings and random states as they were."""
    pytest.importorskip(PACKAGES[name])
    capfd.readouterr()  # what a first import prints
    torch = pytest.importorskip("torch")
    here, home = tmp_path / "here", tmp_path / "home"
    here.mkdir()
    home.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("HOME", str(home))

    def state() -> tuple[Any, ...]:
        return torch.get_default_dtype(), torch.get_num_threads(), torch.get_default_device(), torch.initial_seed()

    before = state()
    method = make_method(name, {"seconds": 1e4, "adam_steps": 40, "second_steps": 20})
    first, second = (method.identify(problem(), np.random.default_rng(1)) for _ in range(2))
    assert k_over_m(first) == k_over_m(second)
    assert state() == before
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")
    assert list(here.iterdir()) == []
    assert list(home.iterdir()) == []


@pytest.mark.parametrize("name", PACKAGES)
def test_what_it_is_not_for_is_declined(name: str) -> None:
    method = load_method(name)()
    record = problem().records[0]
    assert method.objection(problem()) is None
    assert method.objection(Problem(Duffing(), (record,)))
    assert method.objection(Problem(SDOF(), (record, record)))
