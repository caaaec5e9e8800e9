"""Gradient sampling: the density of mcmc term by term, quadrature, and diagnostics that tell."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Estimate, Force, InitialState, Prior, Problem, Record, Status
from bench.dynamics.simulate import measurements
from bench.scenario.scenario import PriorSpec, Scenario
from bench.systems import SDOF, Chain, Duffing, System

pytest.importorskip("blackjax")
from bench import OutputError
from methods.sampling.log_posterior import log_density, prepare
from methods.sampling.nuts import NUTS, diagnostics
from methods.sampling.posterior import Posterior

NOMINAL = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})
PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
TWO = {"m1": 1.2, "m2": 0.9, "c1": 0.25, "c2": 0.2, "k1": 7.0, "k2": 11.0}
HARD = {"m": 1.2, "c": 0.5, "k": 6.0, "k3": 4.0}


def scenario(snr: float, **changes: object) -> Scenario:
    given = {"system": "sdof", "parameters": PLANT, "initial": ((0.8,), (0.5,)), "prior": NOMINAL, **changes}
    return Scenario(snr_db=snr, **given)


def sample(problem: Problem, seed: int = 0, **settings: object) -> Estimate:
    return NUTS(**settings).identify(problem, np.random.default_rng(seed))


def rich(system: System, p: dict[str, float], start: tuple[list[float], list[float]], linear: bool) -> Problem:
    """Two records: displacements from a told start under a force, and an accelerometer with an offset, start untold."""
    rng, state = np.random.default_rng(0), InitialState(*map(np.array, start))
    knots = np.linspace(0, 8, 33)
    push = Force(knots, 3.0 * np.sin(2.2 * knots) + 2.0 * np.cos(5.0 * knots), "linear" if linear else "zero_order")
    records = []
    for measures, forces, known in (("displacement", (push,), True), ("acceleration", (), False)):
        times = np.sort(rng.uniform(0.0, 8.0, 20))
        blanks = [Channel(times, times, measures, dof=i) for i in range(system.n_dof if known else 1)]
        clean = measurements(system, p, state, Record(tuple(blanks), forces)).reshape(len(blanks), -1)
        noisy = clean + 0.03 * np.std(clean) * rng.standard_normal(clean.shape) + 0.4 * (not known)
        channels = [Channel(times, y, measures, dof=i, offset=not known) for i, y in enumerate(noisy)]
        records.append(Record(tuple(channels), forces, state if known else None))
    return Problem(system, tuple(records), Prior(p, dict.fromkeys(p, 0.5)))


CASES = {
    "sdof": (SDOF(), PLANT, ([0.5], [0.0]), True),
    "chain": (Chain(2), TWO, ([0.5, -0.4], [0.0, 1.0]), False),
    "duffing": (Duffing(), HARD, ([0.9], [0.0]), True),
}


@pytest.mark.parametrize(
    "case", ["chain", *(pytest.param(name, marks=pytest.mark.slow) for name in ("sdof", "duffing"))]
)
def test_the_density_is_that_of_mcmc(case: str) -> None:
    """Term by term, at points about the mode: forces of both holds, uneven times, two sensors, an offset.

    The responses come from different code: modes in numpy, matrix exponentials and other steps in jax.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    given = rich(*CASES[case])
    problem = given.expressed_in(given.natural_units())
    model = OutputError(problem)
    mode = model.vector(dict(problem.prior.nominal))
    posterior = Posterior([model], [mode])
    layout, data = prepare(posterior)
    rng = np.random.default_rng(3)
    centre = np.concatenate([mode, np.log(0.1 * model.rms)])
    points = centre + 0.05 * rng.standard_normal((6, centre.size)) * np.maximum(np.abs(centre), 0.02)
    expected = posterior(points)
    computed = np.array([float(log_density(layout, data, point)) for point in points])
    np.testing.assert_allclose(computed - computed[0], expected - expected[0], rtol=2e-4, atol=2e-3)


@pytest.mark.slow
def test_a_nonlinear_system_holds_the_truth() -> None:
    made = scenario(25.0, system="duffing", parameters=HARD, initial=((0.9,), (0.0,)), samples=25, duration=6.0)
    problem, _ = made.replicates(0, 1)[0]
    estimate = sample(problem)
    for group in problem.system.groups:
        marginal = estimate.marginal(group)
        assert marginal is not None, estimate.message
        low, high = marginal.interval(0.999)
        assert low < group.value(HARD) < high


@pytest.mark.slow
def test_a_chain_that_is_too_short_is_a_failure_with_a_sentence() -> None:
    problem, _ = scenario(20.0).replicates(0, 1)[0]
    estimate = sample(problem, blocks=1, effective=1e5)  # of 1200 draws; as long as elsewhere: compiled already
    assert estimate.status is Status.DIVERGED
    assert "not converged" in estimate.message
    assert "R-hat" in estimate.message


@pytest.mark.slow
def test_diagnostics_tell_chains_apart() -> None:
    rng = np.random.default_rng(0)
    still = np.zeros((4, 300), bool)
    mixed = rng.standard_normal((4, 300, 3))
    assert NUTS()._converged(diagnostics(mixed, still))
    # independent draws: as many effective as there are, up to the error of the estimate
    assert diagnostics(mixed, still)["effective_sample_size"] == pytest.approx(1200, rel=0.3)
    apart = mixed.copy()
    apart[1, :, 1] += 1.0
    assert diagnostics(apart, still)["r_hat"] > 1.05
    slow = np.cumsum(mixed, axis=1)
    assert diagnostics(slow, still)["effective_sample_size"] < 100
    stuck = mixed.copy()
    stuck[..., 0] = 1.0
    assert diagnostics(stuck, still)["r_hat"] == np.inf
    assert not NUTS()._converged(diagnostics(mixed, np.ones((4, 300), bool)))
