"""The family's optimisers on functions whose minimum is known, and on the PINN's loss beside the PINN."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest

from bench import Channel, InitialState, Prior, Problem, Record, Status, simulate
from bench.systems import SDOF
from methods.pinn import PINN
from methods.pinn_family import PINNFamily
from methods.pinn_family.choices import OPTIMIZERS, SAMPLINGS, WEIGHTINGS

torch = pytest.importorskip("torch")

from methods.pinn_family import optimizers, second_order, weighting  # noqa: E402
from methods.pinn_family.loss import Exhausted  # noqa: E402
from methods.pinn_family.sampling import SAMPLINGS as SAMPLERS  # noqa: E402

TRUE = {"m": 1.7, "c": 0.9, "k": 14.0}
PRIOR = Prior({"m": 1.68, "c": 1.5, "k": 9.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
QUICK_WEIGHTINGS, QUICK_OPTIMIZERS = ("paper", "causal"), ("adam", "lbfgs", "natural_gradient")


def problem(noise: float = 0.05, known: bool = True, seed: int = 0) -> Problem:
    times = np.linspace(0.0, 8.0, 25)
    start = InitialState(np.array([0.6]), np.array([-0.8]))
    clean = simulate(SDOF(), TRUE, start, times).displacement[0]
    values = clean + noise * np.random.default_rng(seed).standard_normal(25)
    return Problem(SDOF(), (Record((Channel(times, values),), (), start if known else None),), PRIOR)


class Bowl:
    """A stand-in for the loss: a sum of squares whose curvatures span six orders of magnitude, least at ``centre``."""

    def __init__(self, n: int = 12, work: float = 3000.0) -> None:
        rng = np.random.default_rng(3)
        axes = np.linalg.qr(rng.standard_normal((n, n)))[0]
        self.matrix = torch.as_tensor(axes @ np.diag(np.logspace(0, 6, n)) @ axes.T)
        self.centre = torch.as_tensor(rng.standard_normal(n))
        self.work = work
        self.best: tuple[float, Any] | None = None

    def charge(self, work: float) -> None:
        self.work -= work
        if self.work <= 0:
            raise Exhausted

    def freeze(self) -> None:
        pass

    def value(self, z: Any) -> float:
        return self.gradient(z)[0]

    def gradient(self, z: Any) -> tuple[float, Any]:
        self.charge(1.0)
        off = z - self.centre
        value = 1.0 + 0.5 * float(off @ self.matrix @ off)
        if self.best is None or value < self.best[0]:
            self.best = value, z.clone()
        return value, self.matrix @ off


@pytest.mark.parametrize("method", [optimizers.SelfScaledBFGS, optimizers.SelfScaledBroyden])
def test_self_scaled_quasi_newton_finds_the_bottom_of_an_ill_conditioned_bowl(method: Any) -> None:
    bowl = Bowl()
    with contextlib.suppress(Exhausted):
        method(None, np.random.default_rng(0)).minimise(bowl, torch.zeros(12, dtype=torch.float64))
    assert bowl.best[0] == pytest.approx(1.0, abs=1e-9)


def test_nystrom_newton_cg_needs_few_steps_of_such_a_bowl(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its preconditioner has the whole matrix, so conjugate gradients end at once."""
    monkeypatch.setattr(second_order, "RANK", 12)
    bowl: Any = Bowl()
    method = second_order.NystromNewtonCG(None, np.random.default_rng(0))
    computed = method.minimise(bowl, torch.zeros(12, dtype=torch.float64))
    assert float(torch.linalg.norm(computed - bowl.centre)) < 1e-3
    assert bowl.work > 1000


def log_k_over_m(method: Any, given: Problem) -> tuple[float, float]:
    """Log of k/m and its standard error."""
    estimate = method.identify(given, np.random.default_rng(0))
    assert estimate.status is Status.OK
    marginal = estimate.marginal(given.system.quantity("k_over_m"))
    low, high = np.log(marginal.interval(0.68))
    return float(np.log(marginal.value)), float(high - low) / 2.0


@pytest.mark.parametrize("known", [True, False])
def test_levenberg_marquardt_of_the_family_ends_where_the_pinn_does(known: bool) -> None:
    reference, sd = log_k_over_m(PINN(), problem(known=known))
    computed, own_sd = log_k_over_m(PINNFamily(), problem(known=known))
    assert computed == pytest.approx(reference, abs=0.03 * sd)
    assert own_sd == pytest.approx(sd, rel=0.03)


