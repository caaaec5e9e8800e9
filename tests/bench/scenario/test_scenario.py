"""Data: noise as the SNR defines it, streams that never meet, a calibrated prior, and no truth in a problem."""

from __future__ import annotations

import math
import pickle
import pickletools
import struct
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bench import InputError
from bench.scenario.declaration import validated
from bench.scenario.scenario import ForceSpec, PriorSpec, Scenario, config_path
from bench.scenario.truth import closed_form
from bench.store.cell import Cell

TRUE = {"m": 1.2345678901, "c": 0.4567890123, "k": 8.7654321098}
NOMINAL = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})
BASE = Scenario("sdof", TRUE, ((0.87654321,), (0.34567891,)), 20.0, prior=NOMINAL, dense=50)
CHAIN = replace(
    BASE,
    system="chain",
    parameters={"m1": 1.0, "m2": 0.8, "c1": 0.2, "c2": 0.15, "k1": 12.0, "k2": 9.0},
    initial=((1.0, 0.0), (0.0, 0.0)),
    options={"n": 2},
)


def clean_samples(times: np.ndarray) -> np.ndarray:
    """The free response in its textbook form."""
    a = TRUE["c"] / (2 * TRUE["m"])
    w = math.sqrt(TRUE["k"] / TRUE["m"] - a * a)
    x0, v0 = 0.87654321, 0.34567891
    return np.asarray(np.exp(-a * times) * (x0 * np.cos(w * times) + (v0 + a * x0) / w * np.sin(w * times)))


def data(scenario: Scenario, seed: int = 0, n: int = 3) -> np.ndarray:
    """Measured values of the first replicates, one row each."""
    problems = [problem for problem, _ in scenario.replicates(seed, n)]
    return np.array([np.concatenate([c.values for c in p.records[0].channels]) for p in problems])


def noise(scenario: Scenario, seed: int = 0, n: int = 3) -> np.ndarray:
    """Measured minus clean samples, in standard deviations."""
    sigma = scenario.sigmas(seed)
    times = scenario.times
    clean = scenario._response(times, seed)
    return (data(scenario, seed, n) - clean.ravel()) / np.repeat(sigma, times.size)


def test_a_sample_is_the_response_plus_noise_of_the_variance_that_the_snr_defines() -> None:
    """σ² = mean square of the clean samples / 10^(SNR/10); over 400 replicates it is χ² with 10,000 degrees."""
    for snr in (40.0, 5.0):
        scenario = replace(BASE, snr_db=snr)
        clean = clean_samples(np.linspace(0.0, 10.0, 25))
        sigma = math.sqrt(np.mean(clean**2) / 10 ** (snr / 10))
        assert scenario.sigmas(0)[0] == pytest.approx(sigma, rel=1e-9)
        z = (data(scenario, n=400) - clean) / sigma
        assert np.var(z) == pytest.approx(1.0, abs=5 * math.sqrt(2 / z.size))
        assert np.mean(z) == pytest.approx(0.0, abs=5 / math.sqrt(z.size))
        assert stats.kstest(z.ravel(), "norm").pvalue > 1e-4


def test_what_a_truth_says_of_the_noise() -> None:
    problem, truth = BASE.replicates(0, 1)[0]
    clean = clean_samples(np.linspace(0.0, 10.0, 25))
    error = problem.records[0].channels[0].values - clean
    assert truth.realised_snr_db == pytest.approx(10 * math.log10(np.sum(clean**2) / np.sum(error**2)), abs=1e-6)
    dense = clean_samples(np.linspace(0.0, 10.0, 50))
    np.testing.assert_allclose(truth.dense_displacement[0], dense, atol=1e-12)
    assert truth.sigma_over_peak == pytest.approx(truth.sigma[0] / np.max(np.abs(dense)))
    later = truth.forecast_times
    assert later[0] > 10.0
    assert later[-1] == pytest.approx(20.0)
    np.testing.assert_allclose(truth.forecast_displacement[0], clean_samples(later), atol=1e-12)


def test_noise_of_a_chain_is_scaled_channel_by_channel() -> None:
    sigma = CHAIN.sigmas(0)
    _, truth = CHAIN.replicates(0, 1)[0]
    assert truth.sigma == pytest.approx(tuple(sigma))
    assert sigma[0] != pytest.approx(sigma[1], rel=0.01)
    z = noise(CHAIN, n=300).reshape(300, 2, 25)
    assert np.var(z, axis=(0, 2)) == pytest.approx([1.0, 1.0], abs=5 * math.sqrt(2 / 7500))
    assert np.corrcoef(z[:, 0].ravel(), z[:, 1].ravel())[0, 1] == pytest.approx(0.0, abs=5 / math.sqrt(7500))


