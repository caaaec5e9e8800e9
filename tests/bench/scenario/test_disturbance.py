"""Each disturbance does what it says and nothing else: against closed forms and the laws it is defined by."""

from __future__ import annotations

import math
import pickle
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bench import InputError
from bench.information.fisher import compute_bound
from bench.scenario.disturbance import Disturbance, kinds
from bench.scenario.scenario import METHOD, ForceSpec, PriorSpec, Scenario
from bench.store.bounds import Replicates, bound_identity
from bench.store.cell import Cell

TRUE = {"m": 1.2, "c": 0.5, "k": 9.0}
X0, V0 = 0.9, 0.3
DEFAULTS: dict[str, dict[str, float]] = {
    "integrator": {"size": 1e-9}, "jitter": {"size": 0.02}, "irregular": {"size": 1.0}, "coloured": {"size": 0.7},
    "heavy_tails": {"size": 3.0}, "outliers": {"size": 10.0, "share": 0.08}, "bias": {"size": 0.05},
    "drift": {"size": 0.1}, "late_trigger": {"size": 0.02}, "added_friction": {"size": 0.02},
    "cubic_spring": {"size": 0.2}, "second_mode": {"size": 0.1},
}  # fmt: skip
NOMINAL = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})
BASE = Scenario("sdof", TRUE, ((X0,), (V0,)), 20.0, prior=NOMINAL, dense=50)
CHAIN = replace(
    BASE,
    system="chain",
    parameters={"m1": 1.0, "m2": 0.8, "c1": 0.2, "c2": 0.15, "k1": 12.0, "k2": 9.0},
    initial=((1.0, 0.0), (0.0, 0.0)),
    options={"n": 2},
)
DUFFING = replace(BASE, system="duffing", parameters={**TRUE, "k3": 5.0})
FORCED = replace(BASE, force=ForceSpec(1.0, 0.1, 1.0, samples=21))


def disturbed(kind: str, scenario: Scenario = BASE, **settings: float) -> Scenario:
    return replace(scenario, disturbance=Disturbance.from_dict({"kind": kind, **DEFAULTS[kind], **settings}))


