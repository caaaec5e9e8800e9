"""Answers that hold other basins, against the arithmetic of aliases."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from bench import Channel, Estimate, InitialState, Normal, OutputError, Prior, Problem, Record
from bench.entrants.registry import make_method
from bench.scenario.truth import closed_form
from bench.scoring.combination import combine_with_prior
from bench.systems import SDOF, BoucWen, Chain
from methods.starts.band import natural_frequencies
from methods.starts.evidence import basins

RATE, DECAY, MASS = 2 * np.pi * 1.3, 0.08, 2.0
"""Damped rate (rad/s) and decay (1/s) of the motion that is sampled."""
TRUE = {"m": MASS, "c": 2 * DECAY * MASS, "k": MASS * (RATE**2 + DECAY**2)}
STEP = 1.0 / (1.6 * 1.3)
"""1.6 samples a cycle."""


def sampled(
    nominal_hz: float | None, step: float = STEP, n: int = 40, log_sd: float = 0.3, noise: float = 0.02
) -> Problem:
    """A free decay from an initial state that is not known, with a prior about a frequency or none."""
    times = step * np.arange(n)
    values = closed_form(TRUE, 0.3, -1.0, times)
    values = values + noise * np.std(values) * np.random.default_rng(5).standard_normal(n)
    prior = None
    if nominal_hz is not None:
        nominal = {"m": MASS, "c": 0.4, "k": MASS * (2 * np.pi * nominal_hz) ** 2}
        prior = Prior(nominal, {"m": 0.02, "c": 1.0, "k": log_sd})
    return Problem(SDOF(), (Record((Channel(times, values),)),), prior)


def answer(method: str, problem: Problem) -> Estimate:
    return make_method(method, {}).identify(problem, np.random.default_rng(0))


def damped_rate(estimate: Estimate) -> float:
    p = estimate.parameters.values()
    return float(np.sqrt(p["k"] / p["m"] - (p["c"] / p["m"] / 2) ** 2))


@pytest.mark.parametrize("method", ["shooting", "output_error", "frequency", "collocation", "mcmc"])
def test_a_searching_method_names_the_alias_that_fits_as_well(method: str) -> None:
    """At even steps ``w`` and ``2 pi / step - w`` go through the same points; the prior lies between both."""
    problem = sampled(nominal_hz=1.02)
    estimate = combine_with_prior(answer(method, problem), problem.prior)
    rates = sorted(damped_rate(part) for part in (estimate, *estimate.alternatives))
    assert rates == pytest.approx([2 * np.pi / STEP - RATE, RATE], rel=2e-3)
    assert estimate.weight + sum(part.weight for part in estimate.alternatives) == pytest.approx(1.0)
    assert "Hz (" in estimate.message
    marginal = estimate.marginal(estimate.system.quantity("natural_frequency"))
    pieces = marginal.intervals(0.95)
    assert len(pieces) == 2
    assert any(low <= 1.3 <= high for low, high in pieces)
    assert marginal.interval(0.95) == (pieces[0][0], pieces[1][1])
    assert all(high - low < 0.02 for low, high in pieces)


@pytest.mark.parametrize("method", ["output_error", "mcmc"])
def test_the_basin_below_half_the_sampling_rate_is_first_unless_clearly_less_probable(method: str) -> None:
    problem = sampled(nominal_hz=1.08)
    estimate = answer(method, problem)
    assert damped_rate(estimate) == pytest.approx(2 * np.pi / STEP - RATE, rel=2e-3)
    assert 0.05 < estimate.weight < 0.4
    times = np.linspace(0.0, 5.0, 200)
    path = estimate.reconstructions[0](times)[0]
    turns = np.sum(path[1:] * path[:-1] < 0)
    assert turns == pytest.approx(2 * 5.0 * (1 / STEP - 1.3), abs=1.01)  # its own response, and no mean of both


def test_a_wave_at_half_the_sampling_rate_has_no_evidence() -> None:
    """Its velocity is seen by no sample, so that the volume of its basin would be infinite."""
    problem = sampled(nominal_hz=2.0, step=0.14, n=25, noise=0.3)
    model = OutputError(problem.expressed_in(problem.natural_units()))
    step = np.diff(model.problem.records[0].channels[0].times)[0]
    shown = {"m": 1.0, "c": 0.5, "k": (2 * np.pi * 1.3 * 0.14 / step) ** 2}
    hidden = {"m": 1.0, "c": 0.5, "k": (np.pi / step) ** 2}
    starts = np.stack([model.vector(p) for p in (hidden, shown)])
    (ends,) = basins([model], [starts])
    rates = np.sqrt(np.exp(ends.thetas[:, 2] - ends.thetas[:, 0]))
    assert ends.evidence.size == 1
    assert rates[0] < 0.9 * np.pi / step


def test_the_weights_are_those_of_the_prior_and_of_the_volumes() -> None:
    """Basins that fit alike have the odds of their prior, times the ratio of their volumes.

    In parameters (log k, log c, x0, v0) the data decide k by ``delta log k = 2 delta w / w`` and the start by
    ``delta v0 = w delta b``, so that the ratio of volumes of two rates is 1; damping has the same prior in both.
    """
    problem = sampled(nominal_hz=1.02)
    estimate = answer("shooting", problem)
    (other,) = estimate.alternatives
    nominal = np.log(problem.prior.nominal["k"])
    logs = [np.log(MASS * (damped_rate(part) ** 2 + DECAY**2)) for part in (estimate, other)]
    odds = np.exp(0.5 * ((logs[1] - nominal) ** 2 - (logs[0] - nominal) ** 2) / (0.3**2 + 0.02**2))
    assert estimate.weight / other.weight == pytest.approx(odds, rel=0.1)


@pytest.mark.parametrize(("nominal_hz", "expected"), [(0.75, 2 * np.pi / STEP - RATE), (1.35, RATE)])
def test_the_prior_decides_between_aliases(nominal_hz: float, expected: float) -> None:
    estimate = answer("shooting", sampled(nominal_hz, log_sd=0.1))
    assert damped_rate(estimate) == pytest.approx(expected, rel=2e-3)
    assert estimate.alternatives == ()


def test_a_known_initial_state_decides_between_aliases() -> None:
    """The same samples from another initial velocity: an alias has ``v0`` scaled with its rate."""
    problem = sampled(nominal_hz=1.02)
    record = Record(problem.records[0].channels, (), InitialState(np.array([0.3]), np.array([-1.0])))
    estimate = answer("shooting", Problem(problem.system, (record,), problem.prior))
    assert damped_rate(estimate) == pytest.approx(RATE, rel=2e-3)
    assert estimate.alternatives == ()


def test_a_well_sampled_answer_has_no_alternatives() -> None:
    estimate = answer("shooting", sampled(nominal_hz=1.2, step=0.1))
    assert (estimate.alternatives, estimate.weight, estimate.message) == ((), 1.0, "")


@pytest.mark.parametrize("method", ["shooting", "matrix_pencil", "iqml", "ar", "era", "frequency"])
def test_an_answer_without_a_prior_names_its_band_and_its_alias(method: str) -> None:
    """2.08 samples a second: below 1.04 Hz, and 1.3 Hz looks like 0.78 Hz."""
    message = answer(method, sampled(nominal_hz=None)).message
    assert "below 1.04 Hz" in message
    assert "1.3 Hz" in message
    assert "0.78 Hz" in message or "0.779 Hz" in message


def test_samples_that_are_many_a_cycle_need_no_word_on_the_band() -> None:
    assert "half the sampling rate" not in answer("matrix_pencil", sampled(nominal_hz=None, step=0.1)).message


@pytest.mark.parametrize(("step", "warned"), [(0.5, True), (0.05, False)])
def test_hidden_states_are_not_searched_and_the_answer_says_so(step: float, warned: bool) -> None:
    """A stiffness of 40 on a mass of 1 is 1 Hz, known to a factor of 1.6 at one standard deviation."""
    times, names = step * np.arange(9), BoucWen().names
    prior = Prior(dict(zip(names, [1.0, 0.3, 40.0, 15.0, 2.0, 1.0], strict=True)), dict.fromkeys(names, 0.5))
    problem = Problem(BoucWen(), (Record((Channel(times, np.cos(times)),)),), prior)
    estimate = Estimate(problem.system, Normal(names, np.log(list(prior.nominal.values())), None, log=True))
    (completed,) = make_method("shooting", {}).completed([problem], [estimate])
    assert ("other frequencies were not searched for" in completed.message) is warned


def chain_sampled_rarely(seed: int) -> tuple[Problem, np.ndarray]:
    """Two masses of 1.6 and 4.9 Hz at 0.98 samples a cycle of the slower one, and their natural frequencies (Hz).

    The free motion is that of the matrix exponential.
    """
    mass, damping, stiffness = (
        np.diag([3.7642, 3.6088]),
        np.array([[3.755, -2.3437], [-2.3437, 2.3437]]),
        np.array([[2365.88, -1476.7], [-1476.7, 1476.7]]),
    )
    inverse = np.linalg.inv(mass)
    matrix = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ damping]])
    times, start = np.linspace(0.0, 11.967, 20), np.array([0.33674, -0.12103, 0.0, 0.0])
    motion = np.array([expm(matrix * t) @ start for t in times])[:, :2]
    motion += 0.03 * np.std(motion, axis=0) * np.random.default_rng(seed).standard_normal(motion.shape)
    channels = tuple(Channel(times, motion[:, dof], dof=dof) for dof in (0, 1))
    nominal = {"m1": 3.8, "m2": 3.6, "c1": 1.0, "c2": 2.0, "k1": 750.0, "k2": 1700.0}
    log_sd = {name: {"m": 0.02, "c": 1.0, "k": 0.3}[name[0]] for name in nominal}
    problem = Problem(
        Chain(2),
        (Record(channels, (), InitialState(start[:2], start[2:])),),
        Prior(nominal, log_sd),
    )
    return problem, np.sqrt(np.sort(np.linalg.eigvals(inverse @ stiffness).real)) / (2 * np.pi)


@pytest.mark.parametrize("method", ["shooting", pytest.param("ekf", marks=pytest.mark.slow)])
def test_several_modes_beyond_the_band_are_found_or_the_answer_names_them(method: str) -> None:
    """Of 4 repeats at 32 dB the frequencies of the answer or of an alternative are the true ones."""
    for seed in range(4):
        problem, true = chain_sampled_rarely(seed)
        estimate = answer(method, problem)
        parts = (estimate, *estimate.alternatives)
        assert any(natural_frequencies(problem, part) == pytest.approx(true, rel=0.02) for part in parts), seed