@pytest.mark.parametrize(
    "optimizer",
    ["variable_projection", *(pytest.param(name, marks=pytest.mark.slow) for name in ("natural_gradient", "lbfgs"))],
)
def test_other_ways_end_at_the_same_minimum(optimizer: Any) -> None:
    least, sd = log_k_over_m(PINNFamily(), problem())
    computed, _ = log_k_over_m(PINNFamily(optimizer=optimizer, budget=4000.0), problem())
    assert computed == pytest.approx(least, abs=0.2 * sd)


@pytest.mark.parametrize(
    "architecture",
    ["kolmogorov_arnold", "spline", *(pytest.param(name, marks=pytest.mark.slow) for name in ("pirate", "sine"))],
)
def test_other_functions_of_time_end_at_the_same_parameters(architecture: Any) -> None:
    """The equation of motion holds all of them alike: what represents the response must not matter."""
    least, sd = log_k_over_m(PINNFamily(), problem())
    computed, _ = log_k_over_m(PINNFamily(architecture=architecture), problem())
    assert computed == pytest.approx(least, abs=0.2 * sd)


@pytest.mark.parametrize(
    "optimizer", [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK_OPTIMIZERS)) for name in OPTIMIZERS]
)
def test_a_small_budget_gives_an_answer_that_says_so(optimizer: Any) -> None:
    estimate = PINNFamily(optimizer=optimizer, budget=12.0).identify(problem(), np.random.default_rng(0))
    assert estimate.status in (Status.OK, Status.DIVERGED)
    assert "budget of work was used up" in estimate.message
    assert estimate.cost.evaluations <= 40


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in QUICK_WEIGHTINGS else pytest.mark.slow)
        for name in WEIGHTINGS
        if name != "noise"
    ],
)
def test_each_weighting_recovers_a_clean_record(name: Any) -> None:
    estimate = PINNFamily(weighting=name).identify(problem(noise=1e-3), np.random.default_rng(0))
    k_over_m = estimate.marginal(SDOF().quantity("k_over_m"))
    assert k_over_m.value == pytest.approx(TRUE["k"] / TRUE["m"], rel=0.01)


@pytest.mark.parametrize("sampling", ["random", "adaptive"])
def test_moving_points_end_near_the_fixed_ones(sampling: Any) -> None:
    least, sd = log_k_over_m(PINNFamily(), problem())
    computed, _ = log_k_over_m(PINNFamily(sampling=sampling), problem())
    assert computed == pytest.approx(least, abs=0.5 * sd)


def test_the_path_ends_at_the_answer_in_the_units_of_the_problem() -> None:
    given = problem()
    estimate = PINNFamily().identify(given, np.random.default_rng(0))
    path, seconds = estimate.traces["path_parameters"], estimate.traces["path_cpu_s"]
    values = estimate.distribution.values()
    assert path[-1] == pytest.approx([values[name] for name in given.system.names], rel=1e-9)
    assert np.all(np.diff(seconds) >= 0)
    assert estimate.traces["path_loss"][-1] < 0.1 * estimate.traces["path_loss"][0]
    assert 0.0 <= float(estimate.traces["certificate"][0]) < 1e-3
    assert estimate.traces["minimum_parameters"] == pytest.approx(path[-1], rel=1e-2)


def test_an_unfinished_training_has_no_certificate_of_a_minimum() -> None:
    estimate = PINNFamily(optimizer="adam", budget=100.0).identify(problem(), np.random.default_rng(0))
    assert float(estimate.traces["certificate"][0]) > 1e-3
    assert float(estimate.traces["path_loss"][-1]) > 1.05 * float(estimate.traces["minimum_loss"][0])


def test_every_choice_has_a_name_a_source_and_code() -> None:
    assert set(weighting.COMPONENTS) == set(WEIGHTINGS)
    assert set(optimizers.COMPONENTS) == set(OPTIMIZERS)
    assert set(SAMPLERS) == set(SAMPLINGS)
    for choices in PINNFamily.card.choices.values():
        assert all(choice.title and choice.source for choice in choices.values())
        assert len({choice.title for choice in choices.values()}) == len(choices)
