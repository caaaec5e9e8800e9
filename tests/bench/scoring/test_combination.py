"""The prior joins groups once, at the posterior mode, whatever the sign of the groups."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from bench import Estimate, Normal, Prior, Status
from bench.scoring.combination import combine_with_prior
from bench.systems import SDOF, Chain

PRIOR = Prior({"m": 1.05, "c": 0.9, "k": 6.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
NAMES = ("k_over_m", "c_over_m")


def combined(mean: list[float], covariance: np.ndarray | None, prior: Prior = PRIOR) -> Normal:
    groups = Normal(NAMES, np.array(mean), covariance, log=False, dof=21)
    result = combine_with_prior(Estimate(SDOF(), groups=groups), prior)
    assert isinstance(result.parameters, Normal)
    assert result.groups is None
    assert result.parameters.log
    assert result.parameters.dof == 21
    return result.parameters


def brute_force_mode(mean: list[float], covariance: np.ndarray, prior: Prior) -> np.ndarray:
    """The highest point of the log-posterior on a grid over (log m, log c, log k) that shrinks around it."""
    inverse = np.linalg.inv(covariance)
    centre, half = prior.log_mean.copy(), np.array([0.2, 6.0, 3.0])
    for _ in range(60):
        axes = [np.linspace(c - h, c + h, 21) for c, h in zip(centre, half, strict=True)]
        m, c, k = (np.exp(grid) for grid in np.meshgrid(*axes, indexing="ij"))
        miss = np.stack([k / m - mean[0], c / m - mean[1]], -1)
        cost = np.einsum("...i,ij,...j->...", miss, inverse, miss)
        for value, name in ((m, "m"), (c, "c"), (k, "k")):
            cost = cost + (np.log(value / prior.nominal[name]) / prior.log_sd[name]) ** 2
        best = np.unravel_index(np.argmin(cost), cost.shape)
        centre = np.array([axis[i] for axis, i in zip(axes, best, strict=True)])
        half = 0.7 * half
    return centre


@pytest.mark.parametrize(
    ("mean", "sds", "correlation"),
    [
        ([8.0, 0.4], [0.1, 0.05], 0.3),
        ([8.0, -0.1], [0.1, 0.2], 0.0),
        ([8.0, -0.1], [0.1, 0.2], 0.8),
        ([-3.0, -1.0], [4.0, 0.5], -0.5),
        ([40.0, 5.0], [10.0, 5.0], 0.5),
        ([7.0, 3.0], [3.0, 0.1], 0.0),
    ],
)
def test_the_result_is_the_posterior_mode(mean: list[float], sds: list[float], correlation: float) -> None:
    off = correlation * sds[0] * sds[1]
    covariance = np.array([[sds[0] ** 2, off], [off, sds[1] ** 2]])
    found = combined(mean, covariance)
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0)
    miss = (found.mean - brute_force_mode(mean, covariance, PRIOR)) / np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(miss, 0.0, atol=1e-3)  # a thousandth of a standard deviation


def test_precise_groups_are_a_linear_gaussian_measurement_of_log_ratios() -> None:
    """As S -> 0, log g is normal with covariance S / (g g'), and mean and covariance are those of linear Gaussian
    conditioning: ``K = P B' (B P B' + R)^-1``."""
    mean, covariance = np.array([7.5, 0.42]), np.array([[4e-8, 1e-10], [1e-10, 9e-10]])
    found = combined(list(mean), covariance)
    b = np.array([[-1.0, 0.0, 1.0], [-1.0, 1.0, 0.0]])
    p, r = np.diag(PRIOR.log_sds**2), covariance / np.outer(mean, mean)
    gain = p @ b.T @ np.linalg.inv(b @ p @ b.T + r)
    np.testing.assert_allclose(found.mean, PRIOR.log_mean + gain @ (np.log(mean) - b @ PRIOR.log_mean), atol=1e-6)
    np.testing.assert_allclose(found.covariance, p - gain @ b @ p, rtol=1e-3, atol=1e-9)


def test_groups_that_say_nothing_leave_the_prior_and_count_it_once() -> None:
    found = combined([8.0, 0.4], np.diag([1e12, 1e12]))
    np.testing.assert_allclose(found.mean, PRIOR.log_mean, atol=1e-6)
    np.testing.assert_allclose(found.covariance, np.diag(PRIOR.log_sds**2), rtol=1e-6, atol=1e-9)


def test_what_is_not_to_be_combined_is_left_alone() -> None:
    groups = Normal(NAMES, np.array([8.0, 0.4]), None, log=False)
    without_prior = Estimate(SDOF(), groups=groups)
    assert combine_with_prior(without_prior, None) is without_prior
    failed = Estimate.failed(SDOF(), Status.DIVERGED, "no")
    assert combine_with_prior(failed, PRIOR) is failed
    native = Estimate(SDOF(), parameters=Normal(("m", "c", "k"), np.zeros(3), None, log=True))
    assert combine_with_prior(native, PRIOR) is native


@pytest.mark.parametrize("signs", list(itertools.product([1, -1], repeat=2)))
def test_a_chain_with_groups_of_any_sign_gives_positive_finite_parameters(signs: tuple[int, int]) -> None:
    system = Chain(2)
    prior = Prior(dict.fromkeys(system.names, 1.0), dict.fromkeys(system.names, 0.5))
    names = tuple(group.name for group in system.groups)
    mean = np.array([0.8, 0.2 * signs[0], 0.15, 12.0 * signs[1], 9.0])
    groups = Normal(names, mean, np.diag((0.1 * np.abs(mean)) ** 2), log=False)
    result = combine_with_prior(Estimate(system, groups=groups), prior).checked()
    assert result.status is Status.OK
    assert isinstance(result.parameters, Normal)
    assert all(value > 0 for value in result.parameters.values().values())
    if signs == (1, 1):
        assert result.parameters.values()["k2"] / result.parameters.values()["m1"] == pytest.approx(9.0, rel=0.1)