@pytest.mark.parametrize(
    "changes",
    [
        {"initial_state": "unknown"},
        {"prior": None},
        {"prior": PriorSpec("handbook", NOMINAL.sd_by_kind, True)},
        {"label": "x"},
    ],
    ids=["start", "no prior", "wrong prior", "label"],
)
def test_data_do_not_depend_on_what_a_method_is_told(changes: dict[str, Any]) -> None:
    np.testing.assert_array_equal(data(replace(BASE, **changes)), data(BASE))


def test_a_replicate_does_not_depend_on_how_many_there_are() -> None:
    np.testing.assert_array_equal(data(BASE, n=7)[:2], data(BASE, n=2))
    nominal = [[p.prior.nominal for p, _ in BASE.replicates(0, n)][:2] for n in (2, 7)]
    assert nominal[0] == nominal[1]


def test_the_data_are_the_same_in_another_process(python: Callable[..., Any]) -> None:
    """Nothing may hang on the hash seed or on the order of a set."""
    script = (
        "from bench.scenario.scenario import *;"
        f"s = Scenario('sdof', {TRUE!r}, {BASE.initial!r}, 20.0, prior=PriorSpec('n', {dict(NOMINAL.sd_by_kind)!r}));"
        "p = s.replicates(3, 1)[0][0]; print(p.records[0].channels[0].values.tobytes().hex(), p.prior.nominal)"
    )
    there = python("-c", script, env={"PYTHONHASHSEED": "1"}).stdout
    problem = BASE.replicates(3, 1)[0][0]
    own = f"{problem.records[0].channels[0].values.tobytes().hex()} {problem.prior.nominal}\n"
    assert there == own


@pytest.mark.parametrize(
    "other",
    [
        replace(BASE, snr_db=21.0),
        replace(BASE, parameters={**TRUE, "c": 0.5}),
        replace(BASE, initial=((0.9,), (0.0,))),
        replace(BASE, duration=11.0),
        replace(BASE, force=ForceSpec(1.0, 0.1, 1.0)),
    ],
    ids=["snr", "parameter", "start", "duration", "force"],
)
def test_another_scenario_has_another_noise(other: Scenario) -> None:
    one, two = noise(BASE, n=40).ravel(), noise(other, n=40).ravel()
    assert abs(np.corrcoef(one, two)[0, 1]) < 5 / math.sqrt(one.size)


def test_seeds_replicates_and_axes_are_different_streams() -> None:
    by_seed = np.concatenate([noise(BASE, seed, 4) for seed in (0, 1)])
    correlation = np.corrcoef(by_seed) - np.eye(8)
    assert np.max(np.abs(correlation)) < 5 / math.sqrt(25)
    assert len({tuple(np.round(row, 9)) for row in by_seed}) == 8
    firsts = {axis: BASE.stream(axis, 0, 0).standard_normal() for axis in range(4)}
    assert len(set(firsts.values())) == 4
    assert BASE.stream(3, 0, 0, 1).standard_normal() != BASE.stream(3, 0, 0, 2).standard_normal()


def test_the_nominal_prior_is_calibrated_and_independent() -> None:
    """z = (log nominal - log true) / sd is standard normal, parameter by parameter, and never centred on the truth."""
    priors = [problem.prior for problem, _ in BASE.replicates(0, 500)]
    z = np.array([prior.residuals(np.log(list(TRUE.values()))) for prior in priors if prior is not None])
    assert z.shape == (500, 3)
    for column in z.T:
        assert stats.kstest(column, "norm").pvalue > 1e-4
    assert np.max(np.abs(np.corrcoef(z.T) - np.eye(3))) < 5 / math.sqrt(500)
    first = priors[0]
    assert dict(first.log_sd) == {"m": 0.02, "c": 1.0, "k": 0.5}


def test_the_wrong_prior_is_three_standard_deviations_off_to_either_side() -> None:
    wrong = replace(BASE, prior=replace(NOMINAL, wrong=True))
    priors = [problem.prior for problem, _ in wrong.replicates(0, 200)]
    z = np.array([prior.residuals(np.log(list(TRUE.values()))) for prior in priors if prior is not None])
    np.testing.assert_allclose(np.abs(z), 3.0, rtol=1e-9)
    assert np.all(np.abs(np.mean(np.sign(z), axis=0)) < 5 / math.sqrt(200))


def test_the_multisine_has_its_rms_and_its_lines() -> None:
    spec = ForceSpec(2.0, 0.1, 1.0, tones=10, samples=1001)
    force = replace(BASE, force=spec, duration=100.0).forces(0)[0]
    assert np.sqrt(np.mean(force.values[:-1] ** 2)) == pytest.approx(2.0, rel=1e-6)  # whole periods of every tone
    spectrum = np.abs(np.fft.rfft(force.values[:-1])) / 500
    lines = np.flatnonzero(spectrum > 1e-9) / 100.0
    np.testing.assert_allclose(lines, np.linspace(0.1, 1.0, 10))
    np.testing.assert_allclose(spectrum[spectrum > 1e-9], 2.0 * math.sqrt(2 / 10))


