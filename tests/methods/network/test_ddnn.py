"""The data-driven network against functions that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Problem, Record
from bench.systems import SDOF
from methods.network.ddnn import DDNN, Smoother

torch = pytest.importorskip("torch")

FAST = DDNN(iterations=30, draws=30)


def sine(noise: float, n: int = 30, seed: int = 0) -> Problem:
    t = np.linspace(0.0, 5.0, n)
    y = np.sin(4.0 * t + 0.3) + noise * np.random.default_rng(seed).standard_normal(n)
    return Problem(SDOF(), (Record((Channel(t, y),)),))


def test_reconstructs_a_sine_and_its_frequency() -> None:
    estimate = FAST.identify(sine(0.01), np.random.default_rng(0))
    times = np.linspace(0.0, 5.0, 101)
    error = estimate.reconstructions[0](times)[0] - np.sin(4.0 * times + 0.3)
    assert np.sqrt(np.mean(error**2)) < 0.02
    values = estimate.groups.values()
    assert values["k_over_m"] == pytest.approx(16.0, rel=0.03)
    assert abs(values["c_over_m"]) < 0.3


def test_noise_is_estimated_not_told() -> None:
    levels = [FAST.identify(sine(noise, n=60), np.random.default_rng(0)).traces["sigma"][-1] for noise in (0.03, 0.3)]
    root = np.sqrt(np.mean(sine(0.0, 60).records[0].channels[0].values ** 2))
    assert levels[0] * root == pytest.approx(0.03, rel=0.5)
    assert levels[1] * root == pytest.approx(0.3, rel=0.5)


def test_draws_have_the_posterior_of_the_linear_model() -> None:
    """Spread of the drawn x(t) at the samples against the textbook Gaussian posterior, from an explicit Jacobian."""
    record = sine(0.2, n=12).records[0]
    with torch.no_grad():
        smoother = Smoother(record, 1, 16, 2, 3.0, np.random.default_rng(0))
        smoother.fit(20)
        tape, _ = smoother.errors(smoother.theta)
        jacobian = (smoother.jacobian(tape) * smoother.scale[:, None]).numpy()
        prior = jacobian @ np.diag(smoother.spread().numpy() ** 2) @ jacobian.T
        noise = np.diag((smoother.sigma * smoother.scale.numpy()) ** 2)
        expected = prior - prior @ np.linalg.solve(prior + noise, prior)
        drawn = smoother.paths(record.channels[0].times, 4000, np.random.default_rng(1))[1:, 0, :, 0]
    np.testing.assert_allclose(np.cov(drawn, rowvar=False), expected, atol=0.1 * expected.max())
