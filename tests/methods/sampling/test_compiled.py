"""Compiled output error of a sampler: many sets at once have the response of each alone."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, InitialState, OutputError, Prior, Problem, Record
from bench.systems import BoucWen
from methods.sampling.posterior import Compiled

pytest.importorskip("jax")
BOUC_WEN = {"m": 1.1, "c": 0.35, "k": 4.5, "kz": 7.0, "beta": 1.1, "gamma": 0.8}


def test_many_predictions_of_a_hidden_state_are_those_of_few() -> None:
    """Enough sets to be compiled, and one at a time, which are integrated by adaptive steps of another order."""
    times = np.linspace(0.0, 2.0, 20)
    record = Record((Channel(times, np.cos(times)),), initial_state=InitialState([1.5], [0.0]))
    prior = Prior(BOUC_WEN, dict.fromkeys(BOUC_WEN, 0.5))
    problem = Problem(BoucWen(), (record,), prior)
    model, plain = Compiled(problem), OutputError(problem)
    theta = np.log(list(BOUC_WEN.values())) + 0.2 * np.random.default_rng(4).standard_normal((9, 6))
    np.testing.assert_allclose(model.predict(theta), [plain.predict(part) for part in theta], atol=3e-5)