def motion(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity of the free response, from its textbook form."""
    a = TRUE["c"] / (2 * TRUE["m"])
    w = math.sqrt(TRUE["k"] / TRUE["m"] - a * a)
    b = (V0 + a * X0) / w
    cosine, sine, decay = np.cos(w * times), np.sin(w * times), np.exp(-a * times)
    x = decay * (X0 * cosine + b * sine)
    return x, -a * x + decay * w * (b * cosine - X0 * sine)


def values(scenario: Scenario, n: int) -> np.ndarray:
    """Samples of the first replicates, shape (n, n_dof, samples)."""
    return np.array([[c.values for c in p.records[0].channels] for p, _ in scenario.replicates(0, n)])


def times(scenario: Scenario, n: int) -> np.ndarray:
    """Stated times of the first replicates, shape (n, samples)."""
    return np.array([p.records[0].channels[0].times for p, _ in scenario.replicates(0, n)])


def noise(scenario: Scenario, n: int) -> np.ndarray:
    """Samples less the closed form at their stated times, in standard deviations, shape (n, samples)."""
    clean = motion(np.linspace(0.0, 10.0, scenario.samples))[0]
    sigma = math.sqrt(np.mean(clean**2) / 10 ** (scenario.snr_db / 10))
    return (values(scenario, n)[:, 0] - np.array([motion(t)[0] for t in times(scenario, n)])) / sigma


@pytest.mark.parametrize(
    "scenario",
    [BASE, *(pytest.param(scenario, marks=pytest.mark.slow) for scenario in (FORCED, DUFFING, CHAIN))],
    ids=["one mass", "forced", "Duffing", "two masses"],
)
def test_another_integrator_changes_nothing_beyond_its_tolerance(scenario: Scenario) -> None:
    ((plain_problem, plain),) = scenario.replicates(0, 1)
    ((moved_problem, moved),) = disturbed("integrator", scenario).replicates(0, 1)
    sigma = min(plain.sigma)
    for here, there in zip(plain_problem.records[0].channels, moved_problem.records[0].channels, strict=True):
        assert 0 < np.max(np.abs(there.values - here.values)) < 1e-6 * sigma
    assert 0 < np.max(np.abs(moved.dense_displacement - plain.dense_displacement)) < 1e-6 * sigma
    np.testing.assert_allclose(moved.forecast_displacement, plain.forecast_displacement, atol=1e-6 * sigma)


def test_jitter_is_normal_with_its_part_of_the_step_and_not_told() -> None:
    """From (sample - closed form at the stated time) / velocity, to first order, where the mass is fast."""
    scenario = disturbed("jitter", replace(BASE, snr_db=200.0))
    stated = times(scenario, 400)
    np.testing.assert_array_equal(stated, np.tile(np.linspace(0.0, 10.0, 25), (400, 1)))
    x, v = motion(stated[0])
    off = values(scenario, 400)[:, 0] - x
    np.testing.assert_allclose(off[:, 0], 0.0, atol=1e-8)  # the first sample starts the clock
    fast = np.abs(v) > 0.7 * np.exp(-TRUE["c"] / (2 * TRUE["m"]) * stated[0]) * np.max(np.abs(v))
    fast[0] = False
    z = off[:, fast] / v[fast] / (0.02 * 10 / 24)
    assert z.shape[1] > 5
    assert stats.kstest(z.ravel(), "norm").pvalue > 1e-4
    assert np.max(np.abs(np.corrcoef(z.T) - np.eye(z.shape[1]))) < 5 / math.sqrt(400)


def test_irregular_times_are_uniform_and_told_as_they_are() -> None:
    scenario = disturbed("irregular", replace(BASE, snr_db=200.0))
    told = times(scenario, 200)
    np.testing.assert_array_equal(told[:, [0, -1]], np.tile([0.0, 10.0], (200, 1)))
    assert np.all(np.diff(told, axis=1) > 0)
    assert stats.kstest(told[:, 1:-1].ravel() / 10.0, "uniform").pvalue > 1e-4
    # order statistics of 23 uniform times: the i-th is Beta(i, 24 - i)
    assert stats.kstest(told[:, 5] / 10.0, stats.beta(5, 19).cdf).pvalue > 1e-4
    np.testing.assert_allclose(values(scenario, 200)[:, 0], motion(told)[0], atol=1e-8)
    half = times(disturbed("irregular", replace(BASE, snr_db=200.0), size=0.5), 200)
    np.testing.assert_allclose(half, 0.5 * (told + np.linspace(0.0, 10.0, 25)), atol=1e-12)


@pytest.mark.slow
def test_coloured_noise_is_autoregressive_and_of_the_stated_variance() -> None:
    n = 2000
    z = noise(disturbed("coloured"), n)
    for column in (0, 1, 12, 24):  # stationary from the first sample on
        assert stats.kstest(z[:, column], "norm").pvalue > 1e-4
    correlation = np.corrcoef(z.T)
    lags = np.abs(np.subtract.outer(np.arange(25), np.arange(25)))
    # the sample correlation of a normal pair has standard deviation (1 - rho²) / sqrt(n)
    assert np.max(np.abs(correlation - 0.7**lags) * math.sqrt(n) / np.maximum(1 - 0.49**lags, 1e-6)) < 5
    chain = values(disturbed("coloured", CHAIN), n) - values(disturbed("coloured", CHAIN), n).mean(0)
    across = np.mean(chain[:, 0] * chain[:, 1], axis=0) / chain.std(axis=0).prod(axis=0)
    assert np.max(np.abs(across)) < 5 / math.sqrt(n)


def test_heavy_tails_are_students_with_the_stated_variance() -> None:
    z = noise(disturbed("heavy_tails"), 800).ravel()
    law = stats.t(3.0, scale=math.sqrt(1.0 / 3.0))  # variance 3 scaled to 1
    assert stats.kstest(z, law.cdf).pvalue > 1e-4
    share = 2 * law.sf(4.0)
    assert np.mean(np.abs(z) > 4.0) == pytest.approx(share, abs=5 * math.sqrt(share / z.size))
    assert share > 50 * 2 * stats.norm.sf(4.0)
    lighter = noise(disturbed("heavy_tails", size=10.0), 800).ravel()
    assert np.var(lighter) == pytest.approx(1.0, abs=5 * math.sqrt((3 + 6 / (10 - 4) - 1) / z.size))
    assert np.var(noise(disturbed("heavy_tails", size=1e5), 400)) == pytest.approx(1.0, abs=5 * math.sqrt(2 / 1e4))


@pytest.mark.parametrize(("samples", "count"), [(5, 1), (25, 2), (100, 8)])
def test_outliers_are_so_many_so_much_larger_and_anywhere(samples: int, count: int) -> None:
    scenario = replace(BASE, samples=samples)
    plain, hit = noise(scenario, 500), noise(disturbed("outliers", scenario), 500)
    larger = ~np.isclose(plain, hit, rtol=1e-6, atol=1e-9)
    assert set(larger.sum(axis=1)) == {count}
    np.testing.assert_allclose(hit[larger], 10.0 * plain[larger], rtol=1e-6)
    assert stats.chisquare(larger.sum(axis=0)).pvalue > 1e-4
    # all others 1, these 100: the variance of the mixture
    share = count / samples
    sd = math.sqrt((share * 2 * 100**2 + (1 - share) * 2) / hit.size)
    assert np.mean(hit**2) == pytest.approx(1 - share + 100 * share, abs=5 * sd)


@pytest.mark.parametrize(("kind", "shape"), [("bias", np.full(25, 0.05)), ("drift", np.linspace(0.0, 0.1, 25))])
def test_a_sensor_error_is_a_part_of_the_rms_the_same_in_every_replicate(kind: str, shape: np.ndarray) -> None:
    clean = motion(np.linspace(0.0, 10.0, 25))[0]
    error = shape * math.sqrt(np.mean(clean**2))
    np.testing.assert_allclose((values(disturbed(kind), 3) - values(BASE, 3))[:, 0], np.tile(error, (3, 1)), atol=1e-12)
    chain = values(disturbed(kind, CHAIN), 1)[0] - values(CHAIN, 1)[0]
    np.testing.assert_allclose(chain, CHAIN.sigmas(0)[:, None] * 10.0 * shape, atol=1e-12)  # 20 dB: ten times sigma
    problem, _ = disturbed(kind).replicates(0, 1)[0]
    assert not problem.records[0].channels[0].offset


def test_a_late_trigger_starts_the_clock_late_and_tells_the_start_of_the_motion() -> None:
    scenario, sampled = disturbed("late_trigger", size=0.1), np.linspace(0.0, 10.0, 25)
    problem, truth = scenario.replicates(0, 1)[0]
    record = problem.records[0]
    np.testing.assert_array_equal(record.channels[0].times, sampled)
    late = motion(sampled + 0.1)[0] - motion(sampled)[0]
    np.testing.assert_allclose(values(scenario, 2) - values(BASE, 2), np.tile(late, (2, 1, 1)), atol=1e-12)
    assert (record.initial_state.displacement[0], record.initial_state.velocity[0]) == (X0, V0)
    x, v = motion(np.array([0.1]))
    assert truth.initial_state.displacement == pytest.approx(x, rel=1e-9)
    assert truth.initial_state.velocity == pytest.approx(v, rel=1e-9)
    # scored in the time of the record, so that who estimates the start is not wrong by the delay
    np.testing.assert_allclose(truth.dense_displacement[0], motion(truth.dense_times + 0.1)[0], atol=1e-12)
    np.testing.assert_allclose(truth.forecast_displacement[0], motion(truth.forecast_times + 0.1)[0], atol=1e-12)


@pytest.mark.parametrize("kind", kinds())
def test_base_noise_level_and_nominal_values_are_those_of_the_undisturbed_scenario(kind: str) -> None:
    other = disturbed(kind)
    for (plain, truth), (problem, moved) in zip(BASE.replicates(1, 3), other.replicates(1, 3), strict=True):
        assert problem.prior.nominal == plain.prior.nominal
        assert moved.sigma == truth.sigma
        assert moved.parameters == truth.parameters
    assert other.stream(METHOD, 1, 2, 3).standard_normal() == BASE.stream(METHOD, 1, 2, 3).standard_normal()


def test_the_realised_snr_counts_all_that_the_samples_are_off_by() -> None:
    problem, truth = disturbed("bias", size=1.0).replicates(0, 1)[0]
    clean = motion(np.linspace(0.0, 10.0, 25))[0]
    off = problem.records[0].channels[0].values - clean
    assert truth.realised_snr_db == pytest.approx(10 * math.log10(np.sum(clean**2) / np.sum(off**2)))
    assert truth.realised_snr_db < 3.0


@pytest.mark.parametrize("kind", kinds())
def test_a_problem_says_nothing_of_its_disturbance(kind: str) -> None:
    size = 0.0198765 if DEFAULTS[kind]["size"] < 1 and kind != "integrator" else DEFAULTS[kind]["size"]
    scenario = disturbed(kind, replace(BASE, initial_state="unknown"), size=size)
    payload = pickle.dumps(scenario.replicates(0, 1)[0][0])
    assert b"isturb" not in payload
    assert kind.encode() not in payload
    if size == 0.0198765:
        assert struct.pack("<d", size) not in payload


def test_a_disturbance_is_part_of_the_identity_and_its_absence_is_not() -> None:
    assert "disturbance" not in BASE.data_identity()
    scenarios = [BASE, *map(disturbed, kinds()), disturbed("bias", size=0.1), disturbed("outliers", share=0.1)]
    assert len({Cell(s, "ls", {}, 20, 0, "ls").identity for s in scenarios}) == len(scenarios)
    assert len({s.disturbance for s in scenarios}) == len(scenarios)
    same = Cell(disturbed("irregular", size=1), "ls", {}, 20, 0, "ls").identity
    assert same == Cell(disturbed("irregular", size=1.0), "ls", {}, 20, 0, "ls").identity


def test_the_bound_is_that_of_the_undisturbed_scenario() -> None:
    small = replace(BASE, dense=25, forecast=0.5)
    untold = set(kinds()) - {"irregular"}
    found = {bound_identity(Replicates(disturbed(kind, small))) for kind in untold}
    assert found == {bound_identity(Replicates(small))}
    irregular = disturbed("irregular", small)
    assert len({bound_identity(Replicates(irregular, seed, n)) for seed, n in ((0, 1), (0, 2), (1, 1))} - found) == 3
    assert compute_bound(disturbed("late_trigger", small, size=1.0)) == compute_bound(small)


@pytest.mark.parametrize("kind", DEFAULTS)
@pytest.mark.parametrize("size", [0.0, math.nan, math.inf])
def test_a_size_out_of_its_range_is_refused(kind: str, size: float) -> None:
    with pytest.raises(InputError, match=r"disturbance\.size="):
        Disturbance.from_dict({"kind": kind, **DEFAULTS[kind], "size": size})


@pytest.mark.parametrize(
    ("stated", "line"),
    [
        ({"kind": "outliers", "size": 10.0, "share": 0.0}, "disturbance.share=0.0: between 0 and 1"),
        ({"kind": "outliers", "size": 10.0}, "disturbance=outliers: its settings are size and share"),
        ({"kind": "bias", "size": 0.1, "share": 0.1}, "disturbance=bias: its settings are size"),
        ({"kind": "shake", "size": 0.1}, "disturbance.kind=shake: known"),
    ],
)
def test_settings_that_make_no_sense_are_refused(stated: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError) as caught:
        Disturbance.from_dict(stated)
    assert str(caught.value).startswith(line)


@pytest.mark.parametrize("kind", ["jitter", "irregular", "outliers", "bias"])
@pytest.mark.parametrize("shape", [BASE, FORCED, replace(BASE, added_mass=(0.5,), initial_state="known")])
def test_an_example_has_all_of_a_replicate_but_the_motion(shape: Scenario, kind: str) -> None:
    """Times, forces, added masses, what is known of the start and the prior are those of replicate 0."""
    scenario = disturbed(kind, shape)
    example, (problem, _) = scenario.example(3), scenario.maker(3)(0)
    assert example.prior == problem.prior
    for blank, record in zip(example.records, problem.records, strict=True):
        for channel, other in zip(blank.channels, record.channels, strict=True):
            np.testing.assert_array_equal(channel.times, other.times)
            assert channel.values.shape == other.values.shape
            assert not np.any(channel.values == other.values)
        forces = [[force.values for force in each.forces] for each in (blank, record)]
        np.testing.assert_array_equal(*forces)
        assert (blank.added_mass is None, blank.initial_state is None) == (
            record.added_mass is None, record.initial_state is None
        )  # fmt: skip
