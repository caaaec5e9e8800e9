"""The weightings against what their sources ask for, worked out by hand from plain rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench import Channel, InitialState, Prior, Problem, Record
from bench.systems import SDOF
from methods.pinn_family import PINNFamily

torch = pytest.importorskip("torch")

from methods.pinn_family.loss import TrainingPath  # noqa: E402
from methods.pinn_family.training import FamilyAttempt  # noqa: E402
from methods.starts.waves import Guess  # noqa: E402

DATA, PHYSICS, START = 0, 1, 2


def attempt(weighting: Any) -> FamilyAttempt:
    """A small problem in units of its own, its network moved from rest."""
    times = np.linspace(0.0, 1.0, 9)
    start = InitialState(np.array([1.0]), np.array([0.0]))
    record = Record((Channel(times, np.cos(9.0 * times)),), (), start)
    prior = Prior({"m": 1.0, "c": 1.0, "k": 80.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
    problem = Problem(SDOF(), (record,), prior)
    settings = PINNFamily(weighting=weighting, width=8, collocation=20)
    guess = Guess(omega=9.0, decay=0.5, left=0.01)
    computed = FamilyAttempt(
        problem, guess, settings, np.random.default_rng(0), lambda results: None, TrainingPath(0.0)
    )
    z = computed.walk.z + 0.1 * torch.as_tensor(np.random.default_rng(1).standard_normal(computed.walk.z.shape))
    computed.walk.z = z
    return computed


def state_of(computed: FamilyAttempt) -> Any:
    with torch.no_grad():
        return computed.residuals.evaluate(computed.walk.z, computed.loss.deviations)


def updated(computed: FamilyAttempt) -> None:
    with torch.no_grad():
        computed.loss.weighting.move(computed.residuals, state_of(computed))


def jacobian_rows(computed: FamilyAttempt) -> np.ndarray:
    """J of the plain rows by central differences, (n_rows, n_z)."""
    ones = torch.ones(1, computed.residuals.n_rows, dtype=torch.float64)
    columns = []
    with torch.no_grad():
        for i in range(computed.walk.z.shape[1]):
            step = torch.zeros_like(computed.walk.z)
            step[0, i] = 1e-6
            ahead, behind = (computed.residuals.evaluate(computed.walk.z + s * step, ones).rows[0] for s in (1, -1))
            columns.append(((ahead - behind) / 2e-6).numpy())
    return np.array(columns).T


def terms(computed: FamilyAttempt) -> np.ndarray:
    return computed.residuals.term_rows.numpy().T.astype(bool)


def test_fixed_weights_make_a_sum_of_mean_squares() -> None:
    """Data over their root mean square, the equation over omega squared times that, the prior with its mild weight."""
    computed = attempt("paper")
    state = state_of(computed)
    ones = torch.ones(1, computed.residuals.n_rows, dtype=torch.float64)
    with torch.no_grad():
        plain = computed.residuals.evaluate(computed.walk.z, ones).rows[0].numpy()
    rms = np.sqrt(np.mean(np.cos(9.0 * np.linspace(0, 1, 9)) ** 2))
    data, physics, start, prior = (plain[own_rows] for own_rows in terms(computed))
    wanted = np.mean((data / rms) ** 2) + np.mean((physics / (81.0 * rms)) ** 2)
    wanted += np.mean(np.array([start[0] / rms, start[1] / (9.0 * rms)]) ** 2)
    wanted += 1e-3 * np.mean((prior / np.array([0.02, 1.0, 0.5])) ** 2)
    assert 2.0 * float(state.loss[0]) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.slow
def test_the_tangent_kernel_weighting_gives_equal_traces() -> None:
    computed = attempt("tangent_kernel")
    updated(computed)
    scaled = jacobian_rows(computed) / computed.loss.deviations[0].numpy()[:, None]
    traces = [np.sum(scaled[rows] ** 2) for rows in terms(computed)[:3]]
    assert traces[PHYSICS] == pytest.approx(traces[DATA], rel=1e-4)
    assert traces[START] == pytest.approx(traces[DATA], rel=1e-4)


@pytest.mark.slow
def test_gradient_norms_tend_to_be_equal() -> None:
    computed = attempt("gradient_norms")
    for _ in range(150):  # of a moving average: 0.9^150 = 1e-7
        updated(computed)
    d = computed.loss.deviations[0].numpy()
    rows = state_of(computed).rows[0].numpy()
    scaled = jacobian_rows(computed) / d[:, None]
    lengths = [np.linalg.norm(scaled[part].T @ rows[part]) for part in terms(computed)[:3]]
    assert lengths[PHYSICS] == pytest.approx(lengths[DATA], rel=1e-3)
    assert lengths[START] == pytest.approx(lengths[DATA], rel=1e-3)


@pytest.mark.parametrize("weighting", ["self_adaptive", "attention"])
def test_large_residuals_gain_weight(weighting: Any) -> None:
    computed = attempt(weighting)
    before, rows = computed.loss.deviations[0].clone(), state_of(computed).rows[0].abs()
    for _ in range(50):
        updated(computed)
    gained = (before / computed.loss.deviations[0]).numpy()
    physics = terms(computed)[PHYSICS]
    order = np.argsort(rows.numpy()[physics])
    assert gained[physics][order[-1]] > gained[physics][order[0]]


def test_causal_weights_fall_along_the_record() -> None:
    computed = attempt("causal")
    computed.loss.weighting.strictness = 1.0
    updated(computed)
    deviations = computed.loss.deviations[0].numpy()[terms(computed)[PHYSICS]]
    assert np.all(np.diff(deviations) >= -1e-12)
    assert deviations[-1] > deviations[0]


def test_multipliers_take_the_violation_up_and_the_penalty_grows_until_it_falls() -> None:
    computed = attempt("augmented_lagrangian")
    weighting: Any = computed.loss.weighting
    with torch.no_grad():
        plain = weighting.plain_rows(state_of(computed)).clone()
    updated(computed)
    physics = terms(computed)[PHYSICS]
    assert weighting.shift[0, physics].numpy() == pytest.approx(plain[physics].numpy())
    assert not weighting.shift[0, ~physics].any()
    computed.residuals.shift = weighting.shift
    weight = float(weighting.weights[PHYSICS])
    updated(computed)  # nothing has moved, so the violation is what it was
    assert float(weighting.weights[PHYSICS]) > weight


def test_relobralo_keeps_the_sum_of_its_weights() -> None:
    computed = attempt("relobralo")
    for _ in range(20):
        updated(computed)
    weights: Any = computed.loss.weighting
    assert float(weights.weights[:3].sum()) == pytest.approx(3.0, rel=1e-9)
