"""Two masses, a sensor on the first only: what its displacement tells, by hand, and what fits make of it.

The chain is ``m1 x1'' + (c1 + c2) x1' - c2 x2' + (k1 + k2) x1 - k2 x2 = 0`` and
``m2 x2'' + c2 (x2' - x1') + k2 (x2 - x1) = 0``. Laplace-transformed, with x(0) and v(0) the start::

    [ m1 s² + (c1 + c2) s + k1 + k2    -(c2 s + k2)      ] [X1]   [ m1 (s x1(0) + v1(0)) + (c1 + c2) x1(0) - c2 x2(0) ]
    [ -(c2 s + k2)                     m2 s² + c2 s + k2 ] [X2] = [ m2 (s x2(0) + v2(0)) + c2 (x2(0) - x1(0))         ]

By Cramer's rule ``X1 = N(s) / D(s)``, both over m1 m2, with D = s⁴ + d3 s³ + d2 s² + d1 s + d0, where

    d3 = (c1 + c2)/m1 + c2/m2                   minus the sum of the poles
    d2 = (k1 + k2)/m1 + k2/m2 + c1 c2/(m1 m2)   (the terms in c2² cancel)
    d1 = (c1 k2 + c2 k1)/(m1 m2)                (the terms in c2 k2 cancel)
    d0 = k1 k2/(m1 m2)                          the product of the squared natural frequencies

**Start unknown.** N has four coefficients, which the four unknown initial values set at will: N tells nothing. So the
data tell d0 to d3, four numbers, of six parameters: two directions are lost. One is the scale of everything; the other,
along which the ratios to m1 change while D stays, is no scaling. None of the five ratios is told.

Weighing both masses leaves four equations for c1, c2, k1, k2, but not one solution: without damping d2 and d0 are
``k1 + (1 + m1/m2) k2 = m1 d2`` and ``k1 k2 = m1 m2 d0``, a quadratic. Of the chain of these tests (masses 1 and 0.8 kg,
springs 12 and 9 N/m) ``2.25 k2² - 32.25 k2 + 108 = 0``: k2 = 9 or 16/3, and k1 = 12 or 20.25. A fit may end at either,
each with an interval of its own; the bound, which is local, knows of one.

**Start known**, the first mass released from rest at 1: ``N = s³ + d3 s² + n1 s + n0`` with

    n1 = c1 c2/(m1 m2) + k2/m2,   n0 = c1 k2/(m1 m2)

Then ``d1 - n0 = c2 k1/(m1 m2)``, and over d0 this is ``r = c2/k2``. ``n0 r`` is c1 c2/(m1 m2), so that
``k2/m2 = n1 - n0 r``; from it c1/m1 = n0/(k2/m2), c2/m2 = r k2/m2, k1/m1 = d0/(k2/m2), and d3 and d2 leave c2/m1 and
k2/m1: all five ratios (and ``m2/m1 = (k2/m1)/(k2/m2) = (c2/m1)/(c2/m2)`` twice over). Only the scale is lost.

**With a prior** the most probable parameters θ (logarithms) have ``gradient of the misfit + P (θ - nominal) = 0``, P
the prior's precision. Along a direction w that neither D nor N feels the misfit has no gradient, so
``w · P (θ - nominal) = 0`` whatever the data: there the estimate is the prior's.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from bench.config.experiment import expand
from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Problem
from bench.entrants.reference import oracle_estimate
from bench.entrants.registry import make_method
from bench.information.fisher import information
from bench.scenario.scenario import METHOD, Scenario
from bench.scenario.truth import Truth
from bench.systems import Chain

NAMES = ("m1", "m2", "c1", "c2", "k1", "k2")
Told = Literal["known", "unknown"]


def told_coefficients(logs: np.ndarray, told: Told) -> np.ndarray:
    """Logarithms of d3, d2, d1, d0, and of n1, n0 where the start is known, by the log-parameters ``logs`` (6,)."""
    m1, m2, c1, c2, k1, k2 = np.exp(logs)
    mm = m1 * m2
    found = [(c1 + c2) / m1 + c2 / m2, (k1 + k2) / m1 + k2 / m2 + c1 * c2 / mm, (c1 * k2 + c2 * k1) / mm, k1 * k2 / mm]
    if told == "known":
        found += [c1 * c2 / mm + k2 / m2, c1 * k2 / mm]
    return np.log(found)


def slopes(logs: np.ndarray, told: Told) -> np.ndarray:
    """Their derivatives by the log-parameters, by central differences (error about 1e-10)."""
    step = 1e-5 * np.eye(6)
    pairs = [(told_coefficients(logs + e, told), told_coefficients(logs - e, told)) for e in step]
    return np.array([(up - down) / 2e-5 for up, down in pairs]).T


def lost(logs: np.ndarray, told: Told) -> np.ndarray:
    """The directions that these do not feel, orthonormal rows: two, or one where the start is known."""
    _, sizes, rows = np.linalg.svd(slopes(logs, told))
    return np.asarray(rows[int(np.sum(sizes > 1e-6 * sizes[0])) :])


def scenario(told: Told) -> Scenario:
    arguments = ["method=prior", "system=chain2_first", f"initial_state={told}", "snr=40"]
    return expand(arguments, multirun=False)[0].scenario


def fit(name: str, problem: Problem, truth: Truth, rng: np.random.Generator) -> Estimate:
    if name == "oracle":
        return oracle_estimate(problem, truth)
    return make_method(name, {}).identify(problem, rng)


@pytest.mark.parametrize(("told", "directions"), [("unknown", 2), ("known", 1)])
def test_the_information_loses_the_directions_that_are_lost_by_hand(told: Told, directions: int) -> None:
    """The Fisher information knows nothing of N and D; its null space is theirs, and holds the scale in both cases."""
    cell = scenario(told)
    truth = np.log([cell.parameters[name] for name in NAMES])
    by_hand, found = lost(truth, told), information(cell).null_space
    assert by_hand.shape == found.shape == (directions, 6)
    assert np.allclose(found @ by_hand.T @ by_hand, found, atol=1e-4)  # the same span
    ones = np.ones(6) / np.sqrt(6)
    assert np.allclose(by_hand.T @ by_hand @ ones, ones)
    told_ratios = [np.allclose(by_hand @ group.vector(NAMES), 0.0, atol=1e-6) for group in Chain(2).groups]
    assert told_ratios == [told == "known"] * 5


@pytest.mark.parametrize("told", ["unknown", "known"])
@pytest.mark.parametrize("name", ["oracle", "output_error", "shooting"])
def test_fits_find_the_coefficients_and_leave_the_rest_to_the_prior(name: str, told: Told) -> None:
    """On three data sets at 40 dB each coefficient's logarithm is off by about its bound, far less than the prior's is.

    Along the lost directions the estimate is the prior's, to a hundredth of the prior's own standard deviation there.
    """
    if name == "shooting":
        pytest.importorskip("casadi")
    cell = scenario(told)
    true = np.log([cell.parameters[name] for name in NAMES])
    gradient = slopes(true, told)
    bound = np.sqrt(np.diag(gradient @ information(cell).covariance[:6, :6] @ gradient.T))
    off, off_before = [], []
    for i, (problem, truth) in enumerate(cell.replicates(0, 3)):
        estimate = fit(name, problem, truth, cell.stream(METHOD, 0, i))
        assert estimate.status is Status.OK
        values, nominal = estimate.parameters.values(), problem.prior.nominal
        logs, before = np.log([values[n] for n in NAMES]), np.log([nominal[n] for n in NAMES])
        off.append((told_coefficients(logs, told) - told_coefficients(true, told)) / bound)
        off_before.append((told_coefficients(before, told) - told_coefficients(true, told)) / bound)
        spread = np.array([problem.prior.log_sds[problem.prior.names.index(n)] for n in NAMES])
        directions = lost(logs, told)
        pull, unit = directions @ ((logs - before) / spread**2), np.sqrt(directions**2 @ spread**-2.0)
        assert np.all(np.abs(pull) < 0.01 * unit)
    rms, rms_before = (np.sqrt(np.mean(np.square(part))) for part in (off, off_before))
    assert 0.2 < rms < 2.0
    assert rms_before > 20.0 * rms
