"""The posterior Cramér-Rao bound, against a closed form, the batch bound and the spread of an efficient tracker."""

import numpy as np
import pytest

from bench.online.bound import OPEN_LOG_SD, bound_variances, riccati
from bench.online.course import Course
from bench.online.forces import HeldForce
from bench.online.scenario import OnlineScenario

SDOF = {"m": 1.3, "c": 0.6, "k": 25.0}


def scenario(**changes) -> OnlineScenario:
    stated = {
        "label": "x",
        "system": "sdof",
        "parameters": SDOF,
        "rate": 10.0,
        "samples": 200,
        "forces": (HeldForce(),),
    }
    return OnlineScenario(**(stated | changes))


def test_with_constant_parameters_it_is_the_batch_bound_at_the_end() -> None:
    """By finite differences of the sampled response from an integrator of its own: (S'S/sigma² + prior)^-1."""
    made = scenario()
    stream = made.stream(0, 0)
    names, times = made.make_system().names, stream.times

    def response(logs: np.ndarray, start: np.ndarray) -> np.ndarray:
        p = dict(zip(names, np.exp(logs), strict=True))
        a = np.array([[0.0, 1.0], [-p["k"] / p["m"], -p["c"] / p["m"]]])
        lam, v = np.linalg.eig(a)
        inverse = np.linalg.inv(v)
        step = (v @ np.diag(np.exp(lam * 0.1)) @ inverse).real
        push = (v @ np.diag((np.exp(lam * 0.1) - 1) / lam) @ inverse).real @ np.array([0.0, 1.0 / p["m"]])
        path = [start]
        for f in stream.truth.known[:-1, 0]:
            path.append(step @ path[-1] + push * f)
        return np.array(path)[:, 0]

    logs = np.log([SDOF[name] for name in names])
    at = np.concatenate([logs, np.zeros(2)])
    slopes = np.empty((times.size, 5))
    for i in range(5):
        h = np.zeros(5)
        h[i] = 1e-5
        up, down = (response((at + sign * h)[:3], (at + sign * h)[3:]) for sign in (1, -1))
        slopes[:, i] = (up - down) / 2e-5
    size = 10.0 * np.sqrt(np.mean(stream.truth.motion**2, axis=0))
    prior = np.diag(1.0 / np.concatenate([np.full(3, OPEN_LOG_SD), size]) ** 2)
    covariance = np.linalg.inv(slopes.T @ slopes / stream.truth.sigma[0] ** 2 + prior)
    found = bound_variances(made, stream)
    for i, name in enumerate(names):
        assert found[name][-1] == pytest.approx(covariance[i, i], rel=2e-3)
    w = np.array([-1.0, 0.0, 1.0])
    assert found["k_over_m"][-1] == pytest.approx(w @ covariance[:3, :3] @ w, rel=2e-3)


def test_a_walk_seen_through_white_noise_has_the_variance_of_the_scalar_riccati_equation() -> None:
    """Linear and Gaussian, closed form: p = (q + sqrt(q² + 4 q r)) / 2 before a sample, p r / (p + r) after it."""
    q, r, n = 0.03, 0.5, 400
    one = np.eye(1)
    found = riccati(np.tile(one, (n, 1, 1)), np.tile(one, (n, 1, 1)), np.full((n, 1), q), one * 1e4, one * r)
    before = 0.5 * (q + np.sqrt(q * q + 4 * q * r))
    assert found[-1, 0, 0] == pytest.approx(before * r / (before + r), rel=1e-9)


def test_behind_a_step_it_opens_by_the_step_and_closes_again() -> None:
    made = scenario(varying={"k": Course("step", change=-0.2)}, samples=400)
    assert made.change_at == 200
    found = np.sqrt(bound_variances(made, made.stream(0, 0))["k"])
    assert found[200] > 5 * found[198]
    assert found[200] <= 1.01 * np.hypot(found[198], abs(np.log(0.8)))
    assert found[-1] < 2.5 * found[198]
