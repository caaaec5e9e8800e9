"""Errors expected from longer, denser or less noisy records, compared with closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.contract.estimate import Status
from bench.contract.problem import Channel, Force, Problem, Record
from bench.entrants.registry import make_method
from bench.likelihood.autoregression import Autoregression
from bench.records.finding import Finding
from bench.records.identification import assess
from bench.records.linearised_fit import LinearisedFit
from bench.records.problem import Measured
from bench.records.what_if import WhatIf, what_if
from bench.scenario.truth import closed_form
from bench.systems.linear import SDOF

P = {"m": 1.0, "c": 0.002, "k": 40.0}
GROUPS = {"k_over_m", "c_over_m", "natural_frequency", "damping_ratio"}


def fitted(times: np.ndarray, force: Force | None = None, colour: float = 0.0, c: float = P["c"]) -> Finding:
    noise = Autoregression(np.array([colour]), 0.02**2 * (1 - colour**2)).drawn(times.size, np.random.default_rng(0))
    x = np.sin(4.0 * times) / 24.0 if force else closed_form({**P, "c": c}, 1.0, 0.0, times)
    problem = Problem(SDOF(), (Record((Channel(times, x + noise, offset=True),), (force,) if force else ()),))
    estimate = make_method("output_error", {}).identify(problem, np.random.default_rng(0))
    assert estimate.status is Status.OK
    return assess("output_error", Measured((), problem, ()), estimate)


def with_noise(finding: Finding, noise: Autoregression) -> Finding:
    """Return the finding with a known noise model, so that its order is not random."""
    fit = finding.fit
    assert fit is not None
    known = Autoregression(noise.coefficients, noise.variance * float(fit.sigma[0]) ** 2)
    return replace(finding, fit=LinearisedFit(fit.model, fit.theta, fit.residuals, fit.slopes, (known,)))


WHITE = Autoregression(np.zeros(0), 1.0)


@pytest.fixture(scope="module")
def free() -> tuple[WhatIf, ...]:
    return what_if(with_noise(fitted(np.arange(301) / 30.0), WHITE))


def test_three_changes_of_the_groups(free: tuple[WhatIf, ...]) -> None:
    assert [change.change for change in free] == ["another 10 s", "twice the sampling rate", "half the noise"]
    for change in free:
        assert set(change.relative_errors) == set(change.today) == GROUPS


def test_half_the_noise_halves_the_error(free: tuple[WhatIf, ...]) -> None:
    for name in GROUPS:
        assert free[2].relative_errors[name] == pytest.approx(free[2].today[name] / 2.0, rel=1e-6)


def test_twice_the_duration_of_an_undamped_sine_reduces_the_error_of_its_frequency_by_two_to_the_three_halves(
    free: tuple[WhatIf, ...],
) -> None:
    """The bound on a frequency falls like T^-3/2 (D. C. Rife, R. R. Boorstyn, IEEE Trans. Inf. Theory 20:591, 1974)."""
    gain = free[0].today["natural_frequency"] / free[0].relative_errors["natural_frequency"]
    assert gain == pytest.approx(2.0**1.5, rel=0.03)


def test_twice_the_samples_of_white_noise_gain_a_root_of_two(free: tuple[WhatIf, ...]) -> None:
    for name in GROUPS:
        assert free[1].today[name] / free[1].relative_errors[name] == pytest.approx(2.0**0.5, rel=0.02)


def test_the_bound_of_a_sine(free: tuple[WhatIf, ...]) -> None:
    """``var(w) = 24 s² / (A² N T²)`` for a sine of unknown phase and amplitude."""
    finding = fitted(np.arange(301) / 30.0)
    assert finding.fit is not None
    sigma = float(finding.fit.sigma[0]) * finding.problem.natural_units().length
    bound = np.sqrt(24.0 * sigma**2 / (301 * 10.0**2)) / np.sqrt(P["k"])
    assert free[0].today["natural_frequency"] == pytest.approx(bound, rel=0.03)


def test_denser_samples_of_strongly_correlated_noise_do_not_help() -> None:
    slow = Autoregression(np.array([0.995]), 1.0 - 0.995**2)
    finding = with_noise(fitted(np.arange(301) / 30.0, c=0.3), slow)
    denser = what_if(finding)[1]
    for name in GROUPS:
        assert denser.relative_errors[name] == pytest.approx(denser.today[name], rel=0.05)


def test_today_is_the_error_by_the_autoregression() -> None:
    finding = fitted(np.arange(200) / 10.0, colour=0.8, c=0.3)
    fit = finding.fit
    assert fit is not None
    covariance = replace(fit, known_noises=fit.noises).coloured
    assert covariance is not None
    for change in what_if(finding):
        for name, error in change.today.items():
            g = fit.gradient(finding.problem.system.quantity(name))
            assert error == pytest.approx(float(np.sqrt(g @ covariance @ g)), rel=1e-6)


@pytest.mark.slow
def test_a_force_is_repeated_and_times_may_be_uneven() -> None:
    times = np.sort(np.random.default_rng(1).uniform(0.0, 12.0, 150))
    pushed = np.arange(121) / 10.0
    finding = fitted(times, Force(pushed, np.sin(4.0 * pushed)), c=0.3)
    longer, denser, quieter = what_if(finding)
    assert longer.change == "another 10 s, with the force repeated"
    assert {"m", "c", "k"} < set(longer.relative_errors)
    for change in (longer, denser, quieter):
        assert all(error < change.today[name] for name, error in change.relative_errors.items())


def test_a_short_record_is_doubled() -> None:
    finding = fitted(np.arange(301) / 30.0)
    milli = replace(finding.problem.records[0].channels[0], times=np.arange(301) / 30e3)
    problem = replace(finding.problem, records=(replace(finding.problem.records[0], channels=(milli,)),))
    estimate = make_method("output_error", {}).identify(problem, np.random.default_rng(0))
    quick = assess("output_error", Measured((), problem, ()), estimate)
    assert what_if(quick)[0].change == "another 0.01 s"