def test_a_force_is_the_same_for_every_replicate_and_another_for_another_seed() -> None:
    forced = replace(BASE, force=ForceSpec(1.0, 0.1, 1.0))
    one, two = (problem.records[0].forces[0].values for problem, _ in forced.replicates(0, 2))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, forced.forces(1)[0].values)


@pytest.mark.parametrize("forces", [{}, {"force": ForceSpec(1.0, 0.1, 1.0)}], ids=["free", "forced"])
def test_the_bytes_that_a_method_gets_hold_no_true_value(forces: dict[str, Any]) -> None:
    problem, truth = replace(BASE, initial_state="unknown", **forces).replicates(0, 1)[0]
    payload = pickle.dumps(problem)
    assert struct.pack(">d", problem.prior.nominal["m"]) in payload  # numbers are seen
    for value in (*TRUE.values(), 0.34567891, truth.sigma[0], truth.realised_snr_db):
        assert struct.pack("<d", value) not in payload
        assert struct.pack(">d", value) not in payload
    words = " ".join(str(argument) for _, argument, _ in pickletools.genops(payload))
    assert "Problem" in words
    assert not [name for name in ("Truth", "cenario", "PriorSpec", "Cell", "Bound") if name in words]


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"snr_db": math.nan}, "snr=nan: input should be a finite number"),
        ({"parameters": {**TRUE, "m": -1.0}}, "system.parameters.m=-1.0: input should be greater than 0"),
        ({"parameters": {"m": 1.0}}, "system.parameters=['m']: needed: m, c, k"),
        ({"initial": ((1.0, 2.0), (0.0,))}, "system.initial=[1.0, 2.0]: 1 finite number(s), one a DOF"),
        ({"initial": ((0.0,), (0.0,))}, "system.initial=[[0.0], [0.0]]: a start away from rest"),
        ({"samples": 2}, "system.samples=2: input should be greater than or equal to 3"),
        ({"system": "beam"}, "system=beam: known systems"),
        ({"measured": (1,)}, "system.measured=[1]: DOFs with a sensor"),
        ({"measured": ()}, "system.measured=[]: DOFs with a sensor"),
        ({"added_mass": (0.0,)}, "system.added_mass=[0.0]: 1 mass(es) in kg"),
        ({"added_mass": (math.inf,)}, "system.added_mass.0=inf: input should be a finite number"),
    ],
)
def test_a_scenario_that_makes_no_sense_is_refused(changes: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError) as caught:
        validated(
            Scenario,
            {**{f.name: getattr(BASE, f.name) for f in fields(BASE)}, **changes},
            {f.name: config_path(f) for f in fields(BASE)},
        )
    assert str(caught.value).startswith(line)


def test_a_cell_is_known_by_what_it_computes() -> None:
    cell = Cell(BASE, "ls", {"a": 1}, 20, 0, "ls")
    assert replace(cell, label="other").identity == cell.identity
    assert replace(cell, scenario=replace(BASE, label="other")).identity == cell.identity
    same = replace(BASE, snr_db=20, parameters=dict(reversed(TRUE.items())))
    assert replace(cell, scenario=same).identity == cell.identity
    others = [
        replace(cell, method="rls"),
        replace(cell, settings={"a": 2}),
        replace(cell, replicates=21),
        replace(cell, seed=1),
        replace(cell, scenario=replace(BASE, initial_state="unknown")),
        replace(cell, scenario=replace(BASE, prior=None)),
        replace(cell, scenario=replace(BASE, snr_db=21.0)),
        replace(cell, scenario=replace(BASE, dense=60)),
    ]
    assert len({c.identity for c in [cell, *others]}) == 1 + len(others)


def test_a_drawn_truth_lies_around_the_nominal_values_as_the_prior_says(reference: Scenario) -> None:
    """Simulation-based calibration: log(truth / nominal) over the prior's width is standard normal."""
    assert reference.prior is not None
    drawn = replace(reference, prior=replace(reference.prior, draws="truth"))
    pairs = drawn.replicates(3, 200)
    assert {tuple(problem.prior.nominal.items()) for problem, _ in pairs if problem.prior} == {
        tuple(reference.parameters.items())
    }
    widths = {"m": 0.02, "c": 1.0, "k": 0.5}
    for name, width in widths.items():
        z = np.log([truth.parameters[name] / reference.parameters[name] for _, truth in pairs]) / width
        assert stats.kstest(z, "norm").pvalue > 0.01
    # the data are those of the drawn truth, at the drawn noise
    problem, truth = pairs[0]
    clean = closed_form(truth.parameters, 1.0, 0.0, reference.times)
    z = (problem.records[0].channels[0].values - clean) / truth.sigma[0]
    assert 0.5 < np.std(z) < 1.5
    assert np.ptp([truth.realised_snr_db for _, truth in pairs]) > 15.0
    assert drawn.data_identity() != reference.data_identity()
