"""Plans of free decays: the closed form agrees with the harness's bound, and simulated tests keep what was promised."""

import dataclasses
import math

import numpy as np
import pytest

from bench.commands.main import main
from bench.entrants.registry import make_method
from bench.information.fisher import compute_bound
from bench.planning.free_decay import Decay, Oscillator, errors, information, motion
from bench.planning.search import SHARE, Likely, as_point, cheapest, proposal
from bench.planning.verify import share_within, simulate_decays
from bench.scenario.scenario import Scenario

GIVEN = ["want=c_over_m:5%", "frequency=2", "damping=0.02", "noise=0.5mm"]


@pytest.mark.parametrize("ratio", [0.002, 0.05, 0.7, 1.0, 1.4])
def test_the_closed_form_is_the_bound_of_the_benchmark(ratio: float) -> None:
    omega, samples, duration, amplitude = 2 * math.pi * 1.5, 60, 2.0, 25.0
    values = amplitude * motion(Oscillator(1.5, ratio), np.linspace(0, duration, samples))[0]
    snr = 10 * math.log10(np.mean(values**2))
    scenario = Scenario(
        "sdof", {"m": 2.0, "c": 4.0 * ratio * omega, "k": 2.0 * omega**2}, ((amplitude,), (0.0,)), snr,
        duration=duration, samples=samples, initial_state="unknown",
    )  # fmt: skip
    bound = compute_bound(scenario).relative_sd
    found = errors(information(Oscillator(1.5, ratio), Decay(samples, duration, amplitude)))
    for name in ("k_over_m", "c_over_m"):
        assert found[name] == pytest.approx(bound[name], rel=1e-6)


def test_derivatives_are_those_of_differences() -> None:
    times, start = np.linspace(0, 3, 40), (0.7, -2.0)
    _, found = motion(Oscillator(0.8, 0.1), times, start)
    step = 1e-6  # k/m is moved at constant c/m
    up, down = (
        motion(Oscillator(0.8 * math.exp(s / 2), 0.1 * math.exp(-s / 2)), times, start)[0] for s in (step, -step)
    )
    np.testing.assert_allclose(found[:, 0], (up - down) / (2 * step), atol=1e-7)


def test_no_scanned_test_with_fewer_samples_reaches_the_error() -> None:
    likely = Likely(2.0, 0.02)
    found = cheapest(likely, "c_over_m", 0.05, 20.0)
    assert found.nominal["c_over_m"] <= 0.05
    fewer = round(0.97 * found.decay.samples)
    for duration in np.geomspace(0.3, 100, 300):
        if fewer > 2.5 * 2.0 * duration + 1:
            assert errors(information(likely.nominal, Decay(fewer, duration, 20.0)))["c_over_m"] > 0.05


def test_who_knows_less_needs_more() -> None:
    sure, unsure = (cheapest(Likely(2.0, 0.02, sd / 4, sd), "c_over_m", 0.05, 20.0) for sd in (0.0, 0.4))
    assert unsure.decay.samples > sure.decay.samples
    assert unsure.share["c_over_m"] <= 0.05
    assert np.mean([errors(information(one, unsure.decay))["c_over_m"] <= 0.05
                    for one in Likely(2.0, 0.02, 0.1, 0.4).drawn(256)]) > SHARE - 0.1  # fmt: skip


def test_a_rate_that_is_given_is_kept_and_one_that_is_too_slow_has_no_test() -> None:
    found = cheapest(Likely(2.0, 0.02), "c_over_m", 0.05, 20.0, rate=40.0)
    assert (found.decay.samples - 1) / found.decay.duration == pytest.approx(40.0, rel=0.05)
    assert cheapest(Likely(2.0, 0.02), "c_over_m", 0.05, 20.0, rate=4.0) is None


def test_a_test_too_noisy_for_its_frequency_is_not_proposed() -> None:
    assert proposal(Likely(2.0, 0.02), Decay(12, 2.0, 0.8)).wrong_basin > 0.05
    assert as_point(Oscillator(2.0, 0.02), Decay(12, 2.0, 0.8)).cycles == pytest.approx(4.0)


@pytest.mark.slow
def test_simulated_tests_are_as_near_as_was_promised() -> None:
    likely = Likely(2.0, 0.02)
    found = cheapest(likely, "c_over_m", 0.05, 20.0)
    off = simulate_decays(likely, found.decay, "c_over_m", make_method("output_error", {}), 200, lambda: None)
    assert share_within(off, 0.05) > 0.90  # 95 % expected; three standard errors of 200
    assert np.sqrt(np.mean(off**2)) == pytest.approx(found.nominal["c_over_m"], rel=0.2)
    worse = dataclasses.replace(found.decay, samples=found.decay.samples // 3)
    assert (
        share_within(
            simulate_decays(likely, worse, "c_over_m", make_method("output_error", {}), 200, lambda: None), 0.05
        )
        < 0.9
    )


def test_the_command_proposes_and_simulates(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    assert main(["design", *GIVEN, "amplitude=1cm", "verify=20"]) == 0
    said = capsys.readouterr().out
    assert "      10  " in said
    assert "Simulated: share of 20 tests" in " ".join(said.split())
    assert main(["design", *GIVEN, "amplitude=1cm", "samples=100", "duration=5"]) == 0
    assert " 100  " in capsys.readouterr().out


def test_units_of_frequency_and_damping_may_be_written(capsys: pytest.CaptureFixture[str]) -> None:
    said = []
    for frequency, damping in (("2", "0.02"), ("2Hz", "2%"), ("2 Hz:0.1%", "2%:0.1%")):
        words = ["want=c_over_m:5%", f"frequency={frequency}", f"damping={damping}", "noise=0.5mm"]
        assert main(["design", *words, "amplitude=1cm", "samples=100", "duration=5"]) == 0
        said.append(capsys.readouterr().out)
    assert said[0] == said[1] != ""


def test_a_damping_that_is_found_to_be_nothing_does_not_spoil_the_stiffness() -> None:
    """Nine samples of a lightly damped motion often fit best without damping."""
    found = simulate_decays(
        Likely(8.6, 0.0017), Decay(9, 0.37, 22.5), "k_over_m", make_method("output_error", {}), 40, lambda: None
    )
    assert np.all(np.isfinite(found))
